"""False positives: how many, where, how large and with which label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from modsim3d.detector.boxes import clip, sizes
from modsim3d.detector.draws import choose, cumulative, keyed_uniforms, poisson_quantile, step_uniforms
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array, Frames, Indices, Targets
from modsim3d.detector.sea import uniform_places
from modsim3d.random_streams import Streams

_DRAWS = 5  # a false positive: place (3), size (1), label (1)
_LEAST_SIDE_PX = 2.0  # half of it is a pixel: what is left of a box centred on the image's edge


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

    def uniforms(self, streams: Streams, purpose: str, frames: Frames, width: int) -> Array:
        """Uniform numbers of each false positive, shape (m, width)."""
        return _ordinal_uniforms(streams, purpose, frames, self.frame, self.ordinal, width)


@dataclass(frozen=True, eq=False)
class Setting:
    """What a model of false positives may look at.

    Attributes:
        streams: Random numbers.
        frames: The frames.
        kept: The targets that were detected, under whichever label.
        false_discovery_rate: Of each frame, shape (S,).
        confidence_threshold: The detector's.
    """

    streams: Streams
    frames: Frames
    kept: Targets
    false_discovery_rate: Array
    confidence_threshold: float

    @property
    def n_kept(self) -> Indices:
        """Detected targets in each frame, shape (S,)."""
        return np.bincount(self.kept.frame, minlength=len(self.frames)).astype(np.int64)


class ClutterModel(Protocol):
    """How many false positives a frame has, and how large they are."""

    def counts(self, setting: Setting) -> Indices:
        """Number in each frame, shape (S,)."""

    def sizes_px(self, setting: Setting, frame: Indices, uniforms: Array) -> Array:
        """Width and height, shape (m, 2), for false positives in these frames, from one number each, (m,)."""


class Calibrated:
    """As many false positives as give the false discovery rate asked for, as large as the vessels seen.

    With n true detections in a frame and a Poisson number of mean n·FDR / (1 − FDR), the share of false
    positives among all detections, summed over frames, is FDR. The number at a step never falls when one
    more vessel is detected.
    """

    def counts(self, setting: Setting) -> Indices:
        """Poisson, read from one uniform number a frame."""
        rate, camera = setting.false_discovery_rate, setting.frames.camera
        uniforms = step_uniforms(setting.streams, "detector.clutter_count", camera, steps=setting.frames.steps)
        return poisson_quantile(uniforms[:, 0], setting.n_kept * rate / (1 - rate))

    def sizes_px(self, setting: Setting, frame: Indices, uniforms: Array) -> Array:
        """Size of a detected vessel's truth box in the same frame; without one the mean count is 0."""
        n_kept = setting.n_kept
        starts = np.cumsum(n_kept) - n_kept
        source = starts[frame] + (uniforms * n_kept[frame]).astype(np.int64)
        return sizes(setting.kept.boxes_px[source])


class Thesis:
    """The original rule (Jessen & Mohr (2023), eq. 7.35): FDR·n − t trials of probability FDR, 100 × 100 px.

    It does not give the false discovery rate asked for: with five vessels, FDR 0.1 and threshold 0.2 it never
    makes a false positive. Rounding (half to even) and size are the original program's.
    """

    side_px = 100.0

    def counts(self, setting: Setting) -> Indices:
        """Successes among the trials of each frame."""
        rate = setting.false_discovery_rate
        trials = np.rint(rate * setting.n_kept - setting.confidence_threshold)
        frame, ordinal = _rows(np.maximum(trials, 0).astype(np.int64))
        uniforms = _ordinal_uniforms(setting.streams, "detector.clutter_trial", setting.frames, frame, ordinal, width=1)
        successes = frame[uniforms[:, 0] < rate[frame]]
        return np.bincount(successes, minlength=len(rate)).astype(np.int64)

    def sizes_px(self, setting: Setting, frame: Indices, uniforms: Array) -> Array:
        """All the same."""
        return np.full((len(frame), 2), self.side_px)


CLUTTER_MODELS: Mapping[str, ClutterModel] = {"calibrated": Calibrated(), "thesis": Thesis()}
"""The models that a detector file can choose from."""


@dataclass(frozen=True, eq=False)
class ClutterSource:
    """Makes the false positives of a detector.

    Attributes:
        model: How many and how large.
        rates: False discovery rate of each state, shape (states,).
        label_distributions: Distribution function over labels of each state, shape (states, labels).
        confidence_threshold: The detector's.
    """

    model: ClutterModel
    rates: Array
    label_distributions: Array
    confidence_threshold: float

    @classmethod
    def from_model(cls, model: DetectorModel) -> ClutterSource:
        """The false positives of a detector model."""
        return cls(
            CLUTTER_MODELS[model.false_positives],
            model.column("false_discovery_rate"),
            cumulative(model.column("false_positive_labels")),
            model.confidence_threshold,
        )

    def draw(self, streams: Streams, frames: Frames, states: Indices, kept: Targets) -> Clutter:
        """False positives, centred on the sea in the image (on the image where it shows no sea).

        A side is at least two pixels before clipping, so at least one after it.
        """
        setting = Setting(streams, frames, kept, self.rates[states], self.confidence_threshold)
        frame, ordinal = _rows(self.model.counts(setting))
        uniforms = _ordinal_uniforms(streams, "detector.clutter", frames, frame, ordinal, _DRAWS)
        centres = uniform_places(frames.sea_half_planes[frame], frames.image_size_px, uniforms[:, :3])
        halves = np.maximum(self.model.sizes_px(setting, frame, uniforms[:, 3]), _LEAST_SIDE_PX) / 2
        boxes = clip(np.concatenate([centres - halves, centres + halves], axis=1), frames.image_size_px)
        return Clutter(frame, ordinal, boxes, choose(self.label_distributions[states[frame]], uniforms[:, 4]))


def _rows(counts: Indices) -> tuple[Indices, Indices]:
    """Frame and place within it of each of `counts[frame]` rows."""
    frame = np.repeat(np.arange(len(counts)), counts)
    return frame, np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts)


def _ordinal_uniforms(
    streams: Streams, purpose: str, frames: Frames, frame: Indices, ordinal: Indices, width: int
) -> Array:
    """Numbers of the first, second, ... false positive of a step: the same, however many there are."""
    names = [str(number) for number in range(int(ordinal.max(initial=-1)) + 1)]
    return keyed_uniforms(streams, purpose, frames, frame, ordinal, names, width)
