"""Solids in the light of lamps, drawn by pyrender in the process's one OpenGL context.
pyrender's own cameras have no skew, and its buffers blend the edges of solids. Therefore pyrender gets what the ID pass
gets: triangles that are already clipped, the projection of the camera itself, and a buffer without multisampling whose
depth is floating-point and reversed. A pixel then shows the solid that the ID pass finds there, except where single
precision puts a pixel centre on the other side of an edge."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import RendererError
from modsim3d.render.context import GLContext, choose_backend, prepare_environment
from modsim3d.render.id_pass import MAX_REGION_PX

GAMMA = 2.2  # exponent from screen values to light, close enough to the curve of sRGB


def import_pyrender() -> Any:
    """The pyrender module for offscreen rendering, imported in the one way that works without a screen.
    `import pyrender` also imports its window. The window needs pyglet, which needs libGL and an X library that servers
    do not have. An empty module replaces the window. Raises RendererError if there is no OpenGL library."""
    prepare_environment(choose_backend())
    if "pyrender" not in sys.modules:
        window = ModuleType("pyrender.viewer")
        window.Viewer = object  # type: ignore[attr-defined]
        sys.modules["pyrender.viewer"] = window
    import pyrender

    return pyrender


@dataclass(frozen=True, eq=False)
class LitFaces:
    """Triangles of T faces in camera coordinates."""

    corners_camera: Array  # in CCF, none nearer than the near plane, shape (T, 3, 3)
    normals_camera: Array  # unit vectors in CCF towards the side that is seen, shape (T, 3)
    colours: Array  # red, green and blue as a screen has them (sRGB), from 0 to 1, shape (T, 3)
    shade: Array | None = None  # by which the colour at each corner is multiplied, shape (T, 3); 1 if None


@dataclass(frozen=True)
class Lamp:
    """Light from far away."""

    towards_camera: tuple[float, float, float]  # direction to the lamp in CCF
    colour: tuple[float, float, float]  # red, green and blue
    strength: float  # 3 makes a white face that is turned to it about white


@dataclass(frozen=True, eq=False)
class LitPicture:
    """A picture of w × h pixels."""

    colour: NDArray[np.uint8]  # sRGB, zero where nothing is, shape (h, w, 3)
    depth_m: NDArray[np.float32]  # distance c3 along the viewing direction, infinite where nothing is, shape (h, w)

    @property
    def drawn(self) -> Mask:
        """Whether each pixel shows a solid, shape (h, w)."""
        return np.isfinite(self.depth_m)


class ShadedRenderer:
    """Draws lit faces and restores the state of the context after each picture, so that ID buffers can be drawn too."""

    def __init__(self, context: GLContext) -> None:
        """Import pyrender and prepare it for the open context."""
        self._context = context
        self._pyrender = import_pyrender()
        from modsim3d.render.pyrender_classes import ProjectionCamera, SharpRenderer  # they need pyrender

        white = [1.0, 1.0, 1.0, 1.0]
        self._material = self._pyrender.MetallicRoughnessMaterial(baseColorFactor=white, doubleSided=True)
        self._camera_type = ProjectionCamera
        self._drawer = SharpRenderer(1, 1)

    def draw(
        self,
        faces: LitFaces,
        pixels: Array,
        near_m: float,
        size: tuple[int, int],
        lamps: Sequence[Lamp],
        ambient: tuple[float, float, float],
    ) -> LitPicture:
        """Draw T faces in a picture of a width and height, with directed light and light from all directions. `pixels`
        maps CCF to homogeneous columns and rows of the picture, shape (3, 3): K, scaled and shifted to the window that
        the picture shows. No face may be nearer than the near plane. `ambient` is red, green and blue, as shares of a
        face's colour. Raises RendererError if the picture is larger than a buffer may be."""
        width, height = size
        if not len(faces.colours) or not min(size):
            return LitPicture(np.zeros((height, width, 3), np.uint8), np.full((height, width), np.inf, np.float32))
        if max(size) > MAX_REGION_PX:
            raise RendererError(f"a picture of {width} × {height} px is too large: at most {MAX_REGION_PX} px a side")
        scene = self._pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0])
        scene.add(self._camera_type(_clip(pixels, near_m, size)))
        scene.add(self._mesh(faces, lit_colours(faces, lamps, ambient)))
        self._drawer.viewport_width, self._drawer.viewport_height = size
        with _kept_state(self._context.gl):
            flags = self._pyrender.RenderFlags
            drawn, inverse = self._drawer.render(scene, flags.OFFSCREEN | flags.SKIP_CULL_FACES | flags.FLAT)
        with np.errstate(divide="ignore"):
            return LitPicture(drawn, np.float32(near_m) / inverse)

    def close(self) -> None:
        """Free the buffers and textures in the context."""
        with _kept_state(self._context.gl):
            self._drawer.delete()

    def _mesh(self, faces: LitFaces, colours: Array) -> Any:
        nearest_first = np.argsort(faces.corners_camera[..., 2].min(axis=1))  # pixels behind are then not shaded
        shade = np.ones((len(colours), 3)) if faces.shade is None else faces.shade
        shown = np.clip(colours[:, None] * shade[..., None], 0, 1)[nearest_first].reshape(-1, 3)
        primitive = self._pyrender.Primitive(
            positions=faces.corners_camera[nearest_first].reshape(-1, 3),
            color_0=np.column_stack([shown, np.ones(len(shown))]),
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
    """The sRGB colour of each face in the light of lamps, by Lambert's law, shape (T, 3). In light from far away a flat
    face has one colour. It is computed here once per face, because computing it at each pixel took most of the time of
    a picture (benchmarks/drawing.py)."""
    light = np.tile(np.array(ambient, dtype=np.float64), (len(faces.colours), 1))
    for lamp in lamps:
        towards = np.array(lamp.towards_camera) / np.linalg.norm(lamp.towards_camera)
        turned = np.maximum(faces.normals_camera @ towards, 0.0)
        light += turned[:, None] * np.array(lamp.colour) * lamp.strength / np.pi
    return np.clip(faces.colours**GAMMA * light, 0.0, 1.0) ** (1 / GAMMA)


@contextmanager
def _kept_state(gl: Any) -> Iterator[None]:
    """Restore the state that the ID pass sets once for all of its pictures."""
    names = gl.GL_CURRENT_PROGRAM, gl.GL_VERTEX_ARRAY_BINDING, gl.GL_ARRAY_BUFFER_BINDING
    program, vertices, buffer = (int(gl.glGetIntegerv(name)) for name in names)
    try:
        yield
    finally:
        gl.glUseProgram(program)
        gl.glBindVertexArray(vertices)
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffer)
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 4)
        for name in (gl.GL_BLEND, gl.GL_CULL_FACE, gl.GL_MULTISAMPLE):
            gl.glDisable(name)
