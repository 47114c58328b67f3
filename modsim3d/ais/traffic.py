"""AIS files in, the traffic of a scene out: runs the parts of this room in their order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from modsim3d.ais.cleaning import blank_unknown, in_order
from modsim3d.ais.gathering import FileTally, Gathered, by_sender, gather
from modsim3d.ais.geography import local_metres, median_place
from modsim3d.ais.hulls import Hull, hulls
from modsim3d.ais.messages import Positions
from modsim3d.ais.options import Options, time_text
from modsim3d.ais.time_grid import TimeGrid, time_grid
from modsim3d.ais.vessel_track import VesselTrack, vessel_track
from modsim3d.ais.viewpoint import Viewpoint, viewpoint
from modsim3d.errors import InputError, ModsimError

MAX_POSES = 3_000_000
"""About 250 MB of JSON, which takes minutes and gigabytes to read again."""
EXCHANGE_HINT = "if latitude and longitude are in each other's place: --swap-coordinates exchanges them in all tables"


@dataclass(frozen=True, eq=False)
class Traffic:
    """The vessels of a scene, and how they came about.

    Attributes:
        dropped: Reason → number of messages left out, in all files and afterwards.
        origin: Latitude and longitude of w1 = w2 = 0.
        vessels: Those that are there at some step, by identity.
        elsewhere: Identities of vessels with usable positions that are there at no step.
        left_out: Reason → number of positions dropped, of each sender of whom no position is left.
        camera: A place to look from.
        repeated: Number of duplicates that say the same as another, as those of several receivers do.
    """

    options: Options
    files: list[FileTally]
    dropped: Counter[str]
    origin: tuple[float, float]
    grid: TimeGrid
    vessels: list[VesselTrack]
    elsewhere: list[int]
    left_out: dict[int, dict[str, int]]
    camera: Viewpoint
    repeated: int


def read_traffic(paths: Sequence[Path], options: Options) -> Traffic:
    """Tracks of all vessels in AIS files of any of the known formats, at the steps of a scene.

    Raises:
        InputError: Something is wrong with a file, or no vessel is left.
        ModsimError: There would be too many steps or poses for one scene.
    """
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
    origin = options.origin or _origin(positions, grid)
    every_hull = hulls(gathered.particulars, np.unique(positions.mmsi).tolist())
    tracks = _limited(_tracks(positions, origin, every_hull, grid, options))
    dropped["jump"] += sum(track.jumps for track in tracks)
    vessels = [track for track in tracks if len(track.steps)]
    if not vessels:
        raise _nothing_left(gathered, options)
    elsewhere, camera = [track.mmsi for track in tracks if not len(track.steps)], _camera(vessels)
    left_out = _left_out(senders, {track.mmsi for track in tracks})
    return Traffic(options, gathered.files, dropped, origin, grid, vessels, elsewhere, left_out, camera, repeated)


def _left_out(senders: Counter[tuple[int, str]], kept: set[int]) -> dict[int, dict[str, int]]:
    """Why positions were dropped, of each sender that is not among those kept."""
    reasons: dict[int, dict[str, int]] = {}
    for (mmsi, reason), count in sorted(senders.items()):
        if mmsi not in kept:
            reasons.setdefault(mmsi, {})[reason] = count
    return reasons


def _tracks(
    positions: Positions, origin: tuple[float, float], every_hull: dict[int, Hull], grid: TimeGrid, options: Options
) -> Iterator[VesselTrack]:
    """The track of each vessel, from positions that are ordered by vessel and time."""
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
                f"this would be more than {MAX_POSES:,} poses: take less of it (--start, --duration, --region), "
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


def _nothing_left(gathered: Gathered, options: Options) -> InputError:
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
