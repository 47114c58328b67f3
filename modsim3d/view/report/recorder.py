"""The frames of a run for the player of its page, in few bytes, and in parts that the player unpacks as needed.
A length in the image is a multiple of `quantum_px`, which is 0.1 px for all but very large images."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.detector.records import KINDS
from modsim3d.geometry.camera import Camera
from modsim3d.runs.counts import Outcome
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.map_marks import footprint
from modsim3d.view.report import packing, part_columns
from modsim3d.view.report.overview import OutcomesBuilder, OutcomeStretches, Overview, PartMotion, ShownRows, rows_of
from modsim3d.view.report.silhouettes import Silhouettes

# ---- The tracks of a tracker for the player of a run's page ----

UNSCORED, SWITCHED, MOVED = 1, 2, 4  # what is so of a row, as bits of the column `trackFlags`


class TrackRows:
    """The rows of tracks that a recording shows, and what is marked at them.
    A switch in a frame that is not shown is marked at its track's next box that is."""

    def __init__(self, followed: FollowedTracks, scene: Scene, steps: Indices) -> None:
        """Find the rows in the frames that the cameras show at ascending steps, shape (S,)."""
        tracks, numbers = followed.tracks, []
        for camera, scene_camera in enumerate(scene.cameras):
            taken = scene.frame_steps(scene_camera, 0, int(steps[-1]) + 1)
            place = np.searchsorted(taken, steps, side="right") - 1
            numbers.append(taken[place[place >= 0]] * len(scene.cameras) + camera)
        self._followed, self._drawn = followed, np.flatnonzero(np.isin(tracks.frame, np.concatenate(numbers)))
        flags = UNSCORED * followed.unscored
        for bit, marked in ((SWITCHED, followed.switched), (MOVED, followed.moved)):
            flags = flags + bit * _at_next(np.flatnonzero(marked), tracks.identity, self._drawn)
        self._flags = flags

    def columns(self, frames: part_columns.PartFrames, quantum: float) -> dict[str, packing.Column | packing.Codes]:
        """The rows in the frames of a part. A lane is one track of one camera."""
        followed, tracks = self._followed, self._followed.tracks
        first, last = (int(reach(frames.numbers)) for reach in (np.min, np.max)) if frames.count else (0, -1)
        some = self._drawn[slice(*np.searchsorted(tracks.frame[self._drawn], (first, last + 1)).tolist())]
        frame = frames.of(tracks.frame[some])
        order = np.argsort(frame, kind="stable")
        order = order[frame[order] != NOBODY]
        rows = some[order]
        vessel = np.where(followed.false, packing.NONE, followed.vessel)[rows]
        return {
            "trackStart": packing.Codes(packing.starts(frame[order], frames.pages), by=packing.ROW_BEFORE),
            "trackLane": packing.Codes(tracks.identity[rows].astype(np.uint32), by=packing.ROW_BEFORE),
            "trackVessel": packing.Codes(vessel.astype(np.uint16), by="trackLane"),
            "trackFlags": self._flags[rows].astype(np.uint8),
            "trackBox": packing.Codes(packing.in_quanta(tracks.boxes_px[rows], quantum), by="trackLane"),
        }


class Lanes:
    """Vessel that each track of one camera follows, over a run that comes in parts."""

    def __init__(self, vessels: int) -> None:
        """Begin with no track in a scene with so many vessels."""
        self._vessels = vessels
        self._found, self._marks = packing.StretchesBuilder(), [np.empty((0, 3), dtype=np.int64)]
        self._taken = NOBODY

    def add(self, index: Indices, shown: Indices, taken: Indices, columns: Mapping[str, packing.Column]) -> None:
        """Add the tracks at some steps: their indices, the frame of each in a part, and its step, all of shape (i,)."""
        rows, at = rows_of(shown, columns["trackStart"])
        lane, flags = columns["trackLane"][rows].astype(np.int64), columns["trackFlags"][rows]
        vessel = columns["trackVessel"][rows].astype(np.int64)
        vessel = np.where(vessel == packing.NONE, self._vessels, vessel)
        key = (lane * (self._vessels + 1) + vessel) * 2 + (flags & UNSCORED > 0)
        self._found.add(key, index[at])
        new = np.diff(taken, prepend=self._taken) != 0
        marked = np.flatnonzero(new[at] & (flags & (SWITCHED | MOVED) > 0))
        self._marks.append(np.column_stack([lane[marked], index[at[marked]], flags[marked]]))
        self._taken = int(taken[-1])

    def columns(self, prefix: str) -> dict[str, packing.Column | packing.Codes]:
        """The stretches of the lanes in order of time, and their marks."""
        spans = self._found.stretches().by_time()
        lane_and_vessel, pale = np.divmod(spans.key, 2)
        lane, vessel = np.divmod(lane_and_vessel, self._vessels + 1)
        vessel = np.where(vessel == self._vessels, packing.NONE, vessel)
        marks = np.concatenate(self._marks)
        return {
            f"{prefix}lane": packing.Codes(lane.astype(np.uint32), by=packing.ROW_BEFORE),
            f"{prefix}index": packing.Codes(spans.first.astype(np.uint32), by=packing.ROW_BEFORE),
            f"{prefix}long": packing.Codes((spans.until - spans.first).astype(np.uint32)),
            f"{prefix}vessel": packing.Codes(vessel.astype(np.uint16), by=f"{prefix}lane"),
            f"{prefix}pale": pale.astype(np.uint8),
            f"{prefix}markLane": marks[:, 0].astype(np.uint32),
            f"{prefix}markIndex": packing.Codes(marks[:, 1].astype(np.uint32), by=packing.ROW_BEFORE),
            f"{prefix}markFlags": marks[:, 2].astype(np.uint8),
        }


def track_facts(followed: FollowedTracks) -> dict[str, Any]:
    """Meaning of the columns, and the number of the track of each lane."""
    _, first = np.unique(followed.tracks.identity, return_index=True)
    return {
        "name": followed.name,
        "numbers": followed.tracks.track[first].tolist(),
        "flags": {"UNSCORED": UNSCORED, "SWITCHED": SWITCHED, "MOVED": MOVED},
        "rule": f"{followed.similarity} below {followed.similarity.least:g}",
    }


def _at_next(marked: Indices, identity: Indices, drawn: Indices) -> packing.Column:
    """Whether each row is the first drawn one of its track at or after a marked one, shape (k,)."""
    order = np.lexsort((drawn, identity[drawn]))
    keys = identity[drawn[order]] * len(identity) + drawn[order]  # ascending, as rows are in order of time
    place = np.searchsorted(keys, identity[marked] * len(identity) + marked)
    inside = place < len(keys)
    row = drawn[order[place[inside]]]
    at = np.zeros(len(identity), dtype=bool)
    at[row[identity[row] == identity[marked[inside]]]] = True
    return at


# ---- Where vessels and cameras are at each step ----

PER_METRE, PER_TURN = 100, 1 << 16


class Places:
    """Places at a run's shown steps, and how far they reach."""

    def __init__(self, scene: Scene) -> None:
        """Begin with the scene's obstacles."""
        self._scene = scene
        self._land = [footprint(obstacle) for obstacle in scene.obstacles]
        self._reach: list[Array] = []
        self._half_m = np.array([vessel.length_m for vessel in scene.vessels])[:, None] / 2
        if scene.labels is not None:
            self._reach.append(np.zeros((1, 2)))  # nobody has a place

    def columns(self, steps: Indices, motion: PartMotion) -> dict[str, packing.Column | packing.Codes]:
        """The places at ascending steps, shape (S,): a row a step, with a column for each vessel or camera."""
        scene, poses = self._scene, motion.at(steps).poses
        present, place_m = poses.present, poses.positions_m[..., :2]
        cameras = [_camera_places(scene, camera, steps, motion) for camera in scene.cameras]
        camera_m, looks, camera_there = (np.stack(columns, axis=1) for columns in zip(*cameras, strict=True))
        self._reach += [(place_m + side * self._half_m)[present] for side in (-1, 1)]
        self._reach.append(camera_m[camera_there])
        every = np.concatenate(self._reach)
        self._reach = [np.array([every.min(axis=0), every.max(axis=0)])]
        places = _centimetres(np.where(present[..., None], place_m, 0.0)).reshape(len(steps), -1)
        return {
            "placed": present.astype(np.uint8),
            "place": packing.Codes(places, by=packing.ROW_BEFORE),
            "heading": packing.Codes(_turns(np.where(present, poses.headings_rad, 0.0)), by=packing.ROW_BEFORE),
            "cameraPlaced": camera_there.astype(np.uint8),
            "cameraPlace": packing.Codes(_centimetres(camera_m).reshape(len(steps), -1), by=packing.ROW_BEFORE),
            "cameraLooks": packing.Codes(_turns(looks).reshape(len(steps), -1), by=packing.ROW_BEFORE),
        }

    def facts(self) -> dict[str, Any]:
        """Dimensions of vessels, outlines of obstacles, least and greatest w1 and w2 of what moves, in metres."""
        return {
            "dimensions": [np.round(np.nan_to_num(v.extents_m[:2]), 2).tolist() for v in self._scene.vessels],
            "obstacles": [_rings(shape) for shape in self._land],
            "extent": np.round(self._reach[0], 2).tolist(),
            "north": self._scene.origin is not None,
        }


def _camera_places(scene: Scene, camera: Camera, steps: Indices, motion: PartMotion) -> tuple[Array, Array, Mask]:
    """Place and view of a camera at ascending steps, shape (S,): w1 and w2, shape (S, 2); the directions to the left
    and the right end of its horizon, shape (S, 2); whether it is there, shape (S,): not while the vessel that carries
    it is absent, which may be so between its frames."""
    present = np.full(len(steps), scene.labels is None)
    if camera.mount.vessel is not None:
        present = motion.at(steps).poses.present[:, scene.vessel_names.index(camera.mount.vessel)]
    place_m, looks_rad = np.zeros((2, len(steps), 2))
    if present.any():
        poses = scene.camera_poses(camera, motion.at(steps[present]), steps[present])
        width, height = camera.intrinsics.image_size_px
        row = float(np.clip(camera.intrinsics.principal_point_px[1], 0, height))
        rays = camera.intrinsics.unproject(np.array([[0.0, row], [width, row]]), np.ones(2)) @ poses.camera_R_world
        place_m[present], looks_rad[present] = poses.positions_m[:, :2], np.arctan2(rays[..., 1], rays[..., 0])
    return place_m, looks_rad, present


def _centimetres(metres: Array) -> packing.Column:
    return np.rint(metres * PER_METRE).astype(np.int32)


def _turns(angles_rad: Array) -> packing.Column:
    return np.rint(angles_rad / (2 * np.pi) * PER_TURN).astype(np.int64).astype(np.uint16)


def _rings(shape: Any) -> list[list[list[float]]]:
    """The closed lines of a footprint, outer and inner ones, in metres."""
    rings = [ring for part in shapely.get_parts(shape).tolist() for ring in (part.exterior, *part.interiors)]
    return [np.round(shapely.get_coordinates(ring)[:-1], 2).tolist() for ring in rings]


# ---- The times of a run's shown steps for its player ----

_DECIMAL = re.compile(r"(-?)(\d+)\.(\d+)")
MAX_DIFFERENCE = 2**31
MAX_DIGITS = 15  # whole numbers up to here are exact in the browser


def clock(timestamps: Sequence[str]) -> tuple[dict[str, Any], packing.Columns]:
    """Facts and columns from which the player has the texts of the steps' times; see `time_text`.
    Texts that are not plain decimals in their shortest form are stored as they are."""
    decimals = max((len(text.partition(".")[2]) for text in timestamps), default=0)
    if all(map(_DECIMAL.fullmatch, timestamps)):
        units = [_in_units(text, decimals) for text in timestamps]
        differences = np.diff(units, prepend=units[0])
        exact = max(map(abs, units)) < 10**MAX_DIGITS and np.abs(differences).max(initial=0) < MAX_DIFFERENCE
        if exact and all(time_text(unit, decimals) == text for unit, text in zip(units, timestamps, strict=True)):
            facts = {"decimals": decimals, "first": units[0]}
            return facts, {"clock": packing.Codes(differences.astype(np.int32), by=packing.ROW_BEFORE)}
    return {}, {"clockTexts": np.frombuffer("\n".join(timestamps).encode("utf-8"), np.uint8)}


def _in_units(text: str, decimals: int) -> int:
    whole, _, part = text.partition(".")
    return int(whole + part.ljust(decimals, "0"))


def time_text(units: int, decimals: int) -> str:
    """A time in units of its last decimal as text, in its shortest form with at least one decimal."""
    digits = f"{abs(units):0{decimals + 1}d}"
    whole, part = digits[: len(digits) - decimals], digits[len(digits) - decimals :]
    return f"{'-' if units < 0 else ''}{whole}.{part.rstrip('0') or '0'}"


FINEST_PX = 0.1


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run for the player."""

    name: str  # tells the recordings of a page apart: `A`, `B`
    facts: dict[str, Any]  # what the numbers mean: names, colours, times
    overview: bytes  # packed columns of what the timeline shows, which the player unpacks first
    parts: tuple[bytes, ...]  # packed columns of each part of the shown steps
    outcomes: tuple[OutcomeStretches, ...]  # what became of the vessels, of each camera


def recording(
    run: StoredRun,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
    name: str = "A",
    count: Callable[[RunRows], None] = lambda rows: None,
) -> Recording:
    """The recording of every K-th step of a run, with tracks if there are some; no more than a part of the run is in
    memory at once. A camera with a frame rate of its own shows the last frame that it took, and an empty frame before
    its first one. `progress` is called with the number of shown steps done since its last call, `count` with all rows
    of the run, some steps at a time.
    Raises RunDirectoryError if the tables are not what a run has written."""
    recorder = _Recorder(run, every, followed)
    done = []
    for part in part_columns.parts(run, every, count):
        done.append(packing.packed(recorder.columns(part)))
        progress(len(part.steps))
    facts, overview = recorder.overview()
    facts |= {"parts": len(done), "partSteps": part_columns.shown_in_a_part(run.scene, every)}
    return Recording(name, facts, packing.packed(overview), tuple(done), recorder.outcomes())


class _Recorder:
    """Values that all parts of a recording share, or that are gathered over them."""

    def __init__(self, run: StoredRun, every: int, followed: FollowedTracks | None) -> None:
        self._scene, self._every, self._followed = run.scene, every, followed
        self._steps = np.arange(0, run.steps, every)
        self._quantum = quantum_px([camera.intrinsics.image_size_px for camera in run.scene.cameras])
        self._places = Places(run.scene)
        self._silhouettes = Silhouettes(run.scene, self._quantum)
        sizes = len(self._steps), len(run.scene.vessels), len(run.scene.detector.states)
        self._overviews = [Overview(*sizes) for _ in run.scene.cameras]
        self._outcomes = [OutcomesBuilder() for _ in run.scene.cameras]
        self._lanes, self._tracks = [], None
        if followed is not None:
            self._lanes = [Lanes(len(run.scene.vessels)) for _ in run.scene.cameras]
            self._tracks = TrackRows(followed, run.scene, self._steps)

    def columns(self, part: part_columns.PartRows) -> dict[str, packing.Column | packing.Codes]:
        """The columns of a part, which is added to the overviews."""
        frames = part_columns.PartFrames(part)
        horizons = np.empty((frames.pages, 3))
        horizons[frames.count :] = part_columns.ALL_SEA
        motion = PartMotion(self._scene, [part.steps, *frames.steps])
        shape_frame, silhouettes = self._silhouettes.columns(part.rows, frames.steps, motion, horizons)
        columns = {
            **part_columns.frame_columns(part, frames),
            "horizon": packing.Codes(horizons.astype(np.float32), by=packing.ROW_BEFORE),
            "shapeStart": packing.Codes(packing.starts(shape_frame, frames.pages), by=packing.ROW_BEFORE),
            **silhouettes,
            **part_columns.truth_columns(part.rows, frames, self._quantum),
            **part_columns.detection_columns(part.rows, frames, self._quantum),
            **self._places.columns(part.steps, motion),
        }
        if self._tracks is not None:
            columns |= self._tracks.columns(frames, self._quantum)
        index = part.steps // self._every
        plain = {name: data.values if isinstance(data, packing.Codes) else data for name, data in columns.items()}
        for camera, (overview, outcomes) in enumerate(zip(self._overviews, self._outcomes, strict=True)):
            rows = ShownRows.of(index, frames.shown[:, camera], plain)
            overview.add(rows)
            outcomes.add(rows)
        for camera, lanes in enumerate(self._lanes):
            lanes.add(index, frames.shown[:, camera], part.taken[:, camera], plain)
        return columns

    def outcomes(self) -> tuple[OutcomeStretches, ...]:
        """Outcomes of the vessels, of each camera, once all parts are there."""
        return tuple(builder.stretches() for builder in self._outcomes)

    def overview(self) -> tuple[dict[str, Any], dict[str, packing.Column | packing.Codes]]:
        """The facts, and the columns of what the timeline shows, once all parts are there."""
        scene, steps = self._scene, self._steps
        times, columns = clock(scene.timestamps(0, int(steps[-1]) + 1)[:: self._every])
        every: dict[str, packing.Column | packing.Codes] = {**columns, **self._silhouettes.still_columns()}
        for camera, overview in enumerate(self._overviews):
            every |= overview.columns(f"{camera}.", half=bool(self._lanes))
        for camera, lanes in enumerate(self._lanes):
            every |= lanes.columns(f"{camera}.lanes.")
        facts = {
            "length": len(steps),
            "every": self._every,
            "clock": times,
            "overviews": [overview.facts(self._quantum) for overview in self._overviews],
            **_facts(scene, self._quantum),
            **self._places.facts(),
        }
        if self._followed is not None:
            facts["tracks"] = track_facts(self._followed)
        return facts, every


def _facts(scene: Scene, quantum: float) -> dict[str, Any]:
    vessels = [palette.vessel_colour(index, scene.own_ships) for index in range(len(scene.vessels))]
    obstacles = [palette.obstacle_colour(index, obstacle.name) for index, obstacle in enumerate(scene.obstacles)]
    states = palette.state_colours(len(scene.detector.states))
    return {
        "name": scene.name,
        "quantum": quantum,
        "mode": scene.annotation.mode,
        "states": [state.name for state in scene.detector.states],
        "labels": list(scene.detector.labels),
        "kinds": list(KINDS),
        "outcomes": {outcome.name: outcome.value for outcome in Outcome},
        "occluders": list(scene.occluder_names),
        "vessels": [{"name": v.name, "label": v.label} for v in scene.vessels],
        "cameras": [
            {"name": camera.name, "size": list(camera.intrinsics.image_size_px), "carrier": camera.mount.vessel}
            for camera in scene.cameras
        ],
        "colours": {
            "vessels": [palette.css(colour) for colour in vessels],
            "owners": [*(palette.css(palette.darker(colour)) for colour in vessels), *map(palette.css, obstacles)],
            "states": [palette.css(colour) for colour in states],
            **{name: palette.css(getattr(palette, name.upper())) for name in ("sea", "sky", "truth", "alarm", "ink")},
        },
    }


def quantum_px(image_sizes_px: list[tuple[int, int]]) -> float:
    """The finest length with which every place in the images fits into 16 bits."""
    return max(FINEST_PX, max(max(size) for size in image_sizes_px) / (packing.NONE - 1))
