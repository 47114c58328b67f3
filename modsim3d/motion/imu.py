"""An inertial measurement unit: its place on board and its errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.random_streams import Purpose, Streams, grid_normals, normals


@dataclass(frozen=True)
class Imu:
    """A strapdown unit with its axes along the vessel's, v1, v2, v3.

    Attributes:
        position_m: Place in VCF.
        rate_noise_rad_s: Standard deviation of the noise of each angular rate; samples are independent.
        rate_bias_rad_s: Standard deviation of the offset of each angular rate, drawn once a run for each vessel.
        acceleration_noise_m_s2: Standard deviation of the noise of each component of the specific force.
        acceleration_bias_m_s2: Standard deviation of the offset of each component of the specific force.
        attitude_noise_rad: Standard deviation of the noise of measured roll and pitch.
        attitude_bias_rad: Standard deviation of the offset of measured roll and pitch.
        heading_noise_rad: Standard deviation of the noise of the measured heading.
        heading_bias_rad: Standard deviation of the offset of the measured heading.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_noise_rad_s: float = 0.0
    rate_bias_rad_s: float = 0.0
    acceleration_noise_m_s2: float = 0.0
    acceleration_bias_m_s2: float = 0.0
    attitude_noise_rad: float = 0.0
    attitude_bias_rad: float = 0.0
    heading_noise_rad: float = 0.0
    heading_bias_rad: float = 0.0

    @property
    def attitude_std_rad(self) -> Array:
        """Standard deviations of the errors of measured roll, pitch and heading over all runs, shape (3,)."""
        return np.hypot(self._attitude_noises_rad, self._attitude_biases_rad)

    @property
    def _attitude_noises_rad(self) -> Array:
        return np.array([self.attitude_noise_rad, self.attitude_noise_rad, self.heading_noise_rad])

    @property
    def _attitude_biases_rad(self) -> Array:
        return np.array([self.attitude_bias_rad, self.attitude_bias_rad, self.heading_bias_rad])

    def attitude_errors(self, streams: Streams, vessel: str, first: int, count: int) -> Array:
        """Errors of measured roll, pitch and heading of a vessel in rad, n = `count` steps from `first` on, (n, 3)."""
        noises, biases = self._attitude_noises_rad, self._attitude_biases_rad
        if not (noises.any() or biases.any()):
            return np.zeros((count, 3))
        sample = grid_normals(streams.uniforms(Purpose.ATTITUDE_NOISE, vessel, first=first, count=count))
        offset = grid_normals(streams.uniforms(Purpose.ATTITUDE_BIAS, vessel, first=0, count=1))
        return noises * sample + biases * offset

    def errors(self, streams: Streams, vessel: str, first: int, count: int) -> tuple[Array, Array]:
        """Errors of the unit of a vessel at the n = `count` steps from `first` on.

        Returns:
            Errors of the angular rates in rad/s and of the specific force in m/s², each of shape (n, 3).
        """
        sample = normals(streams.uniforms(Purpose.IMU_NOISE, vessel, first=first, count=count))
        offset = normals(streams.uniforms(Purpose.IMU_BIAS, vessel, first=0, count=1))
        rates = self.rate_noise_rad_s * sample[:, :3] + self.rate_bias_rad_s * offset[:, :3]
        forces = self.acceleration_noise_m_s2 * sample[:, 3:] + self.acceleration_bias_m_s2 * offset[:, 3:]
        return rates, forces


PERFECT_IMU = Imu()
"""At the vessel's origin, without any error."""
