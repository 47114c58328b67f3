"""What AIS says of vessels besides positions, and how far it is off: sizes, headings and the antenna's place.

The errors are as large as learning takes them to be, so that what it takes off is really there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.voyages.reported import lasting
from modsim3d.core.arrays import Array
from modsim3d.learn.voyage.reference_error import ReferenceNoise
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses

_HEADING, _SIZES, _ANTENNA = 2, slice(3, 6), slice(6, 8)
_MIN_SHARE = 0.2
"""A vessel is at least so large, as a share of what the scene says: a normal number may be below zero."""


@dataclass(frozen=True, eq=False)
class Guesses:
    """Errors of what a scene from AIS says of V vessels, in S steps.

    Attributes:
        sizes_m: Of length, beam and air draft, true less said, shape (V, 3).
        antennas_m: How far positions are off towards the bow and to port, shape (V, 2).
        headings_rad: Of headings, said less true, shape (S, V).
    """

    sizes_m: Array
    antennas_m: Array
    headings_rad: Array

    @classmethod
    def drawn(cls, scene: Scene, seed: int) -> Guesses:
        """Draw them for the scene that `modsim3d ais` has made, as `ReferenceNoise` has their spread."""
        noise, rng = ReferenceNoise.of(scene), np.random.default_rng([seed, 2])
        constant = rng.normal(0, noise.std)
        headings = rng.normal(size=(scene.steps, len(scene.vessels)))
        lasting(headings.T, np.exp(-np.diff(scene.times_s(0, scene.steps)) / noise.position_s))
        return cls(constant[:, _SIZES], constant[:, _ANTENNA], headings * noise.std[:, _HEADING])

    def true_scene(self, scene: Scene) -> Scene:
        """The scene with vessels as large as they really are."""
        vessels = []
        for vessel, wrong in zip(scene.vessels, self.sizes_m, strict=True):
            length, beam, air_draft = np.maximum(vessel.extents_m + wrong, _MIN_SHARE * vessel.extents_m).tolist()
            vessels.append(replace(vessel, length_m=length, beam_m=beam, air_draft_m=air_draft))
        return replace(scene, vessels=tuple(vessels))

    def as_said(self, scene: Scene, said: Scene) -> Scene:
        """A true scene with the sizes that another one says, and wrong headings and antennas."""
        true = scene.poses.poses(0, scene.steps)
        ahead = np.stack([np.cos(true.headings_rad), np.sin(true.headings_rad)], axis=-1)
        port = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
        moved = true.positions_m.copy()
        along, across = self.antennas_m.T[..., None]
        moved[..., :2] += along * ahead + across * port
        poses = Poses(true.present, moved, true.headings_rad + self.headings_rad)
        return replace(scene, vessels=said.vessels, poses=RecordedPoses(scene.poses.timestamps, poses))
