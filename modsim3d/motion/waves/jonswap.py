"""An irregular long-crested sea: harmonic waves with random phases that add up to a JONSWAP spectrum.

The spectrum is Hasselmann et al. (1973), "Measurements of wind-wave growth and swell decay during the Joint North Sea
Wave Project (JONSWAP)", in the form of DNV-RP-C205, §3.5.5, but normalised exactly: the recommended practice only
fits the factor that keeps the significant height. The water is deep: ω² = g k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.waves.base import GRAVITY_M_S2
from modsim3d.random_streams import Purpose, Streams

PEAKEDNESS = 3.3
"""The mean of the JONSWAP campaign."""
OCTAVES_BELOW, OCTAVES_ABOVE = 1, 3
"""Range of frequencies around the peak; 0.03 % of the energy lies above it, and none below."""
COMPONENTS_PER_OCTAVE = 40
NODES = np.array([0.18343464249564984, 0.525532409916329, 0.7966664774136267, 0.9602898564975363])
WEIGHTS = np.array([0.36268378337836205, 0.3137066458778876, 0.22238103445337473, 0.10122853629037562])
"""Gauss-Legendre quadrature over a band, the upper four of eight nodes in [−1, 1] (Abramowitz & Stegun, Table 25.4)."""
STEEPEST = 1 / 15
"""Greatest known significant steepness of seas, 2π H / (g T²) (DNV-RP-C205, §3.5, for T <= 8 s)."""


def jonswap_shape(frequencies_rad_s: Array, peak_rad_s: float, peakedness: float = PEAKEDNESS) -> Array:
    """The JONSWAP spectrum without its scale: ω⁻⁵ exp(−5/4 (ω_p / ω)⁴) γ^exp(−½ ((ω − ω_p) / (σ ω_p))²).

    Args:
        frequencies_rad_s: ω > 0, any shape, which the result has too.
        peak_rad_s: ω_p.
        peakedness: γ; σ is 0.07 up to the peak and 0.09 above it.
    """
    ratio = frequencies_rad_s / peak_rad_s
    width = np.where(ratio <= 1, 0.07, 0.09)
    raised: Array = peakedness ** np.exp(-0.5 * ((ratio - 1) / width) ** 2)
    return ratio**-5 * np.exp(-1.25 * ratio**-4) * raised


@dataclass(frozen=True, eq=False)
class Sea:
    """Harmonic waves ζ_j = a_j cos(k_j · x − ω_j t + ε_j) that all travel in one direction.

    Attributes:
        frequencies_rad_s: ω, shape (N,).
        amplitudes_m: a, shape (N,).
        phases_rad: ε, shape (N,).
        direction_rad: Direction to which the waves travel, counter-clockwise from w1.
    """

    frequencies_rad_s: Array
    amplitudes_m: Array
    phases_rad: Array
    direction_rad: float

    @property
    def wave_numbers_rad_m(self) -> Array:
        """k = ω² / g, shape (N,)."""
        return self.frequencies_rad_s**2 / GRAVITY_M_S2

    def phases_at(self, times_s: Array, positions_m: Array) -> Array:
        """Phase of each wave, k · x − ω t + ε, in radians, shape (n, N).

        Args:
            times_s: Times since the scene's first step, shape (n,).
            positions_m: Places in WCF, shape (n, 2 or 3).
        """
        way = positions_m[:, 0] * math.cos(self.direction_rad) + positions_m[:, 1] * math.sin(self.direction_rad)
        return self.wave_numbers_rad_m * way[:, None] - self.frequencies_rad_s * times_s[:, None] + self.phases_rad

    def elevation_m(self, times_s: Array, positions_m: Array) -> Array:
        """Height of the water in metres, shape (n,); for the arguments see `phases_at`."""
        elevation: Array = (self.amplitudes_m * np.cos(self.phases_at(times_s, positions_m))).sum(axis=-1)
        return elevation


def jonswap_sea(
    significant_height_m: float,
    peak_period_s: float,
    direction_rad: float,
    seed: int,
    peakedness: float = PEAKEDNESS,
) -> Sea:
    """A sea whose elevation has a variance of (H / 4)².

    Each wave has the energy of a band of frequencies. Its frequency is random within the band, so that the sea never
    repeats itself, and its phase is random.

    Args:
        significant_height_m: H, four standard deviations of the elevation.
        peak_period_s: Period of the spectrum's peak.
        direction_rad: Direction to which the waves travel, counter-clockwise from w1.
        seed: Seed of frequencies and phases.
        peakedness: γ.
    """
    peak = 2 * math.pi / peak_period_s
    bands = (OCTAVES_BELOW + OCTAVES_ABOVE) * COMPONENTS_PER_OCTAVE
    edges = peak * 2.0 ** np.linspace(-OCTAVES_BELOW, OCTAVES_ABOVE, bands + 1)  # one is the peak, where σ jumps
    nodes, weights = np.concatenate([-NODES[::-1], NODES]), np.concatenate([WEIGHTS[::-1], WEIGHTS])
    widths, centres = np.diff(edges), (edges[1:] + edges[:-1]) / 2
    within = centres[:, None] + widths[:, None] / 2 * nodes
    energy = (jonswap_shape(within, peak, peakedness) * weights).sum(axis=1) * widths
    energy *= (significant_height_m / 4) ** 2 / energy.sum()
    draws = Streams(seed).uniforms(Purpose.SEA, first=0, count=bands)
    return Sea(
        frequencies_rad_s=edges[:-1] + widths * draws[:, 0],
        amplitudes_m=np.sqrt(2 * energy),
        phases_rad=2 * math.pi * draws[:, 1],
        direction_rad=direction_rad,
    )
