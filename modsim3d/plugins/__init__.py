"""Names for writers of plug-ins; docs/plugins.md has examples."""

from typing import TYPE_CHECKING

from modsim3d.core.lazy_names import LazyNames

if TYPE_CHECKING:
    from modsim3d.core.boxes import iou as iou
    from modsim3d.core.random_streams import Purpose as Purpose
    from modsim3d.core.random_streams import Streams as Streams
    from modsim3d.io.validation import Strict as Strict
    from modsim3d.tracking.trackers.interface import CameraFacts as CameraFacts
    from modsim3d.tracking.trackers.interface import SensedFrame as SensedFrame
    from modsim3d.tracking.trackers.interface import TrackedFrame as TrackedFrame
    from modsim3d.tracking.trackers.interface import Tracker as Tracker
    from modsim3d.tracking.trackers.world_interface import AisReport as AisReport
    from modsim3d.tracking.trackers.world_interface import Navigation as Navigation
    from modsim3d.tracking.trackers.world_interface import WorldFacts as WorldFacts
    from modsim3d.tracking.trackers.world_interface import WorldFrame as WorldFrame
    from modsim3d.tracking.trackers.world_interface import WorldStep as WorldStep
    from modsim3d.tracking.trackers.world_interface import WorldTrackedStep as WorldTrackedStep
    from modsim3d.tracking.trackers.world_interface import WorldTracker as WorldTracker
    from modsim3d.world.poses.base import PoseRequest as PoseRequest
    from modsim3d.world.poses.base import Poses as Poses
    from modsim3d.world.poses.base import PosesByTime as PosesByTime
    from modsim3d.world.poses.base import PoseSource as PoseSource
    from modsim3d.world.poses.base import SourceKeys as SourceKeys
    from modsim3d.world.poses.replay import LivePoses as LivePoses
    from modsim3d.world.poses.replay import load_poses as load_poses
    from modsim3d.world.second_order_waves import Axis as Axis

_NAMES = LazyNames(
    __name__,
    {
        "modsim3d.core.boxes": "iou",
        "modsim3d.core.random_streams": "Purpose Streams",
        "modsim3d.io.validation": "Strict",
        "modsim3d.tracking.trackers.interface": "CameraFacts SensedFrame TrackedFrame Tracker",
        "modsim3d.tracking.trackers.world_interface": (
            "AisReport Navigation WorldFacts WorldFrame WorldStep WorldTrackedStep WorldTracker"
        ),
        "modsim3d.world.poses.base": "PoseRequest PoseSource Poses PosesByTime SourceKeys",
        "modsim3d.world.poses.replay": "LivePoses load_poses",
        "modsim3d.world.second_order_waves": "Axis",
    },
)
__all__ = _NAMES.names
if not TYPE_CHECKING:
    __getattr__, __dir__ = _NAMES.__getitem__, _NAMES.listed
