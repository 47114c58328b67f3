"""The whole detector: annotated boxes in, detections out."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.box_error import NormalBoxError
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.clutter import ClutterSource
from modsim3d.detector.confidence import NormalConfidence
from modsim3d.detector.draws import select, target_uniforms
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import FALSE_POSITIVE, TRUE, Detections, Frames, Targets
from modsim3d.detector.states import StateSequence
from modsim3d.random_streams import Streams


class Detector:
    """A simulated detector (Jessen & Mohr (2023), section 7.6).

    State, dropout and class, box error, false positives, confidence, in this order. The same frames give the
    same detections, whatever was detected before and however a run is split into chunks.
    """

    def __init__(self, model: DetectorModel, seed: int) -> None:
        """Build the parts that the model asks for."""
        self.model = model
        self._streams = Streams(seed)
        self._states = StateSequence(model, self._streams)
        self._classifier = ConfusionClassifier.from_model(model)
        self._box_error = NormalBoxError.from_model(model)
        self._clutter = ClutterSource.from_model(model)
        self._confidence = NormalConfidence.from_model(model)

    def detect(self, frames: Frames, targets: Targets) -> Detections:
        """What the detector puts out for a run of frames of one camera.

        Raises:
            ModsimError: The box error of a state leaves nothing of a box, however often it is drawn.
        """
        streams = self._streams
        states = self._states.at(frames)
        label = self._classifier.classify(streams, frames, states, targets)
        rows = np.flatnonzero(label >= 0)
        kept = select(targets, rows)
        placed = self._box_error.misplace(streams, frames, states, kept)
        clutter = self._clutter.draw(streams, frames, states, kept)
        final = np.concatenate(
            [
                target_uniforms(streams, "detector.confidence", frames, kept, width=2),
                clutter.uniforms(streams, "detector.clutter_confidence", frames, width=2),
            ]
        )
        frame = np.concatenate([kept.frame, clutter.frame])
        n_false = len(clutter.frame)
        # A random key each shuffles the rows within a frame: their order does not tell where they come from.
        order = np.lexsort((final[:, 1], frame))
        return Detections(
            states=states,
            frame=frame[order],
            target=np.concatenate([rows, np.full(n_false, -1)])[order],
            kind=np.repeat([TRUE, FALSE_POSITIVE], [len(rows), n_false])[order],
            label=np.concatenate([label[rows], clutter.label])[order],
            confidence=self._confidence.score(states[frame], final[:, 0])[order],
            boxes_px=np.concatenate([placed.boxes_px, clutter.boxes_px])[order],
            errors_px=np.concatenate([placed.errors_px, np.full((n_false, 4), np.nan)])[order],
            redrawn=np.concatenate([placed.redrawn, np.zeros(n_false, dtype=bool)])[order],
        )
