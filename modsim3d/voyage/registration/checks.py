"""When a registration cannot be known, and why."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.display import counted
from modsim3d.errors import ModsimError
from modsim3d.scene.scene import Scene
from modsim3d.voyage.registration.aligning import Alignment
from modsim3d.voyage.registration.boxes_at_times import BoxesAtTimes
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.search import Search, search

LEAST_VESSELS, LEAST_MATCHES = 3, 30
LEAST_BEARINGS_DEG = 3.0
OVER_CHANCE = 1.5
LEAST_SHARE = 0.15
"""Least share of the detections that a registration has to explain."""
_NEEDED = f"at least {LEAST_MATCHES} matches of {LEAST_VESSELS} vessels are needed"
_OTHERWISE = (
    "The log may be of another place, camera or time; its boxes may be in pixels of another size, or too far off; or "
    "what the scene says of the camera is: its place, its focal length, or its pitch, by more than 4°"
)


def check_times(model: BoxModel, found: BoxesAtTimes, searched_s: float) -> None:
    """Whether scene and detections have a time in common, the searched offset allowed.

    Raises:
        ModsimError: There is none, or there are no detections.
    """
    if not len(found.frame):
        raise ModsimError("registration: there are no detections")
    if len(found.frame) < LEAST_MATCHES:
        raise ModsimError(f"registration: too little to go by: {counted(len(found.frame), 'detection')}, and {_NEEDED}")
    others = int(model.traffic.present.any(axis=0).sum()) - (model.traffic.carrier is not None)
    if others < LEAST_VESSELS:
        raise ModsimError(
            f"registration: the scene has {counted(others, 'vessel')} for the camera to see; at least {LEAST_VESSELS} "
            "are needed"
        )
    low, high = model.traffic.span_s
    first, last = found.times_s[[0, -1]]
    if last + searched_s < low or first - searched_s > high:
        apart = first - high if first > high else last - low
        raise ModsimError(
            f"registration: the detections are from {first:,.1f} to {last:,.1f} s and the scene from {low:,.1f} to"
            f" {high:,.1f} s: the clocks are {_duration(abs(apart))} apart, and at most {searched_s:g} s are searched."
            " Check the time zone and the start of the log"
        )


def check_search(voted: Search, model: BoxModel, found: BoxesAtTimes, clocks_s: Array, scene: Scene) -> None:
    """Whether the best guess explains more detections than chance.

    Raises:
        ModsimError: It does not, with what else would explain them.
    """
    _check_bearings(model, found.boxes_px, "detections")
    best = voted.guesses[0].votes if voted.guesses else 0
    if best > OVER_CHANCE * voted.chance and best >= LEAST_SHARE * voted.searched:
        return
    around = search(model, found, clocks_s[:: max(len(clocks_s) // 20, 1)], np.pi, 1)
    most = around.guesses[0].votes if around.guesses else 0
    if most > OVER_CHANCE * around.chance and most >= LEAST_SHARE * around.searched and most > 2 * best:
        turn = around.guesses[0].yaw_deg
        yaw_rad = np.arctan2(*(f(model.traffic.camera.mount.yaw_rad + np.radians(turn)) for f in (np.sin, np.cos)))
        raise ModsimError(
            f"registration: the camera looks another way than {scene.title} says: {most} of {around.searched}"
            f" detections are explained by a camera that is turned by {turn:+.0f}° of yaw, and {best} by one that looks"
            f" as the scene says. Correct the yaw in the scene: yaw_rad is about {yaw_rad:.2f}"
        )
    mirrored = "Mirrored ones fit better: the images may be mirrored, or upside down" if voted.chance > 2 * best else ""
    raise ModsimError(
        f"registration: the detections do not fit the vessels of {scene.title}: the best clock, within"
        f" {max(abs(clocks_s)):g} s, and the best yaw explain {best} of {voted.searched} detections, and"
        f" {voted.chance} of mirrored detections, which cannot be right. {mirrored or _OTHERWISE}"
    )


def check_matches(model: BoxModel, aligned: Alignment, names: tuple[str, ...]) -> None:
    """Whether enough vessels were matched, and not all at one bearing.

    Raises:
        ModsimError: Too few vessels or matches, or one bearing only.
    """
    seen = aligned.sightings
    vessels = np.unique(seen.vessel)
    if len(vessels) < LEAST_VESSELS or len(seen) < LEAST_MATCHES:
        who = ", ".join(names[vessel] for vessel in vessels) or "none"
        raise ModsimError(
            f"registration: too little to go by: {counted(len(seen), 'match', 'matches')} of "
            f"{counted(len(vessels), 'vessel')} ({who}); {_NEEDED}"
        )
    _check_bearings(model, seen.boxes_px, "matched vessels")


def _check_bearings(model: BoxModel, boxes_px: Array, what: str) -> None:
    """Refuse what is all in one direction."""
    lens = model.traffic.camera.intrinsics
    pixels = np.stack([(boxes_px[:, 0] + boxes_px[:, 2]) / 2, boxes_px[:, 3]], axis=-1)
    rays = lens.unproject(pixels, np.ones(len(pixels)))
    low, high = np.nanpercentile(np.degrees(np.arctan2(rays[:, 0], rays[:, 2])), [2, 98])
    if high - low < LEAST_BEARINGS_DEG:
        raise ModsimError(
            f"registration: all {what} lie within {high - low:.1f}° of one bearing; at least"
            f" {LEAST_BEARINGS_DEG:g}° are needed to tell the clock, the yaw and the lens apart"
        )


def _duration(seconds: float) -> str:
    if seconds >= 5400:
        return f"{seconds / 3600:,.1f} hours"
    return f"{seconds / 60:.0f} minutes" if seconds >= 120 else f"{seconds:.0f} s"
