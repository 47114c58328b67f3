"""The plain style of Jessen & Mohr (2023), Figures 9.3 and 9.4: a dark sea, a light sky, a horizon between them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import RendererError
from modsim3d.geometry.camera import Camera, Intrinsics
from modsim3d.render.id_pass import AnyIdRenderer, Ids, PlainIds, Region
from modsim3d.runs.pipeline import open_renderer
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.truth.buffer_drawing import Triangles, triangles_of
from modsim3d.truth.outlines import Outlines
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas, Window
from modsim3d.world.floating_vessels import Sea
from modsim3d.world.vessels import shoebox

# ---- The solids before a camera at a step ----

SUN = np.array([-0.35, 0.55, 0.76])  # direction to the light that shades faces, in the world
DIMMEST = 0.5


@dataclass(frozen=True, eq=False)
class Solids:
    """The solids before a camera."""

    sight: Sight  # poses of the camera and the vessels at one step
    camera: Camera
    outlines: Outlines  # a row for each solid before the camera
    extents_m: Array  # length, beam and air draft of all vessels, shape (V, 3)
    sea_half_plane: Array  # the side of the horizon on which the sea lies, shape (3,)
    own_ships: tuple[int, ...]  # indices of the vessels that carry cameras
    waves: Sea | None = None  # of the scene
    time_s: float = 0.0  # since the scene's first step

    @classmethod
    def at(cls, scene: Scene, camera: Camera, step: int) -> Solids:
        """The solids before a camera of a scene at a step."""
        sight = scene.sight(camera, np.array([step]))
        extents_m = np.array([vessel.extents_m for vessel in scene.vessels]).reshape(-1, 3)
        (sea,) = scene.sea_half_planes(camera, np.array([step]))
        waves, time_s = scene.waves.sea if scene.waves else None, float(scene.times_s(step, step + 1)[0])
        return cls(sight, camera, sight.outlines(), extents_m, sea, scene.own_ships, waves, time_s)

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera's intrinsics."""
        return self.camera.intrinsics

    @property
    def occluders(self) -> Indices:
        """Index of the vessel or obstacle of each row, shape (n,)."""
        return self.outlines.occluder

    @cached_property
    def triangles(self) -> Triangles:
        """The triangles of all rows, cut at the near plane and far outside the image."""
        return triangles_of(self.outlines, self.intrinsics)

    def ids(self, window: Window, id_renderer: AnyIdRenderer, samples: int = 1) -> Ids:
        """Occluder + 1 at each pixel of a window, 0 where nothing is, shape (h · samples, w · samples)."""
        values = self.occluders[self.triangles.row] + 1
        return self._drawn(values, window, id_renderer, Region(0, 0, *window.size), samples)

    def faces(self, window: Window, id_renderer: AnyIdRenderer, region: Region, samples: int) -> Ids:
        """Triangle + 1 at each pixel of a region of a window, 0 where nothing is; its shape is as that of `ids`."""
        return self._drawn(np.arange(len(self.triangles.row)) + 1, window, id_renderer, region, samples)

    def _drawn(
        self, values: NDArray[np.integer], window: Window, id_renderer: AnyIdRenderer, region: Region, samples: int
    ) -> Ids:
        enlarged = Region(*(samples * side for side in (region.x, region.y, region.width, region.height)))
        corners = window.to_picture(self.triangles.corners_px) * samples
        return id_renderer.draw(corners, self.triangles.inverse_depth, values, enlarged)

    def normals_camera(self) -> Array:
        """Unit normals of the triangles in CCF, on the side turned to the camera, shape (T, 3)."""
        depth = self.intrinsics.near_clip_m / self.triangles.inverse_depth
        corners = self.intrinsics.unproject(self.triangles.corners_px, depth)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # A face is seen from the side that is turned to the camera, whichever way its corners run.
        away = np.einsum("ij,ij->i", normals, corners[:, 0]) > 0
        normals[away] *= -1
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return normals / np.where(length > 0, length, 1.0)

    def light(self) -> Array:
        """Brightness of each triangle by its angle to the sun, from `DIMMEST` to 1, shape (T,)."""
        world = self.normals_camera() @ self.sight.camera_poses.camera_R_world[0]
        light: Array = DIMMEST + (1 - DIMMEST) * (0.5 + 0.5 * world @ (SUN / np.linalg.norm(SUN)))
        return light

    def shoeboxes(self) -> list[tuple[int, Array, Array]]:
        """Shoeboxes of the vessels: index of the vessel, edges and corner points in the image, in pixels.
        Edges are cut at the near plane, shape (E, 2, 2). Corners nearer than it are NaN, shape (8, 2)."""
        body, near, boxes = shoebox().vertices, self.intrinsics.near_clip_m, []
        for vessel in self.occluders[self.outlines.boxed].tolist():
            turned = (body * self.extents_m[vessel]) @ self.sight.world_R_vessel[0, vessel].T
            corners = self.sight.camera_poses.to_camera((turned + self.sight.poses.positions_m[0, vessel])[None])[0]
            edges = _beyond(corners[_EDGES], near)
            boxes.append((vessel, self.intrinsics.project(edges), self.intrinsics.project(corners)))
        return boxes


_EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
"""Corner 4 i + 2 j + k of the shoebox: an edge joins corners that differ in one of i, j, k."""


def _beyond(edges: Array, near_m: float) -> Array:
    """The parts of segments beyond the near plane, shape (E', 2, 3)."""
    depth = edges[..., 2]
    kept = edges[(depth > near_m).any(axis=1)].copy()
    for end in (0, 1):
        cut = kept[:, end, 2] < near_m
        a, b = kept[cut, end], kept[cut, 1 - end]
        share = (near_m - a[:, 2]) / (b[:, 2] - a[:, 2])
        kept[cut, end] = a + share[:, None] * (b - a)
        kept[cut, end, 2] = near_m
    return kept


@contextmanager
def open_id_renderer(scene: Scene) -> Iterator[AnyIdRenderer]:
    """OpenGL for the ID buffers of pictures, or NumPy where there is no OpenGL or the scene uses none."""
    with ExitStack() as stack:
        try:
            renderer = stack.enter_context(open_renderer(scene))
        except RendererError:
            renderer = None  # a picture of a run that was made elsewhere
        yield renderer or PlainIds()


SMOOTH_SAMPLES = 2  # vessels drawn this much larger and shrunk have edges without steps


def background(
    window: Window,
    sea_half_plane: Array,
    image_size_px: tuple[int, int],
    sea: Colour = palette.SEA,
    sky: Colour = palette.SKY,
) -> Image.Image:
    """Sea and sky in a window; paper outside the camera's image.
    The sea is where a x + b y + c ≥ 0 in pixels of the image, with (a, b, c) the sea half plane, shape (3,)."""
    picture = Image.new("RGB", window.size, palette.PAPER)
    draw, (width, height) = ImageDraw.Draw(picture), window.size
    corners = window.to_picture(np.array([[0, 0], [image_size_px[0], image_size_px[1]]], dtype=np.float64))
    (left, top), (right, bottom) = np.clip(np.rint(corners), 0, (width, height)).tolist()
    if right <= left or bottom <= top:
        return picture
    draw.rectangle((left, top, right - 1, bottom - 1), fill=sky)
    # A pixel is of the sea if its centre is; whole pixels count from their own corner here.
    frame = np.array([(left, top), (right - 1, top), (right - 1, bottom - 1), (left, bottom - 1)])
    polygon = below_horizon(frame, (frame + 0.5) / window.scale + (window.x, window.y), sea_half_plane)
    if len(polygon):
        draw.polygon([tuple(point) for point in np.rint(polygon).tolist()], fill=sea)
    return picture


def below_horizon(polygon: Array, polygon_px: Array, sea_half_plane: Array) -> Array:
    """The part of a convex polygon on the sea's side of the horizon, shape (m, 2); empty if there is no sea in it.
    The polygon has its corners in any affine coordinates of the image, shape (n, 2), `polygon_px` the same in pixels;
    for the half plane see `background`."""
    value = polygon_px @ sea_half_plane[:2] + sea_half_plane[2]
    points = []
    for i in range(len(polygon)):
        if (value[i - 1] >= 0) != (value[i] >= 0):
            share = value[i - 1] / (value[i - 1] - value[i])
            points.append(polygon[i - 1] + share * (polygon[i] - polygon[i - 1]))
        if value[i] >= 0:
            points.append(polygon[i])
    return np.array(points).reshape(-1, 2)


def draw_horizon(canvas: Canvas, window: Window, sea_half_plane: Array, image_size_px: tuple[int, int]) -> None:
    """Draw a line where the sea half plane, shape (3,), ends."""
    a, b, c = sea_half_plane
    if a == b == 0:
        return
    foot = -c * np.array([a, b])
    reach = 2.0 * sum(image_size_px) + float(np.abs(foot).max())
    along = np.array([-b, a]) * reach
    canvas.segments(window.to_picture(np.array([[foot - along, foot + along]])), palette.HORIZON, 0.5)


def fill_solids(
    picture: Image.Image,
    window: Window,
    solids: Solids,
    id_renderer: AnyIdRenderer,
    *,
    dim: float = 0.0,
    samples: int = SMOOTH_SAMPLES,
) -> None:
    """Fill the visible part of every vessel in a picture of a window, each side as bright as the light on it.
    `dim` is a share of black in all colours, so that boxes stand out, `samples` the factor by which sides are drawn
    larger before they are shrunk."""

    triangles = solids.triangles
    if not len(triangles.row):
        return
    corners = window.to_picture(triangles.corners_px).reshape(-1, 2)
    region = Region.around(np.concatenate([corners.min(axis=0), corners.max(axis=0)]), window.size)
    if not region.width or not region.height:
        return
    faces = solids.faces(window, id_renderer, region, samples)
    colours = np.array([occluder_colour(occluder, solids) for occluder in solids.occluders.tolist()])[triangles.row]
    table = np.zeros((len(colours) + 1, 4), dtype=np.uint8)
    table[1:, :3] = colours * (solids.light() * (1 - dim))[:, None]
    place = (region.x, region.y, region.x + region.width, region.y + region.height)
    patch = picture.crop(place).resize((region.width * samples, region.height * samples), Image.Resampling.NEAREST)
    # A pixel as one number is looked up four times as fast as three.
    under = np.frombuffer(patch.tobytes("raw", "RGBX"), dtype=np.uint32).reshape(faces.shape)
    pixels = np.where(faces > 0, table.view(np.uint32)[:, 0][faces], under)
    filled = Image.frombytes("RGB", patch.size, pixels.tobytes(), "raw", "RGBX")
    picture.paste(filled.reduce(samples), place)


def occluder_colour(occluder: int, solids: Solids) -> Colour:
    """The colour of a vessel, or that of land or of what is built for an index beyond the vessels."""
    if (index := occluder - len(solids.extents_m)) < 0:
        return palette.vessel_colour(occluder, solids.own_ships)
    return palette.obstacle_colours(solids.sight.obstacles[index].name)[0]
