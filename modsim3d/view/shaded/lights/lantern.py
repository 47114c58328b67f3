"""A light of a vessel: its colour, the sector in which it shines, its range and its place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

NAUTICAL_MILE_M = 1852.0
THRESHOLD_LUX = 2e-7
"""The faintest light that an eye sees at sea by night (COLREG, Annex I, section 8)."""
CLEAR_AIR = 0.8
"""Share of the light that a nautical mile of clear air leaves, the same section's K."""
CLEAR_EXTINCTION_PER_M = -math.log(CLEAR_AIR) / NAUTICAL_MILE_M
AHEAD_DEG = 1.0
"""Sidelights shine this far across the bow (Annex I, section 9: between 1° and 3°)."""


class Colour(Enum):
    """Colours of lights, sRGB from 0 to 1."""

    WHITE = (1.0, 0.96, 0.85)
    RED = (1.0, 0.12, 0.08)
    GREEN = (0.1, 1.0, 0.45)


class Sector(Enum):
    """From which bearing to which a light is seen, in degrees from right ahead, to port positive (Rule 21)."""

    MASTHEAD = (-112.5, 112.5)
    PORT = (-AHEAD_DEG, 112.5)
    STARBOARD = (-112.5, AHEAD_DEG)
    STERN = (112.5, 247.5)
    ALL_ROUND = (-180.0, 180.0)

    def holds(self, bearing_deg: float) -> bool:
        """Whether a light is seen at a bearing from the bow, to port positive, in degrees."""
        first, last = self.value
        return (bearing_deg - first) % 360.0 <= last - first


@dataclass(frozen=True)
class Lantern:
    """A light of a vessel.

    Attributes:
        name: What the rules call it.
        colour: Its colour.
        sector: Where it is seen.
        range_nm: From how far it is seen in clear air, in nautical miles (Rule 22).
        place: Its place in units of the vessel's length, beam and air draft, as a vertex of a solid.
    """

    name: str
    colour: Colour
    sector: Sector
    range_nm: float
    place: tuple[float, float, float]

    @property
    def intensity_cd(self) -> float:
        """Luminous intensity in candela, I = 3.43 · 10⁶ T D² K^−D (COLREG, Annex I, section 8)."""
        return THRESHOLD_LUX * (NAUTICAL_MILE_M * self.range_nm) ** 2 * math.pow(CLEAR_AIR, -self.range_nm)

    def illuminance_lux(self, distance_m: float, extinction_per_m: float = CLEAR_EXTINCTION_PER_M) -> float:
        """Light that arrives at a distance in metres through air that takes a share of it in each metre."""
        return self.intensity_cd / distance_m**2 * math.exp(-extinction_per_m * distance_m)
