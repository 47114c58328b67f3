"""False positives: how many, where, how large and with which label."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask, ranges
from modsim3d.core.boxes import clip, inside_image, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams, grid_normals, on_grid
from modsim3d.detector.draws import choose, cumulative, keyed_uniforms, low_uniforms, poisson_quantile, step_uniforms
from modsim3d.detector.false_positive_placement import DRAWS, Placement
from modsim3d.detector.records import CameraFrames, Targets
from modsim3d.detector.target_statistics import TargetStatistics

# ---- How many false positives a frame has ----

RateKey = Literal["false_discovery_rate", "false_positives_per_image"]


@dataclass(frozen=True, eq=False)
class FalsePositiveRates:
    """Rates of false positives that each state asks for; arrays have shape (states,)."""

    false_discovery: Array  # false positives over all detections
    per_image: Array  # false positives in an image
    confidence_threshold: float  # the detector's, which eq. 7.35 uses


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Numbers that false positives may follow, frame by frame; shapes (S,)."""

    states: Indices  # performance state
    due: Mask  # whether the detector runs
    n_true: Indices  # detections of a vessel; two merged vessels are one
    extras: Array  # expected number of second boxes of vessels


class FalsePositiveModel(ABC):
    """A model of the number of false positives; Poisson numbers unless it says otherwise."""

    rate_key: RateKey = "false_discovery_rate"  # key of a state that holds its rate
    empty_frames: bool = False  # whether a frame without vessels may have false positives
    counts_second_boxes: bool = False  # whether its rate includes second boxes of vessels
    side_px: float | None = None  # of its square boxes; None if the detector file describes places and sizes

    @abstractmethod
    def means(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """Mean number in each frame, persistent and transient ones together, shape (S,)."""

    def dispersion(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """Variance of the number of transient ones over its mean, shape (S,)."""
        return np.ones(len(frames.states))

    def draw(
        self, streams: Streams, seen: CameraFrames, rates: FalsePositiveRates, frames: FrameCounts, share: float
    ) -> Indices:
        """Number of transient ones in each frame, given their share of all, shape (S,)."""
        purpose, camera = Purpose.TRANSIENT_COUNT, seen.camera
        uniforms = step_uniforms(streams, purpose, camera, steps=seen.steps)
        return poisson_quantile(uniforms[:, 0], share * self.means(rates, frames))


class CalibratedNumber(FalsePositiveModel):
    """As many false positives as give the false discovery rate in the file. With n detections of vessels in a frame and
    a Poisson number of mean n·FDR / (1 − FDR), the share of false positives among all detections, summed over frames,
    is FDR. Second boxes of vessels are false as well, so the mean number of others is reduced by theirs. The number at
    a step never falls when one more vessel is detected."""

    counts_second_boxes = True

    def means(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """In proportion to the vessels detected, shape (S,)."""
        rate = rates.false_discovery[frames.states]
        return np.maximum(frames.n_true * rate / (1 - rate) - frames.extras, 0)


class PerImage(FalsePositiveModel):
    """A Poisson number in every image, whatever is in it: an empty sea has false positives too."""

    rate_key = "false_positives_per_image"
    empty_frames = True

    def means(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """The state's rate, at frames at which the detector runs, shape (S,)."""
        return np.where(frames.due, rates.per_image[frames.states], 0.0)


class Thesis(FalsePositiveModel):
    """The original rule (Jessen & Mohr (2023), eq. 7.35): FDR·n − t trials of probability FDR, 100 × 100 px. It does
    not give the false discovery rate in the file: with five vessels, FDR 0.1 and threshold 0.2 it never makes a false
    positive. Rounding (half to even) and size are the original program's."""

    side_px = 100.0

    def means(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """Trials times their probability, shape (S,)."""
        return self._trials(rates, frames) * rates.false_discovery[frames.states]

    def dispersion(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        """That of a binomial number, shape (S,)."""
        return 1 - rates.false_discovery[frames.states]

    def draw(
        self, streams: Streams, seen: CameraFrames, rates: FalsePositiveRates, frames: FrameCounts, share: float
    ) -> Indices:
        """Successes among the trials of each frame, shape (S,); none of them persists."""
        rate = rates.false_discovery[frames.states]
        frame, ordinal = numbered_rows(self._trials(rates, frames))
        uniforms = ordinal_uniforms(streams, Purpose.TRANSIENT_TRIAL, seen, frame, ordinal)
        return np.bincount(frame[uniforms[:, 0] < rate[frame]], minlength=len(rate)).astype(np.int64)

    @staticmethod
    def _trials(rates: FalsePositiveRates, frames: FrameCounts) -> Indices:
        rate = rates.false_discovery[frames.states]
        return np.maximum(np.rint(rate * frames.n_true - rates.confidence_threshold), 0).astype(np.int64)


FALSE_POSITIVE_MODELS: Mapping[str, FalsePositiveModel] = {
    "calibrated": CalibratedNumber(),
    "thesis": Thesis(),
    "per_image": PerImage(),
}
"""By the name that `false_positives.model` has in a detector file."""


def numbered_rows(counts: Indices) -> tuple[Indices, Indices]:
    """Frame of each of `counts[frame]` rows and its place 0, 1, ... within the frame, shapes (m,)."""
    return np.arange(len(counts)).repeat(counts), ranges(np.zeros_like(counts), counts)


def ordinal_uniforms(
    streams: Streams, purpose: Purpose, frames: CameraFrames, frame: Indices, ordinal: Indices
) -> Array:
    """Uniform numbers of the first, second, ... false positive of a step, however many there are, shape (m, width)."""
    names: Sequence[str] = [str(number) for number in range(int(ordinal.max(initial=-1)) + 1)]
    return keyed_uniforms(streams, purpose, frames, frame, ordinal, names)


# ---- False positives that stay for a while ----

_LOOK_BACK = 38  # lifetimes that the oldest can have lived: −ln of the least positive uniform number, 2⁻⁵³, is below 37
_WIDTH = 8  # birth, lifetime, height, place (3), size, label


@dataclass(frozen=True, eq=False)
class PersistentFalsePositives:
    """Persistent false positives, a row for each frame that shows one, m in all."""

    frame: Indices  # index of the frame, non-decreasing, shape (m,)
    age_s: Array  # time since birth, shape (m,)
    uniforms: Array  # for place (3), size and label, the same in all frames of one, shape (m, 5)
    sign: Array  # direction in which it drifts, 1 or −1, shape (m,)


def persistent_false_positives(
    streams: Streams, frames: CameraFrames, rates: Array, lifetime_s: float
) -> PersistentFalsePositives:
    """Persistent false positives in a camera's frames, given their mean number in each, shape (S,), and lifetime."""
    count = int(np.ceil(rates.max(initial=0.0)))
    layers = [_layer(streams, frames, rates - layer, lifetime_s, layer) for layer in range(count)]
    if not layers:
        nothing, none = np.empty(0), np.empty(0, dtype=np.int64)
        return PersistentFalsePositives(none, nothing, np.empty((0, 5)), nothing)
    frame, age, draws = (np.concatenate(columns) for columns in zip(*layers, strict=True))
    order = np.argsort(frame, kind="stable")
    frame, draws = frame[order], draws[order]
    # The last binary digit of the birth, which nothing else can tell, says which way.
    odd = (draws[:, 0] * 2.0**53).astype(np.int64) % 2 == 1
    return PersistentFalsePositives(frame, age[order], draws[:, 3:], np.where(odd, 1.0, -1.0))


def _layer(
    streams: Streams, frames: CameraFrames, rates: Array, lifetime_s: float, layer: int
) -> tuple[Indices, Array, Array]:
    """Frame, age and draws of what a layer shows at rates above its bottom."""
    wanted = np.flatnonzero(rates > 0)
    if not len(wanted):
        return np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, _WIDTH))
    times = frames.times_s[wanted]
    first = int(times[0] // lifetime_s) - _LOOK_BACK
    cells, draws = _births(streams, frames.camera, str(layer), first, int(times[-1] // lifetime_s) + 1 - first)
    born = (cells + draws[:, 0]) * lifetime_s
    lived = -special.log1p(-draws[:, 1]) * lifetime_s
    begin, end = np.searchsorted(times, born), np.searchsorted(times, born + lived)
    seen = end - begin
    one = np.repeat(np.arange(len(born)), seen)
    row = np.arange(len(one)) - np.repeat(np.cumsum(seen) - seen - begin, seen)
    low = draws[one, 2] < rates[wanted[row]]
    row, one = row[low], one[low]
    return wanted[row], times[row] - born[one], draws[one]


def _births(streams: Streams, camera: str, layer: str, first: int, count: int) -> tuple[Indices, Array]:
    """Cell of time and draws of each birth in `count` cells; a cell is a mean lifetime long."""
    index = first + _LOOK_BACK  # the first cells lie before the scene's first step
    numbers = streams.uniforms(Purpose.PERSISTENT_BIRTHS, camera, layer, first=index, count=count)[:, 0]
    births = poisson_quantile(numbers, np.ones(count))
    cells, draws = [np.empty(0, dtype=np.int64)], [np.empty((0, _WIDTH))]
    for k in range(int(births.max(initial=0))):
        some = streams.uniforms(Purpose.PERSISTENT, camera, layer, str(k), first=index, count=count)
        rows = np.flatnonzero(births > k)
        cells.append(first + rows)
        draws.append(some[rows])
    order = np.argsort(np.concatenate(cells), kind="stable")
    return np.concatenate(cells)[order], np.concatenate(draws)[order]


_LN_2 = math.log(2)


class Sizes(Protocol):
    """A distribution of width and height."""

    def at(self, uniforms: Array) -> Array:
        """Width and height from one uniform number each, shape (m, 2)."""


@dataclass(frozen=True)
class FixedSize:
    """One size for all false positives."""

    width_px: float
    height_px: float

    def at(self, uniforms: Array) -> Array:
        """The size for each of m numbers, shape (m, 2)."""
        return np.tile([self.width_px, self.height_px], (len(uniforms), 1))


@dataclass(frozen=True)
class LognormalSize:
    """One aspect ratio, with a size whose logarithm is normally distributed."""

    width_px: float
    height_px: float
    log_std: float

    def at(self, uniforms: Array) -> Array:
        """The median box, scaled, shape (m, 2)."""
        scale: Array = on_grid(special.exp2(self.log_std / _LN_2 * grid_normals(uniforms)))
        return scale[:, None] * [self.width_px, self.height_px]


@dataclass(frozen=True, eq=False)
class SceneSizes:
    """The sizes of the scene's annotated boxes, over all its steps."""

    statistics: TargetStatistics

    def at(self, uniforms: Array) -> Array:
        """The size of one of these boxes for each of m numbers, shape (m, 2)."""
        return self.statistics.sizes_px(uniforms)


_MAX_CHANGE_PX = 0.5  # of a true side: true sides are often whole pixels, and detected ones never
_MIN_SIDE_PX = 2.0  # half of it is a pixel: what is left of a box centred on the image's edge


@dataclass(frozen=True)
class VesselFalseBoxes:
    """False positives that lie on vessels: boxes of a part, or of a vessel and what is around it."""

    share: float  # of the vessels in the image, found or missed, that have one
    lifetime_s: float = 0.0  # time for which one stays; 0 for as long as a frame
    mean: tuple[float, ...] = (0.0,) * 4  # centre from the vessel's, in its width and height, and log of both ratios
    std: tuple[float, ...] = (0.0,) * 4

    def boxes_px(self, true_px: Array, image_size_px: tuple[int, int] | Array, uniforms: Array) -> tuple[Array, Mask]:
        """Boxes on vessels, (n, 4), a pixel wide and high in the image, and which are there, from uniforms (n, 5)."""
        place = np.array(self.mean) + np.array(self.std) * grid_normals(uniforms[:, 1:])
        sides = sizes(true_px)
        middle = (true_px[:, :2] + true_px[:, 2:]) / 2 + sides * place[:, :2]
        half = sides * on_grid(special.exp2(place[:, 2:] / _LN_2)) / 2
        boxes = np.concatenate([middle - half, middle + half], axis=1)
        present: Mask = (uniforms[:, 0] < self.share) & inside_image(boxes, image_size_px)
        return clip(boxes, image_size_px), present


@dataclass(frozen=True, eq=False)
class FalsePositiveOptions:
    """Keys of a detector file about false positives."""

    model: str = "calibrated"
    placement: Placement = field(default_factory=Placement)
    size: Sizes | None = None  # None for the sizes of vessels or for the model's own size
    lifetime_s: float = 1.0  # mean lifetime of persistent ones
    drift_px_s: float = 0.0  # speed of persistent ones along the horizon, to either side
    persistent_share: float = 0.0  # of all false positives
    on_vessels: VesselFalseBoxes | None = None  # besides all others

    @property
    def numbers(self) -> FalsePositiveModel:
        """The model of their number."""
        return FALSE_POSITIVE_MODELS[self.model]

    @property
    def needs_target_statistics(self) -> bool:
        """Whether sizes come from all of the scene: empty frames have no vessels, and persistent ones keep a size."""
        return self.size is None and (self.numbers.empty_frames or self.persistent_share > 0)


@dataclass(frozen=True, eq=False)
class FalsePositives:
    """False positives, m rows ordered by frame."""

    frame: Indices  # index into the run of frames, shape (m,)
    ordinal: Indices  # 0, 1, ... within a frame: what their random numbers are keyed by, shape (m,)
    boxes_px: Array  # inside the image, shape (m, 4)
    label: Indices  # shape (m,)

    def uniforms(self, streams: Streams, purpose: Purpose, frames: CameraFrames) -> Array:
        """Uniform numbers of each false positive, shape (m, width)."""
        return ordinal_uniforms(streams, purpose, frames, self.frame, self.ordinal)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The frames that false positives are drawn for, and the vessels detected in them."""

    streams: Streams
    frames: CameraFrames
    counts: FrameCounts
    detected: Targets


@dataclass(frozen=True, eq=False)
class FalsePositiveSource:
    """Makes the false positives of a detector."""

    options: FalsePositiveOptions
    rates: FalsePositiveRates
    label_distributions: Array  # distribution function over labels of each state, shape (states, labels)
    sizes: Sizes | None  # None for the sizes of vessels detected in the same frame

    @classmethod
    def of(
        cls, options: FalsePositiveOptions, rates: FalsePositiveRates, label_shares: Array, statistics: TargetStatistics
    ) -> FalsePositiveSource:
        """The false positives of a detector whose labels have a distribution in each state, shape (states, labels).
        Raises ModsimError if sizes come from the scene's targets, and there are none."""
        sizes_ = options.size
        if options.needs_target_statistics:
            if not len(statistics.sides.counts) and options.numbers.empty_frames:
                raise ModsimError(
                    "false positives are as large as annotated vessels, but there are none: give false_positives a size"
                )
            sizes_ = SceneSizes(statistics) if len(statistics.sides.counts) else None
        return cls(options, rates, cumulative(label_shares), sizes_)

    def draw_transient(self, around: Surroundings) -> FalsePositives:
        """False positives of one frame only, centred on the sea in the image, or on the image where it shows none.
        Sides are at least two pixels before clipping, so at least one after it."""
        streams, frames, share = around.streams, around.frames, 1 - self.options.persistent_share
        frame, ordinal = numbered_rows(self.options.numbers.draw(streams, frames, self.rates, around.counts, share))
        if not len(frame):  # most frames have none, and a live step is one frame
            return FalsePositives(frame, ordinal, np.empty((0, 4)), np.empty(0, dtype=np.int64))
        uniforms = ordinal_uniforms(streams, Purpose.TRANSIENT, frames, frame, ordinal)
        return self._of_draws(around, frame, ordinal, uniforms, None)

    def draw_persistent(self, around: Surroundings) -> FalsePositives:
        """False positives that stay for a while and drift along the horizon."""
        options = self.options
        means = options.persistent_share * options.numbers.means(self.rates, around.counts)
        positives = persistent_false_positives(around.streams, around.frames, means, options.lifetime_s)
        ordinal = np.arange(len(positives.frame)) - np.searchsorted(positives.frame, positives.frame)
        drift_px = positives.sign * options.drift_px_s * positives.age_s
        return self._of_draws(around, positives.frame, ordinal, positives.uniforms, drift_px)

    def _of_draws(
        self, around: Surroundings, frame: Indices, ordinal: Indices, uniforms: Array, drift_px: Array | None
    ) -> FalsePositives:
        boxes = self.boxes_px(around.frames, around.detected, frame, uniforms[:, : DRAWS + 1], drift_px)
        return FalsePositives(frame, ordinal, boxes, self.labels(around.counts.states[frame], uniforms[:, DRAWS + 1]))

    def labels(self, states: Indices, uniforms: Array) -> Indices:
        """Labels of false positives in a performance state each, from a uniform number each, shapes (m,)."""
        return choose(self.label_distributions[states], uniforms)

    def boxes_px(
        self, frames: CameraFrames, detected: Targets, frame: Indices, uniforms: Array, drift_px: Array | None = None
    ) -> Array:
        """Boxes of false positives, shape (m, 4), at a frame each, (m,), from uniform numbers for place (3) and size,
        (m, 4). Detected vessels are ordered by frame. `drift_px` is how far persistent ones have moved, (m,)."""
        half_planes, image = frames.sea_half_planes[frame], frames.image_size_px
        centres = self.options.placement.places(half_planes, image, uniforms[:, :DRAWS], drift_px)
        halves = np.maximum(self._sizes_px(detected, len(frames), frame, uniforms[:, DRAWS]), _MIN_SIDE_PX) / 2
        return clip(np.concatenate([centres - halves, centres + halves], axis=1), image)

    def _sizes_px(self, detected: Targets, n_frames: int, frame: Indices, uniforms: Array) -> Array:
        """Width and height, shape (m, 2)."""
        side_px = self.options.numbers.side_px
        if side_px is not None:
            return np.full((len(frame), 2), side_px)
        if self.sizes is not None:
            return self.sizes.at(uniforms)
        # The size of a detected vessel's truth box in the same frame; without one the mean count is 0.
        count = np.bincount(detected.frame, minlength=n_frames).astype(np.int64)
        source = (np.cumsum(count) - count)[frame] + (uniforms * count[frame]).astype(np.int64)
        return sizes(detected.boxes_px[source]) + _MAX_CHANGE_PX * (2 * low_uniforms(uniforms) - 1)
