"""What a vessel's satellite receiver and compass measure, once a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from modsim3d.ais.geography import places
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


def measured(
    stay: Stay, vessel: str, streams: Streams, origin: tuple[float, float], position_noise_m: float
) -> Measured:
    """What the sensors of a vessel measure during a stay.

    Args:
        stay: Where the vessel is.
        vessel: Its ID, which keys the noise.
        streams: Random numbers of the run.
        origin: Latitude and longitude of w1 = w2 = 0.
        position_noise_m: Standard deviation of a position along each axis.
    """
    count = int(stay.times_s[-1]) + 1
    noise = grid_normals(streams.uniforms(Purpose.AIS_SENSORS, vessel, first=0, count=count))
    offset = grid_normals(streams.uniforms(Purpose.AIS_COMPASS, vessel, first=0, count=1))[0, 0]
    wander = position_noise_m * _lasting(noise[:, :2])[stay.times_s]
    noise = noise[stay.times_s]
    latitude, longitude = places(stay.antenna_m + wander, origin)
    velocity = stay.velocity_m_s + VELOCITY_NOISE_M_S * noise[:, 2:4]
    # True north differs from w2 by the convergence of the meridians.
    north = np.asarray((longitude - origin[1] + 180) % 360 - 180) * np.sin(np.deg2rad(latitude))
    heading = 90 - np.rad2deg(stay.heading_rad) + north
    return Measured(
        times_s=stay.times_s,
        latitude_deg=latitude,
        longitude_deg=longitude,
        speed_kn=np.linalg.norm(velocity, axis=1) / KNOT_M_S,
        course_deg=np.rad2deg(np.arctan2(velocity[:, 0], velocity[:, 1])) + north,
        heading_deg=heading + COMPASS_OFFSET_DEG * offset + COMPASS_NOISE_DEG * noise[:, 4],
        turn_deg_min=-60 * np.rad2deg(stay.turn_rad_s),
    )


def _lasting(noise: Array) -> Array:
    """A first-order process with the variance of white noise, shape (n, k), that it is made of."""
    driven = np.sqrt(1 - POSITION_KEPT**2) * noise
    driven[0] = noise[0]
    return np.asarray(signal.lfilter([1.0], [1.0, -POSITION_KEPT], driven, axis=0))
