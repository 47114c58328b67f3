"""Solids in the light of lamps, drawn by pyrender in the process's one OpenGL context.

pyrender's own cameras know no skew, and its buffers blend the edges of what they show. So it is given what the ID pass
is given: triangles that are cut already, the projection of the camera itself, and a buffer without multisampling whose
depth is floating-point and reversed. A pixel then shows a solid exactly where the ID pass says so, but for centres
that single precision puts on the other side of an edge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Mask
from modsim3d.errors import RendererError
from modsim3d.render.context import GLContext
from modsim3d.render.id_pass import MAX_REGION_PX
from modsim3d.render.shaded import import_pyrender

GAMMA = 2.2
"""From what a screen is given to light, near enough to the curve of sRGB."""


@dataclass(frozen=True, eq=False)
class LitFaces:
    """Triangles of T faces in camera coordinates.

    Attributes:
        corners_camera: In CCF, none nearer than the near plane, shape (T, 3, 3).
        normals_camera: Unit vectors in CCF towards the side that is seen, shape (T, 3).
        colours: Red, green and blue as a screen has them (sRGB), from 0 to 1, shape (T, 3).
    """

    corners_camera: Array
    normals_camera: Array
    colours: Array


@dataclass(frozen=True)
class Lamp:
    """Light from far away.

    Attributes:
        towards_camera: Direction to the lamp in CCF.
        colour: Red, green and blue.
        strength: 3 makes a white face that is turned to it about white.
    """

    towards_camera: tuple[float, float, float]
    colour: tuple[float, float, float]
    strength: float


@dataclass(frozen=True, eq=False)
class Lit:
    """What was drawn.

    Attributes:
        colour: sRGB, zero where nothing is, shape (h, w, 3).
        depth_m: c3; infinite where nothing is, shape (h, w).
    """

    colour: NDArray[np.uint8]
    depth_m: NDArray[np.float32]

    @property
    def drawn(self) -> Mask:
        """Where something is."""
        return np.isfinite(self.depth_m)


class ShadedRenderer:
    """Draws lit faces. The context's state is as before after each picture, so that ID buffers can be drawn too."""

    def __init__(self, context: GLContext) -> None:
        """Import pyrender, for the context that is open."""
        self._context = context
        self._pyrender = import_pyrender()
        self._material = self._pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[1.0, 1.0, 1.0, 1.0], doubleSided=True
        )
        self._camera_type = _camera_type(self._pyrender)
        self._drawer = _renderer_type(context)(1, 1)

    def draw(
        self,
        faces: LitFaces,
        pixels: Array,
        near_m: float,
        size: tuple[int, int],
        lamps: Sequence[Lamp],
        ambient: tuple[float, float, float],
    ) -> Lit:
        """Draw faces.

        Args:
            faces: What to draw.
            pixels: From CCF to homogeneous columns and rows of the picture: K with a window's scale and place,
                shape (3, 3).
            near_m: No corner is nearer.
            size: Width and height of the picture.
            lamps: From far away.
            ambient: Light from everywhere: a face shows this share of its colour whatever the lamps.
        """
        if not len(faces.colours) or not min(size):
            shape = (size[1], size[0])
            return Lit(np.zeros((*shape, 3), np.uint8), np.full(shape, np.inf, np.float32))
        if max(size) > MAX_REGION_PX:
            raise RendererError(f"a picture of {size[0]} × {size[1]} px was asked for; {MAX_REGION_PX} a side is most")
        scene = self._pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0])
        scene.add(self._camera_type(_clip(pixels, near_m, size)))
        scene.add(self._mesh(faces, lit_colours(faces, lamps, ambient)))
        self._drawer.viewport_width, self._drawer.viewport_height = size
        with _kept_state(self._context.gl):
            flags = self._pyrender.RenderFlags
            drawn, inverse = self._drawer.render(scene, flags.OFFSCREEN | flags.SKIP_CULL_FACES | flags.FLAT)
        with np.errstate(divide="ignore"):
            return Lit(drawn, np.float32(near_m) / inverse)

    def close(self) -> None:
        """Free what the context holds for it."""
        with _kept_state(self._context.gl):
            self._drawer.delete()

    def _mesh(self, faces: LitFaces, colours: Array) -> Any:
        nearest_first = np.argsort(faces.corners_camera[..., 2].min(axis=1))  # what is behind is then not drawn
        opaque = np.column_stack([colours, np.ones(len(colours))])
        primitive = self._pyrender.Primitive(
            positions=faces.corners_camera[nearest_first].reshape(-1, 3),
            color_0=np.repeat(opaque[nearest_first], 3, axis=0),
            material=self._material,
            mode=self._pyrender.GLTF.TRIANGLES,
        )
        return self._pyrender.Mesh([primitive])


def _clip(pixels: Array, near_m: float, size: tuple[int, int]) -> Array:
    """CCF to clip coordinates, shape (4, 4): row 0 is OpenGL's lowest, depth is near / c3, as in the ID pass."""
    clip = np.zeros((4, 4))
    for axis in (0, 1):
        clip[axis, :3] = 2.0 / size[axis] * pixels[axis] - pixels[2]
    clip[2, 3] = near_m
    clip[3, :3] = pixels[2]
    return clip


def lit_colours(faces: LitFaces, lamps: Sequence[Lamp], ambient: tuple[float, float, float]) -> Array:
    """The colour of each face in the light of lamps, as a screen has it: Lambert's law, shape (T, 3).

    A flat face in light from far away has one colour, so it is found here once and not at each pixel of a buffer,
    where it took most of the time of a picture (benchmarks/drawing.py).
    """
    light = np.tile(np.array(ambient, dtype=np.float64), (len(faces.colours), 1))
    for lamp in lamps:
        towards = np.array(lamp.towards_camera) / np.linalg.norm(lamp.towards_camera)
        turned = np.maximum(faces.normals_camera @ towards, 0.0)
        light += turned[:, None] * np.array(lamp.colour) * lamp.strength / np.pi
    colours: Array = np.clip(faces.colours**GAMMA * light, 0.0, 1.0) ** (1 / GAMMA)
    return colours


def _camera_type(pyrender: Any) -> Any:
    class Projection(pyrender.Camera):  # type: ignore[misc]
        """A camera that is nothing but its matrix."""

        def __init__(self, clip: Array) -> None:
            super().__init__()
            self._clip = clip

        def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Array:
            return self._clip

    return Projection


def _renderer_type(context: GLContext) -> Any:
    from pyrender.renderer import Renderer

    gl = context.gl

    class Sharp(Renderer):  # type: ignore[misc]
        """pyrender's renderer with one sample a pixel, and with the depth of this context: reversed, from 1 to 0."""

        def __del__(self) -> None:
            """Nothing: whenever Python collects it, another context may be there, or the ID pass at work."""

        def _configure_main_framebuffer(self) -> None:
            size = (self.viewport_width, self.viewport_height)
            if self._main_fb_dims == size:  # type: ignore[has-type]
                return
            self._delete_main_framebuffer()
            self._main_fb = self._main_fb_ms = gl.glGenFramebuffers(1)
            self._main_cb, self._main_db = gl.glGenRenderbuffers(2)
            gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._main_fb)
            for storage, kind, place in (
                (self._main_cb, gl.GL_RGBA8, gl.GL_COLOR_ATTACHMENT0),
                (self._main_db, gl.GL_DEPTH_COMPONENT32F, gl.GL_DEPTH_ATTACHMENT),
            ):
                gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, storage)
                gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, *size)
                gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, place, gl.GL_RENDERBUFFER, storage)
            if gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER) != gl.GL_FRAMEBUFFER_COMPLETE:
                raise RendererError(f"the renderer offers no picture of {size[0]} × {size[1]} px with float depth")
            self._main_fb_dims = size

        def _delete_main_framebuffer(self) -> None:
            if self._main_fb is not None:
                gl.glDeleteFramebuffers(1, [self._main_fb])
                gl.glDeleteRenderbuffers(2, [self._main_cb, self._main_db])
            self._main_fb = self._main_fb_ms = self._main_cb = self._main_db = None
            self._main_fb_dims = (None, None)

        def _configure_forward_pass_viewport(self, flags: int) -> None:
            super()._configure_forward_pass_viewport(flags)
            gl.glClearDepth(0.0)
            gl.glDepthFunc(gl.GL_GREATER)

        def _read_main_framebuffer(self, scene: Any, flags: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
            width, height = self._main_fb_dims
            gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self._main_fb)
            gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
            colour = np.empty((height, width, 3), dtype=np.uint8)
            depth = np.empty((height, width), dtype=np.float32)
            gl.glReadPixels(0, 0, width, height, gl.GL_RGB, gl.GL_UNSIGNED_BYTE, colour)
            gl.glReadPixels(0, 0, width, height, gl.GL_DEPTH_COMPONENT, gl.GL_FLOAT, depth)
            return colour, depth

    return Sharp


@contextmanager
def _kept_state(gl: Any) -> Iterator[None]:
    """Put back what the ID pass set once for all of its pictures."""
    program, vertices, buffer = (
        int(gl.glGetIntegerv(name))
        for name in (gl.GL_CURRENT_PROGRAM, gl.GL_VERTEX_ARRAY_BINDING, gl.GL_ARRAY_BUFFER_BINDING)
    )
    try:
        yield
    finally:
        gl.glUseProgram(program)
        gl.glBindVertexArray(vertices)
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffer)
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 4)
        for name in (gl.GL_BLEND, gl.GL_CULL_FACE, gl.GL_MULTISAMPLE):
            gl.glDisable(name)
