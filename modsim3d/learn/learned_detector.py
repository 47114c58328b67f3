"""A detector out of labelled sets: the form of each part, its numbers, and the content of a detector file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import orjson

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import iou
from modsim3d.core.errors import InputError
from modsim3d.detector.chain import CONFUSION, MARKOV_CHAIN, MODELS, DetectorPart
from modsim3d.formats.matching import Rule
from modsim3d.io.input_files import MAX_TABLE_CELLS
from modsim3d.io.validation import nearest, shown
from modsim3d.learn import bootstrap
from modsim3d.learn.bootstrap import Resampling
from modsim3d.learn.box_errors.estimate import BoxErrorForm, LearnedBoxErrors, choose_box_errors
from modsim3d.learn.box_errors.laws import LAWS
from modsim3d.learn.confidence import ConfidenceForm, OneConfidenceForm, choose_confidence
from modsim3d.learn.false_positives import NOT_WRITTEN, FalsePositiveForm, LearnedFalsePositives, choose_false_positives
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.misses import ClassForm, LearnedClasses, choose_classes, filled
from modsim3d.learn.multiple_boxes import LearnedMultipleBoxes, MultipleBoxForm, choose_multiple_boxes, why_no_room
from modsim3d.learn.states import Transitions, transitions_of

RICHER = (
    *("relative", "mixed", "student_t", "effects", "persistence", "score", "vessels", "components", "sizes"),
    *("places", "lasting", "confidence", "slopes", "duplicates", "merges", "splits"),
    "on_vessels",
)
"""Parts beside the plain model, which learning can be told to leave out. Box errors that grow with the box, or partly
do; heavy tails; effects on misses; persistence of misses, box errors, confidence and merges; one score behind misses
and confidence; the share that each vessel keeps; a memory of each component of box errors; sizes and places of false
positives, and how long they last; confidence of true detections and false positives apart; its slopes; duplicates,
merges and splits; false positives on vessels."""


class LearnedPart(Protocol):
    """The numbers of one part of the detector; its fields hold `Entry` objects."""

    def sections(self) -> dict[str, dict[str, Any]]:
        """Entries of the part outside the states, by section of the detector file."""

    def state_section(self, state: int) -> dict[str, Any]:
        """Entries of the part in the section of a state, given its index."""


class PartForm(Protocol):
    """The model of one part that the data can carry."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Reason why it is not a richer one: how much data there was, and how much is needed."""

    def estimate(self, observed: Outcomes, resampling: Resampling) -> LearnedPart:
        """The numbers of the model, with replicates for the weights of the resampling."""


def omissions(names: Iterable[str], where: str) -> frozenset[str]:
    """Models of `RICHER` to be left out, by their names. Raises InputError, with `where`, if one is not known."""
    chosen = frozenset(names)
    unknown = sorted(chosen - set(RICHER))
    if unknown:
        hints = [f"{shown(name)} ({nearest(name, RICHER)})" for name in unknown]
        raise InputError(where, [f"must be some of {', '.join(RICHER)} (got {', '.join(hints)})"])
    return chosen


_SECTIONS = ("dropout", "persistence", "false_positives")
_STATE_KEYS = (
    *("confusion", "dropout", "false_positive_labels", "false_discovery_rate", "false_positives_per_image"),
    *("box_error", "confidence"),
)


@dataclass(frozen=True)
class LearnSettings:
    """Settings of the learning of a detector."""

    rule: Rule = field(default_factory=Rule)
    threshold: float = 0.2  # least confidence of a detection that counts
    replicates: int = 300  # of the bootstrap
    seed: int = 0  # of all random numbers
    false_positives: str = "auto"  # `calibrated` or `per_image` number of false positives; `auto` for the likelier one
    without: frozenset[str] = frozenset()  # of `learned.RICHER`, left out whatever the data carry


@dataclass(frozen=True)
class DetectorForm:
    """The model of each part that the data can carry."""

    classes: ClassForm
    box_errors: BoxErrorForm
    false_positives: FalsePositiveForm
    confidence: ConfidenceForm | OneConfidenceForm
    multiple_boxes: MultipleBoxForm

    @property
    def notes(self) -> tuple[str, ...]:
        """Reason why the models are not richer ones."""
        return tuple(note for part in vars(self).values() for note in part.notes)

    def estimate(self, observed: Outcomes, resampling: bootstrap.Resampling) -> LearnedDetector:
        """The numbers of every part, with replicates for the weights of the resampling."""
        return LearnedDetector(
            self.classes.estimate(observed, resampling),
            self.box_errors.estimate(observed, resampling),
            self.false_positives.estimate(observed, resampling),
            self.confidence.estimate(observed, resampling),
            self.multiple_boxes.estimate(observed, resampling),
        )


def choose_form(observed: Outcomes, model: str = "auto") -> DetectorForm:
    """The models that the data can carry; `model` is that of the number of false positives."""
    multiple_boxes = choose_multiple_boxes(observed)
    if model == "auto" and (why := why_no_room(observed)):
        model, multiple_boxes = "per_image", replace(multiple_boxes, notes=(*multiple_boxes.notes, why))
    if model == "auto" and "on_vessels" in observed.kinds.trials:
        model = "per_image"  # those on vessels have a model of their own, and the others are the same in every image
    classes, box_errors = choose_classes(observed), choose_box_errors(observed)
    false_positives, confidence = choose_false_positives(observed, model), choose_confidence(observed, classes.scored)
    return DetectorForm(classes, box_errors, false_positives, confidence, multiple_boxes)


@dataclass(frozen=True, eq=False)
class LearnedDetector:
    """The numbers of every part of a detector but the chain of its states."""

    classes: LearnedClasses
    box_errors: LearnedBoxErrors
    false_positives: LearnedFalsePositives
    confidence: LearnedPart
    multiple_boxes: LearnedMultipleBoxes

    @property
    def parts(self) -> tuple[LearnedPart, ...]:
        """All parts."""
        return self.classes, self.box_errors, self.false_positives, self.confidence, self.multiple_boxes

    def sections(self) -> dict[str, Any]:
        """Sections that the parts write outside the states, in the order of a detector file."""
        sections: dict[str, dict[str, Any]] = {}
        for part in self.parts:
            for name, section in part.sections().items():
                sections.setdefault(name, {}).update(section)
        return {name: sections[name] for name in _SECTIONS if name in sections}

    def state_section(self, state: int) -> dict[str, Any]:
        """Section that the parts write for one state, in the order of a detector file."""
        section: dict[str, Any] = {}
        for part in self.parts:
            section |= part.state_section(state)
        return {key: section[key] for key in _STATE_KEYS if key in section}


@dataclass(frozen=True, eq=False)
class Estimates:
    """Learned numbers, and the data behind them."""

    observed: Outcomes
    form: DetectorForm
    numbers: LearnedDetector
    transitions: Transitions
    resampling: bootstrap.Resampling
    run_s: float  # length of the runs of frames that were resampled; 0 if single images were
    units: Mapping[str | None, int]  # resampled runs or images that hold images of each state; of None, of any

    @property
    def notes(self) -> tuple[str, ...]:
        """Reason why the models are not richer ones."""
        return *self.form.notes, *self.transitions.notes

    def intervals(self, level: float) -> list[bootstrap.Interval]:
        """Confidence intervals of all numbers, those of the transition matrix included."""
        intervals = [
            bootstrap.Interval(entry.key, entry.estimate, *entry.column.interval(level, self.units[entry.key.state]))
            for entry in bootstrap.entries_of(self.numbers)
        ]
        return [*intervals, self.transitions.interval(level, self.observed.states)]

    def detector(self) -> dict[str, Any]:
        """The content of a detector file."""
        states = self.observed.states
        return {
            "labels": list(self.observed.labelled.labels),
            "confidence_threshold": self.observed.threshold,
            **self.transitions.sections(states),
            **self.numbers.sections(),
            "states": {name: self.numbers.state_section(index) for index, name in enumerate(states)},
        }


def learn(observed: Outcomes, transitions: Transitions, settings: LearnSettings) -> Estimates:
    """Learn a detector from data that were matched by the rule and at the threshold of the settings. Raises InputError
    if there are too many classes for the memory."""
    check_size(len(observed.labelled.labels), len(observed.states), settings.replicates)
    form, images = choose_form(observed, settings.false_positives), observed.labelled.images
    run_s = _run_s(observed, form)
    resampling = bootstrap.resample(images, settings.replicates, settings.seed, run_s)
    state = observed.image_state
    units: dict[str | None, int] = {name: resampling.units(state == k) for k, name in enumerate(observed.states)}
    units[None] = resampling.units(state >= 0)
    numbers = form.estimate(observed, resampling)
    numbers = _marked(numbers, unknown_numbers(observed, numbers))
    return Estimates(observed, form, numbers, transitions, resampling, run_s, units)


_MAX_LOST = 0.01  # share of false positives that may be boxes of vessels that failed the matching
NEAR_THE_GATE = 0.1  # of IoU: about as many matches pass by less as boxes fail


def unknown_numbers(observed: Outcomes, numbers: LearnedDetector) -> dict[tuple[str | None, str], str]:
    """Numbers whose intervals would hold the truth too rarely, by state and beginning of their keys, with why."""
    unknown: dict[tuple[str | None, str], str] = {}
    of_state = observed.image_state[observed.labelled.results.image[observed.false]]
    matched = observed.pairs.edges.rule.method != "provenance"  # else boxes that are lost are no false positives
    near, failed = barely_matched(observed), 0.0
    for index, used in enumerate(numbers.box_errors.used):
        false = int(np.count_nonzero(of_state == index))
        lost = min(max(used.lost * used.matches, float(near[index])), false)
        failed += lost
        if not used.settled:
            why = "so many boxes fail the matching, or were drawn anew, that errors may spread farther"
            unknown[used.state, "box_error"] = why
        elif matched and lost > _MAX_LOST * max(false, 1):
            why = f"some {lost:.0f} of {false:,} false positives are boxes that failed the matching"
            unknown[used.state, "confidence.false"] = why
    if matched and numbers.multiple_boxes.on_vessels is not None:
        why = "of a vessel's boxes, matching takes the one that fits best, whichever was drawn for it"
        unknown |= {(None, f"false_positives.on_vessels.{key}"): why for key in ("lifetime_s", "mean", "std")}
    if matched and failed > _MAX_LOST * max(len(observed.false), 1):
        why = f"some {failed:.0f} of {len(observed.false):,} false positives are boxes that failed the matching"
        unknown[None, "false_positives.size"] = why
    elif matched and numbers.multiple_boxes.shares:
        unknown[None, "false_positives.size"] = "second boxes, parts and merges are told from others by how they look"
    few = "of few vessels that keep a share of the noise; measured, 84 to 88 of 100 such intervals hold"
    if numbers.classes.class_vessel_share is not None:
        unknown[None, "persistence.class_s"] = few
    if numbers.box_errors.box_vessel_share is not None:
        unknown[None, "persistence.box_s"] = few
    return unknown


def barely_matched(observed: Outcomes) -> Indices:
    """Number of matches in each state whose IoU is near the least one; none by other rules than IoU."""
    detection, annotation = observed.matched.pairs
    rule, labelled = observed.pairs.edges.rule, observed.labelled
    if rule.method not in ("confidence", "optimal"):
        return np.zeros(len(observed.states), dtype=np.int64)
    overlap = iou(labelled.results.boxes_px[detection], labelled.annotations.boxes_px[annotation])
    state = observed.image_state[labelled.annotations.image[annotation[overlap < rule.least_iou + NEAR_THE_GATE]]]
    return np.bincount(state[state >= 0], minlength=len(observed.states))


def _marked(numbers: LearnedDetector, unknown: Collection[tuple[str | None, str]]) -> LearnedDetector:
    """The numbers, those that are not known marked as such."""

    def change(entry: bootstrap.Entry) -> bootstrap.Entry:
        path = ".".join(entry.key.names)
        if any(entry.key.state == state and path.startswith(beginning) for state, beginning in unknown):
            return replace(entry, column=replace(entry.column, known=False))
        return entry

    return bootstrap.with_entries(numbers, change)


def check_size(classes: int, states: int, replicates: int) -> None:
    """Raise InputError for so many classes that the tables of the replicates would fill the memory."""
    cells = (1 + replicates) * states * classes * (classes + 1)
    if cells > MAX_TABLE_CELLS:
        sizes = f"{classes:,} classes in {states:,} states with {replicates:,} replicates"
        limit = f"tables of {cells:,} cells, more than {MAX_TABLE_CELLS:,}"
        advice = "give fewer classes, fewer states (--states) or --replicates"
        raise InputError("labelled set", [f"{sizes} need {limit}: {advice}"])


def _run_s(observed: Outcomes, form: DetectorForm) -> float:
    """A length of runs that fits the noise which persists longest."""
    longest = max(
        form.classes.class_s,
        form.box_errors.box_s,
        form.false_positives.lifetime_s,
        form.confidence.confidence_s,
        form.multiple_boxes.merge_s,
        form.multiple_boxes.on_vessel_s or 0.0,
    )
    return bootstrap.run_length_s(observed.labelled.images, longest)


# ---- What learns each model of a detector ----

Learner = Callable[..., PartForm | Transitions]

LEARNERS: Mapping[DetectorPart, Mapping[str, Learner]] = {  # what chooses and estimates each model that can be learned
    DetectorPart.STATE: {MARKOV_CHAIN: transitions_of},
    DetectorPart.CLASS: dict.fromkeys((CONFUSION, "logistic"), choose_classes),
    DetectorPart.BOX_ERROR: dict.fromkeys(LAWS, choose_box_errors),
    DetectorPart.FALSE_POSITIVES: dict.fromkeys(("calibrated", "per_image"), choose_false_positives),
    DetectorPart.CONFIDENCE: dict.fromkeys(("normal", "quantiles"), choose_confidence),
}


def models_and_learners() -> Iterator[tuple[DetectorPart, str, Learner | None]]:
    """Part, name and learner of every registered model; None for a model that nothing learns."""
    for part, models in MODELS.items():
        for name in models:
            yield part, name, LEARNERS[part].get(name)


# ---- How well the numbers of a learned detector are known together, as a file beside the detector file ----

FORMAT = 1
COUNTED = ("share", "rate")  # kinds of numbers whose uncertainty is that of a count
_DECIMALS = 3
_MAX_SPREADS = 4.0


def uncertainty_file(detector: Path) -> Path:
    """The file that belongs to a detector file."""
    return detector.with_name(f"{detector.stem}.uncertainty.json")


def uncertainty_text(learned: Estimates, detector: str) -> bytes:
    """The content of the file, given the text of the detector file that it belongs to."""
    written = [_filled(entry) for entry in bootstrap.entries_of(learned.numbers) if _is_written(entry)]
    transitions = learned.transitions
    content = {
        "format": FORMAT,
        "detector_sha256": hashlib.sha256(detector.encode()).hexdigest(),
        "confidence_threshold": learned.observed.threshold,
        "transitions": transitions.counts.astype(int).tolist() if transitions.observed else None,
        "groups": [
            _group(name, units, [entry for entry in written if entry.key.state == name])
            for name, units in learned.units.items()
        ],
    }
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _is_written(entry: bootstrap.Entry) -> bool:
    if entry.key.names[-1] == "confusion":
        return True
    absent = entry.key.names[0] == "persistence" and not np.any(entry.estimate > 0)
    return entry.key.remark != NOT_WRITTEN and not absent and bool(np.all(np.isfinite(entry.estimate)))


def _filled(entry: bootstrap.Entry) -> bootstrap.Entry:
    """The entry; a confusion matrix with columns of labels that were never there, as the detector file has them."""
    if entry.key.names[-1] != "confusion":
        return entry
    values = np.concatenate([filled(entry.estimate)[None], entry.column.values[1:]])
    return replace(entry, column=replace(entry.column, values=values))


def _group(state: str | None, units: int, entries: Sequence[bootstrap.Entry]) -> dict[str, Any]:
    """The numbers of one state, or of None, those that all states share."""
    return {
        "state": state,
        "units": units,
        "numbers": [
            {"key": list(entry.key.names), "kind": entry.column.kind, "estimate": bootstrap.nested(entry.estimate)}
            | _width(entry)
            for entry in entries
        ],
        "correlations": _correlations(entries),
    }


def _width(entry: bootstrap.Entry) -> dict[str, Any]:
    """Observations that a count is worth, or the spread of another number on its scale."""
    column = entry.column
    if column.kind in COUNTED:
        return {"observations": bootstrap.nested(column.independent)}
    spread = bootstrap.spread(_without_outliers(bootstrap.to_scale(column.values[1:], column.kind)))
    return {"spread": bootstrap.nested(np.where(np.isfinite(spread), spread, 0.0))}


def _without_outliers(scaled: Array) -> Array:
    """Replicates (replicates, ...), held within four standard deviations of the median, by the inner two thirds: a few
    in which all errors are equal, with a logarithm of nearly −∞, would make the spread many times as large."""
    finite = np.where(np.isfinite(scaled), scaled, np.nan)
    if not np.isfinite(finite).any(axis=0).all():
        return scaled
    low, middle, high = np.nanquantile(finite, [0.1587, 0.5, 0.8413], axis=0)
    reach = _MAX_SPREADS * (high - low) / 2
    return np.clip(finite, middle - reach, middle + reach)


def correlated(names: Sequence[str], shape: tuple[int, ...]) -> Mask:
    """Places of an entry that have correlations, of its shape: a confusion matrix's misses; none of distributions."""
    places: Mask = np.ones(shape, dtype=bool)
    if names[-1] == "confusion":
        places[:-1] = False
    elif names[-1] in ("false_positive_labels", "density"):
        places[:] = False
    return places


def _correlations(entries: Sequence[bootstrap.Entry]) -> list[list[float]]:
    """The rows of the lower triangle of the correlation matrix, without its diagonal."""
    scores = [_standard(replicates) for entry in entries for replicates in _replicates(entry)]
    rows = min(map(len, scores), default=0)
    return [
        [round(float(first[:rows] @ second[:rows]) / (rows - 1), _DECIMALS) for second in scores[:place]]
        for place, first in enumerate(scores)
    ]


def _replicates(entry: bootstrap.Entry) -> Array:
    """Replicates of the numbers of an entry that have correlations, on their scale, shape (numbers, replicates)."""
    scaled = _without_outliers(bootstrap.to_scale(entry.column.values[1:], entry.column.kind))
    return scaled[:, correlated(entry.key.names, scaled.shape[1:])].T  # one row for each number


def _standard(values: Array) -> Array:
    """Values (n,) with mean zero and standard deviation one, 0 where they are not finite or all are equal."""
    finite = np.isfinite(values)
    if not finite.any() or np.ptp(values[finite]) == 0:
        return np.zeros(len(values))
    moved = np.where(finite, values - values[finite].mean(), 0.0)
    return np.asarray(moved / moved.std(ddof=1))
