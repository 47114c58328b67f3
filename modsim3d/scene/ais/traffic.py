"""AIS files in, the traffic of a scene out: runs the parts of this room in their order."""

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.text import in_percent
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.io.misreadings import ROUNDED, are_rounded
from modsim3d.scene.ais.gathering import FileTally, GatheredReports, by_sender, gather
from modsim3d.scene.ais.hulls import AisHull, hulls
from modsim3d.scene.ais.messages import Positions, blank_unknown, in_order, local_metres, median_place
from modsim3d.scene.ais.options import Options, time_text
from modsim3d.scene.ais.vessel_track import TimeGrid, VesselTrack, time_grid, vessel_track

CELL_M = 1000.0
HEIGHT_M = 20.0
MIN_DISTANCE_M, MAX_DISTANCE_M = 300.0, 2500.0
CLEARANCE_M = 50.0
TRIES = 12
MAX_POSES_LOOKED_AT = 200_000  # of more poses than this, evenly spaced ones are used to find the busiest water


@dataclass(frozen=True)
class Viewpoint:
    """A camera ashore, at w1, w2, w3, that looks at a place on the water, w1, w2; its pitch is positive down."""

    position_m: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float
    target_m: tuple[float, float]
    distance_m: float


def viewpoint(vessels: Indices, places_m: Array, half_lengths_m: Array) -> Viewpoint:
    """A camera that looks across the busiest patch of water: the square kilometre that most vessels visit. It looks at
    right angles to the main direction of motion there, from the distance at which half of that traffic fills its view.
    If a hull comes near that place, the camera is turned aside or moved further away. For each pose in the order of
    time, `vessels` has its vessel, shape (n,), and `places_m` the centre of its hull, shape (n, 2); half lengths of
    hulls are by vessel, shape (V,)."""
    spacing = max(1, len(vessels) // MAX_POSES_LOOKED_AT)
    target = _busiest(places_m[::spacing], vessels[::spacing])
    bearing, distance = _across(places_m, target)
    place = _clear_place(places_m, half_lengths_m[vessels] + CLEARANCE_M, target, bearing, distance)
    look = target - place
    distance = float(np.hypot(*look))
    return Viewpoint(
        (round(float(place[0]), 1), round(float(place[1]), 1), HEIGHT_M),
        round(float(np.arctan2(look[1], look[0])), 4),
        round(float(np.arctan2(HEIGHT_M, distance)), 4),
        (round(float(target[0]), 1), round(float(target[1]), 1)),
        distance,
    )


def _across(places_m: Array, target_m: Array) -> tuple[float, float]:
    """Direction from the target at right angles to the traffic around it, in radians from w1, and a distance in metres.
    The direction is to the south, so that the light comes from behind; the distance shows half of the traffic."""
    near = places_m[np.abs(places_m - target_m).max(axis=1) <= 1.5 * CELL_M]
    spread = near - near.mean(axis=0)
    _, directions = np.linalg.eigh(spread.T @ spread)
    along = directions[:, 1]
    across = float(np.arctan2(-along[0], along[1]))
    reach = float(np.median(np.abs(spread @ along)))
    distance = float(np.clip(1.5 * reach, MIN_DISTANCE_M, MAX_DISTANCE_M))
    return (across if np.sin(across) < 0 else across + np.pi), distance


def _clear_place(places_m: Array, clearance_m: Array, target_m: Array, bearing_rad: float, distance_m: float) -> Array:
    """The first place that is clear of all hulls: at the bearing and distance, turned aside, or further away.
    `clearance_m`, shape (n,), is the distance to keep from each of the places, shape (n, 2)."""
    for attempt in range(TRIES):
        turned = bearing_rad + (0.0, np.pi, 0.5, -0.5)[attempt % 4]
        further = distance_m * 1.5 ** (attempt // 4)
        place = target_m + further * np.array([np.cos(turned), np.sin(turned)])
        if (np.linalg.norm(places_m - place, axis=1) > clearance_m).all():
            return place
    south_m = float((places_m[:, 1] - clearance_m).min()) - CLEARANCE_M  # beyond the southernmost hull
    return np.array([target_m[0], south_m])


def _busiest(places_m: Array, vessels: Indices) -> Array:
    """The mean place, shape (2,), in the cell that most vessels visit; of several, the one with most poses."""
    cells = np.floor(places_m / CELL_M).astype(np.int64)
    names, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    visits = np.unique(np.stack([cell, vessels], axis=1), axis=0)[:, 0]
    visited = np.bincount(visits, minlength=len(names))
    poses = np.bincount(cell, minlength=len(names))
    best = int(np.lexsort((poses, visited))[-1])
    return np.asarray(places_m[cell == best].mean(axis=0))


MAX_POSES = 3_000_000  # about 250 MB of JSON, which takes minutes and gigabytes to read again
EXCHANGE_HINT = "if latitude and longitude are in each other's place: --swap-coordinates exchanges them in all tables"
FEW_MOVES = 50  # so many moves are judged together
DAY_S, MIN_SPEED_SHARE = 86_400.0, 0.05  # positions move at more than this share of the speeds that vessels report
UNDER_WAY_KN, WRONG_COURSES, RIGHT_COURSES = 2.0, 0.8, 0.95  # cosines between courses and movements


@dataclass(frozen=True, eq=False)
class AisTraffic:
    """The vessels of a scene, and how they came about."""

    options: Options
    files: list[FileTally]
    dropped: Counter[str]  # reason → number of messages left out, in all files and afterwards
    origin: tuple[float, float]  # latitude and longitude of w1 = w2 = 0
    grid: TimeGrid
    vessels: list[VesselTrack]  # there at some step, by identity
    elsewhere: list[int]  # identities of vessels with usable positions that are there at no step
    left_out: dict[int, dict[str, int]]  # reason → number of positions dropped, of each sender of whom none is left
    camera: Viewpoint  # a place to look from
    repeated: int  # duplicates that say the same as another, as those of several receivers do
    odd: str = ""  # what cannot be right in all positions together; empty if nothing is


def read_traffic(paths: Sequence[Path], options: Options) -> AisTraffic:
    """Tracks of all vessels in AIS files of any of the known formats, at the steps of a scene. Raises InputError if
    something is wrong with a file, or no vessel is left; ModsimError if there would be too many steps or poses for one
    scene."""
    options.check()
    gathered = gather(paths, options)
    dropped = gathered.dropped
    positions, dropped["duplicate"], repeated = in_order(gathered.positions)
    if not len(positions):
        raise _nothing_left(gathered, options)
    grid = time_grid(positions, options)
    near = grid.within(positions.time_s, options.max_gap_s)
    dropped["outside_window"] += int((~near).sum())
    senders = sum((tally.senders for tally in gathered.files), Counter[tuple[int, str]]())
    senders.update(by_sender("outside_window", positions.mmsi[~near]))
    positions = blank_unknown(positions.take(near))
    if not len(positions):
        raise _nothing_left(gathered, options)
    mmsi = np.unique(positions.mmsi).tolist()
    if are_rounded(mmsi):
        raise InputError("AIS", [f"its {len(mmsi)} MMSI, such as {mmsi[0]}, {ROUNDED}"])
    origin = options.origin or _origin(positions, grid)
    every_hull = hulls(gathered.particulars, mmsi)
    tracks = _limited(_tracks(positions, origin, every_hull, grid, options))
    dropped["jump"] += sum(track.jumps for track in tracks)
    vessels = [track for track in tracks if len(track.steps)]
    if not vessels:
        raise _nothing_left(gathered, options)
    elsewhere, camera = [track.mmsi for track in tracks if not len(track.steps)], _camera(vessels)
    options.check_labels(track.hull.group for track in vessels)
    left_out = _dropped_ships(senders, {track.mmsi for track in tracks})
    odd = next((tally.odd for tally in gathered.files if tally.odd), "") or _odd(positions, origin)
    members = dropped, origin, grid, vessels, elsewhere, left_out, camera, repeated, odd
    return AisTraffic(options, gathered.files, *members)


def _odd(positions: Positions, origin: tuple[float, float]) -> str:
    """Oddities of positions that are ordered by vessel and time; empty if there are none."""
    if (last_s := float(positions.time_s.max())) > time.time() + DAY_S:
        return f"positions reach to {time_text(last_s)}, which is to come"
    one = np.flatnonzero((np.diff(positions.mmsi) == 0) & np.isfinite(positions.speed_kn[1:]))
    places = local_metres(positions.latitude_deg, positions.longitude_deg, origin)
    moved_m = np.hypot(*(places[one + 1] - places[one]).T).sum()
    said_m = (positions.speed_kn[one + 1] * KNOT_M_S * np.diff(positions.time_s)[one]).sum()
    if len(one) >= FEW_MOVES and moved_m < MIN_SPEED_SHARE * said_m:
        return f"vessels move at {in_percent(moved_m / said_m)} of the speeds that they report: are places in degrees?"
    under_way = one[(positions.speed_kn[one] > UNDER_WAY_KN) & np.isfinite(positions.course_deg[one])]
    if len(under_way) < FEW_MOVES or (np.abs(positions.longitude_deg) > 90).any():
        return ""
    other = local_metres(positions.longitude_deg, positions.latitude_deg, (origin[1], origin[0]))
    now, exchanged = (
        float(np.median(np.cos(np.deg2rad(positions.course_deg[under_way]) - np.arctan2(*moved.T))))
        for moved in ((points[under_way + 1] - points[under_way]) for points in (places, other))
    )
    if now < WRONG_COURSES and exchanged > RIGHT_COURSES:
        return f"vessels move along their courses only elsewhere: {EXCHANGE_HINT}"
    return ""


def _dropped_ships(senders: Counter[tuple[int, str]], kept: set[int]) -> dict[int, dict[str, int]]:
    reasons: dict[int, dict[str, int]] = {}
    for (mmsi, reason), count in sorted(senders.items()):
        if mmsi not in kept:
            reasons.setdefault(mmsi, {})[reason] = count
    return reasons


def _tracks(
    positions: Positions, origin: tuple[float, float], every_hull: dict[int, AisHull], grid: TimeGrid, options: Options
) -> Iterator[VesselTrack]:
    places = local_metres(positions.latitude_deg, positions.longitude_deg, origin)
    bounds = [0, *(np.flatnonzero(np.diff(positions.mmsi)) + 1).tolist(), len(positions)]
    for first, stop in pairwise(bounds):
        own = positions.take(np.arange(first, stop))
        yield vessel_track(own, places[first:stop], every_hull[int(own.mmsi[0])], grid, options)


def _limited(tracks: Iterable[VesselTrack]) -> list[VesselTrack]:
    """All tracks, unless they hold more poses than a scene can."""
    kept, poses = [], 0
    for track in tracks:
        poses += len(track.steps)
        if poses > MAX_POSES:
            raise ModsimError(
                f"this would be more than {MAX_POSES:,} poses: take less of it (--start, --end, --region), "
                "or fewer steps (--time-step)"
            )
        kept.append(track)
    return kept


def _origin(positions: Positions, grid: TimeGrid) -> tuple[float, float]:
    """The median position within the scene's time, or of all if there is none, to seven decimals (1 cm)."""
    within = grid.within(positions.time_s, 0.0)
    chosen = positions.take(within) if within.any() else positions
    latitude, longitude = median_place(chosen.latitude_deg, chosen.longitude_deg)
    return round(latitude, 7), round(longitude, 7)


def _camera(vessels: list[VesselTrack]) -> Viewpoint:
    number = np.repeat(np.arange(len(vessels)), [len(vessel.steps) for vessel in vessels])
    order = np.lexsort((number, np.concatenate([vessel.steps for vessel in vessels])))
    places = np.concatenate([vessel.places_m for vessel in vessels])
    half_lengths = np.array([vessel.hull.length_m / 2 for vessel in vessels])
    return viewpoint(number[order], places[order], half_lengths)


def _nothing_left(gathered: GatheredReports, options: Options) -> InputError:
    """The error that says what was asked for, what the files cover and why positions were dropped."""
    wanted = []
    if options.start_s is not None or options.end_s is not None:
        first, last = (time_text(time) if time is not None else "…" for time in (options.start_s, options.end_s))
        wanted.append(f"from {first} to {last}")
    if options.region is not None:
        wanted.append(f"in the region {options.region}")
    problems = [f"no positions of ships {' '.join(wanted)}".rstrip() + f": {gathered.extent}"]
    if reasons := ", ".join(f"{name} {count}" for name, count in sorted((+gathered.dropped).items())):
        problems.append(f"left out: {reasons}")
    if options.region is not None:
        problems.append(EXCHANGE_HINT)
    return InputError("AIS files", problems)
