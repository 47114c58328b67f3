"""Request for a learned detector: how it is learned, checked once for the command line and for Python."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, usual_method
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.io.validation import HORIZON, Count, Number, Positive, Probability, Strict, describe, shown
from modsim3d.learn.learn_detector import LearnOptions, least_confidence
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.model_selection import left_out

Method = Literal["confidence", "optimal", "centre", "provenance"]


class LearnRequest(Strict):
    """Choices of learning from whatever labelled set; what is not explained is as for `modsim3d.learn_detector`."""

    caller: str  # what messages call the request
    conditions: tuple[str, ...] = ()
    states: tuple[str, ...] = ()  # texts such as `good=day,cloudy`; a state for each condition if there are none
    clusters: Annotated[int, Field(strict=True, ge=1)] | None = None  # number of states to be found by F1 instead
    sequence: str | None = None  # text with the name of a state on each line, in time order
    interval_s: Positive | None = None  # time between two states of the sequence, or between two transitions
    match: Method | None = None
    least_iou: Annotated[float, Field(strict=True, gt=0, le=1)] = 0.5
    most_distance_px: Positive = 50.0
    confidence: Probability | None = None
    confidence_scale: tuple[Number, Number] | None = None
    clutter: Literal["auto", "calibrated", "per_image"] = "auto"  # model of the number of false positives
    replicates: Annotated[int, Field(strict=True, ge=20)] = 300
    seed: Count = 0
    level: Annotated[float, Field(ge=0.5, le=0.9999)] = 0.95  # of the confidence intervals
    beta: Annotated[float, Field(ge=0.01, le=100)] = 2.0  # how many times more recall weighs than precision in F-beta
    without: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    image_size_px: tuple[Positive, Positive] | None = None
    frame_rate_hz: Positive | None = None
    first_frame: Literal[0, 1] | None = None
    horizon: Annotated[Number | tuple[Number, Number, Number, Number] | None, HORIZON] = None
    category_offset: int = 0  # added to the category IDs of COCO results
    skip_bad: bool = False  # whether wrong entries of the files are left out
    check: bool = True  # whether to compare with the real results where it was not learned; not for voyages

    @classmethod
    def of(cls, caller: str, **given: Any) -> Self:
        """A request of what was given. Raises InputError for a value that its key does not take."""
        try:
            request = cls(caller=caller, **given)
        except ValidationError as error:
            raise InputError(caller, describe(error, cls)) from None
        scale = request.confidence_scale
        if scale and not scale[0] < scale[1]:
            raise InputError(caller, [f"confidence_scale: must be two numbers that rise (got {shown(scale)})"])
        left_out(request.without, f"{caller}: without")
        return request

    @property
    def read_options(self) -> ReadOptions:
        """Facts that files do not state themselves."""
        line = self.horizon
        return ReadOptions(
            self.labels,
            self.image_size_px,
            self.skip_bad,
            self.frame_rate_hz,
            self.category_offset,
            self.confidence_scale,
            (line,) if isinstance(line, float) else line,
            self.first_frame,
        )

    def settings(self, labelled: LabelledSet, position_m: float = 0.0) -> LearnSettings:
        """Settings of learning from a labelled set; `position_m` is the standard deviation of each coordinate of
        true positions. Raises ModsimError if a least confidence is asked for, and detections have no confidences."""
        method = self.match or usual_method(labelled, position_m)
        return LearnSettings(
            Rule(method, self.least_iou, self.most_distance_px),
            least_confidence(labelled, self.confidence),
            self.replicates,
            self.seed,
            self.clutter,
            left_out(self.without, f"{self.caller}: without"),
        )

    def options(self, interval_s: float | None = None) -> LearnOptions:
        """Options besides; `interval_s` is the time between transitions if none is asked for."""
        interval_s = interval_s if self.interval_s is None else self.interval_s
        return LearnOptions(self.states, self.clusters, self.sequence, interval_s, self.level, self.beta)


def parse_match(text: str | None) -> dict[str, Any]:
    """Method and limit of matches, from a text such as `optimal`, `confidence:0.4` or `centre:30`; none without one.
    Raises ModsimError if there is no such method, or no such limit."""
    if text is None:
        return {}
    method, colon, limit = text.partition(":")
    name = {"confidence": "least_iou", "optimal": "least_iou", "centre": "most_distance_px"}.get(method)
    try:
        value = float(limit) if colon else None
    except ValueError:
        name, method = None, ""
    if method not in ("confidence", "optimal", "centre", "provenance") or (colon and name is None):
        needed = "confidence or optimal, with a least IoU as in optimal:0.4, centre, with a distance as in centre:30"
        raise ModsimError(f"--match {text}: needs {needed}, or provenance")
    return {"match": method} if value is None else {"match": method, str(name): value}


def parse_states(given: int | Mapping[str, Sequence[str]] | Sequence[str] | None, caller: str) -> dict[str, Any]:
    """States of a `LearnRequest` from a mapping, texts such as `good=day,cloudy`, or their number; else InputError."""
    if given is None:
        return {}
    if isinstance(given, list) and len(given) == 1 and given[0].isdecimal() and int(given[0]):
        given = int(given[0])
    if isinstance(given, list):
        return {"states": tuple(given)}
    if isinstance(given, int) and not isinstance(given, bool) and given > 0:
        return {"clusters": given}
    if isinstance(given, Mapping):
        named = {name: [of] if isinstance(of, str) else of for name, of in given.items()}
        if all(isinstance(of, Sequence) and all(isinstance(each, str) for each in of) for of in named.values()):
            return {"states": tuple(f"{name}={','.join(of)}" for name, of in named.items())}
    needed = "a number of states from 1, or a mapping from states to lists of conditions, is needed"
    raise InputError(caller, [f"states: {needed} (got {shown(given)})"])
