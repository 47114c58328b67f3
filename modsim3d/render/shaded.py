"""pyrender, imported in the one way that works on a machine without a screen.

`import pyrender` also imports its window, which needs pyglet, which needs libGL and an X library that a server has no
use for. Only the offscreen renderer is wanted here, so an empty module stands in for the window.
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
