"""The frames of each camera in order, with what is true in them and what a tracker may read of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask, positions
from modsim3d.geometry.camera import Camera
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.runs.tracker_view import TrackerDetections, anonymised
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.outlines import Outlines


@dataclass(frozen=True, eq=False)
class SequenceTruth(Columns):
    """The vessels in a camera's images: n rows in order of frame and vessel, (n,) but for the boxes."""

    frame: Indices  # row of the camera's frames
    vessel: Indices  # index of the vessel
    label: Indices  # index of its true label
    annotated: Mask  # given to the detector
    boxes_px: Array  # of the annotation mode, or the whole vessel's where it is not annotated, (n, 4)
    visible_fraction: Array  # NaN where unknown
    silhouette_px: Array  # pixels of the whole vessel, hidden or not
    visible_px: Array  # pixels of it that are visible; NaN where unknown


@dataclass(frozen=True, eq=False)
class CameraSequence:
    """The F frames of one camera: what is true in them, and what a tracker may read of them."""

    camera: Camera
    steps: Indices  # of the frames, ascending, (F,)
    times_s: Array  # since the scene's first step, (F,)
    truth: SequenceTruth
    detections: TrackerDetections

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.camera.intrinsics.image_size_px

    @property
    def rate_hz(self) -> float:
        """Frames a second, on average."""
        if len(self.times_s) < 2:
            return self.camera.frame_rate_hz or 1.0
        return (len(self.times_s) - 1) / float(self.times_s[-1] - self.times_s[0])


def camera_sequences(run: StoredRun, cameras: tuple[int, ...]) -> tuple[CameraSequence, ...]:
    """The sequences of cameras, by their indices."""
    return sequences_of(RunRows.of(run), cameras)


def sequences_of(rows: RunRows, cameras: tuple[int, ...]) -> tuple[CameraSequence, ...]:
    """The sequences of cameras, by their indices, from rows in memory."""
    count = len(rows.scene.cameras)
    times_s = rows.scene.times_s(0, rows.steps)
    sequences = []
    for index in cameras:
        frames = rows.frames[rows.frames % count == index]
        steps = frames // count
        parts = _truth(rows, frames), _detections(rows, frames)
        sequences.append(CameraSequence(rows.scene.cameras[index], steps, times_s[steps], *parts))
    return tuple(sequences)


def _truth(rows: RunRows, frames: Indices) -> SequenceTruth:
    labels = rows.scene.detector.labels
    every = SequenceTruth(
        positions(frames, rows.truth_frame),
        rows.truth_vessel,
        indices(rows.truth, "label", labels),
        rows.annotated,
        np.where(rows.annotated[:, None], rows.annotated_boxes_px, rows.boxes_px("full")),
        *(rows.numbers(name) for name in ("visible_fraction", "silhouette_px", "visible_px")),
    )
    order = np.lexsort((every.vessel, every.frame))
    return every.take(order[every.frame[order] >= 0])


def _detections(rows: RunRows, frames: Indices) -> TrackerDetections:
    every = anonymised(
        positions(frames, rows.detection_frame),
        indices(rows.detections, "label", rows.scene.detector.labels),
        rows.detection_boxes_px(),
        number_column(rows.detections, "confidence"),
    )
    return every.take(every.frame >= 0)


FIRST_STEPS, SPREAD_STEPS = 10, 20  # steps that are looked at: so many at the beginning, and so many over the whole run
MIN_AREA_PX = 1.0
LEVEL_DEG = 0.05  # a camera that looks no farther from the horizontal is said to look along it
HIDDEN, SMALL, BELOW, ABOVE, LEFT, RIGHT, BEHIND, ABSENT = range(8)
"""Where a vessel is that a camera does not see; the first are the closest to being seen."""
PLACES = (
    "in the picture but hidden",
    "in the picture but smaller than a pixel",
    "ahead of it but below the picture",
    "ahead of it but above the picture",
    "ahead of it but left of the picture",
    "ahead of it but right of the picture",
    "behind it",
    "not there",
)


@dataclass(frozen=True, eq=False)
class Outlook:
    """Some frames of a camera: which way it looks, and what is in the picture by the vessels' boxes. A warning needs no
    meshes, whose silhouettes take long at the start of every run."""

    sight: Sight
    outlines: Outlines

    @classmethod
    def of(cls, scene: Scene, camera: Camera, steps: Indices) -> Outlook:
        """The frames of a camera at some ascending steps, shape (S,)."""
        sight = scene.sight(camera, steps)
        return cls(sight, sight.outlines(as_shoeboxes=True))

    def sees_a_vessel(self) -> bool:
        """Whether a vessel shows a pixel or more in one of the frames. It is taken to where hulls intersect."""
        unseen = analytic_occlusion(self.outlines, self.sight.camera.intrinsics).visible_px < MIN_AREA_PX
        return bool((self.outlines.boxed & ~unseen).any())

    def direction(self) -> str:
        """Direction in which the camera looks in the first of the frames."""
        axis = self.sight.camera_poses.camera_R_world[0, 2]
        up, heading = np.degrees(np.arcsin(np.clip(axis[2], -1, 1))), np.degrees(np.arctan2(axis[1], axis[0]))
        tilt = f"{abs(up):.1f}° {'above' if up > 0 else 'below'} the horizon"
        tilt = "along the horizon" if abs(up) < LEVEL_DEG else tilt
        return f"{tilt}, towards heading {heading + 0.0:.1f}° (counter-clockwise from w1)"

    def places(self) -> str:
        """Number of vessels at each place, each counted where it is closest to being seen."""
        places = self._places()
        nearest = Counter(places.min(axis=0)[~self.sight.carriers.any(axis=0)].tolist())
        phrases = [f"{nearest[place]} {PLACES[place]}" for place in sorted(nearest)]
        return f"vessels: {', '.join(phrases)}" if phrases else "there is no vessel but the one that carries it"

    def _places(self) -> Indices:
        """The place of each vessel in each frame, one of `HIDDEN` to `ABSENT`, shape (S, V)."""
        sight, pinhole = self.sight, self.sight.camera.intrinsics.pinhole
        points = sight.camera_poses.to_camera(sight.poses.positions_m)
        ahead = points[..., 2] >= pinhole.near_clip_m
        places = np.where(ahead, _beside(pinhole.project(points), pinhole.image_size_px), BEHIND)
        rows = self.outlines.boxed
        frame, vessel = self.outlines.frame[rows], self.outlines.occluder[rows]
        places[frame, vessel] = np.where(self.outlines.areas_px[rows] < MIN_AREA_PX, SMALL, HIDDEN)
        return np.where(sight.others, places, ABSENT)


def _beside(pixels: Array, image_size_px: tuple[int, int]) -> Indices:
    """On which side of the picture points lie that are not in it, shape (..., 2) to (...)."""
    column, row = np.moveaxis(pixels, -1, 0)
    vertical = np.where(row < image_size_px[1] / 2, ABOVE, BELOW)
    return np.where(column < 0, LEFT, np.where(column > image_size_px[0], RIGHT, vertical))


def blind_cameras(scene: Scene, steps: int, camera_counts: dict[str, Counts]) -> list[str]:
    """A sentence on each camera that saw no vessel in a run of so many steps: which way it looks, where they are."""
    blind = [camera for camera in scene.cameras if scene.labels is None and not camera_counts[camera.name].seen]
    looked_at = {camera.name: _some_frames(scene, camera, steps) for camera in blind}
    return [
        _sentence(Outlook.of(scene, camera, looked_at[camera.name]), f"its {camera_counts[camera.name].frames} frames")
        for camera in blind
        if len(looked_at[camera.name])
    ]


def blind_at_first(scene: Scene) -> list[str]:
    """A sentence on each camera that sees no vessel in its first frames, nor in some others over the whole scene. Of a
    live scene nothing is said: its poses are not there yet."""
    sentences = []
    for camera in () if scene.live or scene.labels is not None else scene.cameras:
        steps = _some_frames(scene, camera, scene.steps)
        outlook = Outlook.of(scene, camera, steps)
        if len(steps) and not outlook.sees_a_vessel():
            sentences.append(_sentence(outlook, f"the {len(steps)} frames looked at"))
    return sentences


def _some_frames(scene: Scene, camera: Camera, steps: int) -> Indices:
    """Steps of some frames that a camera takes, the first ones and some over all steps, ascending, shape (n,)."""
    wanted = {*range(min(FIRST_STEPS, steps)), *np.linspace(0, steps - 1, SPREAD_STEPS).astype(int).tolist()}
    taken = {scene.last_frame(camera, step + 1) for step in wanted}
    return np.array(sorted(step for step in taken if step is not None), dtype=np.int64)


def _sentence(outlook: Outlook, frames: str) -> str:
    return (
        f"camera '{outlook.sight.camera.name}' sees no vessel in {frames}: it looks {outlook.direction()}; positive "
        f"pitch_rad looks down, positive yaw_rad to port; {outlook.places()}"
    )
