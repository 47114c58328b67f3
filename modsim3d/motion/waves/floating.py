"""Vessels that float on a sea: each responds to the waves at its place."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.waves.base import Motion, Passage
from modsim3d.motion.waves.hull import Complex, Hull, response
from modsim3d.motion.waves.jonswap import Sea


class FloatingVessels:
    """Heave, roll and pitch of vessels on one common sea; no yaw."""

    needs_velocity = True

    def __init__(self, sea: Sea, hulls: Mapping[str, Hull]) -> None:
        """Take the sea, and the hull of each vessel by its ID."""
        self.sea = sea
        self._hulls = dict(hulls)

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel, by its ID.

        Each wave has its phase at the vessel's place, which gives the frequency of encounter ω_e = ω − k · v. The hull
        responds at the same ω_e, from the velocity at the moment. A vessel that turns or speeds up responds as if it
        had kept this course and speed for long.
        """
        sea = self.sea
        advance = passage.velocities_m_s[:, 0] * math.cos(sea.direction_rad)
        advance = advance + passage.velocities_m_s[:, 1] * math.sin(sea.direction_rad)
        encounter = sea.frequencies_rad_s - sea.wave_numbers_rad_m * advance[:, None]
        relative = sea.direction_rad - passage.headings_rad
        hull_response = response(self._hulls[vessel], sea.frequencies_rad_s, encounter, relative)
        phases = sea.phases_at(passage.times_s, passage.positions_m)
        waves = sea.amplitudes_m * (np.cos(phases) + 1j * np.sin(phases))
        roll, pitch = _real_sum(hull_response.roll, waves), _real_sum(hull_response.pitch, waves)
        return Motion(_real_sum(hull_response.heave, waves), np.stack([roll, pitch, np.zeros(len(roll))], axis=-1))


def _real_sum(responses: Complex, waves: Complex) -> Array:
    """Sum over waves, shape (n,); a matrix product would round differently for other numbers of moments."""
    total: Array = (responses.real * waves.real - responses.imag * waves.imag).sum(axis=-1)
    return total
