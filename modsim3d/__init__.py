"""modsim3d: simulates cameras and their vessel detector in front of a multi-object tracker.

    >>> import modsim3d
    >>> scene = modsim3d.load_scene("strait", steps=2)
    >>> for frame in modsim3d.simulate_frames(scene):
    ...     truth, detections = frame.truth.boxes_px, frame.detections.boxes_px

`import modsim3d` loads no OpenGL, plotting or table library; each name below is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modsim3d.campaign.campaign import Campaign, open_campaign, run_campaign
    from modsim3d.core.errors import ModsimError
    from modsim3d.detector.file.reading import load_detector
    from modsim3d.formats.labelled_video.detect_truth import detect_truth
    from modsim3d.learn.learning import learn_detector
    from modsim3d.learn.voyage.learn_voyage import learn_voyage
    from modsim3d.runs.locating import locate
    from modsim3d.runs.pipeline import simulate_frames
    from modsim3d.runs.run import detect_run, run_scene
    from modsim3d.runs.stored_run import open_run
    from modsim3d.scene.cameras import camera_placement
    from modsim3d.scene.from_dict import scene_from_dict
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.scene import Scene
    from modsim3d.tracking.score_run import score_run
    from modsim3d.tracking.track_run import track_run
    from modsim3d.tracking.trackers.interface import TrackedFrame, Tracker
    from modsim3d.verify.verify_run import verify_run
    from modsim3d.view.frame_plot import plot_frame

    __version__: str

__all__ = [
    "Campaign",
    "ModsimError",
    "Scene",
    "TrackedFrame",
    "Tracker",
    "camera_placement",
    "detect_run",
    "detect_truth",
    "learn_detector",
    "learn_voyage",
    "load_detector",
    "load_scene",
    "locate",
    "open_campaign",
    "open_run",
    "plot_frame",
    "run_campaign",
    "run_scene",
    "scene_from_dict",
    "score_run",
    "simulate_frames",
    "track_run",
    "verify_run",
]

_HOMES = {
    "Campaign": "modsim3d.campaign.campaign",
    "ModsimError": "modsim3d.core.errors",
    "Scene": "modsim3d.scene.scene",
    "TrackedFrame": "modsim3d.tracking.trackers.interface",
    "Tracker": "modsim3d.tracking.trackers.interface",
    "camera_placement": "modsim3d.scene.cameras",
    "detect_run": "modsim3d.runs.run",
    "detect_truth": "modsim3d.formats.labelled_video.detect_truth",
    "learn_detector": "modsim3d.learn.learning",
    "learn_voyage": "modsim3d.learn.voyage.learn_voyage",
    "load_detector": "modsim3d.detector.file.reading",
    "load_scene": "modsim3d.scene.reading",
    "locate": "modsim3d.runs.locating",
    "open_campaign": "modsim3d.campaign.campaign",
    "open_run": "modsim3d.runs.stored_run",
    "plot_frame": "modsim3d.view.frame_plot",
    "run_campaign": "modsim3d.campaign.campaign",
    "run_scene": "modsim3d.runs.run",
    "scene_from_dict": "modsim3d.scene.from_dict",
    "score_run": "modsim3d.tracking.score_run",
    "simulate_frames": "modsim3d.runs.pipeline",
    "track_run": "modsim3d.tracking.track_run",
    "verify_run": "modsim3d.verify.verify_run",
}


if not TYPE_CHECKING:  # a type checker takes the imports above, and so finds a misspelt name

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version

            return version("modsim3d")
        if name not in _HOMES:
            raise AttributeError(f"module 'modsim3d' has no attribute '{name}'")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
