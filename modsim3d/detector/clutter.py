"""False positives: how many, where, how large and with which label."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import clip, sizes
from modsim3d.detector.census import TargetCensus
from modsim3d.detector.clutter_models import (
    CLUTTER_MODELS,
    ClutterModel,
    ClutterRates,
    FrameCounts,
    numbered_rows,
    ordinal_uniforms,
)
from modsim3d.detector.draws import choose, cumulative, low_uniforms
from modsim3d.detector.persistent_clutter import persistent_clutter
from modsim3d.detector.placement import DRAWS, Placement
from modsim3d.detector.records import CameraFrames, Targets
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Purpose, Streams, grid_normals, on_grid

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

    census: TargetCensus

    def at(self, uniforms: Array) -> Array:
        """The size of one of these boxes for each of m numbers, shape (m, 2)."""
        return self.census.sizes_px(uniforms)


_MOST_CHANGE_PX = 0.5  # of a true side: true sides are often whole pixels, and detected ones never
_LEAST_SIDE_PX = 2.0  # half of it is a pixel: what is left of a box centred on the image's edge


@dataclass(frozen=True, eq=False)
class ClutterOptions:
    """What a detector file says about false positives.

    Attributes:
        size: How large they are; None for the sizes of vessels or for the model's own size.
        lifetime_s: Mean lifetime of persistent ones.
        drift_px_s: Speed at which persistent ones move along the horizon, to either side.
        persistent_share: Share of the false positives that is persistent.
    """

    model: str = "calibrated"
    placement: Placement = field(default_factory=Placement)
    size: Sizes | None = None
    lifetime_s: float = 1.0
    drift_px_s: float = 0.0
    persistent_share: float = 0.0

    @property
    def numbers(self) -> ClutterModel:
        """The model of their number."""
        return CLUTTER_MODELS[self.model]

    @property
    def needs_census(self) -> bool:
        """Whether sizes come from all of the scene: empty frames have no vessels, and persistent ones keep a size."""
        return self.size is None and (self.numbers.empty_frames or self.persistent_share > 0)


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
class ClutterSource:
    """Makes the false positives of a detector.

    Attributes:
        label_distributions: Distribution function over labels of each state, shape (states, labels).
        sizes: Distribution of their sizes; None for the sizes of vessels detected in the same frame.
    """

    options: ClutterOptions
    rates: ClutterRates
    label_distributions: Array
    sizes: Sizes | None

    @classmethod
    def of(
        cls, options: ClutterOptions, rates: ClutterRates, false_positive_labels: Array, census: TargetCensus
    ) -> ClutterSource:
        """The false positives of a detector whose labels have a distribution in each state, shape (states, labels).

        Raises:
            ModsimError: Sizes come from the scene's targets, and there are none.
        """
        sizes_ = options.size
        if options.needs_census:
            if not len(census.sides.counts) and options.numbers.empty_frames:
                raise ModsimError(
                    "false positives are as large as annotated vessels, but there are none: give false_positives a size"
                )
            sizes_ = SceneSizes(census) if len(census.sides.counts) else None
        return cls(options, rates, cumulative(false_positive_labels), sizes_)

    def draw_transient(self, around: Surroundings) -> Clutter:
        """False positives of one frame only, centred on the sea in the image (on the image where it shows no sea).

        A side is at least two pixels before clipping, so at least one after it.
        """
        streams, frames, share = around.streams, around.frames, 1 - self.options.persistent_share
        counts = self.options.numbers.draw(streams, frames, self.rates, around.counts, share)
        frame, ordinal = numbered_rows(counts)
        if not len(frame):  # most frames have none, and a live step is one frame
            return Clutter(frame, ordinal, np.empty((0, 4)), np.empty(0, dtype=np.int64))
        uniforms = ordinal_uniforms(streams, Purpose.CLUTTER, frames, frame, ordinal)
        return self._clutter(around, frame, ordinal, uniforms, None)

    def draw_persistent(self, around: Surroundings) -> Clutter:
        """False positives that stay for a while and drift along the horizon."""
        options = self.options
        means = options.persistent_share * options.numbers.means(self.rates, around.counts)
        found = persistent_clutter(around.streams, around.frames, means, options.lifetime_s)
        ordinal = np.arange(len(found.frame)) - np.searchsorted(found.frame, found.frame)
        drift_px = found.sign * options.drift_px_s * found.age_s
        return self._clutter(around, found.frame, ordinal, found.uniforms, drift_px)

    def _clutter(
        self, around: Surroundings, frame: Indices, ordinal: Indices, uniforms: Array, drift_px: Array | None
    ) -> Clutter:
        boxes = self.boxes_px(around.frames, around.detected, frame, uniforms[:, : DRAWS + 1], drift_px)
        labels = choose(self.label_distributions[around.counts.states[frame]], uniforms[:, DRAWS + 1])
        return Clutter(frame, ordinal, boxes, labels)

    def boxes_px(
        self, frames: CameraFrames, detected: Targets, frame: Indices, uniforms: Array, drift_px: Array | None = None
    ) -> Array:
        """Boxes of false positives, shape (m, 4).

        Args:
            detected: The vessels that were detected, ordered by frame.
            frame: Frame of each false positive, shape (m,).
            uniforms: Uniform numbers for place (3) and size, shape (m, 4).
            drift_px: How far each has moved along the horizon, shape (m,); None for transient ones.
        """
        half_planes, image = frames.sea_half_planes[frame], frames.image_size_px
        centres = self.options.placement.places(half_planes, image, uniforms[:, :DRAWS], drift_px)
        halves = np.maximum(self._sizes_px(detected, len(frames), frame, uniforms[:, DRAWS]), _LEAST_SIDE_PX) / 2
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
        starts = np.cumsum(count) - count
        source = starts[frame] + (uniforms * count[frame]).astype(np.int64)
        true = sizes(detected.boxes_px[source])
        return true + _MOST_CHANGE_PX * (2 * low_uniforms(uniforms) - 1)
