"""An inertial measurement unit: where it is on board, and what it adds to what it measures."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.arrays import Array
from modsim3d.random_streams import Purpose, Streams, normals


@dataclass(frozen=True)
class Imu:
    """A strapdown unit with its axes along the vessel's, v1, v2, v3.

    Attributes:
        position_m: Where it is, in VCF.
        rate_noise_rad_s: Standard deviation of each sample of an angular rate; samples are independent.
        rate_bias_rad_s: Standard deviation of the offset of each axis, drawn once a run for each vessel.
        acceleration_noise_m_s2: As `rate_noise_rad_s`, of the specific force.
        acceleration_bias_m_s2: As `rate_bias_rad_s`, of the specific force.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_noise_rad_s: float = 0.0
    rate_bias_rad_s: float = 0.0
    acceleration_noise_m_s2: float = 0.0
    acceleration_bias_m_s2: float = 0.0

    def errors(self, streams: Streams, vessel: str, first: int, count: int) -> tuple[Array, Array]:
        """What the unit of a vessel adds to consecutive samples.

        Args:
            streams: Of the scene's seed.
            vessel: ID.
            first: First step.
            count: Number of steps n.

        Returns:
            Errors of the angular rates and of the specific force, each of shape (n, 3).
        """
        sample = normals(streams.uniforms(Purpose.IMU_NOISE, vessel, first=first, count=count, width=6))
        offset = normals(streams.uniforms(Purpose.IMU_BIAS, vessel, first=0, count=1, width=6))
        rates = self.rate_noise_rad_s * sample[:, :3] + self.rate_bias_rad_s * offset[:, :3]
        forces = self.acceleration_noise_m_s2 * sample[:, 3:] + self.acceleration_bias_m_s2 * offset[:, 3:]
        return rates, forces


PERFECT_IMU = Imu()
"""At the vessel's origin, without any error."""
