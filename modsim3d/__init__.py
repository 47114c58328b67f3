"""modsim3d: simulates cameras and their vessel detector in front of a multi-object tracker.

    import modsim3d

    scene = modsim3d.load_scene("simulation_1", mode=2)
    for frame in modsim3d.simulate_frames(scene):
        frame.truth.boxes_px, frame.detections.boxes_px

`import modsim3d` loads no OpenGL, plotting or tracking library; each name below is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modsim3d.errors import ModsimError
    from modsim3d.runs.pipeline import simulate_frames
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.scene import Scene

__all__ = ["ModsimError", "Scene", "load_scene", "run_scene", "simulate_frames"]

_HOMES = {
    "ModsimError": "modsim3d.errors",
    "Scene": "modsim3d.scene.scene",
    "load_scene": "modsim3d.scene.reading",
    "run_scene": "modsim3d.runs.run",
    "simulate_frames": "modsim3d.runs.pipeline",
}

__path__.append(str(Path(__file__).with_name("old_paths")))  # where documented modules are found that have moved


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("modsim3d")
    if name not in _HOMES:
        raise AttributeError(f"module 'modsim3d' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
