"""Response of a hull to harmonic waves: heave, roll and pitch from its length and beam alone.

Heave and pitch are those of a floating box in closed form: Jensen, Mansour & Olsen (2004), "Estimation of ship motions
using closed-form expressions", Ocean Engineering 31, 61–85. Roll is an oscillator driven by the slope of the wave
across the hull; its period is that of the weather criterion, IMO (2008), International Code on Intact Stability, part
A, §2.3.4. A scene has neither draught nor stability; both follow from the beam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array
from modsim3d.motion.waves.base import GRAVITY_M_S2

Complex = NDArray[np.complex128]

BEAM_PER_DRAUGHT = 3.0
"""Our choice; merchant ships have 2.3 to 3.8, small craft up to 5."""
BEAM_PER_METACENTRIC_HEIGHT = 10.0
"""Our choice; it gives roll periods of 4 to 6 s for boats and of 10 to 15 s for large ships."""
ROLL_DAMPING = 0.1
"""Share of critical damping; our choice between a bare hull (0.05) and one with bilge keels under way (0.2)."""
LONG_WAVE = 0.02
"""Phase over half a side, in radians, below which two terms of a series are exact to nine digits."""
LONGEST_M = 400.0
"""Greatest length in the roll period, whose fit has no longer ships."""


@dataclass(frozen=True)
class Hull:
    """The hull of a vessel at the waterline: its extents along v1 and v2."""

    length_m: float
    beam_m: float

    @property
    def draught_m(self) -> float:
        """Depth of the keel."""
        return self.beam_m / BEAM_PER_DRAUGHT

    @property
    def roll_period_s(self) -> float:
        """Natural period 2 C B / √GM with C = 0.373 + 0.023 B / d − 0.043 L / 100."""
        radius = 0.373 + 0.023 * BEAM_PER_DRAUGHT - 0.043 * min(self.length_m, LONGEST_M) / 100
        return 2 * radius * self.beam_m / math.sqrt(self.beam_m / BEAM_PER_METACENTRIC_HEIGHT)


@dataclass(frozen=True, eq=False)
class Response:
    """Complex responses to waves of unit amplitude; the motion is Re[response × e^(i (k · x − ω t + ε))].

    Attributes:
        heave: Metres, shape (n, N).
        roll: Radians, port side down, shape (n, N).
        pitch: Radians, bow down, shape (n, N).
    """

    heave: Complex
    roll: Complex
    pitch: Complex


def response(hull: Hull, frequencies_rad_s: Array, encounter_rad_s: Array, relative_rad: Array) -> Response:
    """Responses of a hull to waves.

    In head and following seas heave and pitch are those of the paper. In beam seas, the paper's waves keep their
    pressure at depth and are not averaged over the beam, so that ripples would heave the hull by half their height.
    Here the pressure falls with the whole wave number, e^(−kT), and the wave is averaged over beam and length.

    Args:
        hull: Length and beam.
        frequencies_rad_s: ω of N waves, shape (N,).
        encounter_rad_s: Frequencies of encounter ω_e, shape (n, N); negative for waves that the hull overtakes.
        relative_rad: Direction of the waves less the heading, shape (n,): 0 for following seas, π for head seas, π/2
            for waves that travel to port.
    """
    number = frequencies_rad_s**2 / GRAVITY_M_S2
    courses, which = np.unique(relative_rad, return_inverse=True)  # a vessel keeps its heading for long
    along, across = number * np.cos(courses)[:, None], number * np.sin(courses)[:, None]
    lengthwise, pitching = (factor[which] for factor in _over(hull.length_m, along))
    beamwise, rolling = (factor[which] for factor in _over(hull.beam_m, across))
    draught = number * hull.draught_m
    ratio = encounter_rad_s / frequencies_rad_s  # α
    band = number * hull.beam_m * ratio**2  # k B α²; with A = 2 sin(band / 2) e^(−k T α²) …
    radiated = (np.sinc(band / (2 * math.pi)) * np.exp(-draught * ratio**2)) ** 2
    damping = band * radiated  # … this is A² / (k B α²)
    spring = 1 - 2 * draught * ratio**2 - 1j * np.sign(ratio) * damping
    force = np.exp(-draught) * np.hypot(1 - draught, number * hull.beam_m * ratio * radiated) / spring
    own = 2 * math.pi / hull.roll_period_s
    oscillator = own**2 / (own**2 - encounter_rad_s**2 - 2j * ROLL_DAMPING * own * encounter_rad_s)
    return Response(
        heave=force * lengthwise * beamwise,
        roll=-1j * np.exp(-draught) * oscillator * rolling * lengthwise,
        pitch=-1j * force * pitching * beamwise,
    )


def _over(side_m: float, numbers_rad_m: Array) -> tuple[Array, Array]:
    """Mean and slope of a wave of unit amplitude over a side of the hull; `numbers_rad_m` are wave numbers along it.

    The mean with the crest at the middle is sin(x) / x with x = k · side / 2. The slope in rad/m is that of the best
    straight line with the zero at the middle, 6 (sin x − x cos x) / (x² side), which is k for long waves.
    """
    half = numbers_rad_m * side_m / 2
    long = np.abs(half) < LONG_WAVE  # the formulas would lose their digits
    x = np.where(long, 1.0, half)
    mean = np.sin(x) / x
    slope = (mean - np.cos(x)) / x
    square = half**2
    mean = np.where(long, 1 - square / 6, mean)
    slope = np.where(long, half / 3 * (1 - square / 10), slope)
    return mean, 6 / side_m * slope
