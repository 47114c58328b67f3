"""How many false positives a detector's model expects, and whether their rate is the one in the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes
from modsim3d.detector.chain import clutter_rates
from modsim3d.detector.clutter_models import FrameCounts
from modsim3d.detector.merges_and_splits import LEAST_SPLIT_PX
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part
from modsim3d.detector.records import FALSE_POSITIVE, FRAGMENT, PERSISTENT, SPLIT, TRUE
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.pairs import lag_pairs
from modsim3d.verify.parameters import Parameter
from modsim3d.verify.rate_measures import DiscoveryRate, ImageRate


@dataclass(frozen=True, eq=False)
class ExpectedClutter:
    """False positives to be expected in each image, given what was detected; shapes (s,).

    Attributes:
        due: Whether the detector runs.
        transient: Mean number in one image only.
        persistent: Mean number of persistent ones.
        extras: Mean number of second boxes of vessels.
        extra_variance: Variance of the number of second boxes.
        dispersion: Variance of the number of transient ones over its mean: 1 for a Poisson number.
    """

    due: Mask
    transient: Array
    persistent: Array
    extras: Array
    extra_variance: Array
    dispersion: Array

    @property
    def all(self) -> Array:
        """Mean number of every kind."""
        return self.transient + self.persistent + self.extras


def expected_clutter(model: DetectorModel, evidence: Evidence) -> ExpectedClutter:
    """What the detector's own model of false positives makes of the images."""
    images, numbers, rates = evidence.frames, model.clutter.numbers, clutter_rates(model)
    due = np.concatenate([model.gates.due(seen.frames) for seen in evidence.cameras])
    extras, variance = _extras(model, evidence)
    frames = FrameCounts(images.state, due, images.n_kept, extras)
    means, share = numbers.means(rates, frames), model.clutter.persistent_share
    return ExpectedClutter(due, (1 - share) * means, share * means, extras, variance, numbers.dispersion(rates, frames))


@dataclass(frozen=True, eq=False)
class ClutterEvidence:
    """What the rates of false positives are measured from."""

    model: DetectorModel
    evidence: Evidence
    expected: ExpectedClutter

    def persistent_variance(self, ours: Mask) -> float:
        """Variance of the number of persistent ones in some images of s.

        Those in two images Δt apart share min(m, m′)·e^(−Δt/lifetime).
        """
        rows = np.flatnonzero(ours & (self.expected.persistent > 0))
        if not len(rows):
            return 0.0
        images, mean = self.evidence.frames, self.expected.persistent[rows]
        total, lifetime = float(mean.sum()), self.model.clutter.lifetime_s
        for later, earlier, apart in lag_pairs(images.camera[rows, None], images.time_s[rows], lifetime):
            total += 2 * float((np.exp(-apart / lifetime) * np.minimum(mean[later], mean[earlier])).sum())
        return total


class RateCheck(Protocol):
    """Measures the rate of false positives that one model has."""

    def of_state(self, seen: ClutterEvidence, s: int) -> Parameter:
        """The rate of a state."""

    def overall(self, seen: ClutterEvidence) -> list[Parameter]:
        """The rate of all states together, if that says more."""


@dataclass(frozen=True)
class DiscoveryRateCheck:
    """The false discovery rate.

    Attributes:
        falls_short: Whether the model's own rule aims at another rate than the file's.
    """

    falls_short: bool = False

    def of_state(self, seen: ClutterEvidence, s: int) -> Parameter:
        """The rate of a state."""
        state = seen.model.states[s]
        rate = state.false_discovery_rate
        return Parameter(
            f"states.{state.name}.false_discovery_rate",
            Part.FALSE_POSITIVES,
            self._measure(seen, seen.evidence.frames.state == s),
            rate,
            state=state.name,
            promised=rate if self.falls_short else None,
            note="asked: what the rule of eq. 7.35 gives here" if self.falls_short else "",
        )

    def overall(self, seen: ClutterEvidence) -> list[Parameter]:
        """The rate of all states together."""
        measure = self._measure(seen, np.ones(len(seen.evidence.frames.state), dtype=bool))
        promised = self._promised(seen) if self.falls_short else None
        name = "false discovery rate, all states"
        return [Parameter(name, Part.FALSE_POSITIVES, measure, in_file=False, promised=promised)]

    @staticmethod
    def _promised(seen: ClutterEvidence) -> float | None:
        """The share of false positives that the states' rates ask for together."""
        kept = seen.evidence.frames.n_kept
        rate = seen.model.column("false_discovery_rate")[seen.evidence.frames.state]
        asked = float((kept * rate / (1 - rate)).sum())
        return asked / (asked + float(kept.sum())) if kept.sum() else None

    @staticmethod
    def _measure(seen: ClutterEvidence, ours: Mask) -> DiscoveryRate | None:
        images, expected = seen.evidence.frames, seen.expected
        true = float(images.n_kept[ours].sum())
        if not true:
            return None
        mean = float(expected.all[ours].sum())
        variance = float((expected.transient * expected.dispersion + expected.extra_variance)[ours].sum())
        variance += seen.persistent_variance(ours)
        inflation = variance / mean if mean > 0 else 1.0
        return DiscoveryRate(float(images.n_false[ours].sum()), true, mean, inflation or 1.0)


class ImageRateCheck:
    """The number of false positives in an image."""

    def of_state(self, seen: ClutterEvidence, s: int) -> Parameter:
        """The rate of a state."""
        state = seen.model.states[s]
        return Parameter(
            f"states.{state.name}.false_positives_per_image",
            Part.FALSE_POSITIVES,
            self._measure(seen, s),
            state.false_positives_per_image,
            state=state.name,
        )

    def overall(self, seen: ClutterEvidence) -> list[Parameter]:
        """Nothing: images of different rates have no common one."""
        return []

    @staticmethod
    def _measure(seen: ClutterEvidence, s: int) -> ImageRate | None:
        ours, expected, clutter = seen.evidence.frames.state == s, seen.expected, seen.evidence.false_detections
        found = int(np.isin(clutter.kind, (FALSE_POSITIVE, PERSISTENT))[clutter.state == s].sum())
        images = float(expected.due[ours].sum())
        if not images:
            return None
        mean = float((expected.transient + expected.persistent)[ours].sum())
        variance = float((expected.transient * expected.dispersion)[ours].sum()) + seen.persistent_variance(ours)
        return ImageRate(found, images, mean / images, variance / mean if mean else 1.0)


RATE_CHECKS: Mapping[str, RateCheck] = {
    "calibrated": DiscoveryRateCheck(),
    "thesis": DiscoveryRateCheck(falls_short=True),
    "per_image": ImageRateCheck(),
}
"""By the name of the model of false positives; a model that is not here is reported as unchecked."""


def second_box_candidates(model: DetectorModel, evidence: Evidence) -> tuple[Indices, Mask]:
    """True detections that may be doubled or split, and which of them are long enough to be split."""
    true_detections, clutter = evidence.true_detections, evidence.false_detections
    single = np.flatnonzero((true_detections.kind == TRUE) | (true_detections.kind == SPLIT))
    instances = true_detections.instance[single]
    placed = sizes(true_detections.boxes_px[single])[:, 0]
    pieces = np.flatnonzero(clutter.kind == FRAGMENT)
    of = {int(chance): int(row) for row, chance in zip(pieces, clutter.instance[pieces], strict=True)}
    split = np.flatnonzero(true_detections.kind[single] == SPLIT)
    other = np.array([of[int(chance)] for chance in instances[split]], dtype=np.int64)
    placed[split] += sizes(clutter.boxes_px[other])[:, 0]  # both parts together
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    return single, model.merges_and_splits.looks_long(truth[instances]) & (placed >= LEAST_SPLIT_PX)


def _extras(model: DetectorModel, evidence: Evidence) -> tuple[Array, Array]:
    """Mean and variance of the number of second boxes in each image, shapes (s,)."""
    rule, size = model.merges_and_splits, len(evidence.frames.state)
    if not rule.duplicates and not rule.splits:
        return np.zeros(size), np.zeros(size)
    single, long = second_box_candidates(model, evidence)
    chance = rule.duplicates + rule.splits * long
    image = _images_of(evidence, evidence.true_detections.instance[single])
    return (
        np.bincount(image, chance, minlength=size).astype(np.float64),
        np.bincount(image, chance * (1 - chance), minlength=size).astype(np.float64),
    )


def _images_of(evidence: Evidence, instances: Indices) -> Indices:
    """Row of `FrameTable` of instances."""
    first = np.cumsum([0, *(len(seen.frames) for seen in evidence.cameras)])
    return first[evidence.instances.camera[instances]] + evidence.instances.frame[instances]
