"""What a camera of a scene sees at the times of a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.runs.pipeline import block_steps, occlusion_by
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotated_rows
from modsim3d.truth.truth_record import Truth, concatenate
from modsim3d.voyage.attitude import Attitude
from modsim3d.voyage.sampling import Sampler

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer


@dataclass(frozen=True, eq=False)
class CameraTruth:
    """What a camera sees in n frames.

    Attributes:
        truth: Its rows; `step` is the number of the frame.
        half_planes: The sea's side of the horizon, shape (n, 3).
        camera_poses: From where it looks.
    """

    truth: Truth
    half_planes: Array
    camera_poses: CameraPoses


def camera_truth(
    scene: Scene,
    number: int,
    camera: Camera,
    times_s: Array,
    renderer: IdRenderer | None,
    attitude: Attitude | None = None,
) -> CameraTruth:
    """The truth of one camera at some times, as that of a run is made, hidden vessels included.

    Args:
        scene: The scene.
        number: Number of the camera in the scene.
        camera: The camera, which registration may have changed.
        times_s: Times since the scene's first step at which the vessel that carries it is there, at least one,
            ascending, shape (n,).
        renderer: That of `open_renderer`.
        attitude: That of own ship as it was measured, in place of the scene's waves.

    Raises:
        ModsimError: The camera has no place at a time.
    """
    sampler, parts, looks, length = Sampler(scene, attitude), [], [], block_steps(scene)
    for first in range(0, len(times_s), length):
        frames = np.arange(first, min(first + length, len(times_s)))
        sight = scene.sight(camera, np.arange(len(frames)), sampler.at(times_s[frames]))
        outlines = sight.outlines(as_shoeboxes=scene.annotation.source == "rectangles")
        occlusion = occlusion_by(outlines, camera.intrinsics, scene.annotation, renderer)
        parts.append(occlusion.truth(outlines, frames, number))
        looks.append(sight.camera_poses)
    truth = concatenate(parts)
    truth = truth.with_annotated(annotated_rows(truth, scene.annotation))
    rotations, places = (np.concatenate([getattr(each, name) for each in looks]) for name in _POSES)
    return CameraTruth(truth, camera.intrinsics.sea_half_plane(rotations), CameraPoses(rotations, places))


_POSES = ("camera_R_world", "positions_m")
