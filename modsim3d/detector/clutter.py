"""False positives: how many, where, how large and with which label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import clip, sizes
from modsim3d.detector.census import TargetCensus
from modsim3d.detector.clutter_sizes import SceneSizes, Sizes
from modsim3d.detector.draws import choose, cumulative, keyed_uniforms, poisson_quantile, step_uniforms
from modsim3d.detector.persistent_clutter import wanderers
from modsim3d.detector.placement import DRAWS, Placement
from modsim3d.detector.records import Frames, Targets
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Purpose, Streams

_DRAWS = DRAWS + 2  # a false positive: place, size, label
_LEAST_SIDE_PX = 2.0  # half of it is a pixel: what is left of a box centred on the image's edge


@dataclass(frozen=True, eq=False)
class ClutterOptions:
    """What a detector file says about false positives.

    Attributes:
        model: One of `CLUTTER_MODELS`.
        placement: Where they are.
        size: How large they are; None for the model's own, the sizes of vessels or the thesis's.
        lifetime_s: Mean lifetime of those that persist.
        drift_px_s: How fast those move along the horizon, to either side.
        persistent_share: Which share of the false positives persists.
    """

    model: str = "calibrated"
    placement: Placement = field(default_factory=Placement)
    size: Sizes | None = None
    lifetime_s: float = 1.0
    drift_px_s: float = 0.0
    persistent_share: float = 0.0

    @property
    def needs_census(self) -> bool:
        """Whether sizes come from all of the scene: an empty frame has none to offer, and a wake keeps its own."""
        return self.size is None and (self.model == "per_image" or self.persistent_share > 0)


@dataclass(frozen=True, eq=False)
class Clutter:
    """False positives, rows ordered by frame.

    Attributes:
        frame: Index into the run of frames, shape (m,).
        ordinal: 0, 1, ... within a frame: what their random numbers are keyed by, shape (m,).
        boxes_px: Inside the image, shape (m, 4).
        label: Shape (m,).
    """

    frame: Indices
    ordinal: Indices
    boxes_px: Array
    label: Indices

    def uniforms(self, streams: Streams, purpose: Purpose, frames: Frames, width: int) -> Array:
        """Uniform numbers of each false positive, shape (m, width)."""
        return _ordinal_uniforms(streams, purpose, frames, self.frame, self.ordinal, width)


@dataclass(frozen=True, eq=False)
class Setting:
    """What a model of false positives may look at.

    Attributes:
        streams: Random numbers.
        frames: The frames.
        states: State of each frame, shape (S,).
        due: At which frames the detector runs, shape (S,).
        kept: The targets that were detected, under whichever label.
        n_true: Detections of a vessel in each frame, shape (S,); fewer than `kept` where vessels are merged.
        extras: Second boxes of vessels to be expected in each frame, shape (S,).
    """

    streams: Streams
    frames: Frames
    states: Indices
    due: Mask
    kept: Targets
    n_true: Indices
    extras: Array


@dataclass(frozen=True, eq=False)
class Rates:
    """How many false positives there are in each state.

    Attributes:
        false_discovery: False over all detections, shape (states,).
        per_image: Shape (states,).
        confidence_threshold: The detector's.
    """

    false_discovery: Array
    per_image: Array
    confidence_threshold: float


class ClutterModel(Protocol):
    """How many false positives a frame has."""

    def counts(self, rates: Rates, setting: Setting, share: float) -> Indices:
        """Number in each frame of the share that does not persist, shape (S,)."""

    def means(self, rates: Rates, setting: Setting) -> Array:
        """Mean number in each frame, shape (S,)."""


class Calibrated:
    """As many false positives as give the false discovery rate asked for.

    With n detections of vessels in a frame and a Poisson number of mean n·FDR / (1 − FDR), the share of false
    positives among all detections, summed over frames, is FDR. Second boxes of vessels are false as well, and as
    many fewer others are made. The number at a step never falls when one more vessel is detected.
    """

    def means(self, rates: Rates, setting: Setting) -> Array:
        """In proportion to the vessels detected."""
        rate = rates.false_discovery[setting.states]
        return np.maximum(setting.n_true * rate / (1 - rate) - setting.extras, 0)

    def counts(self, rates: Rates, setting: Setting, share: float) -> Indices:
        """Poisson, read from one uniform number a frame."""
        return _poisson(setting, share * self.means(rates, setting))


class PerImage:
    """A Poisson number in every image, whatever is in it: an empty sea has false alarms too."""

    def means(self, rates: Rates, setting: Setting) -> Array:
        """The state's rate, at frames at which the detector runs."""
        return np.where(setting.due, rates.per_image[setting.states], 0.0)

    def counts(self, rates: Rates, setting: Setting, share: float) -> Indices:
        """Poisson, read from one uniform number a frame."""
        return _poisson(setting, share * self.means(rates, setting))


class Thesis:
    """The original rule (Jessen & Mohr (2023), eq. 7.35): FDR·n − t trials of probability FDR, 100 × 100 px.

    It does not give the false discovery rate asked for: with five vessels, FDR 0.1 and threshold 0.2 it never
    makes a false positive. Rounding (half to even) and size are the original program's.
    """

    side_px = 100.0

    def means(self, rates: Rates, setting: Setting) -> Array:
        """Trials times their probability."""
        return self._trials(rates, setting) * rates.false_discovery[setting.states]

    def counts(self, rates: Rates, setting: Setting, share: float) -> Indices:
        """Successes among the trials of each frame."""
        rate = rates.false_discovery[setting.states]
        frame, ordinal = _rows(self._trials(rates, setting))
        uniforms = _ordinal_uniforms(setting.streams, Purpose.CLUTTER_TRIAL, setting.frames, frame, ordinal, width=1)
        successes = frame[uniforms[:, 0] < rate[frame]]
        return np.bincount(successes, minlength=len(rate)).astype(np.int64)

    @staticmethod
    def _trials(rates: Rates, setting: Setting) -> Indices:
        rate = rates.false_discovery[setting.states]
        return np.maximum(np.rint(rate * setting.n_true - rates.confidence_threshold), 0).astype(np.int64)


CLUTTER_MODELS: Mapping[str, ClutterModel] = {"calibrated": Calibrated(), "thesis": Thesis(), "per_image": PerImage()}
"""The models that a detector file can choose from."""


@dataclass(frozen=True, eq=False)
class ClutterSource:
    """Makes the false positives of a detector.

    Attributes:
        options: What the file says.
        rates: How many there are.
        label_distributions: Distribution function over labels of each state, shape (states, labels).
        sizes: Of the whole scene's vessels, or as asked; None for those of the vessels in the same frame.
    """

    options: ClutterOptions
    rates: Rates
    label_distributions: Array
    sizes: Sizes | None

    @classmethod
    def of(
        cls, options: ClutterOptions, rates: Rates, false_positive_labels: Array, census: TargetCensus
    ) -> ClutterSource:
        """The false positives of a detector.

        Args:
            options: What the file says.
            rates: How many there are.
            false_positive_labels: Distribution over labels of each state, shape (states, labels).
            census: Of the scene's targets, if sizes come from them.

        Raises:
            ModsimError: Sizes come from the scene's targets, and there are none.
        """
        sizes_ = options.size
        if options.needs_census:
            if not len(census.sides.counts) and options.model == "per_image":
                raise ModsimError(
                    "false positives are as large as annotated vessels, but there are none: give false_positives a size"
                )
            sizes_ = SceneSizes(census) if len(census.sides.counts) else None
        return cls(options, rates, cumulative(false_positive_labels), sizes_)

    def draw(self, setting: Setting) -> Clutter:
        """False positives of one frame only, centred on the sea in the image (on the image where it shows no sea).

        A side is at least two pixels before clipping, so at least one after it.
        """
        model, frames = CLUTTER_MODELS[self.options.model], setting.frames
        frame, ordinal = _rows(model.counts(self.rates, setting, 1 - self.options.persistent_share))
        uniforms = _ordinal_uniforms(setting.streams, Purpose.CLUTTER, frames, frame, ordinal, _DRAWS)
        return self._clutter(setting, frame, ordinal, uniforms, None)

    def draw_persistent(self, setting: Setting) -> Clutter:
        """False positives that stay for a while and drift along the horizon."""
        options, frames = self.options, setting.frames
        means = options.persistent_share * CLUTTER_MODELS[options.model].means(self.rates, setting)
        found = wanderers(setting.streams, frames, means, options.lifetime_s)
        ordinal = np.arange(len(found.frame)) - np.searchsorted(found.frame, found.frame)
        return self._clutter(
            setting, found.frame, ordinal, found.uniforms, found.sign * options.drift_px_s * found.age_s
        )

    def _clutter(
        self, setting: Setting, frame: Indices, ordinal: Indices, uniforms: Array, drift_px: Array | None
    ) -> Clutter:
        boxes = self.boxes_px(setting.frames, setting.kept, frame, uniforms[:, : DRAWS + 1], drift_px)
        labels = choose(self.label_distributions[setting.states[frame]], uniforms[:, DRAWS + 1])
        return Clutter(frame, ordinal, boxes, labels)

    def boxes_px(
        self, frames: Frames, kept: Targets, frame: Indices, uniforms: Array, drift_px: Array | None = None
    ) -> Array:
        """Boxes of false positives from uniform numbers, shape (m, 4).

        Args:
            frames: The frames.
            kept: The targets that were detected, rows ordered by frame.
            frame: Of each false positive, shape (m,).
            uniforms: For place (3) and size, shape (m, 4).
            drift_px: How far each has moved along the horizon, shape (m,); None for those of one frame.
        """
        half_planes, image = frames.sea_half_planes[frame], frames.image_size_px
        centres = self.options.placement.places(half_planes, image, uniforms[:, :DRAWS], drift_px)
        halves = np.maximum(self._sizes_px(kept, len(frames), frame, uniforms[:, DRAWS]), _LEAST_SIDE_PX) / 2
        return clip(np.concatenate([centres - halves, centres + halves], axis=1), image)

    def _sizes_px(self, kept: Targets, n_frames: int, frame: Indices, uniforms: Array) -> Array:
        """Width and height, shape (m, 2)."""
        if self.options.model == "thesis":
            return np.full((len(frame), 2), Thesis.side_px)
        if self.sizes is not None:
            return self.sizes.at(uniforms)
        # The size of a detected vessel's truth box in the same frame; without one the mean count is 0.
        n_kept = np.bincount(kept.frame, minlength=n_frames).astype(np.int64)
        starts = np.cumsum(n_kept) - n_kept
        source = starts[frame] + (uniforms * n_kept[frame]).astype(np.int64)
        return sizes(kept.boxes_px[source])


def _poisson(setting: Setting, means: Array) -> Indices:
    uniforms = step_uniforms(setting.streams, Purpose.CLUTTER_COUNT, setting.frames.camera, steps=setting.frames.steps)
    return poisson_quantile(uniforms[:, 0], means)


def _rows(counts: Indices) -> tuple[Indices, Indices]:
    """Frame and place within it of each of `counts[frame]` rows."""
    frame = np.repeat(np.arange(len(counts)), counts)
    return frame, np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts)


def _ordinal_uniforms(
    streams: Streams, purpose: Purpose, frames: Frames, frame: Indices, ordinal: Indices, width: int
) -> Array:
    """Numbers of the first, second, ... false positive of a step: the same, however many there are."""
    names = [str(number) for number in range(int(ordinal.max(initial=-1)) + 1)]
    return keyed_uniforms(streams, purpose, frames, frame, ordinal, names, width)
