"""What a camera sees, in a recording: sea, sky and silhouettes as a picture, and their lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain

import numpy as np
import shapely
from PIL import Image, ImageDraw

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.runs.run_rows import RunRows
from modsim3d.view import palette
from modsim3d.view.pictures.plain import below_horizon
from modsim3d.view.report.recording.recorder import quantum_px
from modsim3d.view.report.recording.silhouettes.silhouettes import hiding, seen
from modsim3d.view.rerun.log import Log, image_path

MOST_PX = 1280
"""The greatest width of a picture; the viewer stretches it to the size of the camera's image."""
SKY, SEA, FIRST = 0, 1, 2
"""Colours of a picture by their number; the first occluder's comes after those of sky and sea."""
EDGE = 0.35
"""Light of the lines around silhouettes, so that the boxes stand out."""
HALF = 128
"""The opacity of the horizon, which lies over the vessels."""
MOST_COLOURS = 256 - FIRST
"""More occluders than this share colours."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """What one occluder covers of an image by itself: closed lines, shape (k, 2) each, in pixels."""

    occluder: int
    rings_px: Sequence[Array]


@dataclass(frozen=True, eq=False)
class Seen:
    """What a camera sees in a frame: the sea half plane, shape (3,), and silhouettes from back to front."""

    step: int
    camera: Camera
    half_plane: Array
    silhouettes: list[Silhouette]

    def key(self) -> bytes:
        """The same for what looks the same."""
        rings = ((each.occluder, ring.tobytes()) for each in self.silhouettes for ring in each.rings_px)
        return repr((self.half_plane.tobytes(), *rings)).encode()


@dataclass(eq=False)
class Pictures:
    """Puts the pictures of a run into its recording."""

    log: Log
    rows: RunRows
    _last: dict[str, bytes] = field(default_factory=dict)

    def fixed(self) -> None:
        """Log how much larger than its picture each camera's image is."""
        for camera in self.log.scene.cameras:
            scale = np.append(np.array(camera.intrinsics.image_size_px) / picture_size(camera), 1.0)
            self.log.put([*image_path(camera.name), "scene"], self.log.sdk.Transform3D(scale=scale), static=True)

    def show(self, steps: Indices) -> None:
        """Log what the cameras see at some steps, shape (n,), where it differs from what they saw before."""
        for each in seen_at(self.rows, steps):
            now = each.key()
            if self._last.get(each.camera.name) != now:
                self._last[each.camera.name] = now
                self.log.at(each.step)
                self._put(each)

    def _put(self, seen: Seen) -> None:
        sdk, path, scene = self.log.sdk, image_path(seen.camera.name), self.log.scene
        vessels = len(scene.vessels)
        owners = [each.occluder for each in seen.silhouettes for _ in each.rings_px]
        lines = sdk.LineStrips2D(
            [ring for each in seen.silhouettes for ring in simple(each.rings_px, 0.5 / picture_scale(seen.camera))],
            colors=[palette.darker(colour_of(owner, vessels), EDGE) for owner in owners],
            labels=[scene.occluder_names[owner] for owner in owners],
            show_labels=False,
            radii=self.log.thin(),
        )
        line = sdk.LineStrips2D(horizon_px(seen), colors=[(*palette.HORIZON, HALF)], radii=self.log.thin())
        self.log.put([*path, "scene"], sdk.EncodedImage(contents=png(seen, vessels), media_type="image/png"))
        self.log.put([*path, "horizon"], line)
        self.log.put([*path, "silhouettes"], lines)


def seen_at(rows: RunRows, steps: Indices) -> Iterator[Seen]:
    """What each camera sees in the frames that it took at some ascending steps, shape (n,)."""
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
            yield Seen(step, camera, half_plane, shown)


def simple(rings_px: Sequence[Array], tolerance_px: float) -> list[Array]:
    """Closed lines with fewer corners and their first one at the end too, shape (k, 2) each."""
    lines = [shapely.linestrings(np.vstack([ring, ring[:1]])) for ring in rings_px]
    return [shapely.get_coordinates(line) for line in shapely.simplify(lines, tolerance_px)]


def picture_scale(camera: Camera) -> float:
    """Pixels of a camera's picture in a pixel of its image."""
    return min(1.0, MOST_PX / camera.intrinsics.image_size_px[0])


def picture_size(camera: Camera) -> tuple[int, int]:
    """Width and height of a camera's picture in pixels."""
    width, height = (max(1, round(side * picture_scale(camera))) for side in camera.intrinsics.image_size_px)
    return width, height


def png(seen: Seen, vessels: int) -> bytes:
    """The picture of a frame as a PNG file: sky, sea, and silhouettes darker than the boxes on them."""
    picture, written = paint(seen), BytesIO()
    owners = [palette.darker(colour_of(i, vessels)) for i in range(MOST_COLOURS)]
    picture.putpalette([*chain.from_iterable([palette.SKY, palette.SEA, *owners])])
    # imageio passes no palette on. In RGB, this takes 2 to 4 times as long and 1.4 to 1.8 times the bytes.
    picture.save(written, "PNG")
    return written.getvalue()


def colour_of(occluder: int, vessels: int) -> palette.Colour:
    """The colour of a vessel, or of an obstacle for an index beyond the vessels."""
    return palette.vessel_colour(occluder) if occluder < vessels else palette.obstacle_colour(occluder - vessels)


def paint(seen: Seen) -> Image.Image:
    """The picture of a frame, with numbers as colours."""
    size = picture_size(seen.camera)
    picture = Image.new("P", size, SKY)
    frame, scale = np.array([(0, 0), (size[0], 0), size, (0, size[1])]), size / _image_size(seen)
    sea = below_horizon(frame, frame / scale, seen.half_plane)
    if len(sea):
        fill(picture, [sea], SEA)
    for each in seen.silhouettes:
        fill(picture, [ring * scale for ring in each.rings_px], FIRST + each.occluder % MOST_COLOURS)
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


def horizon_px(seen: Seen) -> list[Array]:
    """The horizon in a frame as a line, shape (2, 2); no line if the image shows none."""
    width, height = _image_size(seen)
    frame = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    sea = below_horizon(frame, frame, seen.half_plane)
    normal = float(np.hypot(*seen.half_plane[:2]))
    if not len(sea) or not normal:
        return []
    ends = sea[np.abs(sea @ seen.half_plane[:2] + seen.half_plane[2]) < 1e-6 * normal * (width + height)]
    return [ends] if len(ends) == 2 else []


def _image_size(seen: Seen) -> Array:
    return np.array(seen.camera.intrinsics.image_size_px, dtype=np.float64)
