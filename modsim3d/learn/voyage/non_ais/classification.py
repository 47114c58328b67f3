"""Detections that match no known vessel, judged: of a vessel without a transponder, or false."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas, centres, intersections, iou
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matching, Rule, image_pairs, match
from modsim3d.io.validation import shown
from modsim3d.learn.bootstrap import Column, Entry, Resampling, ratio, resample, run_length_s, with_entries
from modsim3d.learn.learned_detector import Estimates
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.voyage.logs.log import MIN_UNIX_S, utc_s
from modsim3d.learn.voyage.non_ais import duration_types, linking
from modsim3d.learn.voyage.non_ais.linking import Links
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
    weighing: Weighing, resampling: Resampling, state_of: Indices, states: Sequence[str], found: bool, inflation: float
) -> tuple[StateRates, ...]:
    """Rates by state, given that of each image, −1 for none, (I,), and whether things were `found` to last."""
    weights = resampling.weights
    rates = []
    for index, name in enumerate(states):
        in_state = state_of == index
        every = in_state[weighing.image]
        chosen = every & weighing.tells
        whole, marked = weights[:, in_state].sum(axis=1), weights[:, in_state & weighing.empty].sum(axis=1)
        image, duration = weighing.image[chosen], weighing.duration[chosen]
        found_in = resampling.counts(image, 2 * duration + weighing.empty[image], (weighing.lasting.shape[1], 2))
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
                images=int(in_state.sum()),
                unmatched=int(every.sum()),
                upper=rate(most),
                lower=rate(seen[:, ~weighing.perhaps].sum(axis=1)),
                mixture=rate(telling - lasting) if found else None,
                empty=rate(in_empty.sum(axis=1), marked) if marked[0] > 0 else None,
                vessel_share=Column(share, "fraction", np.array(telling[0])),
                kept=rate(kept.sum(axis=1)),
                units=resampling.units(in_state),
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
    """Stretches from a text such as `120-300,900-1000`, or UTC times with a slash, where the scene's Unix `start_s` is
    not None. Raises InputError if a part has another form, ends before it begins, or is in UTC without a start."""
    parts = [_stretch(part.strip(), start_s) for part in text.split(",")]
    if problems := [part for part in parts if isinstance(part, str)]:
        raise InputError("--empty", problems)
    return tuple(part for part in parts if isinstance(part, TimeSpan))


def in_stretches(stretches: tuple[TimeSpan, ...], time_s: Array) -> Mask:
    """Mask of the times (n,) that lie in a stretch, its ends included, shape (n,)."""
    inside: Mask = np.zeros(len(time_s), dtype=bool)
    for stretch in stretches:
        inside |= (time_s >= stretch.first_s - 1e-9) & (time_s <= stretch.last_s + 1e-9)
    return inside


def check_stretches(stretches: tuple[TimeSpan, ...], time_s: Array, counts: Mask | None = None) -> None:
    """Raise InputError for a stretch without any of the counted frames, all if None, at one or more times, (n,)."""
    for stretch in stretches:
        inside = in_stretches((stretch,), time_s)
        if not (inside if counts is None else inside & counts).any():
            low, high = (stretch.when(float(end)) for end in (np.nanmin(time_s), np.nanmax(time_s)))
            raise InputError("--empty", [f"{stretch}: no frame lies in it; they are from {low} to {high}"])


def _stretch(part: str, start_s: float | None) -> TimeSpan | str:
    seconds = _SECONDS.fullmatch(part)
    ends = [float(text) for text in seconds.groups()] if seconds else [utc_s(text) for text in part.split("/")]
    if len(ends) != 2 or any(math.isnan(end) for end in ends):
        return f"{_FORM} (got {shown(part)})"
    utc = not seconds or min(ends) >= MIN_UNIX_S
    if utc and start_s is None:
        return f"{part}: is in UTC, and the scene does not say when it starts: give seconds since its first step"
    zero = start_s if utc and start_s is not None else 0.0
    first_s, last_s = (end - zero for end in ends)
    return TimeSpan(first_s, last_s, zero if utc else None) if first_s < last_s else f"{part}: must end after it begins"


# ---- Where a vessel without a transponder passes a known one ----

_SAME_IOU = 0.5
_NEAR, _MIN_NEAR_PX = 0.25, 5.0  # how far about a vessel its box may be off, in heights of it and in pixels
_PASSES = 0.5  # the largest share of the life of what passes a vessel in which the two are close
_MIN_INSIDE = 0.5  # share of a detection that lies in a box which it may be of


@dataclass(frozen=True, eq=False)
class CrossingTracks:
    """Boxes of vessels without a transponder in each image from the first detection to the last, by image."""

    image: Indices  # (n,), non-decreasing
    boxes_px: Array  # (n, 4)
    tracklet: Indices  # that each is of, (n,)

    @classmethod
    def of(cls, links: Links, chosen: Mask, labelled: LabelledSet) -> CrossingTracks:
        """Tracks of some linked detections (n,), of which each thing is one vessel."""
        images, none = labelled.images, np.empty(0, dtype=np.int64)
        image, boxes_px, number = [none], [np.empty((0, 4))], [none]
        for tracklet in np.unique(links.link[chosen]):
            rows = np.flatnonzero(chosen & (links.link == tracklet))
            rows = rows[np.argsort(links.time_s[rows])]
            seen_s, seen_px = links.time_s[rows], labelled.results.boxes_px[links.rows[rows]]
            same = images.sequence == images.sequence[links.image[rows[0]]]
            frames = np.flatnonzero(same & (images.time_s >= seen_s[0]) & (images.time_s <= seen_s[-1]))
            image.append(frames)
            number.append(np.full(len(frames), tracklet))
            boxes_px.append(np.column_stack([np.interp(images.time_s[frames], seen_s, edge) for edge in seen_px.T]))
        order = np.argsort(np.concatenate(image), kind="stable")
        return cls(np.concatenate(image)[order], np.concatenate(boxes_px)[order], np.concatenate(number)[order])


@dataclass(frozen=True, eq=False)
class Crossings:
    """Annotations and detections without information, since a vessel without a transponder is there."""

    annotations: Mask  # (T,)
    results: Mask  # (D,)


def crossings(tracks: CrossingTracks, links: Links, labelled: LabelledSet, matched: Matching) -> Crossings:
    """Known vessels to whose box a vessel without a transponder comes close; detections about them and at borders."""
    truth, results, number = labelled.annotations, labelled.results, len(labelled.images)
    rows, places = _meetings(tracks, labelled, matched.rule)
    met, beside = np.zeros(len(truth), dtype=bool), np.zeros(len(tracks.image), dtype=bool)
    met[rows] = beside[places] = True
    nearby = np.append(met, False)[matched.annotation]
    passing = tracks.image[beside], tracks.boxes_px[beside]
    for there_image, there_px in ((truth.image[met], truth.boxes_px[met]), passing):
        for row, place in image_pairs(results.image, there_image, number):
            boxes = results.boxes_px[row]
            inside = intersections(boxes, there_px[place]) >= _MIN_INSIDE * areas(boxes)
            nearby[row[inside & (matched.annotation[row] < 0)]] = True
    nearby[links.rows[at_the_border(links, labelled)]] = True
    return Crossings(met & ~truth.ignored, nearby)


def _meetings(tracks: CrossingTracks, labelled: LabelledSet, rule: Rule) -> tuple[Indices, Indices]:
    """Annotations and places of a track that touch, or whose detection may match the other, (n,), not for most of the
    life of the latter: then the truth may be off."""
    truth, none = labelled.annotations, np.empty(0, dtype=np.int64)
    reach_px = rule.most_distance_px if rule.method == "centre" else 0.0
    met: list[tuple[Indices, Indices, Mask]] = [(none, none, np.empty(0, dtype=bool))]
    for row, place in image_pairs(truth.image, tracks.image, len(labelled.images)):
        boxes, passing = truth.boxes_px[row], tracks.boxes_px[place]
        margin = np.maximum(_NEAR * (boxes[:, 3:] - boxes[:, 1:2]), _MIN_NEAR_PX)
        overlap = (boxes[:, :2] - margin < passing[:, 2:]) & (passing[:, :2] < boxes[:, 2:] + margin)
        touch = np.asarray(overlap.all(axis=1))
        meet = touch | (np.linalg.norm(centres(boxes) - centres(passing), axis=1) <= reach_px)
        met.append((row[meet], place[meet], touch[meet]))
    rows, places, touch = (np.concatenate(columns) for columns in zip(*met, strict=True))
    # How long each thing is with each known vessel: in touch, and near enough to be matched with it.
    pairs = np.column_stack([tracks.tracklet[places], truth.identity[rows]])
    couples, couple = np.unique(pairs, axis=0, return_inverse=True)
    couple = couple.ravel()
    most = _PASSES * np.bincount(tracks.tracklet, minlength=1)[couples[:, 0]]
    passes = np.zeros(len(rows), dtype=bool)
    for chosen in (touch, np.ones(len(rows), dtype=bool)):
        passes |= chosen & (np.bincount(couple[chosen], minlength=len(couples)) <= most)[couple]
    return rows[passes], places[passes]


def at_the_border(links: Links, labelled: LabelledSet) -> Indices:
    """Linked detections, as places, of known vessels that come or leave, some frames off where positions are unsure."""
    truth, images = labelled.annotations, labelled.images
    of_known = _border(truth.boxes_px, images.sizes_px[truth.image])
    rows = np.flatnonzero(of_known.any(axis=1))
    rows = rows[np.argsort(images.time_s[truth.image[rows]], kind="stable")]
    of_image = truth.image[rows]
    time_s, below = images.time_s[of_image], _below_horizon(labelled, of_image, truth.boxes_px[rows])
    places = []
    for place in np.flatnonzero(links.at_border & np.isfinite(links.time_s)).tolist():
        when, row = float(links.time_s[place]), links.rows[place]
        near = np.arange(*np.searchsorted(time_s, [when - links.longest_gap_s, when + links.longest_gap_s]))
        box, image = labelled.results.boxes_px[[row]], links.image[[place]]
        side, (top, bottom) = _border(box, images.sizes_px[image])[0], _below_horizon(labelled, image, box)[0]
        same = images.sequence[truth.image[rows[near]]] == images.sequence[links.image[place]]
        same &= (of_known[rows[near]] & side).any(axis=1)
        common = np.minimum(below[near, 1], bottom) - np.maximum(below[near, 0], top)
        both = np.maximum(below[near, 1], bottom) - np.minimum(below[near, 0], top)
        if (same & (common >= _MIN_INSIDE * both)).any():
            places.append(place)
    return np.array(places, dtype=np.int64)


def _below_horizon(labelled: LabelledSet, image: Indices, boxes_px: Array) -> Array:
    """Distances of upper and lower edges of boxes (n, 4) below the horizon, (n, 2), which pitch on board moves by more
    than a far vessel's height; rows of the image where it is unknown."""
    a, b, c = labelled.images.half_planes[image].T
    with np.errstate(divide="ignore", invalid="ignore"):
        horizon = -(a * (boxes_px[:, 0] + boxes_px[:, 2]) / 2 + c) / b
    return boxes_px[:, [1, 3]] - np.where(np.isfinite(horizon), horizon, 0.0)[:, None]


def _border(boxes_px: Array, sizes_px: Array) -> Mask:
    """Whether boxes (n, 4) in images of a size (n, 2) lie at the left and at the right border, shape (n, 2)."""
    with np.errstate(invalid="ignore"):
        far = boxes_px[:, 2] >= sizes_px[:, 0] - linking.AT_BORDER_PX
    return np.column_stack([boxes_px[:, 0] <= linking.AT_BORDER_PX, far])


def fainter(tracks: CrossingTracks, labelled: LabelledSet, matched: Matching, threshold: float) -> Indices:
    """Rows of detections below the least confidence that lie where a vessel without a transponder is."""
    results = labelled.results
    faint = np.flatnonzero(results.confidence < threshold)
    if not len(faint) or not len(tracks.image):
        return faint[:0]
    faint = faint[match(labelled, replace(matched.rule, by_confidence=True)).annotation[faint] < 0]
    parts = [
        faint[a][iou(results.boxes_px[faint[a]], tracks.boxes_px[b]) >= _SAME_IOU]
        for a, b in image_pairs(results.image[faint], tracks.image, len(labelled.images))
    ]
    return np.unique(np.concatenate([faint[:0], *parts]))


_LIKELY, _PERHAPS = 0.5, 0.1  # probabilities from which a thing is taken for a vessel, and from which it may be one


@dataclass(frozen=True, eq=False)
class ClassifiedDetections:
    """Classes of the unmatched detections of a labelled set."""

    observed: Outcomes  # the set with its matches, before anything is left out
    links: Links  # the unmatched detections, linked
    tracklets: linking.Tracklets  # what they are of
    kinds: duration_types.DurationTypes  # the mixture of lifetimes, in one row
    stretches: tuple[TimeSpan, ...]  # those marked as empty
    empty: Mask  # which images lie in them, (I,)
    least_s: float  # least mean lifetime of what lasts as vessels do

    @cached_property
    def lasting(self) -> Array:
        """Probability that each thing lasts as vessels do, shape (N,)."""
        return np.asarray(self.kinds.lasting[0][self.kinds.of_thing])

    @cached_property
    def likely(self) -> Mask:
        """Mask of the linked detections that are taken for a vessel's, shape (n,)."""
        return (self.lasting >= _LIKELY)[self.links.link] & ~self.empty[self.links.image]

    @cached_property
    def tracks(self) -> CrossingTracks:
        """Tracks of the vessels without a transponder."""
        return CrossingTracks.of(self.links, self.likely, self.observed.labelled)

    @cached_property
    def crossings(self) -> Crossings:
        """Places where they pass known ones."""
        return crossings(self.tracks, self.links, self.observed.labelled, self.observed.matched)

    @cached_property
    def telling(self) -> Outcomes:
        """The set and its matches, but for known vessels of which nothing can be told where others pass them."""
        matched = self.observed.matched
        sought = matched.sought & ~self.crossings.annotations
        return replace(self.observed, matched=replace(matched, sought=sought))

    @cached_property
    def passing(self) -> Mask:
        """Mask of the detections without information: vessels pass each other there or come into view, shape (D,)."""
        return self.crossings.results & ~self.empty[self.observed.labelled.results.image]

    @cached_property
    def tells(self) -> Mask:
        """Mask of the linked detections with information: they are taken for a vessel's, or nothing passes, (n,)."""
        return self.likely | ~self.passing[self.links.rows]

    @cached_property
    def left_out(self) -> Mask:
        """Mask of the detections neither hits nor false, since a vessel without a transponder is there, shape (D,)."""
        left_out: Mask = self.passing.copy()
        left_out[self.links.rows[self.likely]] = True
        observed = self.observed
        left_out[fainter(self.tracks, observed.labelled, observed.matched, observed.threshold)] = True
        return left_out

    @cached_property
    def labelled(self) -> LabelledSet:
        """The set without them, and known vessels that they pass ignored: what is learned from."""
        kept, labelled = ~self.left_out, self.observed.labelled
        annotations = replace(labelled.annotations, ignored=labelled.annotations.ignored | self.crossings.annotations)
        return replace(labelled, annotations=annotations, results=labelled.results.take(kept))

    def rates(self, resampling: Resampling, image_state: Indices, states: Sequence[str]) -> tuple[StateRates, ...]:
        """The rates of false positives in states of images (I,), with replicates of a resampling."""
        weights = resampling.weights[:, self.tracklets.first_image]
        kinds = duration_types.kinds_of(self.tracklets, weights, self.links.gap_s, self.least_s)
        likely, perhaps = self.kinds.lasting[0] >= _LIKELY, self.kinds.at_least(_PERHAPS)
        duration = kinds.of_thing[self.links.link]
        weighing = Weighing(self.links.image, duration, self.tells, kinds.lasting, likely, perhaps, self.empty)
        return rates_of(weighing, resampling, image_state, states, self.kinds.found, self.kinds.inflation)

    def own_rates(self, replicates: int, seed: int) -> tuple[StateRates, ...]:
        """Rates of false positives, resampled in runs that are long against the lifetimes of flicker."""
        images = self.observed.labelled.images
        resampling = resample(images, replicates, seed, run_length_s(images, float(self.kinds.short_s[0])))
        return self.rates(resampling, self.observed.image_state, self.observed.states)

    def corrected(self, learned: Estimates) -> Estimates:
        """Correct what was learned from `labelled` by the rate of false positives that is used, as the mixture says."""
        states = learned.observed.states
        rates = self.rates(learned.resampling, learned.observed.image_state, states)
        free = dict(zip(states, _free_share(learned.observed), strict=True))
        changed = {rate.state: rate for rate in rates if rate.source is not RateSource.ALL}

        def change(entry: Entry) -> Entry:
            rate = changed.get(entry.key.state or "")
            if rate is None:
                return entry
            if entry.key.names[0] == "false_discovery_rate":
                return Entry(entry.key, _scaled_share(entry.column, rate, free[rate.state]))
            return Entry(entry.key, rate.used) if entry.key.names[0] == "false_positives_per_image" else entry

        numbers = replace(learned.numbers, false_positives=with_entries(learned.numbers.false_positives, change))
        return replace(learned, numbers=numbers)


def classify_unmatched(
    observed: Outcomes, stretches: tuple[TimeSpan, ...] = (), least_s: float = duration_types.MIN_S
) -> ClassifiedDetections:
    """Link a voyage's unmatched detections, in images with a state, and judge them, given empty stretches on their
    clock, and the least mean lifetime of vessels. Raises InputError if no image lies in a stretch."""
    # What lies beside the place of a known vessel may be another one: nothing is taken for its part.
    observed = replace(observed, without=observed.without | {"on_vessels"})
    images = observed.labelled.images
    counts = observed.image_state >= 0
    check_stretches(stretches, images.time_s, counts)
    empty = in_stretches(stretches, images.time_s) & counts
    links = linking.link(observed)
    tracklets = linking.tracklets_of(links, images)
    kinds = duration_types.kinds_of(tracklets, np.ones((1, len(tracklets.detections))), links.gap_s, least_s)
    return ClassifiedDetections(observed, links, tracklets, kinds, stretches, empty, least_s)


def _free_share(observed: Outcomes) -> Array:
    """Share of the false positives of each state that are neither second boxes nor parts of vessels, (states,)."""
    results, states = observed.labelled.results, len(observed.states)
    free, every = (
        np.bincount(observed.image_state[results.image[rows]], minlength=states)
        for rows in (observed.false_positives, observed.false)
    )
    return free / np.maximum(every, 1)


def _scaled_share(column: Column, rate: StateRates, free: float) -> Column:
    """The share of false positives with the rate that is used. Of the odds of being false, the part `free`, those that
    are no second boxes or parts, changes with the rate."""
    share_before = np.clip(column.values, 0, 1 - 1e-12)
    odds = share_before / (1 - share_before) * (1 - free + free * rate.factor)
    share = odds / (1 + odds)
    true = float(column.counts * (1 - share_before[0]))
    false = float(rate.used.estimate * rate.used.counts)
    if share[0] > 0:
        # As many observations as give the logarithm of the odds its variance, 1 / false + 1 / true.
        counts = 1 / (1 / max(false, 0.5) + 1 / max(true, 0.5)) / max(float(share[0] * (1 - share[0])), 1e-9)
    else:  # none was false of the true ones in the images that tell the rate
        counts = true * float(rate.used.counts) / max(rate.images, 1)
    return replace(column, values=share, counts=np.array(counts), inflation=max(column.inflation, rate.used.inflation))
