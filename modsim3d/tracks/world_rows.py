"""Rows of a file of tracks in the world, before they are known to be plausible."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.geometry.kinematics import HullTracks
from modsim3d.io.misreadings import LOST, ROUNDED, are_rounded, has_lost_digits, other_unit
from modsim3d.io.text_table import RowProblems
from modsim3d.io.validation import shown
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.ais.messages import local_metres
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.world.encounters import hull_tracks

_LOOKED_AT, _MIN_ROWS, _MIN_STEP_ROWS = 2000, 8, 30
"""Rows, spread over the file; fewer fit by chance, and more are needed where little changes."""
_FITS, _FITS_M, _NEARER, _MUCH, _STEP = 0.03, 50.0, 0.6, 3.0, 1.5
"""Another reading is meant if positions are at most this share of the vessels' extent from one, and this far, the gate
of `score`; this share of them is, and nearer than as the file is; and half of them by this factor, or by that where
they are a step off. A looser fit says nothing: so near to some vessel come tracks that are poor or false."""
_SCALES = {"kilometres": 1000.0, "nautical miles": 1852.0, "feet": 0.3048, "centimetres": 0.01, "millimetres": 0.001}
_MIRRORED = {"w1_m counts": (-1, 1), "w2_m counts": (1, -1), "w1_m and w2_m count": (-1, -1)}
_RELATIVE = "the positions are relative to own ship, must be from the scene's zero"


def world_misreading(time_s: Array, position_m: Array, hulls: HullTracks, own: tuple[int, ...]) -> str:
    """Fault of positions (k, 2) that are near vessels only if they are read in another way; empty if there is none.
    `hulls` are the vessels at all steps, and `own` the columns of those that carry cameras."""
    vessels_m = np.delete(hulls.centres_m, own, axis=1)
    if len(time_s) < _MIN_ROWS or np.isnan(vessels_m).all():
        return ""
    rows = np.unique(np.linspace(0, len(time_s) - 1, _LOOKED_AT).astype(np.int64))
    step = np.rint(np.interp(time_s[rows], hulls.times_s, np.arange(len(hulls.times_s)))).astype(np.int64)
    as_it_is = _nearest_m(position_m[rows], vessels_m[step])
    now, meant = float(np.median(as_it_is)), ""
    extent_m = float(np.hypot(*(np.nanmax(vessels_m, axis=(0, 1)) - np.nanmin(vessels_m, axis=(0, 1)))))
    best = limit = min(_FITS * extent_m, _FITS_M)
    for fault, places_m, at in _readings(position_m[rows], step, hulls, own):
        away = _nearest_m(places_m, vessels_m[at])
        factor, least = (_MUCH, _MIN_ROWS) if at is step else (_STEP, _MIN_STEP_ROWS)
        half, nearer = float(np.median(away)), ((away < as_it_is) & (away < limit)).mean() >= _NEARER
        if half < best and now > factor * half and nearer and len(rows) >= least:
            best, meant = half, fault
    return meant and f"{meant} (then half of them are within {best:.3g} m of a vessel instead of {now:.3g} m)"


def _readings(
    position_m: Array, step: Indices, hulls: HullTracks, own: tuple[int, ...]
) -> Iterator[tuple[str, Array, Indices]]:
    """Fault in each other reading, and the places and steps of the rows in it."""
    yield "w1_m and w2_m of the positions are exchanged", position_m[:, ::-1], step
    for signs in ((1, -1), (-1, 1)):
        yield "the positions are turned by a right angle", position_m[:, ::-1] * signs, step
    for axes, signs in _MIRRORED.items():
        yield f"{axes} the other way round in the positions, as in mirrored or turned axes", position_m * signs, step
    for unit, scale in _SCALES.items():
        yield f"the positions seem to be {unit}, must be metres", position_m * scale, step
    for column in own[:1]:
        own_m, heading, (ahead, port) = hulls.centres_m[step, column], hulls.headings_rad[step, column], position_m.T
        turned = [np.cos(heading) * ahead - np.sin(heading) * port, np.sin(heading) * ahead + np.cos(heading) * port]
        yield _RELATIVE, position_m + own_m, step
        yield f"{_RELATIVE}, and along its axes, must be along w1 and w2", np.column_stack(turned) + own_m, step
    later = np.minimum(step + 1, len(hulls.times_s) - 1)
    yield "the times or steps of the positions are a step too low: was the first step left out?", position_m, later


def _nearest_m(position_m: Array, vessels_m: Array) -> Array:
    """Distance of each position from the nearest vessel of its step, shapes (k, 2) and (k, n, 2) to (k,)."""
    away = np.hypot(*np.moveaxis(vessels_m - position_m[:, None], -1, 0))
    nearest: Array = np.nan_to_num(away, nan=np.inf).min(axis=1)
    return nearest


FAR_M = 100_000.0  # tracks all farther than that from where vessels are have another unit or another order
MAX_DEG = (90.0, 180.0)


@dataclass(frozen=True, eq=False)
class WorldRows:
    """Rows of a file, in its order."""

    problems: RowProblems
    name: str  # what tables call the tracks
    track: list[str]  # the tracker's name of each row's track: (k,)
    time_s: Array  # since the scene's first step: (k,)
    position_m: Array  # along w1 and w2: (k, 2)
    velocity_m_s: Array  # NaN where unknown: (k, 2)
    covariance: Array  # of position and velocity, NaN where unknown: (k, 4, 4)
    degrees: Array | None = field(default=None)  # latitudes and longitudes, if the file gives these: (k, 2)


def checked(rows: WorldRows, run: StoredRun) -> WorldTracks:
    """The tracks, if they can be those of a run. Raises InputError if a row has no place or time, is outside the run or
    there twice, or has what is no covariance."""
    names, track = np.unique(np.array(rows.track, dtype=object).astype(str), return_inverse=True)
    track = np.asarray(track, dtype=np.int64).reshape(-1)
    refuse = rows.problems.refuse
    refuse([not name for name in rows.track], lambda _: "track is empty")
    lost = [has_lost_digits(name) and any(mark in name for mark in ".,+") for name in rows.track]  # 1e10 may be a name
    refuse(lost, lambda row: f"track {LOST} (got {shown(rows.track[row])})")
    if are_rounded(int(name) for name in names.tolist() if name.isdecimal()):
        raise InputError(rows.problems.source, [f"its tracks {ROUNDED}"])
    refuse(~np.isfinite(rows.time_s), lambda _: "has no time")
    refuse(_in_row(~np.isfinite(rows.position_m)), lambda _: "has no position")
    refuse(_in_row(np.isinf(rows.velocity_m_s)), lambda _: "the velocity is not finite")
    refuse(_in_row(np.isinf(rows.covariance)), lambda _: "the covariance is not finite")
    rows.problems.settle()
    _check_times(rows, run)
    _check_twice(rows, track)
    _check_covariances(rows)
    rows.problems.settle()
    _check_place(rows, run)
    return WorldTracks.of(
        rows.name, track, tuple(names.tolist()), rows.time_s, rows.position_m, rows.velocity_m_s, rows.covariance
    )


def _in_row(flags: Mask) -> Mask:
    """Whether any flag of each row is up, shape (k, ...) to (k,)."""
    return np.asarray(flags.any(axis=tuple(range(1, flags.ndim))), dtype=np.bool_)


def _check_times(rows: WorldRows, run: StoredRun) -> None:
    times_s = run.scene.times_s(0, run.steps)
    slack = float(np.median(np.diff(times_s))) / 2 if len(times_s) > 1 else 0.0
    outside = (rows.time_s < times_s[0] - slack) | (rows.time_s > times_s[-1] + slack)
    start = float(run.scene.timestamps(0, 1)[0])
    shifted = rows.time_s - start
    why = other_unit(rows.time_s, float(times_s[-1]))
    if start and ((shifted >= -slack) & (shifted <= times_s[-1] + slack)).all():
        why = f": the scene's own time begins at {start:.15g} s, take it off{why}"
    span = f"0 to {times_s[-1]:g} s since its first step{why}"
    rows.problems.refuse(outside, lambda row: f"time {rows.time_s[row]:.15g} s is outside of the run, which has {span}")


def _check_twice(rows: WorldRows, track: Indices) -> None:
    order = np.lexsort((rows.time_s, track))
    twice = np.zeros(len(track), dtype=bool)
    twice[order[1:]] = (np.diff(track[order]) == 0) & (np.diff(rows.time_s[order]) == 0)
    once = "a track may be there once at a time"
    rows.problems.refuse(twice, lambda row: f"{once} (got track {rows.track[row]!r} again)")


def _check_covariances(rows: WorldRows) -> None:
    for what, size in (("position", slice(0, 2)), ("velocity", slice(2, 4)), ("position and velocity", slice(0, 4))):
        block = rows.covariance[:, size, size]
        finite = ~_in_row(~np.isfinite(block))
        wrong = np.zeros_like(finite)
        wrong[finite] = np.linalg.eigvalsh(block[finite])[:, 0] <= 0
        rows.problems.refuse(wrong, lambda _, what=what: f"the covariance of the {what} is not positive definite")  # type: ignore[misc]


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
            raise InputError(rows.problems.source, [wrong])
        return
    problem = f"all positions are more than {FAR_M / 1000:g} km from where the run's vessels are"
    if rows.degrees is not None and run.scene.origin is not None:
        origin = run.scene.origin
        for reason, degrees in (
            ("latitude and longitude seem to be swapped", rows.degrees[:, ::-1]),
            ("latitude and longitude seem to be radians, must be degrees", np.rad2deg(rows.degrees)),
        ):
            if (np.abs(degrees) <= MAX_DEG).all() and near(local_metres(degrees[:, 0], degrees[:, 1], origin)):
                raise InputError(rows.problems.source, [f"{problem}: {reason}"])
    elif near(rows.position_m / 1000):
        problem += ": they seem to be millimetres, must be metres"
    else:
        problem += ": must be metres along w1 and w2 from the scene's own zero"
    raise InputError(rows.problems.source, [problem])
