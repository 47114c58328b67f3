"""The vessels' poses at the steps of one part of a run, computed once for all cameras and for the view from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.scene.scene import Scene


class PartMotion:
    """Poses of a scene's vessels at some steps; waves make them dear."""

    def __init__(self, scene: Scene, steps: Sequence[Indices]) -> None:
        """Compute the poses at all steps that are in any of these, which are not all empty."""
        self._steps = np.unique(np.concatenate(steps))
        self._poses = scene.motion.at(self._steps)

    def at(self, steps: Indices) -> PosesInWaves:
        """The poses at some of the steps, ascending, shape (S,)."""
        return self._poses.rows(np.searchsorted(self._steps, steps))
