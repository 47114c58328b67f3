"""pyrender's camera and renderer, adapted to the projection and the depth of the ID pass.
Import this module after `import_pyrender`, which loads pyrender so that it needs no screen."""

from typing import Any

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.renderer import Renderer

from modsim3d.core.arrays import Array
from modsim3d.render.context import make_framebuffer


class ProjectionCamera(pyrender.Camera):  # type: ignore[misc]
    """A camera that is nothing but its projection matrix."""

    def __init__(self, projection: Array) -> None:
        """Keep the matrix from camera to clip coordinates, shape (4, 4)."""
        super().__init__()
        self._projection = projection

    def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Array:
        """The matrix, shape (4, 4), whatever the size of the picture."""
        return self._projection


class SharpRenderer(Renderer):  # type: ignore[misc]
    """pyrender's renderer with one sample per pixel, and with the depth of the ID pass: reversed, from 1 to 0."""

    def __del__(self) -> None:
        """Free nothing: when Python collects it, another context may be current, or the ID pass at work."""

    def _configure_main_framebuffer(self) -> None:
        size = (self.viewport_width, self.viewport_height)
        if self._main_fb_dims == size:  # type: ignore[has-type]
            return
        self._delete_main_framebuffer()
        self._main_fb, storages = make_framebuffer(GL, size, GL.GL_RGBA8, "a picture")
        self._main_fb_ms, (self._main_cb, self._main_db) = self._main_fb, storages
        self._main_fb_dims = size

    def _delete_main_framebuffer(self) -> None:
        if self._main_fb is not None:
            GL.glDeleteFramebuffers(1, [self._main_fb])
            GL.glDeleteRenderbuffers(2, [self._main_cb, self._main_db])
        self._main_fb = self._main_fb_ms = self._main_cb = self._main_db = None
        self._main_fb_dims = (None, None)

    def _configure_forward_pass_viewport(self, flags: int) -> None:
        super()._configure_forward_pass_viewport(flags)
        GL.glClearDepth(0.0)
        GL.glDepthFunc(GL.GL_GREATER)

    def _read_main_framebuffer(self, scene: Any, flags: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        width, height = self._main_fb_dims
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        colour = np.empty((height, width, 3), dtype=np.uint8)
        depth = np.empty((height, width), dtype=np.float32)
        GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, colour)
        GL.glReadPixels(0, 0, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, depth)
        return colour, depth
