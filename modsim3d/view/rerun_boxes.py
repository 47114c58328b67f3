"""Boxes of a run in a recording: truth, detections and tracks in each image, and how many of them are wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.boxes import centres
from modsim3d.runs.counts import Outcome, having
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.map_marks import view_of
from modsim3d.view.pictures.layers import NAMES, is_a
from modsim3d.world.vessel_motion import PosesInWaves

# ---- Where parts of a run are put into a recording, and at which time ----

STEP, TIME = "step", "time"  # the time lines
THIN_PT, THICK_PT = 0.6, 2.5  # half the widths on the screen of lines below others, and of lines to be seen first


@dataclass(frozen=True, eq=False)
class Log:
    """A recording that is being written, with the module `rerun` as its SDK."""

    sdk: Any
    stream: Any
    scene: Scene

    def put(self, path: Sequence[str], *what: Any, static: bool = False) -> None:
        """Log something at the step that was set last, or for all time."""
        self.stream.log(list(path), *what, static=static)

    def columns(self, path: Sequence[str], steps: Indices, columns: Any) -> None:
        """Log columns of values at some steps, shape (n,)."""
        seconds = self.scene.times_s(0, int(steps[-1]) + 1)[steps]
        times = [self.sdk.TimeColumn(STEP, sequence=steps), self.sdk.TimeColumn(TIME, duration=seconds)]
        self.stream.send_columns(self.sdk.new_entity_path(list(path)), indexes=times, columns=columns)

    def at(self, step: int) -> None:
        """Set the step of what is logged next."""
        self.stream.set_time(STEP, sequence=step)
        self.stream.set_time(TIME, duration=float(self.scene.times_s(step, step + 1)[0]))

    def half_width(self, points: float) -> Any:
        """Half the width of a line on the screen, for the SDK."""
        return self.sdk.Radius.ui_points(points)


def image_path(camera: str) -> list[str]:
    """The entity of a camera's image."""
    return ["world", "cameras", camera, "image"]


COUNTS = {Outcome.FALSE_POSITIVE: "false", Outcome.MISLABELLED: "wrong_class"}
COUNTS |= {Outcome.BELOW_HALF_IOU: "below_half_iou", Outcome.OFF_VESSEL: "off_vessel"}
"""What is counted of the detections of each frame, and under which name."""
MISSED, FALSE, TRACKS, FALSE_TRACKS = "missed", "false", "tracks", "false_tracks"
COLOURS = {  # of the lines of the plots, by what they count
    MISSED: palette.ALARM,
    FALSE: palette.VESSELS[1],
    "wrong_class": palette.VESSELS[4],
    "below_half_iou": palette.VESSELS[3],
    "off_vessel": palette.VESSELS[2],
    TRACKS: palette.VESSELS[5],
    FALSE_TRACKS: palette.ALARM,
}
TEXT = (0.09, 0.07)  # width and height of a text below a box, as shares of the image
PALER = 0.35  # how much paler the lines of each further camera are


@dataclass(eq=False)
class BoxRecorder:
    """Puts the boxes and counts of a run into its recording."""

    log: Log
    rows: RunRows
    followed: FollowedTracks | None = None
    _states: dict[str, int] = field(default_factory=dict)
    _texts: list[Array] = field(default_factory=list)

    @cached_property
    def _columns(self) -> BoxColumns:
        return BoxColumns.of(self.rows)

    def fixed(self) -> None:
        """Log how counts and states are drawn."""
        sdk, model = self.log.sdk, self.log.scene.detector
        names = [state.name for state in model.states]
        colours = np.array(palette.state_colours(len(names)), dtype=np.uint8)
        look = sdk.StateConfiguration(values=names, colors=colours)
        many = len(self.log.scene.cameras) > 1
        for index, camera in enumerate(self.log.scene.cameras):
            self.log.put(["detector", camera.name], look, static=True)
            for count, colour in COLOURS.items():
                if self.followed is None and count in (TRACKS, FALSE_TRACKS):
                    continue
                paler = palette.mixed(colour, palette.WHITE, 1 - (1 - PALER) ** index)
                name = count.replace("_", " ") + (f", {camera.name}" if many else "")
                line = sdk.SeriesLines(colors=[paler], names=[name], interpolation_mode="StepAfter")
                self.log.put(["counts", camera.name, count], line, static=True)

    def show(self, steps: Indices) -> None:
        """Log the boxes and counts of each camera at some steps, shape (n,)."""
        columns, rows, cameras = self._columns, self.rows, self.log.scene.cameras
        for step, camera, truth, drawn in _frames(rows, steps):
            self.log.at(step)
            self._texts.clear()
            frame = step * len(cameras) + camera
            self._state(cameras[camera].name, int(rows.states_of(np.array([frame]))[0]))
            self._truth(cameras[camera].name, columns.missed[truth], columns.full_px[truth], columns.truth_tags[truth])
            self._detections(cameras[camera].name, drawn)
            if self.followed is not None:
                self._tracks(self.followed, frame, cameras[camera].name)

    def _truth(self, camera: str, missed: Mask, boxes_px: Array, tags: list[str]) -> None:
        """Log the boxes of the truth, and the missed ones again with their names."""
        colours = [palette.ALARM if lost else palette.TRUTH for lost in missed]
        self._boxes(camera, "truth", boxes_px, colours, tags, radii=self.log.half_width(THIN_PT))
        lost = np.flatnonzero(missed)
        self._named(camera, MISSED, boxes_px[lost], [tags[i] for i in lost])
        self._count(camera, MISSED, len(lost))

    def _detections(self, camera: str, drawn: slice) -> None:
        """Log the boxes of the detections, the false ones again with what they say, and what is wrong with them."""
        rows, columns, outcome = self.rows, self._columns, self.rows.outcomes[drawn]
        false, boxes_px, tags = having(outcome, Outcome.FALSE_POSITIVE), columns.drawn_px[drawn], columns.tags[drawn]
        own = self.log.scene.own_ships
        pairs = zip(rows.detection_vessel[drawn].tolist(), false.tolist(), strict=True)
        colours = [palette.ALARM if is_false else palette.vessel_colour(source, own) for source, is_false in pairs]
        self._boxes(camera, "detections", boxes_px, colours, tags)
        self._named(camera, FALSE, boxes_px[false], [tags[i] for i in np.flatnonzero(false)])
        lines = columns.tethers[drawn][having(outcome, Outcome.OFF_VESSEL)]
        self.log.put([*image_path(camera), "off_vessel"], self.log.sdk.LineStrips2D(lines, colors=[palette.ALARM]))
        for flag, count in COUNTS.items():
            self._count(camera, count, int(having(outcome, flag).sum()))

    def _tracks(self, followed: FollowedTracks, frame: int, camera: str) -> None:
        """Log the tracks in a frame, by its number, with the names of the vessels that they follow, and how many."""
        rows, names = followed.rows_of(frame), (*self.log.scene.vessel_names, "nothing")
        own = self.log.scene.own_ships
        numbers, vessels = followed.tracks.track[rows].tolist(), followed.vessel[rows].tolist()
        colours = [palette.ALARM if vessel == NOBODY else palette.vessel_colour(vessel, own) for vessel in vessels]
        tags = [f"#{number} on {names[vessel]}" for number, vessel in zip(numbers, vessels, strict=True)]
        self._boxes(camera, TRACKS, followed.tracks.boxes_px[rows], colours, tags)
        self._count(camera, TRACKS, len(numbers))
        self._count(camera, FALSE_TRACKS, vessels.count(NOBODY))

    def _boxes(
        self, camera: str, name: str, boxes_px: Any, colours: Sequence[palette.Colour], tags: list[str], **style: Any
    ) -> None:
        """Log boxes whose texts are shown for the one under the pointer."""
        style = {"array_format": self.log.sdk.Box2DFormat.XYXY, "show_labels": False, **style}
        boxes = self.log.sdk.Boxes2D(array=boxes_px, colors=colours, labels=tags, **style)
        self.log.put([*image_path(camera), name], boxes)

    def _named(self, camera: str, name: str, boxes_px: Any, tags: list[str]) -> None:
        """Log thick boxes in the colour of what went wrong, with those of their texts that lie on no other."""
        size = next(entry.intrinsics.image_size_px for entry in self.log.scene.cameras if entry.name == camera)
        for i, (x0, _, x1, y1) in enumerate(boxes_px.tolist()):
            place = np.array([(x0 + x1) / 2, y1]) / size
            if any((np.abs(place - taken) < TEXT).all() for taken in self._texts):
                tags[i] = ""
            else:
                self._texts.append(place)
        thick = self.log.half_width(THICK_PT)
        self._boxes(camera, name, boxes_px, [palette.ALARM] * len(tags), tags, show_labels=True, radii=thick)

    def _count(self, camera: str, name: str, count: int) -> None:
        self.log.put(["counts", camera, name], self.log.sdk.Scalars(float(count)))

    def _state(self, camera: str, state: int) -> None:
        """Log the performance state where it changes."""
        if self._states.get(camera) != state:
            name = self.log.scene.detector.states[state].name
            self.log.put(["detector", camera], self.log.sdk.StateChange(state=name))
            self._states[camera] = state


@dataclass(frozen=True, eq=False)
class BoxColumns:
    """Columns that are logged of the n rows of the truth and the m detections of a run."""

    rows: RunRows
    missed: Mask  # shape (n,)
    truth_tags: list[str]  # what is written at each row of the truth, n texts
    full_px: Array  # boxes of the whole silhouettes, shape (n, 4)
    drawn_px: Array  # boxes of the detections, shape (m, 4)
    tags: list[str]  # what is written at each detection, m texts
    tethers: Array  # from the centres of detections to their vessels' boxes, NaN for false positives, shape (m, 2, 2)

    @classmethod
    def of(cls, rows: RunRows) -> BoxColumns:
        """The columns of a run."""
        names, missed, drawn_px = rows.scene.vessel_names, rows.annotated & ~rows.detected, rows.detection_boxes_px()
        lost = zip(rows.truth_vessel.tolist(), missed.tolist(), strict=True)
        true = rows.detected_row != NOBODY
        tethers = np.full((len(drawn_px), 2, 2), np.nan)
        low, high = np.split(rows.annotated_boxes_px[rows.detected_row[true]], 2, axis=1)
        tethers[true, 0] = centres(drawn_px[true])
        tethers[true, 1] = np.clip(tethers[true, 0], low, high)
        truth_tags = [f"{names[vessel]} missed" if is_missed else names[vessel] for vessel, is_missed in lost]
        return cls(rows, missed, truth_tags, rows.boxes_px("full"), drawn_px, _detection_tags(rows), tethers)


def _detection_tags(rows: RunRows) -> list[str]:
    """Text at each detection: class, confidence, and what is wrong with it."""
    names, vessels = rows.scene.detector.labels, rows.scene.vessels
    labels, confidence = indices(rows.detections, "label", names).tolist(), number_column(rows.detections, "confidence")
    tags, columns = [], (labels, confidence.tolist(), rows.detection_vessel.tolist(), rows.outcomes.tolist())
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


# ---- The world of a run in a recording ----

MAX_NAMES = 10  # names of more vessels would lie on each other; they are shown for the vessel under the pointer
MAX_FACES = 5000  # a hull with more faces would make a large file; it is left out, and its box stays
NEAR_SHARE = 0.4  # the share of the vessels that are seen at first
IMAGE_SHARE = 0.15  # how wide the image before a camera is, as a share of the traffic's extent


@dataclass(frozen=True, eq=False)
class Eye:
    """Place from which the world is looked at first, and target; `span_m` is the extent of the traffic before it."""

    position_m: Array  # shape (3,)
    target_m: Array  # shape (3,)
    span_m: float


def first_eye(log: Log) -> Eye:
    """Place behind and above the first camera, so that the nearest of the vessels at the first step are seen."""
    scene = log.scene
    poses = scene.poses.poses(0, 1)
    at, looks = view_of(scene, scene.cameras[0], 0)
    places = poses.positions_m[0, poses.present[0], :2]
    distance = np.linalg.norm(places - at, axis=1)
    near = places[distance <= np.quantile(distance, NEAR_SHARE)] if len(places) else places
    points = np.vstack([at, near])
    middle, span = (points.min(axis=0) + points.max(axis=0)) / 2, max(float(np.ptp(points, axis=0).max()), 50.0)
    ahead = looks[len(looks) // 2] if looks[len(looks) // 2].any() else np.array([1.0, 0.0])
    behind = middle - 0.85 * span * ahead
    return Eye(np.append(behind, 0.55 * span), np.append(middle, 0.0), span)


@dataclass(eq=False)
class Space:
    """Puts what is in the world into a recording."""

    log: Log
    _present: dict[int, bool] = field(default_factory=dict)

    def fixed(self, span_m: float) -> None:
        """Log what never changes: axes, lenses and obstacles; images before the cameras are a share of `span_m`."""
        log, sdk = self.log, self.log.sdk
        log.put(["world"], sdk.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for camera in log.scene.cameras:
            lens = camera.intrinsics
            pinhole = sdk.Pinhole(
                image_from_camera=lens.matrix,
                resolution=lens.image_size_px,
                camera_xyz=sdk.ViewCoordinates.RDF,  # c1 right, c2 down, c3 forward
                image_plane_distance=IMAGE_SHARE * span_m * lens.focal_px[0] / lens.image_size_px[0],
                color=palette.SOFT_INK,
            )
            log.put(image_path(camera.name), pinhole, static=True)
        for index, obstacle in enumerate(log.scene.obstacles):
            corners = np.concatenate([vertices[solid.faces] for solid, vertices in obstacle.solids])
            mesh = self._mesh(corners, palette.obstacle_colour(index, obstacle.name))
            log.put(["world", "obstacles", obstacle.name], mesh, static=True)

    def show(self, steps: Indices) -> None:
        """Log where cameras and vessels are at some steps, shape (n,)."""
        scene, sea = self.log.scene, self.log.scene.motion.at(steps)
        for camera in scene.cameras:
            poses = scene.sight(camera, steps).camera_poses
            world_R_camera = np.swapaxes(poses.camera_R_world, -1, -2)
            self._move(["world", "cameras", camera.name], steps, poses.positions_m, world_R_camera)
        for index in range(len(scene.vessels)):
            self._vessel(index, steps, sea)

    def _vessel(self, index: int, steps: Indices, sea: PosesInWaves) -> None:
        vessel, present = self.log.scene.vessels[index], sea.poses.present[:, index]
        path = ["world", "vessels", vessel.name]
        self._move(path, steps[present], sea.poses.positions_m[present, index], sea.world_R_vessel[present, index])
        before = np.append(self._present.get(index, False), present[:-1])
        for i in np.flatnonzero(before != present):
            self.log.at(int(steps[i]))
            if present[i]:
                self.log.put(path, *self._body(index))
            else:
                self.log.put(path, self.log.sdk.Clear(recursive=False))
        self._present[index] = bool(present[-1])

    def _body(self, index: int) -> list[Any]:
        vessel, colour = self.log.scene.vessels[index], palette.vessel_colour(index, self.log.scene.own_ships)
        length, beam, height = vessel.extents_m
        box = self.log.sdk.Boxes3D(
            half_sizes=[[length / 2, beam / 2, height / 2]],
            centers=[[0, 0, height / 2]],
            colors=[colour],
            labels=[vessel.name],
            show_labels=len(self.log.scene.vessels) <= MAX_NAMES,
        )
        if len(vessel.solid.faces) > MAX_FACES:
            return [box]
        return [box, self._mesh((vessel.solid.vertices * vessel.extents_m)[vessel.solid.faces], colour)]

    def _mesh(self, corners: Array, colour: palette.Colour) -> Any:
        """Faces with flat shading, shape (f, 3, 3)."""
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return self.log.sdk.Mesh3D(
            vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=colour
        )

    def _move(self, path: list[str], steps: Indices, positions_m: Any, rotations: Any) -> None:
        if len(steps):
            moves = self.log.sdk.Transform3D.columns(translation=positions_m, mat3x3=rotations)
            self.log.columns(path, steps, moves)
