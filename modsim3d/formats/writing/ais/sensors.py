"""What a vessel's satellite receiver and compass measure, once a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from modsim3d.ais.geography import places, wrapped_deg
from modsim3d.arrays import Array, Indices
from modsim3d.formats.writing.ais.stays import Stay
from modsim3d.random_streams import Purpose, Streams, grid_normals

KNOT_M_S = 1852 / 3600
POSITION_KEPT = 0.99
"""Share of a position's error that is left after a second: errors of satellite receivers last for minutes, so the mean
of many reports is not much better than one."""
VELOCITY_NOISE_M_S = 0.05
"""Along each axis; 0.1 knots."""
COMPASS_OFFSET_DEG, COMPASS_NOISE_DEG = 0.5, 0.5
"""Standard deviations. Heading devices may be off by 1° at rest and 1.5° on the move (IMO resolution MSC.116(73))."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements at n whole seconds, shape (n,) each.

    Attributes:
        times_s: Seconds since the first step.
        latitude_deg: Latitude of the antenna, and with `longitude_deg` its place.
        speed_kn: Speed over ground; NaN if it is not known.
        course_deg: Course over ground, clockwise from true north; NaN if it is not known.
        heading_deg: Of the bow, clockwise from true north and not wrapped.
        turn_deg_min: Rate of turn, positive to starboard.
    """

    times_s: Indices
    latitude_deg: Array
    longitude_deg: Array
    speed_kn: Array
    course_deg: Array
    heading_deg: Array
    turn_deg_min: Array


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard normal errors of a vessel's sensors at each second of a run, from the first step on.

    Attributes:
        position: Along w1 and w2; what is left of them lasts. Shape (n, 2).
        velocity: The same of the velocity, shape (n, 2).
        heading: Of the compass from second to second, shape (n,).
        heading_offset: Of the compass all the time.
    """

    position: Array
    velocity: Array
    heading: Array
    heading_offset: float

    @classmethod
    def of(cls, vessel: str, streams: Streams, seconds: int) -> Noise:
        """The errors of a vessel by its ID, for a number of seconds."""
        drawn = grid_normals(streams.uniforms(Purpose.AIS_SENSORS, vessel, first=0, count=seconds))
        offset = grid_normals(streams.uniforms(Purpose.AIS_COMPASS, vessel, first=0, count=1))
        return cls(_lasting(drawn[:, :2]), drawn[:, 2:4], drawn[:, 4], float(offset[0, 0]))


def measured(stay: Stay, noise: Noise, origin: tuple[float, float], position_noise_m: float) -> Measured:
    """What the sensors of a vessel measure during a stay.

    Args:
        stay: Where the vessel is.
        noise: Errors of its sensors, to the end of the stay at least.
        origin: Latitude and longitude of w1 = w2 = 0.
        position_noise_m: Standard deviation of a position along each axis.
    """
    now = stay.times_s
    latitude, longitude = places(stay.antenna_m + position_noise_m * noise.position[now], origin)
    velocity = stay.velocity_m_s + VELOCITY_NOISE_M_S * noise.velocity[now]
    # True north differs from w2 by the convergence of the meridians.
    north = wrapped_deg(longitude - origin[1]) * np.sin(np.deg2rad(latitude))
    heading = 90 - np.rad2deg(stay.heading_rad) + north
    return Measured(
        times_s=now,
        latitude_deg=latitude,
        longitude_deg=longitude,
        speed_kn=np.linalg.norm(velocity, axis=1) / KNOT_M_S,
        course_deg=np.rad2deg(np.arctan2(velocity[:, 0], velocity[:, 1])) + north,
        heading_deg=heading + COMPASS_OFFSET_DEG * noise.heading_offset + COMPASS_NOISE_DEG * noise.heading[now],
        turn_deg_min=-60 * np.rad2deg(stay.turn_rad_s),
    )


def _lasting(noise: Array) -> Array:
    """A first-order process with the variance of white noise, shape (n, k), that it is made of."""
    driven = np.sqrt(1 - POSITION_KEPT**2) * noise
    driven[:1] = noise[:1]
    return np.asarray(signal.lfilter([1.0], [1.0, -POSITION_KEPT], driven, axis=0))
