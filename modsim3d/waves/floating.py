"""Vessels that float on a sea: each answers the waves where it is."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from modsim3d.arrays import Array
from modsim3d.waves.base import Motion, Passage
from modsim3d.waves.hull import Complex, Hull, response
from modsim3d.waves.jonswap import Sea


class FloatingVessels:
    """Heave, roll and pitch of vessels on one sea that is the same for all of them; no yaw."""

    needs_velocity = True

    def __init__(self, sea: Sea, hulls: Mapping[str, Hull]) -> None:
        """Take the sea, and the hull of each vessel by its ID."""
        self.sea = sea
        self._hulls = dict(hulls)

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel.

        The phase of each wave is taken where the vessel is, so that it meets waves at the frequency of encounter
        ω_e = ω − k · v of itself; the same ω_e, from its velocity at the moment, says how the hull answers. A vessel
        that turns or speeds up is taken to have gone that way for long.
        """
        sea = self.sea
        advance = passage.velocities_m_s[:, 0] * math.cos(sea.direction_rad)
        advance = advance + passage.velocities_m_s[:, 1] * math.sin(sea.direction_rad)
        encounter = sea.frequencies_rad_s - sea.wave_numbers_rad_m * advance[:, None]
        relative = sea.direction_rad - passage.headings_rad
        answer = response(self._hulls[vessel], sea.frequencies_rad_s, encounter, relative)
        phases = sea.phases_at(passage.times_s, passage.positions_m)
        waves = sea.amplitudes_m * (np.cos(phases) + 1j * np.sin(phases))
        roll, pitch = _real_sum(answer.roll, waves), _real_sum(answer.pitch, waves)
        return Motion(_real_sum(answer.heave, waves), np.stack([roll, pitch, np.zeros(len(roll))], axis=-1))


def _real_sum(answer: Complex, waves: Complex) -> Array:
    """Sum over waves; not a matrix product, whose rounding depends on how many moments are asked for together."""
    total: Array = (answer.real * waves.real - answer.imag * waves.imag).sum(axis=-1)
    return total
