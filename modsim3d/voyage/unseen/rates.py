"""Rates of false positives where not everything that floats has a transponder: two bounds, and what lies between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.numbers.resampling import Column, Resampling, ratio


class RateSource(Enum):
    """Which rate of false positives goes into the detector file."""

    EMPTY = "the stretches marked as empty"
    MIXTURE = "the mixture of lifetimes"
    ALL = "all unmatched detections that are not left out"


@dataclass(frozen=True, eq=False)
class Weighing:
    """Unmatched detections, and what speaks for each being of a vessel without a transponder.

    Attributes:
        image: Image of each of n detections, shape (n,).
        duration: Which of D durations its thing has, shape (n,).
        tells: Which tell something; the others lie where vessels pass each other or come into view, shape (n,).
        lasting: Probability that things of a duration last as vessels do, in each replicate, shape (rows, D).
        likely: Whether these are taken for vessels, shape (D,).
        perhaps: Whether they may be vessels, shape (D,).
        empty: Which images lie in stretches marked as empty, shape (I,).
    """

    image: Indices
    duration: Indices
    tells: Mask
    lasting: Array
    likely: Mask
    perhaps: Mask
    empty: Mask


@dataclass(frozen=True, eq=False)
class StateRates:
    """False positives in an image of one state.

    Attributes:
        state: Its name.
        images: Number of its images.
        unmatched: Detections that match nothing, but for second boxes and parts of known vessels.
        taken_for_vessels: Those of them that are taken for a vessel's.
        upper: If all of them are false, those that tell nothing, too.
        lower: If all that may be a vessel's are of vessels.
        mixture: By the mixture; None if nothing lasts as vessels do.
        empty: In the stretches marked as empty; None if none of its images lies in one.
        vessel_share: Share of the unmatched detections that tell something that are of vessels, by the mixture.
        kept: The rate of those that are learned from.
        units: Number of runs or images that were resampled.
    """

    state: str
    images: int
    unmatched: int
    taken_for_vessels: int
    upper: Column
    lower: Column
    mixture: Column | None
    empty: Column | None
    vessel_share: Column
    kept: Column
    units: int

    @property
    def source(self) -> RateSource:
        """Which rate is used."""
        if self.empty is not None:
            return RateSource.EMPTY
        return RateSource.ALL if self.mixture is None else RateSource.MIXTURE

    @property
    def used(self) -> Column:
        """The rate that is used."""
        return self.empty or self.mixture or self.kept

    @property
    def factor(self) -> Array:
        """The rate that is used over that of the detections that are learned from, shape (rows,)."""
        factor = ratio(self.used.values, self.kept.values)
        return np.where(np.isfinite(factor), factor, 1.0)


def rates_of(
    weighing: Weighing,
    resampling: Resampling,
    image_state: Indices,
    states: Sequence[str],
    found: bool,
    inflation: float,
) -> tuple[StateRates, ...]:
    """The rates in each state.

    Args:
        weighing: The unmatched detections.
        resampling: Weights of the images.
        image_state: State of each image, −1 for none, shape (I,).
        states: Their names.
        found: Whether the data show things that last as vessels do.
        inflation: Factor by which flicker that stays raises the variance of the number of its detections.
    """
    weights = resampling.weights
    rates = []
    for index, name in enumerate(states):
        ours = image_state == index
        every = ours[weighing.image]
        chosen = every & weighing.tells
        whole, marked = weights[:, ours].sum(axis=1), weights[:, ours & weighing.empty].sum(axis=1)
        image, duration = weighing.image[chosen], weighing.duration[chosen]
        cells = (weighing.lasting.shape[1], 2)
        found_in = resampling.counts(image, 2 * duration + weighing.empty[image], cells)
        seen, in_empty = found_in.sum(axis=2), found_in[:, :, 1]

        def rate(amount: Array, images: Array = whole) -> Column:
            return Column(np.nan_to_num(ratio(amount, images)), "rate", np.array(images[0]), inflation)

        most = resampling.counts(weighing.image[every], np.zeros(int(every.sum()), dtype=np.int64), ())
        telling, lasting = seen.sum(axis=1), (seen * weighing.lasting).sum(axis=1)
        kept = np.where(weighing.likely, in_empty, seen)
        share = np.nan_to_num(ratio(lasting, telling))
        rates.append(
            StateRates(
                state=name,
                images=int(ours.sum()),
                unmatched=int(every.sum()),
                taken_for_vessels=int(weighing.likely[duration].sum()),
                upper=rate(most),
                lower=rate(seen[:, ~weighing.perhaps].sum(axis=1)),
                mixture=rate(telling - lasting) if found else None,
                empty=rate(in_empty.sum(axis=1), marked) if marked[0] > 0 else None,
                vessel_share=Column(share, "fraction", np.array(telling[0])),
                kept=rate(kept.sum(axis=1)),
                units=resampling.units(ours),
            )
        )
    return tuple(rates)
