"""Checks of a scene as a whole: its parts are valid by themselves, but may not go together."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from modsim3d.core.arrays import Indices
from modsim3d.core.errors import InputError
from modsim3d.geometry.camera import Camera
from modsim3d.io.validation import nearest
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.world.bodies import PREFIX

CHECKED_STEPS = 1000
"""Steps whose camera positions are checked together; it bounds the memory."""


def scene_problems(scene: Scene) -> list[str]:
    """Every problem, each with its path in the scene file."""
    problems = [
        f"cameras.{camera.name}.distortion: {problem}"
        for camera in scene.cameras
        if (problem := camera.intrinsics.lens_problem())
    ]
    problems += [
        f"ais.vessels.{name}: no vessel '{name}' ({nearest(name, scene.vessel_names)})"
        for name in scene.ais.vessels
        if name not in scene.vessel_names
    ]
    if scene.live:
        return problems + _live_problems(scene)
    problems += [problem for camera in scene.cameras if (problem := _frame_problem(scene, camera))]
    return problems + _place_problems(scene)


def _live_problems(scene: Scene) -> list[str]:
    """Parts of a scene that need later steps, which a live scene does not know yet."""
    problems = []
    if scene.waves is not None and scene.waves.motion.needs_velocity:
        problems.append(
            "waves.spectrum: the sea needs the velocities of vessels, which a stream gives too late: use a level or "
            "coefficients"
        )
    if scene.detector.dropout.anchored:
        problems.append(
            "detector: holds rates over the whole scene (anchor: state_rate), which a stream does not know beforehand: "
            "use anchor: none"
        )
    if scene.detector.clutter.needs_census:
        problems.append(
            "detector: false positives are as large as the scene's vessels, which a stream does not show beforehand: "
            "give false_positives a size"
        )
    return problems


def _frame_problem(scene: Scene, camera: Camera) -> str | None:
    """Problem of a camera that should take more frames than there are steps, or that takes none."""
    if camera.frame_rate_hz is None and not camera.start_offset_s:
        return None
    times_s = scene.times_s(0, scene.steps)
    interval_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0  # a log may have gaps
    rate = camera.frame_rate_hz
    if rate is not None and rate * interval_s > 1 + 1e-6:
        return (
            f"cameras.{camera.name}.frame_rate_hz: {rate:g} frames a second are more than the scene's steps of "
            f"{interval_s:g} s give: at most {1 / interval_s:g}, or leave it out for a frame at every step"
        )
    if not len(scene.frame_steps(camera, 0, scene.steps)):
        return (
            f"cameras.{camera.name}.start_offset_s: the scene ends {times_s[-1]:g} s after its first step, "
            f"before the first frame is due ({camera.start_offset_s:g} s): no frame would be taken"
        )
    return None


def _place_problems(scene: Scene) -> list[str]:
    found: dict[str, tuple[str, ...]] = {}
    for first in range(0, scene.steps, CHECKED_STEPS):
        steps = np.arange(first, min(first + CHECKED_STEPS, scene.steps))
        found.update(place_problems(scene, steps, leave_out=found))
    return [problem for problems in found.values() for problem in problems]


def place_problems(scene: Scene, steps: Indices, leave_out: Collection[str] = ()) -> dict[str, tuple[str, ...]]:
    """Problems of each camera's place at some ascending steps of shape (S,): it has no pose, or is inside a body.

    Returns:
        Name of the camera → its problems; only cameras that have one and are not left out.
    """
    found, calm = {}, None
    for camera in scene.cameras:
        if camera.name not in leave_out:
            try:
                calm = calm or scene.own_motion.at(steps)
                _check_place(scene, scene.sight(camera, steps, calm))
            except InputError as error:
                found[camera.name] = error.problems
    return found


def _check_place(scene: Scene, calm: Sight) -> None:
    """Raise an error if the camera is inside a body.

    In `calm`, waves move only the vessels that carry cameras. Waves take time to compute, so those of other vessels are
    added only for vessels that come within reach of the camera.
    """
    if scene.annotation.allow_camera_inside:
        return
    sight, motion = calm, scene.motion
    if within_reach := {*calm.vessels_within_reach.tolist()}.intersection(motion.moved):
        moved = tuple(sorted(within_reach.union(scene.own_ships)))
        sight = scene.sight(calm.camera, calm.steps, replace(motion, moved=moved).at(calm.steps))
    inside = sight.body_around()
    if inside is None:
        return
    frame, body = inside
    when = scene.poses.timestamps[int(sight.steps[frame])]
    kind, name = ("vessel", scene.occluder_names[body])
    if body >= len(scene.vessels):
        kind, name = "obstacle", name.removeprefix(PREFIX)
    problem = (
        f"cameras.{sight.camera.name}: is inside {kind} '{name}' at time {when} s: move one of them, or set "
        "annotation.allow_camera_inside: true"
    )
    raise InputError(scene.title, [problem])
