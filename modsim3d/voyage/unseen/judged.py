"""Detections that match no known vessel, judged: of a vessel without a transponder, or false."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import LabelledSet, Results
from modsim3d.learn.learned import Learned
from modsim3d.learn.numbers.entries import Entry, with_entries
from modsim3d.learn.numbers.resampling import Column, Resampling, resample
from modsim3d.learn.observed.observed import Observed
from modsim3d.voyage.unseen.crossings import Crossings, Tracks, crossings, fainter
from modsim3d.voyage.unseen.lifetimes import LEAST_S, Kinds, kinds_of
from modsim3d.voyage.unseen.links import Links, link
from modsim3d.voyage.unseen.rates import RateSource, StateRates, Weighing, rates_of
from modsim3d.voyage.unseen.stretches import Stretch, check_stretches, in_stretches
from modsim3d.voyage.unseen.things import Things, things_of

_LIKELY, _PERHAPS = 0.5, 0.1
"""Probabilities from which a thing is taken for a vessel, and from which it may be one."""
_RUN_TIMES = 12.0
_LEAST_RUNS = 24


@dataclass(frozen=True, eq=False)
class Judged:
    """What became of the unmatched detections of a labelled set.

    Attributes:
        observed: The set with its matches, before anything is left out.
        links: The unmatched detections, linked.
        things: What they are of.
        kinds: The mixture of lifetimes, in one row.
        stretches: The stretches marked as empty.
        empty: Which images lie in them, shape (I,).
        least_s: Least mean lifetime of what lasts as vessels do.
    """

    observed: Observed
    links: Links
    things: Things
    kinds: Kinds
    stretches: tuple[Stretch, ...]
    empty: Mask
    least_s: float

    @cached_property
    def lasting(self) -> Array:
        """Probability that each thing lasts as vessels do, shape (N,)."""
        probability: Array = self.kinds.lasting[0][self.kinds.of_thing]
        return probability

    @cached_property
    def likely(self) -> Mask:
        """Which linked detections are taken for a vessel's, shape (n,)."""
        likely: Mask = (self.lasting >= _LIKELY)[self.links.link] & ~self.empty[self.links.image]
        return likely

    @cached_property
    def tracks(self) -> Tracks:
        """Where the vessels without a transponder are."""
        return Tracks.of(self.links, self.likely, self.observed.labelled)

    @cached_property
    def crossings(self) -> Crossings:
        """Where they pass known ones."""
        return crossings(self.tracks, self.links, self.observed.labelled, self.observed.matched)

    @cached_property
    def telling(self) -> Observed:
        """The set and its matches, but for known vessels of which nothing can be told where others pass them."""
        matched = self.observed.matched
        sought = matched.sought & ~self.crossings.annotations
        return replace(self.observed, matched=replace(matched, sought=sought))

    @cached_property
    def passing(self) -> Mask:
        """Which detections tell nothing, since vessels pass each other there or come into view, shape (D,)."""
        passing: Mask = self.crossings.results & ~self.empty[self.observed.labelled.results.image]
        return passing

    @cached_property
    def tells(self) -> Mask:
        """Which linked detections tell something: they are taken for a vessel's, or nothing passes there, (n,)."""
        tells: Mask = self.likely | ~self.passing[self.links.rows]
        return tells

    @cached_property
    def left_out(self) -> Mask:
        """Which detections are neither hits nor false, since a vessel without a transponder is there, shape (D,)."""
        left_out: Mask = self.passing.copy()
        left_out[self.links.rows[self.likely]] = True
        observed = self.observed
        left_out[fainter(self.tracks, observed.labelled, observed.matched, observed.threshold)] = True
        return left_out

    @cached_property
    def labelled(self) -> LabelledSet:
        """The set without them, and known vessels that they pass ignored: what is learned from."""
        kept, labelled = ~self.left_out, self.observed.labelled
        columns: dict[str, Any] = {
            k: None if each is None else each[kept] for k, each in vars(labelled.results).items()
        }
        annotations = replace(labelled.annotations, ignored=labelled.annotations.ignored | self.crossings.annotations)
        return replace(labelled, annotations=annotations, results=Results(**columns))

    def rates(self, resampling: Resampling, image_state: Indices, states: Sequence[str]) -> tuple[StateRates, ...]:
        """The rates of false positives in states of images (I,), with replicates of a resampling."""
        weights = resampling.weights[:, self.things.first_image]
        kinds = kinds_of(self.things, weights, self.links.gap_s, self.least_s)
        likely, perhaps = self.kinds.lasting[0] >= _LIKELY, self.kinds.at_least(_PERHAPS)
        duration = kinds.of_thing[self.links.link]
        weighing = Weighing(self.links.image, duration, self.tells, kinds.lasting, likely, perhaps, self.empty)
        return rates_of(weighing, resampling, image_state, states, self.kinds.found, self.kinds.inflation)

    def own_rates(self, replicates: int, seed: int) -> tuple[StateRates, ...]:
        """The same with a resampling of runs that are long against the lifetimes of flicker."""
        images = self.observed.labelled.images
        spans = [float(np.ptp(images.time_s[images.sequence == s])) for s in np.unique(images.sequence)]
        run_s = min(_RUN_TIMES * float(self.kinds.short_s[0]), float(np.nansum(spans)) / _LEAST_RUNS)
        resampling = resample(images, replicates, seed, run_s)
        return self.rates(resampling, self.observed.image_state, self.observed.states)

    def corrected(self, learned: Learned) -> Learned:
        """What was learned from `labelled`, with the rate of false positives that is used.

        Detections are left out or kept as a whole; the mixture knows that a few of either are of the other kind.
        """
        states = learned.observed.states
        rates = self.rates(learned.resampling, learned.observed.image_state, states)
        free = dict(zip(states, _free_share(learned.observed), strict=True))
        changed = {each.state: each for each in rates if each.source is not RateSource.ALL}

        def change(entry: Entry) -> Entry:
            rate = changed.get(entry.key.state or "")
            if rate is None:
                return entry
            if entry.key.names[0] == "false_discovery_rate":
                return Entry(entry.key, _scaled_share(entry.column, rate, free[rate.state]))
            return Entry(entry.key, rate.used) if entry.key.names[0] == "false_positives_per_image" else entry

        numbers = replace(learned.numbers, false_positives=with_entries(learned.numbers.false_positives, change))
        return replace(learned, numbers=numbers)


def judge(observed: Observed, stretches: tuple[Stretch, ...] = (), least_s: float = LEAST_S) -> Judged:
    """Link the unmatched detections of a voyage and judge them.

    Args:
        observed: The set, matched; of its images those with a state take part.
        stretches: Stretches in which nothing floats but known vessels, on the clock of the images.
        least_s: Least mean lifetime of what lasts as vessels do.

    Raises:
        InputError: No image lies in a stretch that is marked as empty.
    """
    images = observed.labelled.images
    counts = observed.image_state >= 0
    check_stretches(stretches, images.time_s, counts)
    empty = in_stretches(stretches, images.time_s) & counts
    links = link(observed)
    things = things_of(links, images)
    kinds = kinds_of(things, np.ones((1, len(things.detections))), links.gap_s, least_s)
    return Judged(observed, links, things, kinds, stretches, empty, least_s)


def _free_share(observed: Observed) -> Array:
    """Share of the false detections of each state that are neither second boxes nor parts of vessels, (states,)."""
    results, states = observed.labelled.results, len(observed.states)
    free, every = (
        np.bincount(observed.image_state[results.image[rows]], minlength=states)
        for rows in (observed.false_positives, observed.false)
    )
    return free / np.maximum(every, 1)


def _scaled_share(column: Column, rate: StateRates, free: float) -> Column:
    """The share of false detections with the rate that is used, of which the part `free` are no second boxes."""
    value = np.clip(column.values, 0, 1 - 1e-12)
    scaled = value / (1 - value) * (1 - free + free * rate.factor)
    share = scaled / (1 + scaled)
    true = float(column.counts * (1 - value[0]))
    false = float(rate.used.estimate * rate.used.counts)
    if share[0] > 0:
        # The variance of the logarithm of the odds is 1 / false + 1 / true, as if of so many observations.
        worth = 1 / (1 / max(false, 0.5) + 1 / max(true, 0.5)) / max(float(share[0] * (1 - share[0])), 1e-9)
    else:  # none was false of the true ones in the images that tell the rate
        worth = true * float(rate.used.counts) / max(rate.images, 1)
    return replace(column, values=share, counts=np.array(worth), inflation=max(column.inflation, rate.used.inflation))
