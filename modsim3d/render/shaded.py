"""pyrender, imported in the one way that works on a machine without a screen.

`import pyrender` also imports its window. The window needs pyglet, which needs libGL and an X library that servers do
not have. Only the offscreen renderer is used here, so an empty module replaces the window.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from modsim3d.render.context import choose_backend, prepare_environment


def import_pyrender() -> Any:
    """The pyrender module, for offscreen rendering with the chosen backend.

    Raises:
        RendererError: There is no OpenGL library.
    """
    prepare_environment(choose_backend())
    if "pyrender" not in sys.modules:
        window = ModuleType("pyrender.viewer")
        window.Viewer = object  # type: ignore[attr-defined]
        sys.modules["pyrender.viewer"] = window
    import pyrender

    return pyrender
