"""An inertial measurement unit: its place on board and its errors."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.arrays import Array
from modsim3d.random_streams import Purpose, Streams, normals


@dataclass(frozen=True)
class Imu:
    """A strapdown unit with its axes along the vessel's, v1, v2, v3.

    Attributes:
        position_m: Place in VCF.
        rate_noise_rad_s: Standard deviation of the noise of each angular rate; samples are independent.
        rate_bias_rad_s: Standard deviation of the offset of each angular rate, drawn once a run for each vessel.
        acceleration_noise_m_s2: Standard deviation of the noise of each component of the specific force.
        acceleration_bias_m_s2: Standard deviation of the offset of each component of the specific force.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_noise_rad_s: float = 0.0
    rate_bias_rad_s: float = 0.0
    acceleration_noise_m_s2: float = 0.0
    acceleration_bias_m_s2: float = 0.0

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
