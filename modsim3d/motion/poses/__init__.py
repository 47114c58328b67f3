"""Pose sources: which vessels are present at each step, where they are, and their headings."""

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
