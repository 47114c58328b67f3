"""A run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain
from typing import Any

import numpy as np
import shapely
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError, RunDirectoryError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.written_files import OutputFiles
from modsim3d.geometry.camera import Camera
from modsim3d.io.atomic_write import put_in_place
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.selection import check_every
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.view import palette, rerun_boxes
from modsim3d.view.followed_tracks import followed_tracks, read_of_tracks
from modsim3d.view.pictures.plain import below_horizon
from modsim3d.view.report.recorder import quantum_px
from modsim3d.view.report.silhouettes import hiding, seen

# ---- What the viewer shows when it opens a recording ----

PICTURES, PLOTS, LANE = 6.0, (1.9, 1.3), 0.5
"""Heights of the rows, as shares: cameras and world, a plot where there is one and where there are two, and a lane of
states beside its title and axis."""
BEHIND = (12, 14, 16)  # colour behind the world and around the cameras' images


def blueprint(log: rerun_boxes.Log, eye: rerun_boxes.Eye, last_step: int, *, tracks: bool) -> Any:
    """The blueprint of a recording up to its last step, with tracks or without, for the SDK."""
    from rerun import blueprint as parts

    scene, cameras = log.scene, []
    for camera in scene.cameras:
        origin = _path(log, rerun_boxes.image_path(camera.name))
        cameras.append(parts.Spatial2DView(origin=origin, name=f"camera {camera.name}", background=BEHIND))
    pictures = cameras[0] if len(cameras) == 1 else parts.Tabs(*cameras)
    end_s = float(scene.times_s(last_step, last_step + 1)[0])
    rows = [
        parts.Horizontal(pictures, _world(log, parts, eye), column_shares=[3, 2]),
        _plot(log, parts, "missed and false", (rerun_boxes.MISSED, rerun_boxes.FALSE), end_s),
    ]
    if tracks:
        counts = rerun_boxes.TRACKS, rerun_boxes.FALSE_TRACKS
        rows.append(_plot(log, parts, "tracks, and those on nothing", counts, end_s))
    shares = [PICTURES, *[PLOTS[tracks]] * (len(rows) - 1)]
    lanes = [camera.name for camera in scene.cameras[: None if scene.detector.performance.per_camera else 1]]
    rows.append(
        parts.StateTimelineView(
            origin="detector",
            contents=[_path(log, ["detector", name]) for name in lanes],
            name="performance state of the detector",
            time_view=_whole(log, parts, end_s),
        )
    )
    return parts.Blueprint(
        parts.Vertical(*rows, row_shares=[*shares, LANE * (1 + len(lanes))]),
        parts.TimePanel(timeline=rerun_boxes.TIME, state="collapsed"),
        parts.SelectionPanel(state="hidden"),
        parts.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _world(log: rerun_boxes.Log, parts: Any, eye: rerun_boxes.Eye) -> Any:
    """The world, with the cameras' pictures in it and no boxes on these."""
    hidden = [f"- {_path(log, [*rerun_boxes.image_path(camera.name), '**'])}" for camera in log.scene.cameras]
    shown = [f"+ {_path(log, [*rerun_boxes.image_path(camera.name), 'scene'])}" for camera in log.scene.cameras]
    lenses = [f"+ {_path(log, rerun_boxes.image_path(camera.name))}" for camera in log.scene.cameras]
    return parts.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", *hidden, *lenses, *shown],
        name="world",
        background=palette.BLACK,
        eye_controls=parts.EyeControls3D(position=eye.position_m, look_target=eye.target_m, eye_up=(0, 0, 1)),
    )


def _plot(log: rerun_boxes.Log, parts: Any, title: str, counts: tuple[str, ...], end_s: float) -> Any:
    lines = [_path(log, ["counts", camera.name, count]) for camera in log.scene.cameras for count in counts]
    axis, legend = _whole(log, parts, end_s), parts.Corner2D.RightTop
    return parts.TimeSeriesView(origin="counts", contents=lines, name=title, axis_x=axis, plot_legend=legend)


def _whole(log: rerun_boxes.Log, parts: Any, end_s: float) -> Any:
    """An axis of the whole time."""
    ends = (log.sdk.TimeRangeBoundary.absolute(seconds=time) for time in (0.0, end_s))
    return parts.TimeAxis(view_range=log.sdk.encodings.TimeRange(*ends))


def _path(log: rerun_boxes.Log, parts: list[str]) -> str:
    """A path as text, with what has a meaning in it escaped."""
    return str(log.sdk.new_entity_path(parts))


# ---- What a camera sees, in a recording ----

MAX_PX = 1280  # the greatest width of a picture; the viewer stretches it to the size of the camera's image
SKY, SEA, FIRST = 0, 1, 2  # numbers of colours of a picture; the first occluder's comes after those of sky and sea
EDGE = 0.35  # light of the lines around silhouettes, so that the boxes stand out
HALF = 128  # the opacity of the horizon, which lies over the vessels
MAX_COLOURS = 256 - FIRST  # more occluders than this share colours


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Area that one occluder covers of an image by itself: closed lines, shape (k, 2) each, in pixels."""

    occluder: int
    rings_px: Sequence[Array]


@dataclass(frozen=True, eq=False)
class ViewOutlines:
    """View of a camera in a frame: the sea half plane, shape (3,), and silhouettes from back to front."""

    step: int
    camera: Camera
    half_plane: Array
    silhouettes: list[Silhouette]

    def key(self) -> bytes:
        """Key that is equal for what looks the same."""
        rings = ((shape.occluder, ring.tobytes()) for shape in self.silhouettes for ring in shape.rings_px)
        return repr((self.half_plane.tobytes(), *rings)).encode()


@dataclass(eq=False)
class Pictures:
    """Puts the pictures of a run into its recording."""

    log: rerun_boxes.Log
    rows: RunRows
    _last: dict[str, bytes] = field(default_factory=dict)

    def fixed(self) -> None:
        """Log how much larger than its picture each camera's image is."""
        for camera in self.log.scene.cameras:
            scale = np.append(np.array(camera.intrinsics.image_size_px) / picture_size(camera), 1.0)
            path = [*rerun_boxes.image_path(camera.name), "scene"]
            self.log.put(path, self.log.sdk.Transform3D(scale=scale), static=True)

    def show(self, steps: Indices) -> None:
        """Log what the cameras see at some steps, shape (n,), where it differs from what they saw before."""
        for view in seen_at(self.rows, steps):
            now = view.key()
            if self._last.get(view.camera.name) != now:
                self._last[view.camera.name] = now
                self.log.at(view.step)
                self._put(view)

    def _put(self, seen: ViewOutlines) -> None:
        sdk, path, scene = self.log.sdk, rerun_boxes.image_path(seen.camera.name), self.log.scene
        thin = self.log.half_width(rerun_boxes.THIN_PT)
        owners = [shape.occluder for shape in seen.silhouettes for _ in shape.rings_px]
        obstacles = [obstacle.name for obstacle in scene.obstacles]
        colours = palette.owner_colours(len(scene.vessels), obstacles, scene.own_ships)
        lines = sdk.LineStrips2D(
            [ring for shape in seen.silhouettes for ring in simple(shape.rings_px, 0.5 / picture_scale(seen.camera))],
            colors=[palette.darker(colours[owner], EDGE) for owner in owners],
            labels=[scene.occluder_names[owner] for owner in owners],
            show_labels=False,
            radii=thin,
        )
        line = sdk.LineStrips2D(horizon_px(seen), colors=[(*palette.HORIZON, HALF)], radii=thin)
        self.log.put([*path, "scene"], sdk.EncodedImage(contents=png(seen, colours), media_type="image/png"))
        self.log.put([*path, "horizon"], line)
        self.log.put([*path, "silhouettes"], lines)


def seen_at(rows: RunRows, steps: Indices) -> Iterator[ViewOutlines]:
    """Views of each camera in the frames that it took at some ascending steps, shape (n,)."""
    scene, cameras, hides = rows.scene, len(rows.scene.cameras), hiding(rows)
    quantum = quantum_px([camera.intrinsics.image_size_px for camera in scene.cameras])
    for index, camera in enumerate(scene.cameras):
        taken = rows.frames[rows.frames % cameras == index] // cameras
        taken = taken[np.isin(taken, steps)]
        if not len(taken):
            continue
        half_planes, shapes = seen(scene, index, taken, scene.motion.at(taken), quantum, hides)
        silhouettes: list[list[Silhouette]] = [[] for _ in taken]
        for frame, occluder, (count, corners) in zip(shapes.frame, shapes.occluder, shapes.pieces(), strict=True):
            lines = np.split(corners * quantum, np.cumsum(count)[:-1])
            silhouettes[frame].append(Silhouette(int(occluder), lines))
        for step, half_plane, shown in zip(taken.tolist(), half_planes, silhouettes, strict=True):
            yield ViewOutlines(step, camera, half_plane, shown)


def simple(rings_px: Sequence[Array], tolerance_px: float) -> list[Array]:
    """Closed lines with fewer corners and their first one at the end too, shape (k, 2) each."""
    lines = [shapely.linestrings(np.vstack([ring, ring[:1]])) for ring in rings_px]
    return [shapely.get_coordinates(line) for line in shapely.simplify(lines, tolerance_px)]


def picture_scale(camera: Camera) -> float:
    """Pixels of a camera's picture in a pixel of its image."""
    return min(1.0, MAX_PX / camera.intrinsics.image_size_px[0])


def picture_size(camera: Camera) -> tuple[int, int]:
    """Width and height of a camera's picture in pixels."""
    width, height = (max(1, round(side * picture_scale(camera))) for side in camera.intrinsics.image_size_px)
    return width, height


def png(seen: ViewOutlines, colours: Sequence[palette.Colour]) -> bytes:
    """The picture of a frame as a PNG file: sky, sea, and silhouettes darker than the boxes on them."""
    picture, written = paint(seen), BytesIO()
    owners = [palette.darker(colour) for colour in colours[:MAX_COLOURS]]
    picture.putpalette([*chain.from_iterable([palette.SKY, palette.SEA, *owners])])
    # imageio passes no palette on. In RGB, this takes 2 to 4 times as long and 1.4 to 1.8 times the bytes.
    picture.save(written, "PNG")
    return written.getvalue()


def paint(seen: ViewOutlines) -> Image.Image:
    """The picture of a frame, with numbers as colours."""
    size = picture_size(seen.camera)
    picture = Image.new("P", size, SKY)
    frame, scale = np.array([(0, 0), (size[0], 0), size, (0, size[1])]), size / _image_size(seen)
    sea = below_horizon(frame, frame / scale, seen.half_plane)
    if len(sea):
        fill(picture, [sea], SEA)
    for shape in seen.silhouettes:
        fill(picture, [ring * scale for ring in shape.rings_px], FIRST + shape.occluder % MAX_COLOURS)
    return picture


def fill(picture: Image.Image, rings: Sequence[Array], number: int) -> None:
    """Fill what closed lines enclose; a line that runs the other way round than the largest one is a hole."""
    if len(rings) == 1:
        ImageDraw.Draw(picture).polygon(_points(rings[0]), fill=number)
        return
    areas = [float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) for x, y in (ring.T for ring in rings)]
    order = sorted(range(len(rings)), key=lambda i: -abs(areas[i]))
    corners = np.concatenate(rings)
    low = np.maximum(np.floor(corners.min(axis=0)), 0)
    size = np.minimum(np.ceil(corners.max(axis=0)) + 1, picture.size) - low
    covered = Image.new("1", (int(size[0]), int(size[1])))
    draw = ImageDraw.Draw(covered)
    for i in order:
        draw.polygon(_points(rings[i] - low), fill=int(areas[i] * areas[order[0]] > 0))
    picture.paste(number, (int(low[0]), int(low[1])), covered)


def _points(ring: Array) -> list[tuple[float, ...]]:
    """The corners of a polygon for Pillow, whose pixels have whole centres."""
    return [tuple(point) for point in (ring - 0.5).tolist()]


def horizon_px(seen: ViewOutlines) -> list[Array]:
    """The horizon in a frame as a line, shape (2, 2); no line if the image shows none."""
    width, height = _image_size(seen)
    frame = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    sea = below_horizon(frame, frame, seen.half_plane)
    normal = float(np.hypot(*seen.half_plane[:2]))
    if not len(sea) or not normal:
        return []
    ends = sea[np.abs(sea @ seen.half_plane[:2] + seen.half_plane[2]) < 1e-6 * normal * (width + height)]
    return [ends] if len(ends) == 2 else []


def _image_size(seen: ViewOutlines) -> Array:
    return np.array(seen.camera.intrinsics.image_size_px, dtype=np.float64)


STEPS_TOGETHER = 250  # whose geometry is computed together


def export_rerun(
    run: StoredRun | StrPath,
    out: StrPath,
    *,
    every: int = 1,
    tracks: StrPath | None = None,
    similarity: str | None = None,
    threshold: float | None = None,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda steps: None,
) -> OutputFiles:
    """Write a run as `run.rrd`, a recording for the Rerun viewer.

        modsim3d.export_rerun("runs/first", "recordings", tracks="tracks/reference")

    Args:
        run, out: A run or its directory; folder for the file.
        every, tracks, similarity, threshold, overwrite, progress: As those of `modsim3d.report`.

    Raises:
        ModsimError: The run or its tracks are wrong, the Rerun SDK is missing, or the file cannot be written.
        TypeError: A path is neither text nor a path.
    """
    check_every(every)
    try:
        import rerun
    except ImportError:
        raise ModsimError("--format rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'") from None
    run, path = opened_run(run), as_path(out, "out", "a folder") / "run.rrd"
    if not run.steps:
        raise RunDirectoryError(f"{run.folder} was interrupted before its first steps were finished")
    followed = followed_tracks(tracks, run, similarity, threshold)
    rows = RunRows.of(run)
    name = f"{run.scene.name}-{run.scene.sha256[:12]}"
    # The viewer keeps one layout for an application, so that scenes with other cameras must be other applications.
    application = f"modsim3d-{name}-{run.steps}{'' if followed is None else '-tracks'}"
    stream = rerun.RecordingStream(application, recording_id=name, send_properties=False)
    stream.set_log_time_enabled(False)  # the time of writing does not belong to the run
    log = rerun_boxes.Log(rerun, stream, run.scene)
    eye, steps = rerun_boxes.first_eye(log), np.arange(0, run.steps, every)
    pictures, boxes, space = Pictures(log, rows), rerun_boxes.BoxRecorder(log, rows, followed), rerun_boxes.Space(log)
    inputs = read_of_run(run.folder) + read_of_tracks(tracks)
    with claimed([path], overwrite=overwrite, inputs=inputs), put_in_place(path) as partial:
        stream.save(partial, blueprint(log, eye, int(steps[-1]), tracks=followed is not None))
        space.fixed(eye.span_m)
        pictures.fixed()
        boxes.fixed()
        for first in range(0, len(steps), STEPS_TOGETHER):
            some = steps[first : first + STEPS_TOGETHER]
            for part in (space, pictures, boxes):
                part.show(some)
            progress(len(some))
        stream.flush()
        stream.disconnect()
    return OutputFiles((path,), () if followed is None else (followed.sentence(),))
