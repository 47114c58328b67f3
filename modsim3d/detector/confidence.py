"""How sure the detector says it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.detector.draws import normals
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array, Indices


@dataclass(frozen=True, eq=False)
class NormalConfidence:
    """Normal, moved to the nearer end of [threshold, 1] where outside (Jessen & Mohr (2023), section 7.6.2).

    Attributes:
        means: Of each state, shape (states,).
        stds: Of each state, shape (states,).
        threshold: Least confidence of a detection that is put out; it drops none.
    """

    means: Array
    stds: Array
    threshold: float

    @classmethod
    def from_model(cls, model: DetectorModel) -> NormalConfidence:
        """The confidence of a detector model."""
        return cls(model.column("confidence_mean"), model.column("confidence_std"), model.confidence_threshold)

    def score(self, state: Indices, uniforms: Array) -> Array:
        """Confidence of detections made in these states, from one uniform number each; shapes (m,)."""
        return np.clip(self.means[state] + self.stds[state] * normals(uniforms), self.threshold, 1.0)
