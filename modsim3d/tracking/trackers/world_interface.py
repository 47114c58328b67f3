"""Interface of trackers that work in the world: one is given all cameras, AIS and navigation step by step."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.io.validation import Strict
from modsim3d.runs.locating import Located
from modsim3d.tracking.trackers.interface import SensedFrame


@dataclass(frozen=True, eq=False)
class WorldFacts:
    """Facts that a tracker knows before the first step.

    Attributes:
        cameras: Cameras with their intrinsics, mounts and rates, in the order of the scene.
        labels: Names of the classes.
        own_ships: Names of the vessels that carry cameras.
        sea: `flat` or `curved`.
        origin: Latitude and longitude in degrees of w1 = w2 = 0; None where the scene has none.
    """

    cameras: tuple[Camera, ...]
    labels: tuple[str, ...]
    own_ships: tuple[str, ...]
    sea: str = "flat"
    origin: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """One frame of a camera.

    Attributes:
        camera: Name of the camera.
        sensed: Its m detections.
        located: Bearing, inverse range and position of each detection with their covariances, as a tracker can know
            them: by the measured attitude, and by the detector's mean errors, which are taken out. m rows.
        position_m: Centre of the camera along w1, w2 and w3, as known, shape (3,).
        camera_R_world: Rotation from the world to the camera, as known, shape (3, 3).
    """

    camera: str
    sensed: SensedFrame
    located: Located
    position_m: Array
    camera_R_world: Array


@dataclass(frozen=True, eq=False)
class AisReport:
    """A report of another vessel's AIS. One of a position has no sides, and one of a name and a size no position.

    Attributes:
        received_s: Time since the scene's first step at which it arrived.
        mmsi: Number of the station.
        nmea: The sentences, for decoders.
        measured_s: Time at which the position was measured, before it arrived.
        position_m: Place of the antenna along w1 and w2, shape (2,).
        velocity_m_s: Velocity over ground along w1 and w2, shape (2,); None where it is not available.
        heading_rad: Heading, counter-clockwise from w1; None where it is not available.
        sides_m: Distances from the antenna to bow, stern, port and starboard.
    """

    received_s: float
    mmsi: int
    nmea: str
    measured_s: float | None = None
    position_m: Array | None = None
    velocity_m_s: Array | None = None
    heading_rad: float | None = None
    sides_m: tuple[int, int, int, int] | None = None


@dataclass(frozen=True, eq=False)
class Navigation:
    """Readings of the instruments on board of a vessel that carries cameras.

    Attributes:
        vessel: Its name.
        position_m: Centre of its bottom plane along w1, w2 and w3, heave included, without error, shape (3,).
        attitude_rad: Roll, pitch and heading as measured, with the yaw in waves, shape (3,).
        rates_rad_s: Angular velocity as measured, shape (3,).
        forces_m_s2: Specific force as measured, shape (3,).
    """

    vessel: str
    position_m: Array
    attitude_rad: Array
    rates_rad_s: Array
    forces_m_s2: Array


@dataclass(frozen=True, eq=False)
class WorldStep:
    """All that arrives at one step.

    Attributes:
        step: Number of the scene's time step.
        time_s: Time since the scene's first step.
        frames: Frames of the cameras that took one, in the order of the scene; maybe none.
        ais: Reports that have arrived since the step before, in the order in which they did.
        navigation: Readings of each own ship, in the order of the scene.
    """

    step: int
    time_s: float
    frames: tuple[WorldFrame, ...]
    ais: tuple[AisReport, ...]
    navigation: tuple[Navigation, ...]


@dataclass(frozen=True, eq=False)
class WorldTrackedStep:
    """Tracks that a tracker reports at one step: k rows in any order; k may be 0.

    Attributes:
        track: A number for each track, the same at all steps, shape (k,).
        position_m: Centre of the vessel along w1 and w2, shape (k, 2).
        velocity_m_s: Over ground along w1 and w2, shape (k, 2); None if the tracker has none.
        covariance: Of position and velocity, shape (k, 4, 4), or of the position, (k, 2, 2); NaN for a track without;
            None if it has none.
    """

    track: Indices
    position_m: Array
    velocity_m_s: Array | None = None
    covariance: Array | None = None

    @classmethod
    def empty(cls) -> Self:
        """No track."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 2)))


class WorldTracker(Strict):
    """A tracker in the world; its fields are its settings, with their defaults.

    A plug-in names a subclass of it, or of `Tracker`, under the entry point group `modsim3d.trackers`.
    """

    def follow_world(self, steps: Iterable[WorldStep], facts: WorldFacts) -> Iterator[WorldTrackedStep]:
        """Track the vessels around: for each step, in order of time, one answer before the next is read."""
        raise NotImplementedError
