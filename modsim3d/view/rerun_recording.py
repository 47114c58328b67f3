"""A run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.errors import ModsimError, RunDirectoryError
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.outputs.placing import put_in_place
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view import palette

SIGHT_STEPS = 250
"""Steps whose geometry is computed together."""


def write_recording(
    run: StoredRun, out: Path, every: int = 1, progress: Callable[[int], None] = lambda steps: None
) -> None:
    """Write every K-th step of a run as an `.rrd` file with the time lines `step` and `time`.

    `progress` is called with the number of steps that were written since its last call.

    Raises:
        ModsimError: The Rerun SDK is not installed, or the run has no steps.
    """
    try:
        import rerun
    except ImportError:
        raise ModsimError("modsim3d rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'") from None
    if not run.steps:
        raise RunDirectoryError(f"{run.folder} was interrupted before its first steps were finished")
    name = f"{run.scene.name}-{run.scene.sha256[:12]}"
    stream = rerun.RecordingStream("modsim3d", recording_id=name, send_properties=False)
    stream.set_log_time_enabled(False)  # the time of writing does not belong to the run
    with put_in_place(out) as partial:
        stream.save(partial)
        _record(rerun, stream, run, every, progress)


def _record(rerun: Any, stream: Any, run: StoredRun, every: int, progress: Callable[[int], None]) -> None:
    recorder = _Recorder(rerun, stream, run.scene)
    recorder.fixed()
    rows, steps = RunRows.of(run), np.arange(0, run.steps, every)
    for first in range(0, len(steps), SIGHT_STEPS):
        some = steps[first : first + SIGHT_STEPS]
        recorder.space(some)
        recorder.images(rows, some)
        progress(len(some))
    stream.flush()
    stream.disconnect()


@dataclass
class _Recorder:
    """Puts parts of a run into a recording, with the module `rerun` as its SDK."""

    sdk: Any
    stream: Any
    scene: Scene

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

    def images(self, rows: RunRows, steps: Indices) -> None:
        """Log the boxes and counts of each camera at some steps, shape (n,)."""
        full, drawn_px = rows.boxes_px("full"), rows.detection_boxes_px()
        missed = rows.annotated & ~rows.detected
        labels = indices(rows.detections, "label", self.scene.detector.labels)
        confidence = numbers(rows.detections, "confidence")
        names = self.scene.vessel_names
        for step, camera, truth, drawn in _frames(rows, steps):
            self._at(step)
            self._state(camera, int(rows.states_of(np.array([step * len(self.scene.cameras) + camera]))[0]))
            name = self.scene.cameras[camera].name
            path = ["world", "cameras", name, "image"]
            vessels = rows.truth_vessel[truth]
            colours = [palette.ALARM if lost else palette.TRUTH for lost in missed[truth]]
            tags = [f"{names[v]} missed" if lost else names[v] for v, lost in zip(vessels, missed[truth], strict=True)]
            self._boxes([*path, "truth"], full[truth], colours, tags)
            sources = rows.detection_vessel[drawn]
            colours = [palette.ALARM if source == NOBODY else palette.vessel_colour(int(source)) for source in sources]
            what = zip(labels[drawn], confidence[drawn], strict=True)
            tags = [f"{self.scene.detector.labels[label]} {sure:.2f}" for label, sure in what]
            self._boxes([*path, "detections"], drawn_px[drawn], colours, tags)
            for kind, count in (("missed", missed[truth].sum()), ("false", (sources == NOBODY).sum())):
                self.stream.log(["counts", name, kind], self.sdk.Scalars(float(count)))

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


def _frames(rows: RunRows, steps: Indices) -> Iterator[tuple[int, int, slice, slice]]:
    """Step and camera of each frame that was taken at some steps, and its rows of truth and detections."""
    cameras = len(rows.scene.cameras)
    for number in rows.frames[np.isin(rows.frames // cameras, steps)].tolist():
        frame = (number, number + 1)
        truth, drawn = (np.searchsorted(column, frame) for column in (rows.truth_frame, rows.detection_frame))
        yield number // cameras, number % cameras, slice(*truth), slice(*drawn)
