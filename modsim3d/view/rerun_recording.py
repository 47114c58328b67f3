"""A run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import centres
from modsim3d.errors import ModsimError, RunDirectoryError
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.outputs.placing import put_in_place
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.outcome_words import NAMES, is_a

COUNTS = {
    Outcome.FALSE_POSITIVE: "false",
    Outcome.MISLABELLED: "wrong_class",
    Outcome.BELOW_HALF_IOU: "below_half_iou",
    Outcome.OFF_VESSEL: "off_vessel",
}
"""What is counted of the detections of each frame, and under which name."""
SIGHT_STEPS = 250
"""Steps whose geometry is computed together."""


def write_recording(
    run: StoredRun,
    out: Path,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
) -> None:
    """Write every K-th step of a run as an `.rrd` file with the time lines `step` and `time`.

    Args:
        run: The run.
        out: The file.
        every: K.
        progress: Called with the number of steps that were written since its last call.
        followed: The tracks of a tracker; none if None.

    Raises:
        ModsimError: The Rerun SDK is not installed, or the run has no steps.
    """
    try:
        import rerun
    except ImportError:
        raise ModsimError("modsim3d rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'") from None
    if not run.steps:
        raise RunDirectoryError(f"{run.folder} was interrupted before its first steps were finished")
    rows = RunRows.of(run)
    name = f"{run.scene.name}-{run.scene.sha256[:12]}"
    stream = rerun.RecordingStream("modsim3d", recording_id=name, send_properties=False)
    stream.set_log_time_enabled(False)  # the time of writing does not belong to the run
    with put_in_place(out) as partial:
        stream.save(partial)
        _record(_Recorder(rerun, stream, run.scene, followed), rows, np.arange(0, run.steps, every), progress)


def _record(recorder: _Recorder, rows: RunRows, steps: Indices, progress: Callable[[int], None]) -> None:
    columns = _Columns.of(rows)
    recorder.fixed()
    for first in range(0, len(steps), SIGHT_STEPS):
        some = steps[first : first + SIGHT_STEPS]
        recorder.space(some)
        recorder.images(columns, some)
        progress(len(some))
    recorder.stream.flush()
    recorder.stream.disconnect()


@dataclass
class _Recorder:
    """Puts parts of a run into a recording, with the module `rerun` as its SDK."""

    sdk: Any
    stream: Any
    scene: Scene
    followed: FollowedTracks | None = None

    def __post_init__(self) -> None:
        self._present = np.zeros(len(self.scene.vessels), dtype=bool)
        self._states: dict[str, int] = {}

    def fixed(self) -> None:
        """Log what never changes: axes, lenses and obstacles."""
        self.stream.log("world", self.sdk.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for camera in self.scene.cameras:
            lens = camera.intrinsics
            pinhole = self.sdk.Pinhole(
                image_from_camera=lens.matrix,
                resolution=lens.image_size_px,
                camera_xyz=self.sdk.ViewCoordinates.RDF,  # c1 right, c2 down, c3 forward
            )
            self.stream.log(["world", "cameras", camera.name, "image"], pinhole, static=True)
        for index, obstacle in enumerate(self.scene.obstacles):
            corners = np.concatenate([vertices[solid.faces].reshape(-1, 3) for solid, vertices in obstacle.solids])
            mesh = self.sdk.Mesh3D(vertex_positions=corners, albedo_factor=palette.obstacle_colour(index))
            self.stream.log(["world", "obstacles", obstacle.name], mesh, static=True)

    def space(self, steps: Indices) -> None:
        """Log where cameras and vessels are at some steps, shape (n,)."""
        sea = self.scene.motion.at(steps)
        sights = [self.scene.sight(camera, steps) for camera in self.scene.cameras]
        for camera, sight in zip(self.scene.cameras, sights, strict=True):
            poses = sight.camera_poses
            world_R_camera = np.swapaxes(poses.camera_R_world, -1, -2)
            self._move(["world", "cameras", camera.name], steps, poses.positions_m, world_R_camera)
        for index in range(len(self.scene.vessels)):
            self._vessel(index, steps, sea)

    def _vessel(self, index: int, steps: Indices, sea: PosesInWaves) -> None:
        vessel, present = self.scene.vessels[index], sea.poses.present[:, index]
        path = ["world", "vessels", vessel.name]
        self._move(path, steps[present], sea.poses.positions_m[present, index], sea.world_R_vessel[present, index])
        before = np.concatenate([self._present[index : index + 1], present[:-1]])
        for i in np.flatnonzero(before != present):
            self._at(int(steps[i]))
            self.stream.log(path, self._box(index) if present[i] else self.sdk.Clear(recursive=False))
        self._present[index] = present[-1]

    def _box(self, index: int) -> Any:
        vessel = self.scene.vessels[index]
        length, beam, height = vessel.extents_m
        return self.sdk.Boxes3D(
            half_sizes=[[length / 2, beam / 2, height / 2]],
            centers=[[0, 0, height / 2]],
            colors=[palette.vessel_colour(index)],
            labels=[vessel.name],
        )

    def _move(self, path: list[str], steps: Indices, positions_m: Any, rotations: Any) -> None:
        if len(steps):
            columns = self.sdk.Transform3D.columns(translation=positions_m, mat3x3=rotations)
            self.stream.send_columns(self.sdk.new_entity_path(path), indexes=self._times(steps), columns=columns)

    def images(self, columns: _Columns, steps: Indices) -> None:
        """Log the boxes and counts of each camera at some steps, shape (n,)."""
        rows = columns.rows
        for step, camera, truth, drawn in _frames(rows, steps):
            self._at(step)
            self._state(camera, int(rows.states_of(np.array([step * len(self.scene.cameras) + camera]))[0]))
            name = self.scene.cameras[camera].name
            path = ["world", "cameras", name, "image"]
            missed, sources, outcome = columns.missed[truth], rows.detection_vessel[drawn], rows.outcomes[drawn]
            colours = [palette.ALARM if lost else palette.TRUTH for lost in missed]
            self._boxes([*path, "truth"], columns.full_px[truth], colours, columns.truth_tags[truth])
            false = having(outcome, Outcome.FALSE_POSITIVE)
            found = zip(sources.tolist(), false.tolist(), strict=True)
            colours = [palette.ALARM if is_false else palette.vessel_colour(source) for source, is_false in found]
            self._boxes([*path, "detections"], columns.drawn_px[drawn], colours, columns.tags[drawn])
            lines = columns.tethers[drawn][having(outcome, Outcome.OFF_VESSEL)]
            self.stream.log([*path, "off_vessel"], self.sdk.LineStrips2D(lines, colors=[palette.ALARM]))
            self.stream.log(["counts", name, "missed"], self.sdk.Scalars(float(missed.sum())))
            if self.followed is not None:
                self._tracks(self.followed, step * len(self.scene.cameras) + camera, name)
            for flag, count in COUNTS.items():
                self.stream.log(["counts", name, count], self.sdk.Scalars(float(having(outcome, flag).sum())))

    def _tracks(self, followed: FollowedTracks, frame: int, camera: str) -> None:
        """Log the tracks in a frame, by its number, with the names of the vessels that they follow, and how many."""
        rows, names = followed.rows_of(frame), (*self.scene.vessel_names, "nothing")
        numbers, vessels = followed.tracks.track[rows].tolist(), followed.vessel[rows].tolist()
        shown = list(zip(numbers, vessels, strict=True))
        colours = [palette.ALARM if vessel == NOBODY else palette.track_colour(number) for number, vessel in shown]
        tags = [f"#{number} on {names[vessel]}" for number, vessel in shown]
        self._boxes(["world", "cameras", camera, "image", "tracks"], followed.tracks.boxes_px[rows], colours, tags)
        for count, value in (("tracks", len(shown)), ("false_tracks", vessels.count(NOBODY))):
            self.stream.log(["counts", camera, count], self.sdk.Scalars(float(value)))

    def _boxes(self, path: list[str], boxes_px: Any, colours: list[palette.Colour], tags: list[str]) -> None:
        boxes = self.sdk.Boxes2D(array=boxes_px, array_format=self.sdk.Box2DFormat.XYXY, colors=colours, labels=tags)
        self.stream.log(path, boxes)

    def _state(self, camera: int, state: int) -> None:
        """Log the performance state where it changes."""
        name = self.scene.cameras[camera].name
        if self._states.get(name) != state:
            self.stream.log(["detector", name], self.sdk.TextLog(self.scene.detector.states[state].name))
            self._states[name] = state

    def _at(self, step: int) -> None:
        self.stream.set_time("step", sequence=step)
        self.stream.set_time("time", duration=float(self.scene.times_s(step, step + 1)[0]))

    def _times(self, steps: Indices) -> list[Any]:
        seconds = self.scene.times_s(0, int(steps[-1]) + 1)[steps]
        return [self.sdk.TimeColumn("step", sequence=steps), self.sdk.TimeColumn("time", duration=seconds)]


@dataclass(frozen=True, eq=False)
class _Columns:
    """What is logged of the n rows of the truth and the m detections of a run.

    Attributes:
        missed: Shape (n,).
        full_px: Boxes of the whole silhouettes, shape (n, 4).
        drawn_px: Boxes of the detections, shape (m, 4).
        tethers: Lines from the centres of the detections to their vessels' annotated boxes; NaN for a false positive,
            shape (m, 2, 2).
    """

    rows: RunRows
    missed: Mask
    truth_tags: list[str]
    full_px: Array
    drawn_px: Array
    tags: list[str]
    tethers: Array

    @classmethod
    def of(cls, rows: RunRows) -> _Columns:
        """The columns of a run."""
        names, missed, drawn_px = rows.scene.vessel_names, rows.annotated & ~rows.detected, rows.detection_boxes_px()
        lost = zip(rows.truth_vessel.tolist(), missed.tolist(), strict=True)
        known = rows.detected_row != NOBODY
        tethers = np.full((len(drawn_px), 2, 2), np.nan)
        low, high = np.split(rows.annotated_boxes_px[rows.detected_row[known]], 2, axis=1)
        tethers[known, 0] = centres(drawn_px[known])
        tethers[known, 1] = np.clip(tethers[known, 0], low, high)
        return cls(
            rows,
            missed,
            [f"{names[vessel]} missed" if is_missed else names[vessel] for vessel, is_missed in lost],
            rows.boxes_px("full"),
            drawn_px,
            _detection_tags(rows),
            tethers,
        )


def _detection_tags(rows: RunRows) -> list[str]:
    """What is written at each detection: class, confidence, and what is wrong with it."""
    names, vessels = rows.scene.detector.labels, rows.scene.vessels
    labels, confidence = indices(rows.detections, "label", names).tolist(), numbers(rows.detections, "confidence")
    tags = []
    columns = (labels, confidence.tolist(), rows.detection_vessel.tolist(), rows.outcomes.tolist())
    for label, sure, vessel, outcome in zip(*columns, strict=True):
        words = [f"{'false: ' if outcome & Outcome.FALSE_POSITIVE else ''}{names[label]} {sure:.2f}"]
        if outcome & Outcome.MISLABELLED:
            words.append(is_a(vessels[vessel].label))
        if outcome & Outcome.BELOW_HALF_IOU:
            words.append(NAMES[Outcome.OFF_VESSEL if outcome & Outcome.OFF_VESSEL else Outcome.BELOW_HALF_IOU])
        tags.append(", ".join(words))
    return tags


def _frames(rows: RunRows, steps: Indices) -> Iterator[tuple[int, int, slice, slice]]:
    """Step and camera of each frame that was taken at some steps, and its rows of truth and detections."""
    cameras = len(rows.scene.cameras)
    for number in rows.frames[np.isin(rows.frames // cameras, steps)].tolist():
        frame = (number, number + 1)
        truth, drawn = (np.searchsorted(column, frame) for column in (rows.truth_frame, rows.detection_frame))
        yield number // cameras, number % cameras, slice(*truth), slice(*drawn)
