"""Vessels that float on a sea: each responds to the waves at its place."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.random_streams import Purpose, Streams

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, eq=False)
class Passage:
    """One vessel on calm water at n moments, each complete in itself."""

    times_s: Array  # since the scene's first step: (n,)
    steps: Indices  # index of each step: (n,)
    positions_m: Array  # origins of the vessel in WCF: (n, 3)
    headings_rad: Array  # counter-clockwise from w1: (n,)
    velocities_m_s: Array  # over ground in WCF: (n, 3)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a vessel in waves at n moments."""

    heave_m: Array  # displacement of its origin along w3: (n,)
    # Roll, pitch and yaw as in `camera_poses.vehicle_R_nominal`: (n, 3); positive roll lowers the port side, positive
    # pitch the bow, positive yaw turns to port.
    angles_rad: Array


class WaveMotion(Protocol):
    """A model of waves. The motion at a moment depends on that moment alone, not on earlier or other calls."""

    needs_velocity: bool  # whether it uses velocities, which need the next pose of the vessel

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel, by its ID, at its times and places; they are the same for all cameras."""


PEAKEDNESS = 3.3  # the mean of the JONSWAP campaign
OCTAVES_BELOW, OCTAVES_ABOVE = 1, 3  # around the peak; 0.03 % of the energy lies above this range, and none below
COMPONENTS_PER_OCTAVE = 40
NODES = np.array([0.18343464249564984, 0.525532409916329, 0.7966664774136267, 0.9602898564975363])
WEIGHTS = np.array([0.36268378337836205, 0.3137066458778876, 0.22238103445337473, 0.10122853629037562])
"""Gauss-Legendre quadrature over a band, the upper four of eight nodes in [−1, 1] (Abramowitz & Stegun, Table 25.4)."""
STEEPEST = 1 / 15  # greatest known significant steepness of seas, 2π H / (g T²) (DNV-RP-C205, §3.5, for T <= 8 s)


def jonswap_shape(frequencies_rad_s: Array, peak_rad_s: float, peakedness: float = PEAKEDNESS) -> Array:
    """The JONSWAP spectrum without its scale: ω⁻⁵ exp(−5/4 (ω_p / ω)⁴) γ^exp(−½ ((ω − ω_p) / (σ ω_p))²), for ω > 0 of
    any shape, which the result has too. The peakedness is γ; σ is 0.07 up to the peak and 0.09 above it."""
    ratio = frequencies_rad_s / peak_rad_s
    width = np.where(ratio <= 1, 0.07, 0.09)
    raised: Array = peakedness ** np.exp(-0.5 * ((ratio - 1) / width) ** 2)
    return ratio**-5 * np.exp(-1.25 * ratio**-4) * raised


@dataclass(frozen=True, eq=False)
class Sea:
    """Harmonic waves ζ_j = a_j cos(k_j · x − ω_j t + ε_j) that all travel in one direction."""

    frequencies_rad_s: Array  # ω: (N,)
    amplitudes_m: Array  # a: (N,)
    phases_rad: Array  # ε: (N,)
    direction_rad: float  # to which the waves travel, counter-clockwise from w1

    @property
    def wave_numbers_rad_m(self) -> Array:
        """k = ω² / g, shape (N,)."""
        return self.frequencies_rad_s**2 / GRAVITY_M_S2

    def phases_at(self, times_s: Array, positions_m: Array) -> Array:
        """Phase of each wave, k · x − ω t + ε, in radians: (n, N), at times (n,) and places in WCF (n, 2 or 3)."""
        way = positions_m[:, 0] * math.cos(self.direction_rad) + positions_m[:, 1] * math.sin(self.direction_rad)
        return self.wave_numbers_rad_m * way[:, None] - self.frequencies_rad_s * times_s[:, None] + self.phases_rad

    def elevation_m(self, times_s: Array, positions_m: Array) -> Array:
        """Height of the water in metres, shape (n,); for the arguments see `phases_at`."""
        elevation: Array = (self.amplitudes_m * np.cos(self.phases_at(times_s, positions_m))).sum(axis=-1)
        return elevation


def jonswap_sea(
    significant_height_m: float, peak_period_s: float, direction_rad: float, seed: int, peakedness: float = PEAKEDNESS
) -> Sea:
    """A sea whose elevation has a variance of (H / 4)². Each wave has the energy of a band of frequencies. Its
    frequency is random within the band, so that the sea never repeats itself, and its phase is random. The significant
    height is H, four standard deviations of the elevation, the peakedness γ; the waves travel to a direction
    counter-clockwise from w1."""
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


Complex = NDArray[np.complex128]

BEAM_PER_DRAUGHT = 3.0  # our choice; merchant ships have 2.3 to 3.8, small craft up to 5
BEAM_PER_METACENTRIC_HEIGHT = 10.0  # our choice; roll periods of 4 to 6 s for boats and 10 to 15 s for large ships
ROLL_DAMPING = 0.1  # of critical damping; our choice between a bare hull (0.05) and bilge keels under way (0.2)
LONG_WAVE = 0.02  # phase over half a side, in radians, below which two terms of a series are exact to nine digits
MAX_LENGTH_M = 400.0  # greatest length in the roll period, whose fit has no longer ships


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
        radius = 0.373 + 0.023 * BEAM_PER_DRAUGHT - 0.043 * min(self.length_m, MAX_LENGTH_M) / 100
        return 2 * radius * self.beam_m / math.sqrt(self.beam_m / BEAM_PER_METACENTRIC_HEIGHT)


@dataclass(frozen=True, eq=False)
class Response:
    """Complex responses to waves of unit amplitude, (n, N) each; motion is Re[response × e^(i (k · x − ω t + ε))]."""

    heave: Complex  # metres
    roll: Complex  # radians, port side down
    pitch: Complex  # radians, bow down


def response(hull: Hull, frequencies_rad_s: Array, encounter_rad_s: Array, relative_rad: Array) -> Response:
    """Responses of a hull to N waves of frequencies ω (N,), met at frequencies of encounter ω_e (n, N), negative for
    waves that the hull overtakes. `relative_rad` is the direction of the waves less the heading (n,): 0 for following
    seas, π for head seas, π/2 for waves that travel to port. In head and following seas heave and pitch are those of
    the paper. In beam seas, the paper's waves keep their pressure at depth and are not averaged over the beam, so that
    ripples would heave the hull by half their height. Here the pressure falls with the whole wave number, e^(−kT), and
    the wave is averaged over beam and length."""
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
    straight line with the zero at the middle, 6 (sin x − x cos x) / (x² side), which is k for long waves."""
    half = numbers_rad_m * side_m / 2
    long = np.abs(half) < LONG_WAVE  # the formulas would lose their digits
    x = np.where(long, 1.0, half)
    mean = np.sin(x) / x
    slope = (mean - np.cos(x)) / x
    square = half**2
    mean = np.where(long, 1 - square / 6, mean)
    slope = np.where(long, half / 3 * (1 - square / 10), slope)
    return mean, 6 / side_m * slope


class FloatingVessels:
    """Heave, roll and pitch of vessels on one common sea; no yaw."""

    needs_velocity = True

    def __init__(self, sea: Sea, hulls: Mapping[str, Hull]) -> None:
        """Take the sea, and the hull of each vessel by its ID."""
        self.sea = sea
        self._hulls = dict(hulls)

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel, by its ID. Each wave has its phase at the vessel's place, which gives the
        frequency of encounter ω_e = ω − k · v. The hull responds at the same ω_e, from the velocity at the moment. A
        vessel that turns or speeds up responds as if it had kept this course and speed for long."""
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
