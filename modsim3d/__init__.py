"""modsim3d: simulates cameras and their vessel detector in front of a multi-object tracker.

    >>> import modsim3d
    >>> scene = modsim3d.load_scene("strait", steps=2)
    >>> for frame in modsim3d.simulate_frames(scene):
    ...     truth, detections = frame.truth.boxes_px, frame.detections.boxes_px

`import modsim3d` loads no OpenGL, plotting or table library; each name is imported when it is first used.
"""

from modsim3d.core.lazy_names import LazyNames

_NAMES = LazyNames(__name__, __file__)
__all__ = _NAMES.names
__getattr__, __dir__ = _NAMES.__getitem__, _NAMES.listed
