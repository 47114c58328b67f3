"""Rates of false positives where not everything that floats has a transponder: two bounds, and what lies between."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.io.validation import shown
from modsim3d.learn.bootstrap import Column, Resampling, ratio
from modsim3d.learn.voyage.logs.log import MIN_UNIX_S, utc_s
from modsim3d.scene.ais.options import time_text


class RateSource(Enum):
    """Rate of false positives that goes into the detector file."""

    EMPTY = "the stretches marked as empty"
    MIXTURE = "the mixture of lifetimes"
    ALL = "all unmatched detections that are not left out"


@dataclass(frozen=True, eq=False)
class Weighing:
    """Unmatched detections, and what speaks for each being of a vessel without a transponder."""

    image: Indices  # of each of n detections, (n,)
    duration: Indices  # which of D durations its thing has, (n,)
    tells: Mask  # which tell something; the others lie where vessels pass each other or come into view, (n,)
    lasting: Array  # probability that things of a duration last as vessels do, in each replicate, (rows, D)
    likely: Mask  # which of these are taken for vessels, (D,)
    perhaps: Mask  # which may be vessels, (D,)
    empty: Mask  # which images lie in stretches marked as empty, (I,)


@dataclass(frozen=True, eq=False)
class StateRates:
    """False positives in an image of one state."""

    state: str
    images: int
    unmatched: int  # detections that match nothing, but for second boxes and parts of known vessels
    taken_for_vessels: int  # those of them that are taken for a vessel's
    upper: Column  # if all of them are false, those that tell nothing, too
    lower: Column  # if all that may be a vessel's are of vessels
    mixture: Column | None  # by the mixture; None if nothing lasts as vessels do
    empty: Column | None  # in the stretches marked as empty; None if none of its images lies in one
    vessel_share: Column  # of the unmatched detections that tell something those of vessels, by the mixture
    kept: Column  # the rate of those that are learned from
    units: int  # number of runs or images that were resampled

    @property
    def source(self) -> RateSource:
        """Rate that is used."""
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
    """The rates in each state; the state of each image is −1 for none, (I,). `found` says that the data show things
    that last as vessels do, and `inflation` is by what flicker that stays raises the variance of that number."""
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


# ---- Stretches of time in which a user knows that the sea is empty ----

_SECONDS = re.compile(r"([0-9]+(?:\.[0-9]*)?)-([0-9]+(?:\.[0-9]*)?)")
_FORM = (
    "must be FROM-TO in seconds since the scene's first step, such as 120-300, or two UTC times, such as "
    "2024-01-04T10:02:00Z/2024-01-04T10:05:00Z"
)


@dataclass(frozen=True)
class TimeSpan:
    """From one time to another, both in seconds since the scene's first step."""

    first_s: float
    last_s: float
    start_s: float | None = field(default=None, compare=False)  # Unix time of that step if given in UTC, to show it so

    def __str__(self) -> str:
        """As it is given."""
        if self.start_s is None:
            return f"{self.first_s:g}-{self.last_s:g}"
        return f"{self.when(self.first_s)}/{self.when(self.last_s)}"

    def when(self, time_s: float) -> str:
        """A time since the scene's first step, in words."""
        return f"{time_s:g} s" if self.start_s is None else time_text(self.start_s + time_s)


def parse_stretches(text: str, start_s: float | None) -> tuple[TimeSpan, ...]:
    """Stretches from a text such as `120-300,900-1000`, or with UTC times and a slash between them. `start_s` is the
    Unix time of the scene's first step; None if the scene does not say. Raises InputError if a part has another form,
    ends before it begins, or is in UTC and the scene does not say when it is."""
    found = [_stretch(part.strip(), start_s) for part in text.split(",")]
    if problems := [each for each in found if isinstance(each, str)]:
        raise InputError("--empty", problems)
    return tuple(each for each in found if isinstance(each, TimeSpan))


def in_stretches(stretches: tuple[TimeSpan, ...], time_s: Array) -> Mask:
    """Mask of the times (n,) that lie in a stretch, its ends included, shape (n,)."""
    inside: Mask = np.zeros(len(time_s), dtype=bool)
    for each in stretches:
        inside |= (time_s >= each.first_s - 1e-9) & (time_s <= each.last_s + 1e-9)
    return inside


def check_stretches(stretches: tuple[TimeSpan, ...], time_s: Array, counts: Mask | None = None) -> None:
    """Raise InputError for a stretch in which no frame that counts lies, given the times of all frames, at least one,
    (n,), and which of them count, (n,); all if None."""
    for stretch in stretches:
        inside = in_stretches((stretch,), time_s)
        if not (inside if counts is None else inside & counts).any():
            low, high = (stretch.when(float(end)) for end in (np.nanmin(time_s), np.nanmax(time_s)))
            raise InputError("--empty", [f"{stretch}: no frame lies in it; they are from {low} to {high}"])


def _stretch(part: str, start_s: float | None) -> TimeSpan | str:
    """A stretch, or what is wrong with it."""
    seconds = _SECONDS.fullmatch(part)
    ends = [float(each) for each in seconds.groups()] if seconds else [utc_s(each) for each in part.split("/")]
    if len(ends) != 2 or any(math.isnan(each) for each in ends):
        return f"{_FORM} (got {shown(part)})"
    utc = not seconds or min(ends) >= MIN_UNIX_S
    if utc and start_s is None:
        return f"{part}: is in UTC, and the scene does not say when it starts: give seconds since its first step"
    zero = start_s if utc and start_s is not None else 0.0
    first_s, last_s = (each - zero for each in ends)
    return TimeSpan(first_s, last_s, zero if utc else None) if first_s < last_s else f"{part}: must end after it begins"
