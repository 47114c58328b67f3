"""Checks that each camera of a scene has a pose at each step and is not inside a body."""

from __future__ import annotations

from collections.abc import Collection

from modsim3d.arrays import Indices
from modsim3d.errors import InputError
from modsim3d.geometry.camera import Camera
from modsim3d.scene.scene import Scene
from modsim3d.vessels.obstacles import PREFIX


def place_problems(scene: Scene, steps: Indices, leave_out: Collection[str] = ()) -> dict[str, tuple[str, ...]]:
    """Problems of each camera's place at some steps: it has no pose, or is inside a body.

    Args:
        scene: The scene.
        steps: Ascending, shape (S,).
        leave_out: Names of cameras that are not checked.

    Returns:
        Camera → problems; only cameras that have one.
    """
    found = {}
    for camera in scene.cameras:
        if camera.name not in leave_out:
            try:
                _check_place(scene, camera, steps)
            except InputError as error:
                found[camera.name] = error.problems
    return found


def _check_place(scene: Scene, camera: Camera, steps: Indices) -> None:
    sight = scene.sight(camera, steps)
    inside = None if scene.annotation.allow_camera_inside else sight.body_around()
    if inside is None:
        return
    frame, body = inside
    when = scene.poses.timestamps[int(steps[frame])]
    kind, name = ("vessel", scene.occluder_names[body])
    if body >= len(scene.vessels):
        kind, name = "obstacle", name.removeprefix(PREFIX)
    raise InputError(
        f"scene {scene.path}",
        [
            f"cameras.{camera.name}: is inside {kind} '{name}' at time {when} s: move one of them, or set "
            "annotation.allow_camera_inside: true"
        ],
    )
