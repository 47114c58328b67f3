"""The keys of a campaign file."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_serializer, model_validator

from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import HORIZON, NeedText, Number, Positive, Strict, describe, kind_of, nearest
from modsim3d.tracking.trackers.command import DEFAULT_TIMEOUT_S
from modsim3d.tracks.tracks import SimilarityName
from modsim3d.tracks.true_tracks import DEFAULT_GAP_S, TruthName

MAX_SEEDS = 1_000_000
MAX_DETECTOR_SEEDS = 1_000
MAX_BASE = 9_000
Scalar = str | int | float | bool | None


def _checked_share(value: float) -> float:
    if value == 1:
        raise ValueError("no number of runs shows that every seed is right: ask for a share below 1, as in 0.99")
    if not 0 < value < 1:
        raise ValueError(f"needs a share between 0 and 1, as in 0.99 (got {value:g})")
    return value


def _checked_confidence(value: float) -> float:
    if not 0.5 <= value < 1:
        raise ValueError(f"needs a probability of 0.5 or more and below 1, as in 0.95 (got {value:g})")
    return value


Share = Annotated[float, Field(strict=True), AfterValidator(_checked_share)]
Confidence = Annotated[float, Field(strict=True), AfterValidator(_checked_confidence)]
Text = Annotated[str, Field(min_length=1)]
Layer = Literal["truth", "detections", "tracks"]
TIMES = ("frame_ms_median", "frame_ms_p99", "frame_ms_max", "peak_memory_mb")
"""Scores of what a tracker took in a run: of its working times for a frame, or for a step of all cameras, and of the
memory of a program."""


class Seeds(Strict):
    """Numbers of repetitions."""

    traffic: Annotated[int, Field(strict=True, ge=1, le=MAX_SEEDS)] = 1  # of the scene: the unit of every interval
    detector: Annotated[int, Field(strict=True, ge=1, le=MAX_DETECTOR_SEEDS)] = 1  # for each traffic seed


class Range(Strict):
    """Values that a drawn key may have: all between two numbers, or one of some."""

    low: Number | None = None
    high: Number | None = None
    scale: Literal["linear", "log"] = "linear"  # log: equally often in each decade
    whole: bool = False  # only whole numbers are drawn
    choices: Annotated[list[Any], Field(min_length=1)] | None = None  # of any kind, in place of the numbers

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        """`[0.5, 3]` stands for `{low: 0.5, high: 3}`."""
        if isinstance(value, list):
            if len(value) != 2:
                raise ValueError(f"a range is two numbers, as in [0.5, 3] (got {len(value)} values)")
            return {"low": value[0], "high": value[1]}
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.choices is not None:
            if self.low is not None or self.high is not None:
                raise ValueError("give either choices, or low and high")
            return self
        if self.low is None or self.high is None:
            raise ValueError("low and high are needed, or choices")
        if not self.low < self.high:
            raise ValueError(f"low must be below high (got {self.low:g} and {self.high:g})")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"with scale log, low must be above 0 (got {self.low:g})")
        if self.whole and not (self.low.is_integer() and self.high.is_integer()):
            raise ValueError(f"with whole, low and high must be whole numbers (got {self.low:g} and {self.high:g})")
        return self


Ranges = Annotated[dict[Text, Range], Field(min_length=1)]
Values = Annotated[dict[Text, Annotated[list[Any], Field(min_length=1)]], Field(min_length=1)]
Conditions = Annotated[list[Annotated[dict[Text, Any], Field(min_length=1)]], Field(min_length=1)]


class Factor(Strict):
    """One thing that is varied; the conditions of a campaign are all combinations of its factors."""

    grid: Values | None = None  # every combination is taken
    pairs: Values | None = None  # they change together: all first values, all second ones, …
    conditions: Conditions | None = Field(default=None, alias="list")  # written out: mappings of keys to values
    latin_hypercube: Ranges | None = None  # each traffic seed gets a point of one Latin hypercube
    uniform: Ranges | None = None  # each traffic seed gets a point drawn by itself

    @property
    def ranges(self) -> dict[str, Range]:
        """The ranges of the keys that are drawn; none if the factor has values."""
        return self.latin_hypercube or self.uniform or {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [field.alias or name for name, field in type(self).model_fields.items()]
        given = sum(getattr(self, name) is not None for name in type(self).model_fields)
        if given != 1:
            raise ValueError(f"give exactly one of {', '.join(names)} (got {given})")
        if self.pairs is not None and len({len(values) for values in self.pairs.values()}) > 1:
            lengths = ", ".join(f"{key} {len(values)}" for key, values in self.pairs.items())
            raise ValueError(f"pairs: every key needs as many values as the others (got {lengths})")
        return self


class TrackerKeys(Strict):
    """A tracker of the campaign."""

    tracker: Text | None = None  # name of a tracker or a plug-in
    command: Annotated[list[Text], Field(min_length=1)] | None = None  # a program and its arguments in its place
    name: Text | None = None  # in tables; that of the tracker, or of the program, if None
    settings: dict[Text, Any] = Field(default_factory=dict, alias="set")  # in place of those chosen for the scene
    timeout_s: Annotated[float, Field(strict=True, gt=0, le=86_400)] = DEFAULT_TIMEOUT_S  # of the program's answers
    files: list[Text] | None = None  # that decide what it does; those among its arguments if None

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        return {"tracker": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.tracker is None) == (self.command is None):
            raise ValueError("give either tracker, a name, or command, a program and its arguments")
        for name in ("timeout_s", "files"):
            if self.command is None and name in self.model_fields_set:
                raise ValueError(f"{name} is for command")
        return self

    @model_serializer(mode="wrap")
    def _as_given(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Without the keys of the other kind, so that plans are as they were before there were programs."""
        left_out = ("command", "timeout_s", "files") if self.command is None else ("tracker",)
        return {key: value for key, value in handler(self).items() if key not in left_out}

    @property
    def label(self) -> str:
        """Name in tables."""
        return self.name or self.tracker or Path((self.command or [""])[0]).name


class WorldScoreKeys(Strict):
    """The rules of scores in the world: gate, GOSPA, and limits of predicted closest approaches."""

    gate_m: Positive = 50.0
    gospa_c_m: Annotated[float, Field(strict=True, gt=0, le=1e6)] = 50.0
    gospa_p: Annotated[float, Field(strict=True, ge=1, le=10)] = 1.0
    right_m: Positive = 100.0
    before_s: Positive = 60.0
    alarm_m: Positive = 200.0


class ScoreKeys(Strict):
    """The rules of the scores, as the options of `modsim3d score`; those of scores `in_world` are None where usual."""

    truth: TruthName = "annotated"
    similarity: SimilarityName = "iou"
    scale_px: Positive | None = None
    threshold: Annotated[float, Field(strict=True, gt=0, le=1)] = 0.5
    gap_s: Annotated[float, Field(strict=True, ge=0, le=1e9)] = DEFAULT_GAP_S
    gospa_c: Annotated[float, Field(strict=True, gt=0, le=1e6)] = 100.0
    gospa_p: Annotated[float, Field(strict=True, ge=1, le=10)] = 1.0
    in_world: WorldScoreKeys | None = None

    @model_serializer(mode="wrap")
    def _as_given(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Without usual rules in the world, so that plans are as before there were any."""
        return {key: value for key, value in handler(self).items() if key != "in_world" or value is not None}


KNOWN = "known_m"  # score of an approach: the distance from which on a vessel is known


class ApproachKind(Strict):
    """Vessels that a lookout requirement is about; all that own ship's cameras saw if nothing is given."""

    length_m: tuple[Number, Number] | None = None  # from the first on, and below the second
    label: Text | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.length_m is not None and not 0 <= self.length_m[0] < self.length_m[1]:
            raise ValueError("length_m needs two lengths, the smaller first, as in [8, 15]")
        return self

    @property
    def text(self) -> str:
        """It in words."""
        size = "" if self.length_m is None else f" of {self.length_m[0]:g} to {self.length_m[1]:g} m"
        return f"{self.label or 'vessels'}{size}"


class Requirement(Strict):
    """Bound on a score: on its mean over traffic seeds, or with `in` on its value in a share of them. `where` maps keys
    of the campaign, and `tracker`, to the value, or several, of the runs that it is about; a `state`, a `camera` and
    the groups of the breakdown that are no keys of the campaign are parts of the runs. With labels of trackers in `of`
    and `minus` it is about the score of one less that of the other, with the same seeds; else about that of each.
    `share` is the least share of traffic seeds all of whose runs must have a right value, and `resting_on` the least
    share of what is to be followed that the score of each run must rest on. `confidence` is the least probability that
    a verdict is right when the truth is at the threshold; of a mean that is looked at once it is measured and not
    proved. With `known_at_m` it is on the lookout: `share` is that of the approaches of vessels of a `kind`, in the
    file `of`, that must be known at that distance, mean over traffic seeds; by one track unless
    `one_track` is false."""

    score: Text
    where: dict[Text, Annotated[Scalar | list[Scalar], NeedText("a value, or a list of them, is needed")]] = Field(
        default_factory=dict
    )
    of: Text | None = None
    minus: Text | None = None
    at_least: Number | None = None
    at_most: Number | None = None
    share: Share | None = Field(default=None, alias="in")
    resting_on: Annotated[float, Field(strict=True, gt=0, le=1)] | None = None
    confidence: Confidence = 0.95
    known_at_m: Positive | None = None
    kind: ApproachKind | None = None
    one_track: bool = True

    @model_validator(mode="before")
    @classmethod
    def _lookout(cls, value: Any) -> Any:
        """`{known_at_m: R, of: KIND, share: S}` is on the distances of approaches."""
        if not isinstance(value, dict) or value.get("known_at_m") is None or "kind" in value:
            return value
        if "share" in value and "in" in value:
            raise ValueError("share and in are the same here: leave one out")
        kept = {key: setting for key, setting in value.items() if key not in ("of", "share")}
        return {"score": KNOWN, **kept, "kind": value.get("of") or {}, "in": value.get("share", value.get("in"))}

    @model_serializer(mode="wrap")
    def _as_given(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Without the keys of a lookout requirement if it is none, so that plans are as before there were any."""
        left_out = () if self.kind else ("known_at_m", "kind", "one_track")
        return {key: value for key, value in handler(self).items() if key not in left_out}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.known_at_m is not None:
            return self._checked_lookout()
        if self.kind is not None or not self.one_track:
            raise ValueError("kind and one_track need known_at_m")
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError("give either at_least or at_most")
        if (self.of is None) != (self.minus is None):
            raise ValueError("a difference needs both of and minus, the names of two trackers")
        if self.of is not None and self.of == self.minus:
            raise ValueError(f"of and minus are both '{self.of}': a difference needs two trackers")
        if self.of is not None and "tracker" in self.where:
            raise ValueError("a difference names its trackers with of and minus: leave tracker out of where")
        return self

    def _checked_lookout(self) -> Self:
        others = {"score", "at_least", "at_most", "minus", "resting_on"} - ({"score"} if self.score == KNOWN else set())
        if wrong := [key for key in sorted(others) if getattr(self, key) is not None]:
            raise ValueError(f"{wrong[0]} does not go with known_at_m")
        if self.share is None:
            raise ValueError("known_at_m needs share, that of the approaches that must be known, as in share: 0.95")
        return self

    @property
    def what(self) -> str:
        """The score, or of which trackers the difference of it is."""
        return self.score if self.of is None else f"{self.score} of {self.of} minus {self.minus}"

    @property
    def of_time(self) -> bool:
        """Whether it is on what a run took, which is not the same when it is made again."""
        return self.score in TIMES

    @property
    def threshold(self) -> float:
        """The value that is just right."""
        threshold = next((limit for limit in (self.at_least, self.at_most) if limit is not None), self.known_at_m)
        assert threshold is not None
        return threshold

    def holds(self, value: float) -> bool:
        """Whether a value is right."""
        return value >= self.threshold if self.at_least is not None else value <= self.threshold


class SearchKeys(Strict):
    """Search for scenes and seeds in which a tracker fails: those with the least or the greatest value of a score. The
    keys of `over` may change, within their ranges. `budget` scenes are tried, `batch` of them proposed at once, each
    with one of `seeds` traffic seeds; what is found depends on `batch`, and not on the workers."""

    minimise: Text | None = None
    maximise: Text | None = None
    over: Ranges
    budget: Annotated[int, Field(strict=True, ge=1, le=100_000)]
    batch: Annotated[int, Field(strict=True, ge=1, le=1_000)] = 10
    seeds: Annotated[int, Field(strict=True, ge=1, le=MAX_SEEDS)] = 1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.minimise is None) == (self.maximise is None):
            raise ValueError("give either minimise or maximise")
        return self


class LabelledVideos(Strict):
    """Labelled videos in place of a scene: each traffic seed shows one of them."""

    truth: Text
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}$")] | None = None  # in tables
    detections: Text | None = None
    detector: Text | None = None
    labels: list[Text] | None = None
    image_size_px: tuple[Number, Number] | None = None
    frame_rate_hz: Number | None = None
    horizon: Annotated[Number | tuple[Number, Number, Number, Number] | None, HORIZON] = None
    first_frame: Literal[0, 1] | None = None
    confidence_scale: tuple[Number, Number] | None = None
    skip_bad: bool = False

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.detector is None) == (self.detections is None):
            raise ValueError("give either detector, a simulated one, or detections, those of a real one")
        return self

    @property
    def called(self) -> str:
        """Its name in tables: that of the file, or of the folder of a MOT sequence."""
        path = Path(self.truth)
        stem = path.parts[-3] if path.parts[-2:] == ("gt", "gt.txt") and len(path.parts) > 2 else path.stem
        return self.name or re.sub("[^A-Za-z0-9_-]", "_", stem)


class CampaignKeys(Strict):
    """The keys of a campaign file."""

    scenes: Annotated[list[Text], Field(min_length=1)]  # files, or names of shipped scenes
    steps: Annotated[int, Field(strict=True, ge=1)] | None = None  # in place of those of the scenes
    seed: Annotated[int, Field(strict=True, ge=1, le=MAX_BASE)] = 1  # all others are derived from it
    seeds: Seeds = Field(default_factory=Seeds)
    settings: dict[Text, Any] = Field(default_factory=dict, alias="set")  # the same in all runs, as --set
    vary: list[Factor] = Field(default_factory=list)
    trackers: Annotated[list[TrackerKeys], Field(min_length=1)]  # all over the same detections
    score: ScoreKeys = Field(default_factory=ScoreKeys)
    require: list[Requirement] = Field(default_factory=list)
    level: Literal["each", "family"] = "each"  # confidence of each verdict, or of all together, by Holm
    stop: Literal["once", "sequential"] = "once"  # judged when all runs are done, or after each batch until decided
    batch: Annotated[int, Field(strict=True, ge=1)] = 20  # traffic seeds between two looks of `sequential`
    uncertainty: Literal["learned"] | None = None  # draw detectors from the intervals that `learn` wrote
    search: SearchKeys | None = None  # in place of the plan
    keep: list[Layer] = Field(default_factory=list)  # on the disk

    @property
    def timed(self) -> bool:
        """Whether what runs took is noted: where a program runs, or a requirement is on it."""
        programs = any(tracker.command is not None for tracker in self.trackers)
        return self.search is None and (programs or any(requirement.of_time for requirement in self.require))

    @property
    def lookout(self) -> bool:
        """Whether a requirement is on the distances of approaches."""
        return any(requirement.known_at_m is not None for requirement in self.require)

    @model_validator(mode="before")
    @classmethod
    def _one_scene(cls, value: Any) -> Any:
        """`scene: fairway` stands for `scenes: [fairway]`."""
        if not isinstance(value, dict) or "scene" not in value:
            return value
        if "scenes" in value:
            raise ValueError("give either scene or scenes")
        return {"scenes": [value["scene"]], **{key: setting for key, setting in value.items() if key != "scene"}}


@dataclass(frozen=True)
class CampaignFile:
    """A campaign file that was read."""

    path: Path
    keys: CampaignKeys
    videos: Mapping[int, LabelledVideos] = field(default_factory=dict)
    """Labelled videos by their place among the scenes, which has their name; `checked` makes scenes of them."""

    @property
    def base(self) -> Path:
        """The folder that its paths are relative to."""
        return self.path.resolve().parent


def shipped_campaigns() -> dict[str, Path]:
    """Campaigns that come with the package, by name."""
    return {path.stem: path for path in sorted((data_folder("scenes") / "campaigns").glob("*.yaml"))}


def find_campaign(campaign: StrPath) -> Path:
    """File that a path or the name of a shipped campaign stands for. Raises InputError if there is neither, and
    TypeError for what is neither text nor a path."""
    path, shipped = as_path(campaign, "campaign", "a path or the name of a shipped campaign"), shipped_campaigns()
    if path.is_file():
        return path
    if str(campaign) in shipped:
        return shipped[str(campaign)]
    hint = nearest(str(campaign), shipped)
    raise InputError(f"campaign {path}", [f"no such file, and no shipped campaign has this name ({hint})"])


def _labelled_videos(data: dict[str, Any], path: Path) -> tuple[dict[int, LabelledVideos], dict[str, Any]]:
    """The labelled videos of a campaign file, and its content with the name in place of each of them."""
    given = data.get("scenes", [data["scene"]] if "scene" in data else None)
    if not isinstance(given, list) or not any(isinstance(scene, dict) for scene in given):
        return {}, data
    videos = dict[int, LabelledVideos]()
    for place, scene in enumerate(given):
        if isinstance(scene, dict):
            try:
                videos[place] = LabelledVideos.model_validate(scene)
            except ValidationError as error:
                raise InputError(f"campaign {path}", describe(error, LabelledVideos, "scenes", place)) from None
    scenes = [videos[place].called if place in videos else scene for place, scene in enumerate(given)]
    names = [video.called for video in videos.values()]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"campaign {path}", [f"scenes: two are called '{twice[0]}': give them a name of their own"])
    return videos, {**{key: value for key, value in data.items() if key != "scene"}, "scenes": scenes}


def read_campaign(campaign: StrPath) -> CampaignFile:
    """Read a campaign file; InputError with every problem of its keys, TypeError if it is neither text nor a path."""
    path = find_campaign(campaign)
    data = load_yaml(path, "campaign")
    if not isinstance(data, dict):
        needed = f"a mapping of keys is needed (got {kind_of(data)})"
        raise InputError(f"campaign {path}", ["the file is empty" if data is None else needed])
    if {"cameras", "detector"} <= data.keys():
        raise InputError(f"campaign {path}", ["this is a scene: a campaign names it under scenes, and trackers beside"])
    try:
        videos, data = _labelled_videos(data, path.resolve())
        keys = CampaignKeys.model_validate(data)
    except ValidationError as error:
        # A colon stands before a problem of the whole file.
        problems = [problem.removeprefix(": ") for problem in describe(error, CampaignKeys)]
        raise InputError(f"campaign {path}", problems) from None
    return CampaignFile(path, keys, videos)
