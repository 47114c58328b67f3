"""Noise that stays with a vessel for a while. Each kind runs over all steps of the scene from its first, whatever a
camera saw: a vessel that was hidden comes back with the noise that it would have had. Fresh numbers are those of a
detector without persistence, so a vanishing correlation time gives its output (confidence to its rounding)."""

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, occurring
from modsim3d.core.random_streams import GRID, Purpose, Streams, grid_normals, on_grid
from modsim3d.detector.draws import BOX_ERROR_STREAMS, ERROR_NORMALS, latent_normals, target_uniforms
from modsim3d.detector.records import CameraFrames, Targets

Clock = Callable[[int, int], Array]  # times of steps first to stop − 1 since the scene's first, in s, (stop − first,)
_UNIFORM_STEP = 2.0**-40
NEVER_CHANGES_S = 1e9  # a correlation time that no run is long enough to tell from an endless one
_DECAY_STEP = 2.0**-40  # finer than the grid of drawn numbers: a decay close to one must stay what it is
_DECAYS_KEPT = 4096  # steps take few different times
_MAX_STEPS, _VESSEL_STEPS = 512, 100_000  # worked out at a time: it bounds the memory


@dataclass(frozen=True)
class LatentScore:
    """A standard normal number of each vessel in each camera, behind its misses and its confidence. A vessel is missed
    where the number's probability is below the chance of a miss; above it the number says how sure the detector is. It
    is a sum: a part that the vessel keeps, autoregressive parts, and white noise."""

    vessel_share: float  # of the variance, which a vessel keeps
    shares: tuple[float, ...] = ()  # of the variance, of each autoregressive part
    times_s: tuple[float, ...] = ()  # correlation time of each

    @property
    def white_share(self) -> float:
        """Share of the variance that is new at every step."""
        return max(1.0 - self.vessel_share - sum(self.shares), 0.0)

    @property
    def memory_s(self) -> float:
        """Time in which it is forgotten; endless where vessels keep a share."""
        return NEVER_CHANGES_S if self.vessel_share else max(self.times_s, default=0.0)

    def correlation(self, apart_s: Array) -> Array:
        """Correlation of a vessel's numbers at times above 0 apart, same shape."""
        correlation = np.full(np.shape(apart_s), self.vessel_share)
        for share, time_s in zip(self.shares, self.times_s, strict=True):
            correlation = correlation + share * np.exp(-apart_s / time_s)
        return correlation


@dataclass(frozen=True, eq=False)
class BoxMemory:
    """Memory of the numbers behind box errors: of e_x, e_y, e_w, e_h, and of the scale of heavy tails. Each is a sum as
    of `LatentScore`; parts of the same time run side by side."""

    vessel_share: Array  # share of the variance that a vessel keeps, shape (5,)
    shares: Array  # share of the variance of each autoregressive part, shape (parts, 5)
    times_s: Array  # its correlation time, shape (parts,)

    @property
    def white_share(self) -> Array:
        """Share of the variance that is new at every step, shape (5,)."""
        return np.asarray(np.maximum(1.0 - self.vessel_share - self.shares.sum(axis=0), 0.0))

    @property
    def memory_s(self) -> float:
        """Time in which all is forgotten; endless where vessels keep a share."""
        return NEVER_CHANGES_S if self.vessel_share.any() else float(self.times_s.max(initial=0.0))

    def correlation(self, apart_s: Array) -> Array:
        """Correlation of a vessel's numbers at times above 0 apart, shape (..., 5)."""
        return self.vessel_share + np.exp(-np.asarray(apart_s)[..., None] / self.times_s) @ self.shares


@dataclass(frozen=True)
class Persistence:
    """Correlation times in seconds, 0 for independent draws, and shares in [0, 1) of the variance of latent numbers
    that each vessel keeps in each camera for a whole run. With a `score`, which is None if misses and confidence are
    drawn apart, `class_s` and `class_vessel_share` are those of the label alone."""

    class_s: float = 0.0  # misses and confusions
    box_s: float = 0.0  # box errors
    confidence_s: float = 0.0
    merge_s: float = 0.0  # whether two vessels that overlap come out as one box
    class_vessel_share: float = 0.0  # misses and confusions
    box_vessel_share: float = 0.0  # box errors
    score: LatentScore | None = None
    box: BoxMemory | None = None

    @property
    def class_memory_s(self) -> float:
        """Time in which misses and confusions are forgotten; endless where vessels keep a share."""
        if self.score is not None:
            return self.score.memory_s
        return NEVER_CHANGES_S if self.class_vessel_share else self.class_s

    @property
    def confidence_memory_s(self) -> float:
        """Time in which confidence is forgotten; endless where vessels keep a share."""
        return self.confidence_s if self.score is None else self.score.memory_s

    @property
    def box_memory_s(self) -> float:
        """Time in which box errors are forgotten; endless where vessels keep a share."""
        if self.box is not None:
            return self.box.memory_s
        return NEVER_CHANGES_S if self.box_vessel_share else self.box_s


def with_share(share: float, kept: Array, varying: Array) -> Array:
    """Standard normal numbers of which a share of the variance is kept, from such numbers of one shape."""
    return math.sqrt(share) * kept + math.sqrt(1 - share) * varying


class Process(Protocol):
    """A stationary process of each vessel, step by step."""

    @property
    def correlation_s(self) -> float:
        """Time in which the correlation falls to 1/e."""

    @property
    def width(self) -> int:
        """Numbers per vessel and step."""

    def fresh(self, streams: Streams, camera: str, vessel: str, first: int, count: int) -> Array:
        """Random numbers of one vessel that steps are made from, shape (count, at least width)."""

    def advance(self, values: Array, fresh: Array, decay: float) -> Array:
        """The next values from the last ones and fresh numbers; `decay` is e^(−Δt/τ). Shapes (vessels, ...)."""


@dataclass(frozen=True)
class KeptUniform:
    """Uniform numbers that are kept together with probability e^(−Δt/τ), and otherwise resampled. They are uniform at
    every step, so inverting any distribution at one gives that distribution exactly, whatever τ. Two of them Δt apart
    are the same number with probability e^(−Δt/τ), else independent."""

    correlation_s: float
    width: int = 1
    numbers: Purpose = Purpose.CLASS
    kept: Purpose = Purpose.CLASS_KEPT

    def fresh(self, streams: Streams, camera: str, vessel: str, first: int, count: int) -> Array:
        """New numbers, and one that decides whether they are taken, shape (count, width + 1)."""
        new = streams.uniforms(self.numbers, camera, vessel, first=first, count=count)
        return np.concatenate([new, streams.uniforms(self.kept, camera, vessel, first=first, count=count)], axis=1)

    def advance(self, values: Array, fresh: Array, decay: float) -> Array:
        """Keep the numbers or take the new ones, shape (vessels, width)."""
        return np.where(fresh[:, self.width :] < decay, values, fresh[:, : self.width])


@dataclass(frozen=True)
class Autoregressive:
    """Standard normal numbers with correlation e^(−Δt/τ): z ← ρ·z + √(1 − ρ²)·ε with ρ = e^(−Δt/τ), which is exact for
    steps of any length (an Ornstein–Uhlenbeck process, Gillespie (1996), "Exact numerical simulation of the
    Ornstein-Uhlenbeck process and its integral", eq. 1.9)."""

    correlation_s: float
    width: int = ERROR_NORMALS

    def fresh(self, streams: Streams, camera: str, vessel: str, first: int, count: int) -> Array:
        """Independent standard normal numbers, shape (count, width)."""
        purposes = BOX_ERROR_STREAMS.widths(self.width - ERROR_NORMALS)
        uniforms = [streams.uniforms(purpose, camera, vessel, first=first, count=count) for purpose in purposes]
        return grid_normals(np.concatenate(uniforms, axis=1))

    def advance(self, values: Array, fresh: Array, decay: float) -> Array:
        """Mix old and new numbers, shape (vessels, width)."""
        return decay * values + math.sqrt(1 - decay * decay) * fresh


@dataclass(frozen=True)
class AutoregressiveScore(Autoregressive):
    """The normal number behind the confidence of a vessel's detection: an autoregressive process of width 1."""

    width: int = 1

    def fresh(self, streams: Streams, camera: str, vessel: str, first: int, count: int) -> Array:
        """Independent standard normal numbers, shape (count, 1)."""
        return grid_normals(streams.uniforms(Purpose.CONFIDENCE, camera, vessel, first=first, count=count)[:, :1])


@dataclass(frozen=True)
class AutoregressivePart(Autoregressive):
    """An autoregressive part of the score of a vessel, of width 1, or of the numbers behind a box error, of width 5."""

    width: int = 1
    purpose: Purpose = Purpose.SCORE
    ordinal: int = 0

    def fresh(self, streams: Streams, camera: str, vessel: str, first: int, count: int) -> Array:
        """Independent standard normal numbers, shape (count, width)."""
        uniforms = streams.uniforms(self.purpose, camera, vessel, str(self.ordinal), first=first, count=count)
        return grid_normals(uniforms)


@functools.lru_cache(_DECAYS_KEPT)
def decay(seconds: float, correlation_s: float) -> float:
    """e^(−Δt/τ), one at a time: how a run is split must not show in how an array of exponentials is rounded."""
    return float(on_grid(np.array(math.exp(-seconds / correlation_s)), _DECAY_STEP))


class Walk:
    """The values of one process of all vessels of a camera, computed step by step from the first."""

    def __init__(self, process: Process, streams: Streams, clock: Clock, camera: str, vessels: tuple[str, ...]) -> None:
        """Begin before the first step."""
        self._process, self._streams, self._clock = process, streams, clock
        self._camera, self._vessels = camera, vessels
        self._next, self._stride = 0, max(1, min(_MAX_STEPS, _VESSEL_STEPS // max(len(vessels), 1)))
        self._values = np.empty((len(vessels), process.width))

    def at(self, steps: Indices, vessel: Indices) -> Array:
        """Values of a vessel each at a step each, shape (n, width)."""
        result = np.empty((len(steps), self._process.width))
        if not len(steps):
            return result
        if steps.min() < self._next:
            self._next = 0
        stop = int(steps.max()) + 1
        while self._next < stop:
            first = self._next
            values = self._piece(min(first + self._stride, stop))
            rows = np.flatnonzero((steps >= first) & (steps < self._next))
            result[rows] = values[steps[rows] - first, vessel[rows]]
        return result

    def _piece(self, stop: int) -> Array:
        """The values from the next step up to `stop`, shape (steps, vessels, width)."""
        first, process = self._next, self._process
        times = self._clock(max(first - 1, 0), stop).tolist()
        decays = [decay(b - a, process.correlation_s) for a, b in itertools.pairwise(times)]
        decays = decays if first else [0.0, *decays]  # nothing is kept from before the first step
        fresh = np.stack(
            [process.fresh(self._streams, self._camera, vessel, first, stop - first) for vessel in self._vessels],
            axis=1,
        )
        piece = np.empty((stop - first, *self._values.shape))
        values = np.zeros_like(self._values) if first == 0 else self._values
        for k, kept in enumerate(decays):
            piece[k] = values = process.advance(values, fresh[k], kept)
        self._values, self._next = values, stop
        return piece


class VesselNoise:
    """The noise of each target: drawn for each step, or kept for a while."""

    def __init__(self, persistence: Persistence, streams: Streams, clock: Clock) -> None:
        """Read the times of steps from a clock where noise persists."""
        self._persistence, self._streams, self._clock = persistence, streams, clock
        self._walks: dict[tuple[Process, str, tuple[str, ...]], Walk] = {}

    def uniforms(self, frames: CameraFrames, targets: Targets) -> Array:
        """Uniform numbers for class and dropout, shape (n,)."""
        persistence = self._persistence
        if persistence.class_s:
            uniforms = self._walked(KeptUniform(persistence.class_s), frames, targets)
        else:
            uniforms = target_uniforms(self._streams, Purpose.CLASS, frames, targets)
        share = persistence.class_vessel_share
        if not share:
            return uniforms[:, 0]
        kept = self._kept_by_vessels(Purpose.CLASS_VESSEL, frames, targets)
        mixed = on_grid(special.ndtr(with_share(share, kept, grid_normals(uniforms[:, :1]))))
        return np.minimum(mixed[:, 0], 1 - GRID)  # a number of one would miss what is never missed

    def normals(self, frames: CameraFrames, targets: Targets, extra: int = 0) -> Array:
        """Standard normal numbers that box errors are made from, shape (n, 4 + extra)."""
        persistence = self._persistence
        if persistence.box is not None:
            return self._remembered(persistence.box, frames, targets, extra)
        if persistence.box_s:
            normals = self._walked(Autoregressive(persistence.box_s, ERROR_NORMALS + extra), frames, targets)
        else:
            normals = latent_normals(self._streams, BOX_ERROR_STREAMS, frames, targets, extra)
        share = persistence.box_vessel_share
        if not share:
            return normals
        kept = self._kept_by_vessels(Purpose.BOX_ERROR_VESSEL, frames, targets)
        errors = with_share(share, kept, normals[:, :ERROR_NORMALS])
        return np.concatenate([errors, normals[:, ERROR_NORMALS:]], axis=1)

    def _remembered(self, memory: BoxMemory, frames: CameraFrames, targets: Targets, extra: int) -> Array:
        """Numbers each component of which has a memory of its own, shape (n, 4 + extra)."""
        width = ERROR_NORMALS + extra
        kept = self._kept_by_vessels(Purpose.BOX_ERROR_PART_VESSEL, frames, targets)[:, :width]
        total = np.sqrt(memory.vessel_share[:width]) * kept
        for ordinal, (shares, time_s) in enumerate(zip(memory.shares, memory.times_s.tolist(), strict=True)):
            part = AutoregressivePart(time_s, ERROR_NORMALS + 1, Purpose.BOX_ERROR_PART, ordinal)
            total = total + np.sqrt(shares[:width]) * self._walked(part, frames, targets)[:, :width]
        white = latent_normals(self._streams, BOX_ERROR_STREAMS, frames, targets, extra)
        return total + np.sqrt(memory.white_share[:width]) * white

    def _kept_by_vessels(self, purpose: Purpose, frames: CameraFrames, targets: Targets) -> Array:
        """Standard normal numbers that belong to the camera and the vessel of each target, shape (n, width)."""
        present, place = occurring(targets.vessel, len(targets.vessel_ids))
        names = [targets.vessel_ids[vessel] for vessel in present]
        kept = [self._streams.uniforms(purpose, frames.camera, name, first=0, count=1) for name in names]
        return grid_normals(np.concatenate([np.empty((0, purpose.uniforms)), *kept]))[place]

    def score_uniforms(self, frames: CameraFrames, targets: Targets) -> Array:
        """Uniform numbers for confidence and order, shape (n, 2)."""
        uniforms = target_uniforms(self._streams, Purpose.CONFIDENCE, frames, targets)
        if self._persistence.confidence_s:
            normals = self._walked(AutoregressiveScore(self._persistence.confidence_s), frames, targets)[:, 0]
            level = on_grid(special.ndtr(normals), _UNIFORM_STEP)
            uniforms[:, 0] = np.clip(level, _UNIFORM_STEP, 1 - _UNIFORM_STEP)
        return uniforms

    def scores(self, score: LatentScore, frames: CameraFrames, targets: Targets) -> Array:
        """Probabilities of the normal numbers behind misses and confidence, uniform in (0, 1), shape (n,)."""
        total = math.sqrt(score.vessel_share) * self._kept_by_vessels(Purpose.SCORE_VESSEL, frames, targets)[:, 0]
        for ordinal, (share, time_s) in enumerate(zip(score.shares, score.times_s, strict=True)):
            walked = self._walked(AutoregressivePart(time_s, ordinal=ordinal), frames, targets)[:, 0]
            total = total + math.sqrt(share) * walked
        white = grid_normals(target_uniforms(self._streams, Purpose.SCORE_WHITE, frames, targets))[:, 0]
        total = total + math.sqrt(score.white_share) * white
        return np.clip(on_grid(special.ndtr(total), _UNIFORM_STEP), _UNIFORM_STEP, 1 - _UNIFORM_STEP)

    def on_vessel(self, lifetime_s: float, frames: CameraFrames, targets: Targets) -> Array:
        """Uniform numbers for a false positive on each target, shape (n, 5)."""
        if not lifetime_s:
            return target_uniforms(self._streams, Purpose.ON_VESSEL, frames, targets)
        kept = KeptUniform(lifetime_s, Purpose.ON_VESSEL.uniforms, Purpose.ON_VESSEL, Purpose.ON_VESSEL_KEPT)
        return self._walked(kept, frames, targets)

    def _walked(self, process: Process, frames: CameraFrames, targets: Targets) -> Array:
        key = (process, frames.camera, targets.vessel_ids)
        if key not in self._walks:
            self._walks[key] = Walk(process, self._streams, self._clock, frames.camera, targets.vessel_ids)
        return self._walks[key].at(frames.steps[targets.frame], targets.vessel)
