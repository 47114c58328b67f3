"""Names of the package: type checkers read this file, and `LazyNames` imports each name when it is first used."""

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
