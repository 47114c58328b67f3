"""The whole detector: annotated boxes in, detections out."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import at_least_a_pixel, sizes, unions
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.detector import draws, false_positives, records
from modsim3d.detector.box_error import BoxErrorSource, MisplacedBoxes, TrueBoxes
from modsim3d.detector.classification import ConfusionClassifier, PerformanceStates
from modsim3d.detector.confidence import SCORES, Confidence
from modsim3d.detector.dropout import EFFECTS
from modsim3d.detector.merges_and_splits import Events, PairNoise, halves
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Clock, VesselNoise
from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.detector.target_statistics import TargetStatistics

# ---- The whole detector ----


@dataclass(frozen=True, eq=False)
class _RawBoxes(Columns):
    """Detections before they have a confidence: columns of `Detections`, and what confidence needs."""

    frame: Indices
    target: Indices
    partner: Indices
    kind: Indices
    label: Indices
    boxes_px: Array
    errors_px: Array
    redrawn: Mask
    visible_fraction: Array  # of the vessel, NaN where there is none, shape (m,)
    uniforms: Array  # for confidence and order, shape (m, 2)


_KEPT_COLUMNS = tuple(column.name for column in fields(_RawBoxes) if column.name in Detections.__dataclass_fields__)


@dataclass(frozen=True, eq=False)
class _Vessels:
    """The n vessels that are neither missed nor merged into another's box."""

    targets: Targets  # a merged one has the box around both
    row: Indices  # of the annotated target, shape (n,)
    partner: Indices  # row of the smaller of two merged targets, else −1, shape (n,)
    label: Indices
    level: Array | None  # chance of a smaller confidence where one score decides on misses too, shape (n,)

    def unscored(
        self, rows: Indices | slice, kind: Indices, boxes_px: Array, errors_px: Array, redrawn: Mask, uniforms: Array
    ) -> _RawBoxes:
        """Detections of k of the vessels; boxes and errors have shape (k, 4), uniforms (k, 2), the others (k,)."""
        return _RawBoxes(
            frame=self.targets.frame[rows],
            target=self.row[rows],
            partner=np.where(kind == records.MERGED, self.partner[rows], -1),
            kind=kind,
            label=self.label[rows],
            boxes_px=boxes_px,
            errors_px=errors_px,
            redrawn=redrawn,
            visible_fraction=self.targets.visible_fraction[rows],
            uniforms=uniforms,
        )


def _false(
    frame: Indices, target: Indices | None, kind: int, label: Indices, boxes_px: Array, uniforms: Array
) -> _RawBoxes:
    """Detections of one kind that are no box of a vessel, of which they may lie on one."""
    count = len(frame)
    none = np.full(count, -1)
    return _RawBoxes(
        frame=frame,
        target=none if target is None else target,
        partner=none,
        kind=np.full(count, kind),
        label=label,
        boxes_px=boxes_px,
        errors_px=np.full((count, 4), np.nan),
        redrawn=np.zeros(count, dtype=bool),
        visible_fraction=np.full(count, np.nan),
        uniforms=uniforms,
    )


class Detector:
    """A simulated detector (Jessen & Mohr (2023), section 7.6): state, dropout and class, box error, false positives,
    confidence, in this order. The same frames give the same detections, however a run is split into chunks."""

    def __init__(self, model: DetectorModel, seed: int, statistics: TargetStatistics, clock: Clock) -> None:
        """Build the parts that the model asks for; the seed is the key of all its random numbers. `statistics` come
        from `target_statistics`; the clock has the times of the scene's steps, since noise may persist. Raises
        ModsimError if the sizes of false positives come from targets, and there are none."""
        self.model = model
        self._streams = Streams(seed)
        self._states = PerformanceStates(model, self._streams)
        self._noise = VesselNoise(model.persistence, self._streams, clock)
        self._pair_noise = PairNoise(model.persistence.merge_s, self._streams, clock)
        self._classifier = ConfusionClassifier.from_model(model, statistics)
        self._box_error = BoxErrorSource.from_model(model)
        self._false_positive_source = false_positive_source(model, statistics)
        self._confidence = Confidence([state.confidence for state in model.states], model.confidence_threshold)

    def detect(self, frames: CameraFrames, targets: Targets) -> Detections:
        """Detections in frames of one camera. Raises ModsimError if box errors leave nothing of a box at any draw."""
        states = self._states.at(frames)
        passed = self.model.gates.passed(frames, targets)
        rows = np.flatnonzero(passed)
        detected = self._detected(frames, states, targets, rows)
        vessels = detected.targets
        latent = self._noise.normals(frames, vessels, self._box_error.extra_normals)
        placed = self._box_error.misplace(self._streams, TrueBoxes.of(frames, states, vessels), latent)
        single = detected.partner < 0
        events = self.model.merges_and_splits.events(self._streams, frames, vessels, placed.boxes_px, single)
        parts = [
            self._true_detections(frames, detected, placed, events),
            *self._duplicates(frames, states, detected, events),
            *self._fragments(frames, detected, placed, events),
            *self._false_positives(frames, states, vessels, events),
            *self._on_vessels(frames, states, targets, rows),
        ]
        return self._scored(states, parts, passed)

    def _detected(self, frames: CameraFrames, states: Indices, targets: Targets, passed: Indices) -> _Vessels:
        candidates = targets if len(passed) == len(targets) else draws.select(targets, passed)
        label, level = self._classified(frames, states, candidates)
        # Which pairs merge does not depend on who is missed, so that what is left of a vessel's own draws is no choice.
        pairs = self.model.merges_and_splits.merged_pairs(self._pair_noise, frames, candidates)
        larger, smaller = pairs[label[pairs[:, 0]] >= 0].T
        boxes, partner = candidates.boxes_px, np.full(len(passed), -1)
        if len(larger):
            boxes, label = boxes.copy(), label.copy()
            boxes[larger], partner[larger] = unions(boxes[larger], boxes[smaller]), passed[smaller]
            label[smaller] = -1
        rows = np.flatnonzero(label >= 0)
        vessels = draws.select(replace(candidates, boxes_px=boxes), rows)
        return _Vessels(vessels, passed[rows], partner[rows], label[rows], None if level is None else level[rows])

    def _classified(self, frames: CameraFrames, states: Indices, targets: Targets) -> tuple[Indices, Array | None]:
        """Label of each target, −1 where it is missed, and the level of its confidence where the same score decides."""
        uniforms, score = self._noise.uniforms(frames, targets), self.model.persistence.score
        if score is None:
            return self._classifier.classify(frames, states, targets, uniforms), None
        scores = self._noise.scores(score, frames, targets)
        return self._classifier.classify_scored(frames, states, targets, uniforms, scores)

    def _true_detections(
        self, frames: CameraFrames, detected: _Vessels, placed: MisplacedBoxes, events: Events
    ) -> _RawBoxes:
        """One detection of each detected vessel; of a split one the larger part."""
        boxes = placed.boxes_px.copy()
        kind = np.where(detected.partner >= 0, records.MERGED, records.TRUE)
        boxes[events.split], _ = halves(boxes[events.split], events.cut)
        kind[events.split] = records.SPLIT
        errors = np.where((kind == records.TRUE)[:, None], placed.errors_px, np.nan)
        uniforms = self._noise.score_uniforms(frames, detected.targets)
        if detected.level is not None:
            uniforms[:, 0] = detected.level
        return detected.unscored(slice(None), kind, boxes, errors, placed.redrawn, uniforms)

    def _duplicates(self, frames: CameraFrames, states: Indices, detected: _Vessels, events: Events) -> list[_RawBoxes]:
        """Second boxes, whose errors are drawn like those of the first."""
        if not len(events.doubled):
            return []
        vessels = draws.select(detected.targets, events.doubled)
        extra = self._box_error.extra_normals
        latent = draws.latent_normals(self._streams, draws.DUPLICATE_STREAMS, frames, vessels, extra)
        true = TrueBoxes.of(frames, states, vessels)
        placed = self._box_error.misplace(self._streams, true, latent, draws.DUPLICATE_REDRAW_STREAMS)
        uniforms = draws.target_uniforms(self._streams, Purpose.DUPLICATE_CONFIDENCE, frames, vessels)
        kind = np.full(len(vessels), records.DUPLICATE)
        return [detected.unscored(events.doubled, kind, placed.boxes_px, placed.errors_px, placed.redrawn, uniforms)]

    def _fragments(
        self, frames: CameraFrames, detected: _Vessels, placed: MisplacedBoxes, events: Events
    ) -> list[_RawBoxes]:
        """The smaller parts of split boxes."""
        count = len(events.split)
        if not count:
            return []
        _, smaller = halves(placed.boxes_px[events.split], events.cut)
        kind, errors = np.full(count, records.FRAGMENT), np.full((count, 4), np.nan)
        vessels = draws.select(detected.targets, events.split)
        uniforms = draws.target_uniforms(self._streams, Purpose.FRAGMENT_CONFIDENCE, frames, vessels)
        return [detected.unscored(events.split, kind, smaller, errors, np.zeros(count, dtype=bool), uniforms)]

    def _on_vessels(self, frames: CameraFrames, states: Indices, targets: Targets, passed: Indices) -> list[_RawBoxes]:
        """False positives on vessels that pass the gates, found or missed."""
        law = self.model.false_positives.on_vessels
        if law is None:
            return []
        vessels = draws.select(targets, passed)
        uniforms = self._noise.on_vessel(law.lifetime_s, frames, vessels)
        true_px = at_least_a_pixel(vessels.boxes_px, frames.image_size_px)
        boxes, present = law.boxes_px(true_px, frames.image_size_px, uniforms)
        rows = np.flatnonzero(present)
        shown = draws.select(vessels, rows)
        confidence = draws.target_uniforms(self._streams, Purpose.ON_VESSEL_CONFIDENCE, frames, shown)
        labels = self._false_positive_source.labels(states[shown.frame], uniforms[rows, 0] / law.share)
        return [_false(shown.frame, passed[rows], records.ON_VESSEL, labels, boxes[rows], confidence)]

    def _false_positives(
        self, frames: CameraFrames, states: Indices, vessels: Targets, events: Events
    ) -> list[_RawBoxes]:
        n_true = np.bincount(vessels.frame, minlength=len(frames)).astype(np.int64)
        counts = false_positives.FrameCounts(states, self.model.gates.due(frames), n_true, events.expected)
        around = false_positives.Surroundings(self._streams, frames, counts, vessels)
        source = self._false_positive_source
        drawn = [(records.FALSE_POSITIVE, Purpose.TRANSIENT_CONFIDENCE, source.draw_transient(around))]
        if self.model.false_positives.persistent_share:
            drawn.append((records.PERSISTENT, Purpose.PERSISTENT_CONFIDENCE, source.draw_persistent(around)))
        return [
            _false(batch.frame, None, kind, batch.label, batch.boxes_px, batch.uniforms(self._streams, purpose, frames))
            for kind, purpose, batch in drawn
        ]

    def _scored(self, states: Indices, parts: Sequence[_RawBoxes], passed: Mask) -> Detections:
        """All detections with their confidence; their order within a frame is random."""
        parts = [part for part in parts if len(part.frame)] or parts[:1]  # in a live step, most are empty
        every = parts[0] if len(parts) == 1 else _RawBoxes.join(parts)
        width, height = sizes(every.boxes_px).T
        false, (uniforms, ties) = records.are_false(every.kind), every.uniforms.T
        confidence = self._confidence.score(
            states[every.frame], false, every.visible_fraction, np.sqrt(width * height), uniforms
        )
        output = self.model.gates.most_confident(every.frame, confidence, ties)
        if self.model.operating_threshold is not None:
            output &= confidence >= self.model.operating_threshold
        order = np.lexsort((ties, every.frame))
        order = order[output[order]]
        gated = ~passed
        gated[every.target[~output & ~false]] = True
        gated[every.partner[~output & (every.partner >= 0)]] = True
        columns = {name: getattr(every, name)[order] for name in _KEPT_COLUMNS}
        return Detections(states=states, confidence=confidence[order], gated=gated, **columns)


def false_positive_source(model: DetectorModel, statistics: TargetStatistics) -> false_positives.FalsePositiveSource:
    """The false positives of a detector. Raises ModsimError if their sizes come from targets, and there are none."""
    return false_positives.FalsePositiveSource.of(
        model.false_positives, false_positive_rates(model), model.column("false_positive_labels"), statistics
    )


def false_positive_rates(model: DetectorModel) -> false_positives.FalsePositiveRates:
    """Rates of false positives that each state of a detector asks for."""
    discovery, per_image = model.column("false_discovery_rate"), model.column("false_positives_per_image")
    return false_positives.FalsePositiveRates(discovery, per_image, model.confidence_threshold)


def target_statistics(model: DetectorModel, parts: Iterable[tuple[CameraFrames, Targets]]) -> TargetStatistics:
    """Statistics that a `Detector` needs of the targets in `parts`, the whole scene, that pass its gates; else none."""
    if not model.needs_target_statistics:
        return TargetStatistics()
    return TargetStatistics.total(
        TargetStatistics.of(model.dropout, draws.select(targets, np.flatnonzero(model.gates.passed(frames, targets))))
        for frames, targets in parts
    )


# ---- The parts of a detector, and the models that each part can be ----


class DetectorPart(StrEnum):
    """The parts of a detector in the order in which it works, with the names that reports use."""

    STATE = "performance state"
    CLASS = "dropout and class"
    BOX_ERROR = "box error"
    FALSE_POSITIVES = "false positives"
    CONFIDENCE = "confidence"


MARKOV_CHAIN, CONFUSION = "markov_chain", "confusion"

MODELS: Mapping[DetectorPart, Mapping[str, object]] = {  # what draws each part, by the name of the model
    DetectorPart.STATE: {MARKOV_CHAIN: PerformanceStates},
    DetectorPart.CLASS: {CONFUSION: ConfusionClassifier, **EFFECTS},
    DetectorPart.BOX_ERROR: draws.ERROR_DISTRIBUTIONS,
    DetectorPart.FALSE_POSITIVES: false_positives.FALSE_POSITIVE_MODELS,
    DetectorPart.CONFIDENCE: SCORES,
}


@dataclass(frozen=True)
class UsedModel:
    """A model that a detector uses: its registered name, the key of the file that chooses it, and its state, if one."""

    part: DetectorPart
    name: str
    key: str
    state: str | None = None


def used_models(model: DetectorModel) -> Iterator[UsedModel]:
    """Every model that a detector uses, in the order of its parts."""
    yield UsedModel(DetectorPart.STATE, MARKOV_CHAIN, "performance")
    yield UsedModel(DetectorPart.CLASS, CONFUSION, "dropout.model")
    for effect in model.dropout.effects:
        yield UsedModel(DetectorPart.CLASS, model_name(EFFECTS, effect), f"dropout.{effect.attribute}")
    for index, effects in model.dropout.own.items():
        for effect in effects:
            name = model.states[index].name
            key = f"states.{name}.dropout.{effect.attribute}"
            yield UsedModel(DetectorPart.CLASS, model_name(EFFECTS, effect), key, name)
    for state in model.states:
        name = model_name(draws.ERROR_DISTRIBUTIONS, state.box_error.distribution)
        yield UsedModel(DetectorPart.BOX_ERROR, name, f"states.{state.name}.box_error.law", state.name)
    yield UsedModel(DetectorPart.FALSE_POSITIVES, model.false_positives.model, "false_positives.model")
    for state in model.states:
        true, false = state.confidence.true, state.confidence.false
        for suffix, scores in ({"": true} if true is false else {".true": true, ".false": false}).items():
            key = f"states.{state.name}.confidence{suffix}"
            yield UsedModel(DetectorPart.CONFIDENCE, model_name(SCORES, scores), key, state.name)


def model_name(models: Mapping[str, type], value: object) -> str:
    """The name under which the type of a value is registered. Raises LookupError if it is not."""
    for name, kind in models.items():
        if type(value) is kind:
            return name
    raise LookupError(f"{type(value).__name__} is not registered: known are {', '.join(models)}")
