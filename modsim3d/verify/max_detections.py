"""Frames in which the limit `max_detections` was reached: there the detections left out bias what is seen."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.model import DetectorModel
from modsim3d.verify.evidence import Evidence


def max_detections_note(model: DetectorModel, evidence: Evidence) -> str:
    """Why rates and confidence cannot be tested; empty if they can."""
    limit = model.gates.max_detections
    if limit is None:
        return ""
    reached = int((evidence.frames.n_kept + evidence.frames.n_false >= limit).sum())
    return f"max_detections was reached in {reached} images: what was left out is not known" if reached else ""


def frames_above_max(model: DetectorModel, evidence: Evidence) -> int:
    """Images with more detections than the limit."""
    limit = model.gates.max_detections
    return 0 if limit is None else int(np.sum(evidence.frames.n_kept + evidence.frames.n_false > limit))
