"""Checks of a scene as a whole, whose parts are valid by themselves."""

from __future__ import annotations

import numpy as np

from modsim3d.geometry.camera import Camera
from modsim3d.scene.places import place_problems
from modsim3d.scene.scene import Scene

CHECKED_STEPS = 1000
"""Steps whose camera positions are checked together; it bounds the memory."""


def scene_problems(scene: Scene) -> list[str]:
    """Every problem, each with its path in the scene file."""
    problems = [
        f"cameras.{camera.name}.distortion: {problem}"
        for camera in scene.cameras
        if (problem := camera.intrinsics.lens_problem())
    ]
    if scene.live:
        return problems + _live_problems(scene)
    problems += [problem for camera in scene.cameras if (problem := _frame_problem(scene, camera))]
    return problems + _place_problems(scene)


def _live_problems(scene: Scene) -> list[str]:
    """Parts that need steps which a live scene does not know yet."""
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
    """Problem of a camera that asks for more frames than there are steps, or for none.

    The median interval counts, since a log may have gaps.
    """
    if camera.frame_rate_hz is None and not camera.start_offset_s:
        return None
    times_s = scene.times_s(0, scene.steps)
    interval_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
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
    """Problems of the cameras' places at all steps."""
    found: dict[str, tuple[str, ...]] = {}
    for first in range(0, scene.steps, CHECKED_STEPS):
        steps = np.arange(first, min(first + CHECKED_STEPS, scene.steps))
        found.update(place_problems(scene, steps, leave_out=found))
    return [problem for problems in found.values() for problem in problems]
