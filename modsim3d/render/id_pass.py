"""ID buffers: which solid is front-most at each pixel centre.
Solids are projected in double precision before they get here. OpenGL is only a rasteriser with a depth buffer: it gets
corners in pixels and the plane of each triangle. Corners are rounded to 1/256 px, the precision of Mesa's rasteriser.
An offset by whole pixels then changes nothing, so a region of the image holds exactly the pixels that the whole image
would hold there.
The reciprocal of depth is linear in the image, so each triangle has three coefficients, and a pixel's depth is a sum of
their products with its column and row. Triangles in one plane, as the decks of two rafted boats, have the same
coefficients when these are rounded, and therefore the same depth at every pixel, in any buffer: the first is in front.
Beyond a triangle's edge, where rounded corners reach, its depth stays between those of its corners."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array
from modsim3d.core.errors import RendererError
from modsim3d.render.context import GLContext, make_framebuffer

# ---- ID buffers ----

SUBPIXELS = 256
VIEWPORT_PX = 16384
"""Side of the viewport. It is a power of two, so that pixels map to it exactly. It is placed so that it contains the
corners of what is drawn: OpenGL then cuts no edges, which would move corners. Images of up to 12,000 px with corners at
most 2048 px outside fit; in a wider supersampled image, edges far outside a tile may be cut."""
MAX_REGION_PX = 12_288
MIN_BUFFER_PX = 64
NO_AREA_PX = 1e-9  # triangles of less than half of this area in square pixels have no gradient of depth
KEPT_BUFFERS_PX = 12_000_000  # buffers are kept and used again until together they have more pixels than this

_VERTEX = np.dtype([("position", np.float32, 2), ("plane", np.float32, 3), ("range", np.float32, 2), ("id", np.uint32)])

_VERTEX_SHADER = """#version 330 core
layout(location = 0) in vec2 position;
layout(location = 1) in vec3 plane;
layout(location = 2) in vec2 range;
layout(location = 3) in uint id;
flat out vec3 depth;
flat out vec2 ends;
flat out uint solid;
void main() { depth = plane; ends = range; solid = id; gl_Position = vec4(position, 0.0, 1.0); }
"""
_FRAGMENT_SHADER = """#version 330 core
uniform vec2 to_image;  // from the buffer
flat in vec3 depth;
flat in vec2 ends;
flat in uint solid;
layout(location = 0) out uint pixel;
void main() {
  pixel = solid;
  gl_FragDepth = clamp(dot(depth, vec3(gl_FragCoord.xy + to_image, 1.0)), ends.x, ends.y);
}
"""

Ids = NDArray[np.uint32]


@dataclass(frozen=True)
class Region:
    """A rectangle of whole pixels: columns [x, x + width) and rows [y, y + height)."""

    x: int
    y: int
    width: int
    height: int

    @classmethod
    def around(cls, box_px: Array, image_size_px: tuple[int, int], margin_px: int = 1) -> Region:
        """The pixels of an image that a box x_min, y_min, x_max, y_max, shape (4,), touches; empty if there are none. A
        margin is added on each side, within the image."""
        low = np.clip(np.floor(box_px[:2]) - margin_px, 0, image_size_px)
        high = np.clip(np.ceil(box_px[2:]) + margin_px, 0, image_size_px)
        width, height = np.maximum(high - low, 0)
        return cls(int(low[0]), int(low[1]), int(width), int(height))

    def common(self, other: Region) -> Region:
        """The pixels that both regions contain; empty if there are none."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Region(x, y, max(right - x, 0), max(bottom - y, 0))


@dataclass(frozen=True, eq=False)
class Sheet:
    """Regions of an image that are drawn side by side in one buffer."""

    regions: list[Region]
    places: NDArray[np.int64]  # column and row of the top left corner of each in the buffer, (k, 2); no two overlap
    size: tuple[int, int]  # width and height of the buffer

    @property
    def corners(self) -> NDArray[np.int64]:
        """Column and row of the top left corner of each region in the image, shape (k, 2)."""
        return np.array([(region.x, region.y) for region in self.regions], dtype=np.int64).reshape(-1, 2)


class IdRenderer:
    """Draws triangles into ID buffers of 32-bit integers with a float depth buffer. Integer buffers are never blended,
    dithered or converted, and 32 bits hold more IDs than a scene can have. The depth is near/c3, greatest at the front.
    Its precision is therefore relative: two boxes a metre apart are drawn in the right order at any distance."""

    def __init__(self, context: GLContext) -> None:
        """Draw in a context."""
        self.context = context
        self._buffers: dict[tuple[int, int], tuple[int, Any]] = {}

    @cached_property
    def _gl(self) -> ModuleType:
        """OpenGL, once the shaders are compiled and the state is set that all drawings share."""
        gl = self.context.gl
        gl.glBindVertexArray(gl.glGenVertexArrays(1))
        program = _program(gl)
        gl.glUseProgram(program)
        self._to_image = gl.glGetUniformLocation(program, "to_image")
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, gl.glGenBuffers(1))
        for place, size, first in ((0, 2, 0), (1, 3, 8), (2, 2, 20)):
            gl.glEnableVertexAttribArray(place)
            gl.glVertexAttribPointer(place, size, gl.GL_FLOAT, False, _VERTEX.itemsize, ctypes.c_void_p(first))
        gl.glEnableVertexAttribArray(3)
        gl.glVertexAttribIPointer(3, 1, gl.GL_UNSIGNED_INT, _VERTEX.itemsize, ctypes.c_void_p(28))
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthFunc(gl.GL_GREATER)
        gl.glClearDepth(0.0)
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 4)
        return gl

    def prepare(self) -> None:
        """Draw something now, for whom the first drawing would come late: it loads functions and compiles shaders."""
        corner, whole = Region(0, 0, 1, 1), np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]])
        self.draw(whole, np.ones((1, 3)), np.ones(1, dtype=np.int64), corner)

    def draw(self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], region: Region) -> Ids:
        """The ID at each pixel of a region, shape (region.height, region.width); zero where nothing is. Triangles have
        corners at columns and rows of the image in pixels (T, 3, 2), near / c3 of these in (0, 1] (T, 3), and a
        positive ID of their solid (T,). Raises RendererError if the region is larger than a buffer."""
        sheet = Sheet([region], np.zeros((1, 2), dtype=np.int64), (region.width, region.height))
        return self.draw_sheet(corners_px, inverse_depth, ids, np.array([len(ids)]), sheet)

    def draw_sheet(
        self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], counts: NDArray[np.int64], sheet: Sheet
    ) -> Ids:
        """The ID at each pixel of a buffer with several regions, shape (height, width); zero where nothing is.
        Triangles are given as for `draw`, those of the first region first; `counts` says how many are drawn in each of
        the k regions (k,). Raises RendererError if the buffer is larger than one may be."""
        width, height = sheet.size
        out = np.zeros((height, width), dtype=np.uint32)
        if not len(ids) or not out.size:
            return out
        if max(sheet.size) > MAX_REGION_PX:
            problem = f"an ID buffer of {width} × {height} px is too large"
            raise RendererError(f"{problem}: at most {MAX_REGION_PX} px a side")
        vertices, origins = _vertices(corners_px, inverse_depth, ids, counts, sheet)
        gl = self._gl
        self._bind_buffer(width, height)
        gl.glClearBufferuiv(gl.GL_COLOR, 0, np.zeros(4, dtype=np.uint32))
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
        gl.glBufferData(gl.GL_ARRAY_BUFFER, vertices.nbytes, vertices, gl.GL_STREAM_DRAW)
        gl.glEnable(gl.GL_SCISSOR_TEST)
        columns = sheet.places, origins, np.cumsum(counts) - counts, counts
        places = zip(sheet.regions, *(column.tolist() for column in columns), strict=True)
        for region, (x, y), (left, top), first, count in places:
            gl.glViewport(x + left, y + top, VIEWPORT_PX, VIEWPORT_PX)
            gl.glScissor(x, y, region.width, region.height)
            gl.glUniform2f(self._to_image, region.x - x, region.y - y)
            gl.glDrawArrays(gl.GL_TRIANGLES, 3 * first, 3 * count)
        gl.glDisable(gl.GL_SCISSOR_TEST)
        gl.glReadPixels(0, 0, width, height, gl.GL_RED_INTEGER, gl.GL_UNSIGNED_INT, out)
        return out

    def _bind_buffer(self, width: int, height: int) -> None:
        """Bind a buffer that is little larger than a region, since all of it is cleared; make it at first use."""
        size = _buffer_side(width), _buffer_side(height)
        gl = self._gl
        if size in self._buffers:
            self._buffers[size] = self._buffers.pop(size)  # which makes it the last used
        else:
            while self._buffers and sum(w * h for w, h in (*self._buffers, size)) > KEPT_BUFFERS_PX:
                framebuffer, storages = self._buffers.pop(next(iter(self._buffers)))
                gl.glDeleteFramebuffers(1, [framebuffer])
                gl.glDeleteRenderbuffers(2, storages)
            self._buffers[size] = make_framebuffer(gl, size, gl.GL_R32UI, "an integer buffer")
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._buffers[size][0])


def _vertices(
    corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], counts: NDArray[np.int64], sheet: Sheet
) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """The vertices, and the origin of each region's viewport from its place. Row 0 of a region is OpenGL's lowest."""
    vertices = np.empty((len(ids), 3), dtype=_VERTEX)
    snapped = np.rint(corners_px * SUBPIXELS) / SUBPIXELS - np.repeat(sheet.corners, counts, axis=0)[:, None]
    # A viewport begins at the least corner, or as near to it as it can while containing the region.
    side = np.array([(region.width, region.height) for region in sheet.regions])
    origins = np.zeros(side.shape)
    some = counts > 0
    origins[some] = np.minimum.reduceat(np.floor(snapped.min(axis=1)), (np.cumsum(counts) - counts)[some])
    origins = np.clip(origins, side - VIEWPORT_PX, 0)
    vertices["position"] = (snapped - np.repeat(origins, counts, axis=0)[:, None]) * (2 / VIEWPORT_PX) - 1
    vertices["plane"] = _planes(corners_px, inverse_depth)[:, None]
    vertices["range"] = np.stack([inverse_depth.min(axis=1), inverse_depth.max(axis=1)], axis=1)[:, None]
    vertices["id"] = np.asarray(ids)[:, None]
    return vertices.reshape(-1), origins.astype(np.int64)


def _planes(corners_px: Array, inverse_depth: Array) -> Array:
    """Coefficients of column, row and 1 whose sum is the inverse depth of each triangle, shape (T, 3). Of a triangle
    without area in the image it is that of its corners' mean."""
    (ax, ay), (bx, by) = (corners_px[:, 1:] - corners_px[:, :1]).transpose(1, 2, 0)
    a, b = (inverse_depth[:, 1:] - inverse_depth[:, :1]).T
    area = ax * by - bx * ay
    flat = np.abs(area) < NO_AREA_PX
    area = np.where(flat, np.inf, area)
    along_x, along_y = (a * by - b * ay) / area, (ax * b - bx * a) / area
    x, y = corners_px.mean(axis=1).T
    return np.stack([along_x, along_y, inverse_depth.mean(axis=1) - along_x * x - along_y * y], axis=1)


def _buffer_side(pixels: int) -> int:
    """A buffer side that is at most a quarter larger, out of four sizes between a power of two and the next."""
    step = max(MIN_BUFFER_PX, (1 << (pixels - 1).bit_length()) // 8)
    return -(-pixels // step) * step


def _program(gl: object) -> int:
    from OpenGL.GL import shaders

    parts = ((_VERTEX_SHADER, "GL_VERTEX_SHADER"), (_FRAGMENT_SHADER, "GL_FRAGMENT_SHADER"))
    compiled = [shaders.compileShader(text, getattr(gl, kind)) for text, kind in parts]
    return int(shaders.compileProgram(*compiled, validate=False))


# ---- ID buffers without OpenGL ----


class AnyIdRenderer(Protocol):
    """Renderer of ID buffers: `IdRenderer` by OpenGL, or `PlainIds` without it."""

    def draw(self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], region: Region) -> Ids:
        """The ID at each pixel of a region, shape (height, width); zero where nothing is. See `IdRenderer.draw`."""


class PlainIds:
    """Draws triangle by triangle with a depth buffer, in NumPy. A pixel whose centre is exactly on an edge belongs to
    the triangles on both sides; OpenGL gives it to one of them."""

    def draw(self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], region: Region) -> Ids:
        """The ID at each pixel of a region, shape (height, width); zero where nothing is. See `IdRenderer.draw`."""
        out = np.zeros((region.height, region.width), dtype=np.uint32)
        depth = np.zeros(out.shape)
        corners = corners_px - (region.x, region.y)
        low = np.clip(np.floor(corners.min(axis=1, initial=np.inf)), 0, (region.width, region.height)).astype(int)
        high = np.clip(np.ceil(corners.max(axis=1, initial=-np.inf)), 0, (region.width, region.height)).astype(int)
        for i in np.flatnonzero((high > low).all(axis=1)).tolist():
            (x0, y0), (x1, y1) = low[i], high[i]
            here = np.s_[y0:y1, x0:x1]
            centres = np.arange(x0, x1) + 0.5, np.arange(y0, y1)[:, None] + 0.5
            weights = _barycentric(corners[i], *centres)
            if weights is None:
                continue
            inverse = sum(w * d for w, d in zip(weights, inverse_depth[i], strict=True))
            front = (np.minimum.reduce(weights) >= 0) & (inverse > depth[here])
            out[here][front] = ids[i]
            depth[here][front] = inverse[front]
        return out


def _barycentric(triangle: Array, x: Array, y: Array) -> tuple[Array, Array, Array] | None:
    """Barycentric coordinates of points in a triangle (3, 2); None if the triangle is seen edge-on."""
    (ax, ay), (bx, by), (cx, cy) = triangle
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if doubled == 0:
        return None
    first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / doubled
    second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / doubled
    return first, second, 1 - first - second
