"""Pose sources: which vessels are present at each step, where they are, and their headings.

`base` has the interface: `Poses`; `PoseSource`, which gives them; and `SourceKeys`, a section of a scene file that
builds a source. Each built-in source is one file, and `registry` knows them by name. To add one, copy `tracks` (at the
scene's times), `replay` (a file with its own times) or `stream` (poses that arrive during the run, which `live` keeps),
and enter its keys in `registry.SOURCES`. In a plug-in a subclass of `timed.PosesByTime` is the shortest way; `checked`
checks what plug-ins return.
"""

from modsim3d.motion.poses.base import PoseRequest, Poses, PoseSource, SourceKeys, generated_timestamps, times_s
from modsim3d.motion.poses.circular import CircularMotion, circular_motion
from modsim3d.motion.poses.live import LivePoses
from modsim3d.motion.poses.registry import NamedSource, read_source
from modsim3d.motion.poses.replay import RecordedPoses, load_poses
from modsim3d.motion.poses.timed import PosesByTime
from modsim3d.motion.poses.tracks import Tracks, waypoint_tracks

__all__ = [
    "CircularMotion",
    "LivePoses",
    "NamedSource",
    "PoseRequest",
    "PoseSource",
    "Poses",
    "PosesByTime",
    "RecordedPoses",
    "SourceKeys",
    "Tracks",
    "circular_motion",
    "generated_timestamps",
    "load_poses",
    "read_source",
    "times_s",
    "waypoint_tracks",
]
