"""Shares of vessels that have a second box or come out in two parts, and of pairs that come out as one box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.core.arrays import Indices
from modsim3d.core.boxes import centres, sizes
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.bootstrap import Column, Entry, Key, Resampling, digits, nested, ratio, widened
from modsim3d.learn.match_shapes import Trials
from modsim3d.learn.match_types import THRESHOLDS, hits_and_trials
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.persistence import Consecutive, SightingStretches, Steps, inflation, steps_of, stretches_of

# ---- How long two vessels that overlap come out as one box, or do not ----


@dataclass(frozen=True, eq=False)
class ConsecutiveTrials:
    """Pairs that could have been merged, or vessels with a possible false positive, and which follow each other."""

    trials: Trials
    steps: Steps
    stretches: SightingStretches

    @classmethod
    def of(cls, labelled: LabelledSet, trials: Trials) -> ConsecutiveTrials:
        """Pairs of vessels with identities in frames with times."""
        pair = _identities(labelled, trials.vessels)
        return cls(
            trials,
            steps_of(labelled.images, trials.image, pair),
            stretches_of(labelled.images, trials.image, pair, np.zeros(len(pair), dtype=np.int64)),
        )

    def products(self) -> Consecutive:
        """Products of the deviations from the mean share. A case of which it is not sure whether the pair was tried
        counts by its weight. It has only hits, so the squares of deviations are those of as many hits and misses."""
        hits, weight = self.trials.hits, self.trials.weight
        share = float(np.clip(hits.sum() / max(weight.sum(), 1e-12), 0, 1))
        residual = hits - share * weight
        squares = hits * (1 - share) ** 2 + (weight - hits) * share**2
        a, b = self.steps.earlier, self.steps.later
        return Consecutive(
            residual[a] * residual[b], squares[a] * weight[b], self.steps.apart_s, self.trials.image[b], self.stretches
        )

    def inflation(self, correlation_s: float) -> float:
        """Variance of the mean share with a correlation time, over that of independent pairs."""
        return inflation(self.steps, len(self.trials.image), correlation_s)


def _identities(labelled: LabelledSet, vessels: Indices) -> Indices:
    """A number for the same two vessels, whichever comes first, −1 where one has no identity; shape (n,)."""
    both = np.sort(labelled.annotations.identity[vessels], axis=1)
    _, pair = np.unique(both, axis=0, return_inverse=True)
    return np.where(both[:, 0] >= 0, pair.ravel(), -1)


_NO_ROOM = (
    "false_positives: per_image, for a rate of false positives that counts second boxes and parts of vessels must be "
    "at least what these would make if every vessel were long"
)
_EXTRA = ("duplicates", "splits")
_MARGIN = 1e-4  # more than what the digits in the file can change


@dataclass(frozen=True)
class MultipleBoxForm:
    """Types among `match_types.NAMES` that the data show, with thresholds or None, and rough correlation times of
    merges and of false positives on vessels, 0 if they do not persist, the latter None if none lie there."""

    shown: tuple[tuple[str, float | None], ...]
    notes: tuple[str, ...]
    merge_s: float = 0.0
    on_vessel_s: float | None = None

    def estimate(self, observed: Outcomes, resampling: Resampling) -> LearnedMultipleBoxes:
        """The probability of each, and the correlation time of merges."""
        entries, merge_s, factor = [], None, dict[str, float]()
        if self.merge_s > 0:
            consecutive = ConsecutiveTrials.of(observed.labelled, observed.kinds.trials["merges"])
            merge_s = Entry(Key(("persistence", "merge_s")), consecutive.products().column(resampling))
            factor["merges"] = consecutive.inflation(float(merge_s.estimate))
        for name, _ in self.shown:
            sums = hits_and_trials(observed.kinds.trials[name], resampling)
            share = np.clip(ratio(sums[:, 0], sums[:, 1]), 0, 1)
            column = Column(share, "share", np.array(sums[0, 1]), factor.get(name, 1.0))
            entries.append(Entry(Key(("false_positives", name)), column))
        on_vessels = None
        if self.on_vessel_s is not None:
            on_vessels = LearnedOnVessels.of(observed, self.on_vessel_s, resampling)
        return LearnedMultipleBoxes(self, tuple(entries), merge_s, on_vessels)


PLACE = ("across", "down", "log width", "log height")
"""Where a false positive lies on its vessel: centre in the vessel's sides, logarithms of the ratios of sides."""


@dataclass(frozen=True, eq=False)
class LearnedOnVessels:
    """False positives on vessels: share of vessels that have one, lifetime (None for a frame), place and size (4,)."""

    share: Entry
    lifetime_s: Entry | None
    mean: Entry
    std: Entry

    @classmethod
    def of(cls, observed: Outcomes, lifetime_s: float, resampling: Resampling) -> LearnedOnVessels:
        """Their numbers; a rough lifetime of 0 means that they do not stay."""
        trials, on = observed.kinds.trials["on_vessels"], observed.kinds.on_vessels
        lifetime, factor = None, 1.0
        section = ("false_positives", "on_vessels")
        if lifetime_s > 0:
            consecutive = ConsecutiveTrials.of(observed.labelled, trials)
            lifetime = Entry(Key((*section, "lifetime_s")), consecutive.products().column(resampling))
            factor = consecutive.inflation(float(lifetime.estimate))
        hits, number = hits_and_trials(trials, resampling).T
        vessel_px = observed.labelled.annotations.boxes_px[on.vessel]
        box_px = observed.labelled.results.boxes_px[on.box]
        ratio_of_sides = np.log(np.maximum(sizes(box_px), 1e-6) / sizes(vessel_px))
        place = np.hstack([(centres(box_px) - centres(vessel_px)) / sizes(vessel_px), ratio_of_sides])
        image = observed.labelled.annotations.image[on.vessel]
        sums = resampling.sums(image, np.hstack([np.ones((len(place), 1)), place, place**2]))
        mean, square = ratio(sums[:, 1:5], sums[:, :1]), ratio(sums[:, 5:], sums[:, :1])
        std = np.sqrt(np.maximum(square - mean**2, 1e-12))
        counts, error = np.full(4, sums[0, 0]), std[0] * np.sqrt(factor / max(sums[0, 0], 1.0))
        mean, std = widened(mean, error), np.exp(widened(np.log(std), error / std[0] / np.sqrt(2)))
        return cls(
            Entry(Key((*section, "share")), Column(ratio(hits, number), "share", np.array(number[0]), factor)),
            lifetime,
            Entry(Key((*section, "mean"), axes=(PLACE,)), Column(mean, "mean", counts)),
            Entry(Key((*section, "std"), axes=(PLACE,)), Column(std, "positive", counts)),
        )

    def section(self) -> dict[str, Any]:
        """Section of a detector file."""
        lifetime = {} if self.lifetime_s is None else {"lifetime_s": digits(self.lifetime_s.estimate)}
        mean, std = (nested(entry.estimate) for entry in (self.mean, self.std))
        return {"share": digits(self.share.estimate), **lifetime, "mean": mean, "std": std}


@dataclass(frozen=True, eq=False)
class LearnedMultipleBoxes:
    """The probability of each kind; `merge_s` is None if merges do not persist, `on_vessels` if none lie on vessels."""

    form: MultipleBoxForm
    shares: tuple[Entry, ...]
    merge_s: Entry | None = None
    on_vessels: LearnedOnVessels | None = None

    def sections(self) -> dict[str, dict[str, Any]]:
        """Probabilities, thresholds that are not the defaults, and the correlation time of merges."""
        section: dict[str, Any] = {}
        if self.on_vessels is not None:
            section["on_vessels"] = self.on_vessels.section()
        for (name, least), entry in zip(self.form.shown, self.shares, strict=True):
            section[name] = digits(np.nan_to_num(entry.estimate))
            if least is not None and least != THRESHOLDS[name][1]:
                section[THRESHOLDS[name][0]] = least
        sections = {"false_positives": section} if section else {}
        if self.merge_s is not None and self.merge_s.estimate > 0:
            sections["persistence"] = {"merge_s": digits(self.merge_s.estimate)}
        return sections

    def state_section(self, state: int) -> dict[str, Any]:
        """Nothing in the states."""
        return {}


def choose_multiple_boxes(observed: Outcomes) -> MultipleBoxForm:
    """Choose the types that the data show."""
    kinds, notes = observed.kinds, list(observed.kinds.notes)
    merge_s, on_vessel_s = (
        0.0 if "persistence" in observed.without else _lasting_s(observed, name, key, notes)
        for name, key in (("merges", "persistence.merge_s"), ("on_vessels", "false_positives.on_vessels.lifetime_s"))
    )
    shown = tuple((name, kinds.thresholds.get(name)) for name in kinds.trials if name != "on_vessels")
    return MultipleBoxForm(shown, tuple(notes), merge_s, on_vessel_s if "on_vessels" in kinds.trials else None)


def _lasting_s(observed: Outcomes, name: str, key: str, notes: list[str]) -> float:
    """Rough correlation time of a kind; 0 with a note if it does not persist, or that is not sure."""
    trials = observed.kinds.trials.get(name)
    if trials is None or not len(observed.steps):
        return 0.0  # which the notes on the kind and on misses say
    products = ConsecutiveTrials.of(observed.labelled, trials).products()
    if not len(products):
        notes.append(f"{key}: 0; none could be seen in two frames with times")
        return 0.0
    correlation = products.correlation()
    if correlation.persists:
        return products.rough_time_s()
    notes.append(f"{key}: 0; {correlation.doubt}")
    return 0.0


def why_no_room(observed: Outcomes) -> str:
    """Note if a state has fewer false positives than second boxes and parts alone may make, with every vessel long,
    see `detector.file.agreement`; else empty."""
    sums = [(t.hits.sum(), t.weight.sum()) for name, t in observed.kinds.trials.items() if name in _EXTRA]
    extra = sum(float(np.clip(hits / weight, 0, 1)) for hits, weight in sums if weight > 0)
    results = observed.labelled.results
    false, true = (
        np.bincount(observed.image_state[results.image[rows]], minlength=len(observed.states))
        for rows in (observed.false, observed.true)
    )
    return "" if extra == 0 or np.all(false >= (extra + _MARGIN) * true) else _NO_ROOM
