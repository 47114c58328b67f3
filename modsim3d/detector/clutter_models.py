"""How many false positives a frame has: the models that a detector file can choose from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, ranges
from modsim3d.detector.draws import keyed_uniforms, poisson_quantile, step_uniforms
from modsim3d.detector.records import CameraFrames
from modsim3d.random_streams import Purpose, Streams

RateKey = Literal["false_discovery_rate", "false_positives_per_image"]


@dataclass(frozen=True, eq=False)
class ClutterRates:
    """How many false positives each state asks for.

    Attributes:
        false_discovery: False positives over all detections, shape (states,).
        per_image: False positives in an image, shape (states,).
        confidence_threshold: The detector's threshold, which eq. 7.35 uses.
    """

    false_discovery: Array
    per_image: Array
    confidence_threshold: float


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """What the number of false positives may follow, frame by frame; shapes (S,).

    Attributes:
        states: Performance state.
        due: Whether the detector runs.
        n_true: Detections of a vessel; two merged vessels are one.
        extras: Expected number of second boxes of vessels.
    """

    states: Indices
    due: Mask
    n_true: Indices
    extras: Array


class ClutterModel(ABC):
    """A model of the number of false positives; Poisson numbers unless it says otherwise.

    Attributes:
        rate_key: The key of a state that holds its rate.
        empty_frames: Whether a frame without vessels may have false positives.
        counts_second_boxes: Whether its rate includes second boxes of vessels.
        side_px: Side of its square boxes; None if the detector file describes places and sizes.
    """

    rate_key: RateKey = "false_discovery_rate"
    empty_frames: bool = False
    counts_second_boxes: bool = False
    side_px: float | None = None

    @abstractmethod
    def means(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """Mean number in each frame, persistent and transient ones together, shape (S,)."""

    def dispersion(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """Variance of the number of transient ones over its mean, shape (S,)."""
        return np.ones(len(frames.states))

    def draw(
        self, streams: Streams, camera_frames: CameraFrames, rates: ClutterRates, frames: FrameCounts, share: float
    ) -> Indices:
        """Number of transient ones in each frame, given their share of all, shape (S,)."""
        purpose, camera = Purpose.CLUTTER_COUNT, camera_frames.camera
        uniforms = step_uniforms(streams, purpose, camera, steps=camera_frames.steps)
        return poisson_quantile(uniforms[:, 0], share * self.means(rates, frames))


class Calibrated(ClutterModel):
    """As many false positives as give the false discovery rate in the file.

    With n detections of vessels in a frame and a Poisson number of mean n·FDR / (1 − FDR), the share of false
    positives among all detections, summed over frames, is FDR. Second boxes of vessels are false as well, so the mean
    number of others is reduced by theirs. The number at a step never falls when one more vessel is detected.
    """

    counts_second_boxes = True

    def means(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """In proportion to the vessels detected, shape (S,)."""
        rate = rates.false_discovery[frames.states]
        return np.maximum(frames.n_true * rate / (1 - rate) - frames.extras, 0)


class PerImage(ClutterModel):
    """A Poisson number in every image, whatever is in it: an empty sea has false positives too."""

    rate_key = "false_positives_per_image"
    empty_frames = True

    def means(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """The state's rate, at frames at which the detector runs, shape (S,)."""
        return np.where(frames.due, rates.per_image[frames.states], 0.0)


class Thesis(ClutterModel):
    """The original rule (Jessen & Mohr (2023), eq. 7.35): FDR·n − t trials of probability FDR, 100 × 100 px.

    It does not give the false discovery rate in the file: with five vessels, FDR 0.1 and threshold 0.2 it never makes
    a false positive. Rounding (half to even) and size are the original program's.
    """

    side_px = 100.0

    def means(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """Trials times their probability, shape (S,)."""
        return self._trials(rates, frames) * rates.false_discovery[frames.states]

    def dispersion(self, rates: ClutterRates, frames: FrameCounts) -> Array:
        """That of a binomial number, shape (S,)."""
        return 1 - rates.false_discovery[frames.states]

    def draw(
        self, streams: Streams, camera_frames: CameraFrames, rates: ClutterRates, frames: FrameCounts, share: float
    ) -> Indices:
        """Successes among the trials of each frame, shape (S,); none of them persists."""
        rate = rates.false_discovery[frames.states]
        frame, ordinal = numbered_rows(self._trials(rates, frames))
        uniforms = ordinal_uniforms(streams, Purpose.CLUTTER_TRIAL, camera_frames, frame, ordinal)
        successes = frame[uniforms[:, 0] < rate[frame]]
        return np.bincount(successes, minlength=len(rate)).astype(np.int64)

    @staticmethod
    def _trials(rates: ClutterRates, frames: FrameCounts) -> Indices:
        rate = rates.false_discovery[frames.states]
        return np.maximum(np.rint(rate * frames.n_true - rates.confidence_threshold), 0).astype(np.int64)


CLUTTER_MODELS: Mapping[str, ClutterModel] = {"calibrated": Calibrated(), "thesis": Thesis(), "per_image": PerImage()}
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
