"""From labelled sets to a report: conditions, states, figures and the detector."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError

from modsim3d.core.arrays import Indices, Mask
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.text import in_percent
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import NOT_SCORED, Matching, Rule, fits, image_pairs, match, overlap, usual_method
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.io.validation import HORIZON, Count, Number, Positive, Probability, Strict, describe, shown
from modsim3d.learn import states as state_maps
from modsim3d.learn.figures import Figures, Matches, error_shares
from modsim3d.learn.learned_detector import NEAR_THE_GATE, LearnSettings, barely_matched, check_size, learn, omissions
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.report import LearnReport, NearGate
from modsim3d.learn.self_check import SelfCheck
from modsim3d.learn.states import StateMap, Transitions

# ---- True detections that are lost because their boxes lie too far off ----

_MAX_SHARE = 0.5


def gate_warning(labelled: LabelledSet, matched: Matching, rule: Rule) -> str | None:
    """Warning, with figures, if the rule does not match most of what could be a match: detections known to be of a
    vessel that it does not let match that; elsewhere missed annotations that a false positive overlaps. Else None."""
    if rule.method == "provenance" or not matched.sought.any():
        return None
    recall = f"recall {len(matched.pairs[0]) / np.count_nonzero(matched.sought):.3f}"
    if labelled.results.origin is not None:
        return _of_own_vessels(labelled, matched, rule, labelled.results.origin, recall)
    missed = matched.sought & (matched.detection < 0)
    near, matches = len(_overlapped(labelled, np.flatnonzero(missed), matched.false)), len(matched.pairs[0])
    if near <= _MAX_SHARE * (near + matches):
        return None
    return (
        f"{near:,} of {np.count_nonzero(missed):,} missed annotations overlap a false positive, and only {matches:,} "
        f"detections match: if those boxes are meant for each other, {recall} counts them as missed. Use --match "
        "centre:PX with a distance that is large against the errors of the boxes"
    )


def _of_own_vessels(labelled: LabelledSet, matched: Matching, rule: Rule, origin: Indices, recall: str) -> str | None:
    rows = np.flatnonzero(matched.counts & (origin >= 0))
    good, _ = fits(labelled, rows, origin[rows], rule)
    lost = int(np.count_nonzero(~good))
    if lost <= _MAX_SHARE * len(rows):
        return None
    far = f"have IoU below {rule.least_iou:g} with their own vessel"
    if rule.method == "centre":
        far = f"have their centre more than {rule.most_distance_px:g} px from that of their own vessel"
    return f"{lost:,} of {len(rows):,} detections {far}: {recall} counts them as missed. Use --match provenance"


def _overlapped(labelled: LabelledSet, annotations: Indices, detections: Indices) -> Indices:
    """Annotations that a detection overlaps, among some of both; all rows in the order of their images."""
    results, truth = labelled.results, labelled.annotations
    parts = [annotations[:0]]
    for first, second in image_pairs(results.image[detections], truth.image[annotations], len(labelled.images)):
        row, target = detections[first], annotations[second]
        touching = overlap(results.boxes_px[row], truth.boxes_px[target], truth.crowd[target]) > 0
        parts.append(np.unique(target[touching]))
    return np.unique(np.concatenate(parts))


MIN_CONFIDENCE = 0.2  # least confidence of a detection that counts, unless another is asked for


@dataclass(frozen=True)
class LearnOptions:
    """Options besides the settings of learning."""

    states: tuple[str, ...] = ()  # texts such as `good=day,cloudy`
    clusters: int | None = None  # number of states to make by F1
    sequence: str | None = None  # text with the name of a state on each line
    interval_s: float | None = None  # time between transitions
    level: float = 0.95  # of the confidence intervals
    beta: float = 2.0  # how many times more recall weighs than precision in F-beta
    check: bool = False  # whether to compare with the real results where it was not learned


def learn_detector(labelled: LabelledSet, settings: LearnSettings, options: LearnOptions) -> LearnReport:
    """Learn and report. Raises ModsimError if there are no annotations, no detection matches any, the states do not fit
    the conditions, or some conditions have confidences and others have none."""
    _check_scores(labelled)
    check_size(len(labelled.labels), 1, settings.replicates)  # before boxes are matched, which takes longer
    matched = match(labelled, settings.rule, settings.threshold)
    if not matched.sought.any():
        raise ModsimError("no annotation is there to be detected: nothing can be learned")
    if not len(matched.pairs[0]):
        sought, counted = np.count_nonzero(matched.sought), np.count_nonzero(matched.counts)
        raise ModsimError(
            f"none of {len(labelled.results):,} detections matches any of {sought:,} annotations ({settings.rule}), "
            f"and {counted:,} of them have a confidence of at least {settings.threshold:g}: they may be of other "
            "images, have boxes in other pixels, or need another rule"
        )
    curve_rule = settings.rule.for_average_precision
    by_label = match(labelled, curve_rule) if labelled.scored else None
    state_map = _state_map(labelled, matched, options)
    image_state = state_map.of_images(labelled.images, labelled.conditions)
    observed = Outcomes(labelled, matched, state_map.names, image_state, settings.threshold, settings.without)
    learned = learn(observed, _transitions(observed, options), settings)
    matches = Matches(labelled, matched, by_label, learned.resampling, options.beta, learned.numbers.classes.inflation)
    return LearnReport(
        labelled=labelled,
        by_label=by_label,
        conditions=_figures_of_conditions(matches),
        states=[matches.figures(name, image_state == k) for k, name in enumerate(state_map.names)],
        state_map=state_map,
        learned=learned,
        shares=None if by_label is None else error_shares(labelled, by_label, image_state >= 0, curve_rule),
        level=options.level,
        beta=options.beta,
        matched_by=str(settings.rule),
        curves_matched_by=str(curve_rule),
        warning=gate_warning(labelled, matched, settings.rule),
        remarks_on_data=(*dict.fromkeys(labelled.notes), *_remarks(observed)),
        near_gate=_near_gate(observed, settings.rule),
        check=SelfCheck.of(learned, settings) if options.check else None,
    )


def least_confidence(labelled: LabelledSet, asked: float | None) -> float:
    """Least confidence of a detection that counts: the one asked for, or 0.2, but a run's operating threshold at least;
    0 without confidences. Raises ModsimError if one was asked for, and there are no confidences."""
    if labelled.scored:
        return max(MIN_CONFIDENCE if asked is None else asked, labelled.dropped_below)
    if asked is not None:
        raise ModsimError(f"--confidence {asked:g} needs confidences, and {NOT_SCORED}: leave it out, and all count")
    return 0.0


def _check_scores(labelled: LabelledSet) -> None:
    """Raise ModsimError for conditions with confidences beside conditions without."""
    missing, condition = np.isnan(labelled.results.confidence), labelled.images.condition[labelled.results.image]
    if not labelled.scored or not missing.any():
        return
    without, scored = (
        ", ".join(labelled.conditions[k] for k in np.unique(condition[rows])) for rows in (missing, ~missing)
    )
    raise ModsimError(
        f"the detections of {without} have no confidences (-1), and those of {scored} do: learn from them apart"
    )


def _state_map(labelled: LabelledSet, matched: Matching, options: LearnOptions) -> StateMap:
    """The states that are named, that clusters make or that conditions are; only those with images."""
    if options.states and options.clusters:
        raise ModsimError("give the conditions of each state, or a number of states to be found: not both")
    if options.states:
        state_map = state_maps.parse_states(options.states, labelled.conditions)
    elif options.clusters:
        seen = np.unique(labelled.images.condition)
        f1 = {labelled.conditions[k]: _f1(labelled, matched, labelled.images.condition == k) for k in seen}
        state_map = state_maps.cluster(f1, options.clusters)
    else:
        state_map = state_maps.each_its_own(labelled.conditions)
    used = np.unique(state_map.of_images(labelled.images, labelled.conditions))
    return StateMap({name: given for k, (name, given) in enumerate(state_map.states.items()) if k in used})


def _f1(labelled: LabelledSet, matched: Matching, images: Mask) -> float:
    """F1 of some images (I,), labels left aside."""
    right = float(images[labelled.results.image[matched.pairs[0]]].sum())
    detected = float((matched.counts & images[labelled.results.image]).sum())
    true = float((matched.sought & images[labelled.annotations.image]).sum())
    return 2 * right / (detected + true) if detected + true else 0.0


def _figures_of_conditions(matches: Matches) -> list[Figures]:
    """The figures of conditions that have images, the largest F1 first."""
    condition, names = matches.labelled.images.condition, matches.labelled.conditions
    figures = [matches.figures(name, condition == k) for k, name in enumerate(names) if np.any(condition == k)]
    return sorted(figures, key=lambda row: -float(np.nan_to_num(row.any_label.f1.estimate)))


def _transitions(observed: Outcomes, options: LearnOptions) -> Transitions:
    """Transitions between states, from the text if it is given, else from the frames."""
    count, interval_s = len(observed.states), options.interval_s
    if interval_s is not None and not interval_s > 0:
        raise InputError("--time-step", [f"must be above 0 (got {interval_s:g})"])
    if options.sequence is None:
        return state_maps.transitions_of(observed.labelled.images, observed.image_state, count, interval_s)
    sequence = state_maps.parse_sequence(options.sequence, observed.states, "--sequence")
    return state_maps.count_transitions([sequence], count, interval_s)


_MANY_NEAR = 0.05
_ALMOST_ALL, _HARDLY_ANY = 0.8, 0.2


def _remarks(observed: Outcomes) -> Iterator[str]:
    """Remarks on what the data lack, and on what speaks against the matches: labels that are nearly all one off."""
    if not observed.labelled.scored:
        yield (
            "the detections have no confidences (-1): all of them count, average precision and the other figures that "
            "need confidences are left out, and the detector file gives every detection a confidence of 1"
        )
    labelled, (detection, annotation) = observed.labelled, observed.matched.pairs
    if observed.threshold == labelled.dropped_below > 0:
        yield (
            f"the run's operating_threshold dropped detections below {observed.threshold:g}: the rates are those from "
            "there on, and it is the detector file's confidence_threshold"
        )
    shift = labelled.results.label[detection] - labelled.annotations.label[annotation]
    for step, where in ((1, "after"), (-1, "before")):
        if (shift == 0).mean() < _HARDLY_ANY and (shift == step).mean() > _ALMOST_ALL:
            yield (
                f"{in_percent((shift == step).mean())} of the matches have the label {where} that of the annotation in "
                "the list of categories: do results count from another number? In MOT, --labels can give the numbers "
                f"of both files one name; in COCO, --category-offset {-step} moves results"
            )


def _near_gate(observed: Outcomes, rule: Rule) -> NearGate:
    """The states of which many matches are near the least IoU."""
    labelled, annotation = observed.labelled, observed.matched.pairs[1]
    if rule.method not in ("confidence", "optimal") or not len(annotation):
        return NearGate()
    state = observed.image_state[labelled.annotations.image[annotation]]
    other = "--match provenance cuts off none"
    if labelled.results.origin is None:
        other = "--match centre:PX, with a distance that is large against the errors, cuts off less"
    matches = np.maximum(np.bincount(state[state >= 0], minlength=len(observed.states)), 1)
    shares = zip(observed.states, barely_matched(observed) / matches, strict=True)
    many = tuple((name, float(share)) for name, share in shares if share > _MANY_NEAR)
    return NearGate(many, rule.least_iou + NEAR_THE_GATE, other, several=len(observed.states) > 1)


Method = Literal["confidence", "optimal", "centre", "provenance"]
NumberModel = Literal["auto", "calibrated", "per_image"]


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
    false_positives: NumberModel = "auto"  # model of the number of false positives
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
        omissions(request.without, f"{caller}: without")
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
            self.false_positives,
            omissions(self.without, f"{self.caller}: without"),
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
        if all(isinstance(of, Sequence) and all(isinstance(entry, str) for entry in of) for of in named.values()):
            return {"states": tuple(f"{name}={','.join(of)}" for name, of in named.items())}
    needed = "a number of states from 1, or a mapping from states to lists of conditions, is needed"
    raise InputError(caller, [f"states: {needed} (got {shown(given)})"])
