"""The whole detector: annotated boxes in, detections out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes, unions
from modsim3d.detector.box_error import BoxErrorSource, MisplacedBoxes, TrueBoxes
from modsim3d.detector.census import TargetCensus
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.clutter import Clutter, ClutterSource, Surroundings
from modsim3d.detector.clutter_models import ClutterRates, FrameCounts
from modsim3d.detector.confidence import Confidence
from modsim3d.detector.draws import DUPLICATE_REDRAW_STREAMS, DUPLICATE_STREAMS, latent_normals, select, target_uniforms
from modsim3d.detector.merges_and_splits import Events, halves
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Clock, VesselNoise
from modsim3d.detector.records import (
    DUPLICATE,
    FALSE_KINDS,
    FALSE_POSITIVE,
    FRAGMENT,
    MERGED,
    PERSISTENT,
    SPLIT,
    TRUE,
    CameraFrames,
    Detections,
    Targets,
)
from modsim3d.detector.states import PerformanceStates
from modsim3d.random_streams import Purpose, Streams


@dataclass(frozen=True, eq=False)
class _Found:
    """Detections of one origin before they have a confidence: columns of `Detections`, and what confidence needs.

    Attributes:
        visible_fraction: Of the vessel, NaN where there is none, shape (m,).
        uniforms: For confidence and order, shape (m, 2).
    """

    frame: Indices
    target: Indices
    partner: Indices
    kind: Indices
    label: Indices
    boxes_px: Array
    errors_px: Array
    redrawn: Mask
    visible_fraction: Array
    uniforms: Array


@dataclass(frozen=True, eq=False)
class _Shown:
    """Detected vessels, with two merged ones as one.

    Attributes:
        targets: With the box around both where merged.
        row: Row of the annotated target, shape (n,).
        partner: Row of the smaller of two that are merged, else -1, shape (n,).
        label: Detected label, shape (n,).
    """

    targets: Targets
    row: Indices
    partner: Indices
    label: Indices


class Detector:
    """A simulated detector (Jessen & Mohr (2023), section 7.6).

    State, dropout and class, box error, false positives, confidence, in this order. The same frames give the
    same detections, whatever was detected before and however a run is split into chunks.
    """

    def __init__(self, model: DetectorModel, seed: int, census: TargetCensus, clock: Clock | None = None) -> None:
        """Build the parts that the model asks for.

        Args:
            model: What the detector is like.
            seed: Everything random comes from it.
            census: Of the scene's targets, from `take_census`.
            clock: Times of the scene's steps, for noise that persists.

        Raises:
            ModsimError: The model needs a clock and has none, or takes sizes from targets and there are none.
        """
        self.model = model
        self._streams = Streams(seed)
        self._states = PerformanceStates(model, self._streams)
        self._noise = VesselNoise(model.persistence, self._streams, clock)
        self._classifier = ConfusionClassifier.from_model(model, census)
        self._box_error = BoxErrorSource.from_model(model)
        self._clutter = clutter_of(model, census)
        self._confidence = Confidence([state.confidence for state in model.states], model.confidence_threshold)

    def detect(self, frames: CameraFrames, targets: Targets) -> Detections:
        """The detections in a run of frames of one camera.

        Raises:
            ModsimError: The box error of a state leaves nothing of a box, however often it is drawn.
        """
        states = self._states.at(frames)
        passed = self.model.gates.passed(frames, targets)
        shown = self._shown(frames, states, targets, np.flatnonzero(passed))
        vessels = shown.targets
        latent = self._noise.normals(frames, vessels, self._box_error.extra_normals)
        placed = self._box_error.misplace(self._streams, TrueBoxes.of(frames, states, vessels), latent)
        single = shown.partner < 0
        events = self.model.merges_and_splits.events(self._streams, frames, vessels, placed.boxes_px, single)
        found = [
            self._true(frames, shown, placed, events),
            *self._second_boxes(frames, states, shown, placed, events),
            *self._false(frames, states, shown, events),
        ]
        return self._scored(states, found, passed)

    def _shown(self, frames: CameraFrames, states: Indices, targets: Targets, passed: Indices) -> _Shown:
        """Vessels that are neither missed nor merged into another's box."""
        candidates = targets if len(passed) == len(targets) else select(targets, passed)
        label = self._classifier.classify(frames, states, candidates, self._noise.uniforms(frames, candidates))
        detected = np.flatnonzero(label >= 0)
        rows, label = passed[detected], label[detected]
        kept = select(targets, rows)
        pairs = self.model.merges_and_splits.merged_pairs(self._streams, frames, kept)
        if not len(pairs):
            return _Shown(kept, rows, np.full(len(rows), -1), label)
        larger, smaller = pairs.T
        boxes, partner = kept.boxes_px.copy(), np.full(len(rows), -1)
        boxes[larger], partner[larger] = unions(boxes[larger], boxes[smaller]), rows[smaller]
        rest = np.setdiff1d(np.arange(len(rows)), smaller)
        return _Shown(select(replace(kept, boxes_px=boxes), rest), rows[rest], partner[rest], label[rest])

    def _true(self, frames: CameraFrames, shown: _Shown, placed: MisplacedBoxes, events: Events) -> _Found:
        """One detection of each vessel shown."""
        boxes, errors = placed.boxes_px, placed.errors_px
        kind = np.where(shown.partner >= 0, MERGED, TRUE)
        if len(events.split):
            boxes = boxes.copy()
            boxes[events.split], _ = halves(boxes[events.split], events.cut)
            kind[events.split] = SPLIT
        if np.any(kind != TRUE):
            errors = np.where((kind == TRUE)[:, None], errors, np.nan)
        return _of_vessels(
            shown,
            slice(None),
            kind,
            boxes,
            errors,
            placed.redrawn,
            self._final(frames, shown.targets, Purpose.CONFIDENCE),
        )

    def _second_boxes(
        self, frames: CameraFrames, states: Indices, shown: _Shown, placed: MisplacedBoxes, events: Events
    ) -> Sequence[_Found]:
        """Further boxes of vessels that have one."""
        found = []
        if len(events.doubled):
            vessels = select(shown.targets, events.doubled)
            extra, true = self._box_error.extra_normals, TrueBoxes.of(frames, states, vessels)
            latent = latent_normals(self._streams, DUPLICATE_STREAMS, frames, vessels, extra)
            again = self._box_error.misplace(self._streams, true, latent, DUPLICATE_REDRAW_STREAMS)
            final = self._final(frames, vessels, Purpose.DUPLICATE_CONFIDENCE)
            kind = np.full(len(vessels), DUPLICATE)
            found.append(
                _of_vessels(shown, events.doubled, kind, again.boxes_px, again.errors_px, again.redrawn, final)
            )
        if len(events.split):
            _, smaller = halves(placed.boxes_px[events.split], events.cut)
            kind = np.full(len(smaller), FRAGMENT)
            final = self._final(frames, select(shown.targets, events.split), Purpose.FRAGMENT_CONFIDENCE)
            nothing = np.full((len(smaller), 4), np.nan)
            redrawn = np.zeros(len(smaller), dtype=bool)
            found.append(_of_vessels(shown, events.split, kind, smaller, nothing, redrawn, final))
        return found

    def _false(self, frames: CameraFrames, states: Indices, shown: _Shown, events: Events) -> Sequence[_Found]:
        """Detections of nothing."""
        vessels = shown.targets
        n_true = np.bincount(vessels.frame, minlength=len(frames)).astype(np.int64)
        due = self.model.gates.due(frames)
        counts = FrameCounts(states, due, n_true, events.expected)
        around = Surroundings(self._streams, frames, counts, vessels)
        transient = self._clutter.draw_transient(around)
        found = [self._of_clutter(frames, transient, FALSE_POSITIVE, Purpose.CLUTTER_CONFIDENCE)]
        if self.model.clutter.persistent_share:
            clutter = self._clutter.draw_persistent(around)
            found.append(self._of_clutter(frames, clutter, PERSISTENT, Purpose.PERSISTENT_CONFIDENCE))
        return found

    def _of_clutter(self, frames: CameraFrames, clutter: Clutter, kind: int, purpose: Purpose) -> _Found:
        count = len(clutter.frame)
        nobody, unknown = np.full(count, -1), np.full(count, np.nan)
        return _Found(
            frame=clutter.frame,
            target=nobody,
            partner=nobody,
            kind=np.full(count, kind),
            label=clutter.label,
            boxes_px=clutter.boxes_px,
            errors_px=np.full((count, 4), np.nan),
            redrawn=np.zeros(count, dtype=bool),
            visible_fraction=unknown,
            uniforms=clutter.uniforms(self._streams, purpose, frames),
        )

    def _final(self, frames: CameraFrames, vessels: Targets, purpose: Purpose) -> Array:
        """Numbers for confidence and order, shape (n, 2)."""
        return target_uniforms(self._streams, purpose, frames, vessels)

    def _scored(self, states: Indices, found: Sequence[_Found], passed: Mask) -> Detections:
        """All of them with their confidence; their order within a frame is random."""
        every = _Found(**{name: np.concatenate([getattr(part, name) for part in found]) for name in _COLUMNS})
        width, height = sizes(every.boxes_px).T
        false = np.isin(every.kind, FALSE_KINDS)
        confidence = self._confidence.score(
            states[every.frame],
            false,
            every.visible_fraction,
            np.sqrt(width * height),
            every.uniforms[:, 0],
        )
        output = self.model.gates.most_confident(every.frame, confidence, every.uniforms[:, 1])
        order = np.lexsort((every.uniforms[:, 1], every.frame))
        gated = ~passed
        if not output.all():
            order = order[output[order]]
            gated[every.target[~output & ~false]] = True
            gated[np.setdiff1d(every.partner[~output], [-1])] = True
        return Detections(
            states=states,
            frame=every.frame[order],
            target=every.target[order],
            partner=every.partner[order],
            kind=every.kind[order],
            label=every.label[order],
            confidence=confidence[order],
            boxes_px=every.boxes_px[order],
            errors_px=every.errors_px[order],
            redrawn=every.redrawn[order],
            gated=gated,
        )


_COLUMNS = tuple(_Found.__dataclass_fields__)


def _of_vessels(
    shown: _Shown,
    rows: Indices | slice,
    kind: Indices,
    boxes_px: Array,
    errors_px: Array,
    redrawn: Mask,
    uniforms: Array,
) -> _Found:
    """Detections of some of the vessels shown."""
    return _Found(
        frame=shown.targets.frame[rows],
        target=shown.row[rows],
        partner=np.where(kind == MERGED, shown.partner[rows], -1),
        kind=kind,
        label=shown.label[rows],
        boxes_px=boxes_px,
        errors_px=errors_px,
        redrawn=redrawn,
        visible_fraction=shown.targets.visible_fraction[rows],
        uniforms=uniforms,
    )


def clutter_of(model: DetectorModel, census: TargetCensus) -> ClutterSource:
    """The false positives of a detector.

    Raises:
        ModsimError: Their sizes come from the scene's targets, and there are none.
    """
    return ClutterSource.of(model.clutter, clutter_rates(model), model.column("false_positive_labels"), census)


def clutter_rates(model: DetectorModel) -> ClutterRates:
    """How many false positives each state of a detector asks for."""
    discovery, per_image = model.column("false_discovery_rate"), model.column("false_positives_per_image")
    return ClutterRates(discovery, per_image, model.confidence_threshold)
