"""What a file of tracks in the world says, before it is known to be plausible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from modsim3d.ais.geography import local_metres
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.errors import InputError
from modsim3d.inputs.misreadings import LOST, has_lost_digits, other_unit
from modsim3d.inputs.validation import shown
from modsim3d.motion.encounters import hull_tracks
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.world_diagnosis import world_misreading
from modsim3d.tracks.world_tracks import WorldTracks

FAR_M = 100_000.0
"""Tracks that are all farther than that from where vessels are have another unit or another order."""
SHOWN_PROBLEMS = 5
MOST_DEG = (90.0, 180.0)


@dataclass(frozen=True, eq=False)
class WorldRows:
    """Rows of a file, in its order.

    Attributes:
        source: The file, for errors.
        name: What tables call the tracks.
        place: Name of a row by its index, for errors.
        track: The tracker's name of each row's track, shape (k,).
        time_s: Times since the scene's first step, shape (k,).
        position_m: Along w1 and w2, shape (k, 2).
        velocity_m_s: NaN where unknown, shape (k, 2).
        covariance: Of position and velocity, NaN where unknown, shape (k, 4, 4).
        degrees: Latitudes and longitudes, shape (k, 2), if the file gives these.
    """

    source: str
    name: str
    place: Callable[[int], str]
    track: list[str]
    time_s: Array
    position_m: Array
    velocity_m_s: Array
    covariance: Array
    degrees: Array | None = field(default=None)


def checked(rows: WorldRows, run: StoredRun) -> WorldTracks:
    """The tracks, if they can be those of a run.

    Raises:
        InputError: A row has no place or time, is outside the run or there twice, or has what is no covariance.
    """
    names, track = np.unique(np.array(rows.track, dtype=object).astype(str), return_inverse=True)
    track = np.asarray(track, dtype=np.int64).reshape(-1)
    _report(rows, np.array([not name for name in rows.track], dtype=bool), "track is empty")
    lost = [has_lost_digits(name) and any(mark in name for mark in ".,+") for name in rows.track]  # 1e10 may be a name
    _report(rows, np.array(lost, dtype=bool), f"track {LOST}", lambda row: f" (got {shown(rows.track[row])})")
    _report(rows, ~np.isfinite(rows.time_s), "has no time")
    _report(rows, _in_row(~np.isfinite(rows.position_m)), "has no position")
    _report(rows, _in_row(np.isinf(rows.velocity_m_s)), "the velocity is not finite")
    _report(rows, _in_row(np.isinf(rows.covariance)), "the covariance is not finite")
    _check_times(rows, run)
    _check_twice(rows, track)
    _check_covariances(rows)
    _check_place(rows, run)
    return WorldTracks.of(
        rows.name, track, tuple(names.tolist()), rows.time_s, rows.position_m, rows.velocity_m_s, rows.covariance
    )


def _in_row(flags: Mask) -> Mask:
    """Whether any flag of each row is up, shape (k, ...) to (k,)."""
    return np.asarray(flags.any(axis=tuple(range(1, flags.ndim))), dtype=np.bool_)


def _report(rows: WorldRows, wrong: Mask, what: str, got: Callable[[int], str] = lambda _: "") -> None:
    found = np.flatnonzero(wrong)
    if len(found):
        problems = [f"{rows.place(row)}: {what}{got(row)}" for row in found[:SHOWN_PROBLEMS].tolist()]
        if len(found) > SHOWN_PROBLEMS:
            problems.append(f"… and {len(found) - SHOWN_PROBLEMS:,} more")
        raise InputError(rows.source, problems)


def _check_times(rows: WorldRows, run: StoredRun) -> None:
    times_s = run.scene.times_s(0, run.steps)
    slack = float(np.median(np.diff(times_s))) / 2 if len(times_s) > 1 else 0.0
    outside = (rows.time_s < times_s[0] - slack) | (rows.time_s > times_s[-1] + slack)
    if not outside.any():
        return
    row = int(np.flatnonzero(outside)[0])
    problem = (
        f"{rows.place(row)}: time {rows.time_s[row]:.15g} s is outside of the run, which has 0 to {times_s[-1]:g} s "
        "since its first step"
    )
    start = float(run.scene.timestamps(0, 1)[0])
    shifted = rows.time_s - start
    if start and ((shifted >= -slack) & (shifted <= times_s[-1] + slack)).all():
        problem += f": the scene's own time begins at {start:.15g} s, take it off"
    raise InputError(rows.source, [problem + other_unit(rows.time_s, float(times_s[-1]))])


def _check_twice(rows: WorldRows, track: Indices) -> None:
    order = np.lexsort((rows.time_s, track))
    same = (np.diff(track[order]) == 0) & (np.diff(rows.time_s[order]) == 0)
    twice = np.zeros(len(track), dtype=bool)
    twice[order[1:]] = same
    if twice.any():
        row = int(np.flatnonzero(twice)[0])
        _report(rows, twice, f"a track may be there once at a time (got track {rows.track[row]!r} again)")


def _check_covariances(rows: WorldRows) -> None:
    for what, size in (("position", slice(0, 2)), ("velocity", slice(2, 4)), ("position and velocity", slice(0, 4))):
        block = rows.covariance[:, size, size]
        known = ~_in_row(~np.isfinite(block))
        wrong = np.zeros_like(known)
        wrong[known] = np.linalg.eigvalsh(block[known])[:, 0] <= 0
        _report(rows, wrong, f"the covariance of the {what} is not positive definite")


def _check_place(rows: WorldRows, run: StoredRun) -> None:
    """Refuse positions that are all far from every vessel, or near them in another reading, and say which fits."""
    hulls = hull_tracks(run.scene.vessels, run.scene.poses, run.steps)
    centres = hulls.centres_m.reshape(-1, 2)
    low, high = np.nanmin(centres, axis=0), np.nanmax(centres, axis=0)

    def near(position_m: Array) -> bool:
        beyond = np.maximum(np.maximum(low - position_m, position_m - high), 0)
        return bool((np.hypot(*beyond.T) <= FAR_M).any())

    if not len(rows.position_m) or near(rows.position_m):
        wrong = world_misreading(rows.time_s, rows.position_m, hulls, run.scene.own_ships)
        if wrong and rows.degrees is None:
            raise InputError(rows.source, [wrong])
        return
    problem = f"all positions are more than {FAR_M / 1000:g} km from where the run's vessels are"
    if rows.degrees is not None and run.scene.origin is not None:
        origin = run.scene.origin
        for reason, degrees in (
            ("latitude and longitude seem to be swapped", rows.degrees[:, ::-1]),
            ("latitude and longitude seem to be radians, must be degrees", np.rad2deg(rows.degrees)),
        ):
            if (np.abs(degrees) <= MOST_DEG).all() and near(local_metres(degrees[:, 0], degrees[:, 1], origin)):
                raise InputError(rows.source, [f"{problem}: {reason}"])
    elif near(rows.position_m / 1000):
        problem += ": they seem to be millimetres, must be metres"
    else:
        problem += ": must be metres along w1 and w2 from the scene's own zero"
    raise InputError(rows.source, [problem])
