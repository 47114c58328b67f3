"""Interface of trackers that work in the world: one is given all cameras, AIS and navigation step by step. Times are
since the scene's first step, and places along w1, w2 and w3."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.io.validation import Strict
from modsim3d.runs.locating import Locations
from modsim3d.tracking.trackers.interface import SensedFrame


@dataclass(frozen=True, eq=False)
class WorldFacts:
    """Facts that a tracker knows before the first step."""

    cameras: tuple[Camera, ...]  # with their intrinsics, mounts and rates, in the order of the scene
    labels: tuple[str, ...]  # names of the classes
    own_ships: tuple[str, ...]  # names of the vessels that carry cameras
    sea: str = "flat"  # or `curved`
    origin: tuple[float, float] | None = None  # latitude and longitude in degrees of w1 = w2 = 0, if there is one


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """One frame of a camera, with m detections."""

    camera: str  # name
    sensed: SensedFrame
    located: Locations  # m rows: each detection in the world by what is known, without the detector's mean errors
    position_m: Array  # of the camera's centre, (3,)
    camera_R_world: Array  # from the world to the camera, by the measured attitude, (3, 3)


@dataclass(frozen=True, eq=False)
class AisReport:
    """A report of another vessel's AIS. One of a position has no sides, and one of a name and a size no position."""

    received_s: float  # when it arrived
    mmsi: int
    nmea: str  # its sentences, for decoders
    measured_s: float | None = None  # when the position was measured
    position_m: Array | None = None  # of the antenna, (2,)
    velocity_m_s: Array | None = None  # over ground, (2,); None where it is not available
    heading_rad: float | None = None  # counter-clockwise from w1; None where it is not available
    sides_m: tuple[int, int, int, int] | None = None  # from the antenna to bow, stern, port and starboard


@dataclass(frozen=True, eq=False)
class Navigation:
    """Readings of the instruments of a vessel that carries cameras, as in `OwnShips`."""

    vessel: str  # name
    position_m: Array  # of the centre of its bottom plane, heave included, without error, (3,)
    attitude_rad: Array  # measured roll, pitch and heading, with the yaw in waves, (3,)
    rates_rad_s: Array  # measured, (3,)
    forces_m_s2: Array  # measured, (3,)


@dataclass(frozen=True, eq=False)
class WorldStep:
    """All that arrives at one step."""

    step: int
    time_s: float
    frames: tuple[WorldFrame, ...]  # of the cameras that took one, in the order of the scene
    ais: tuple[AisReport, ...]  # that have arrived since the step before, in the order in which they did
    navigation: tuple[Navigation, ...]  # of each own ship, in the order of the scene


@dataclass(frozen=True, eq=False)
class WorldTrackedStep:
    """Tracks that a tracker reports at one step: k rows in any order; k may be 0."""

    track: Indices  # a number for each track, the same at all steps, (k,)
    position_m: Array  # of the vessel's centre, (k, 2)
    velocity_m_s: Array | None = None  # over ground, (k, 2); None if the tracker has none
    covariance: Array | None = None  # of position and velocity, (k, 4, 4), or of the position, (k, 2, 2); NaN: none

    @classmethod
    def empty(cls) -> Self:
        """No track."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 2)))


class WorldTracker(Strict):
    """A tracker in the world; its fields are its settings, with their defaults. A plug-in names a subclass of it, or of
    `Tracker`, under the entry point group `modsim3d.trackers`."""

    def follow_world(self, steps: Iterable[WorldStep], facts: WorldFacts) -> Iterator[WorldTrackedStep]:
        """Track the vessels around: for each step, in order of time, one answer before the next is read."""
        raise NotImplementedError
