"""Detections that match no known vessel, judged: of a vessel without a transponder, or false."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas, centres, intersections, iou
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched, Rule, image_pairs, match
from modsim3d.learn.bootstrap import Column, Entry, Resampling, resample, run_length_s, with_entries
from modsim3d.learn.learned import Learned
from modsim3d.learn.matches import Observed
from modsim3d.learn.voyage.non_ais.linking import AT_BORDER_PX, Links, link
from modsim3d.learn.voyage.non_ais.rates import (
    RateSource,
    StateRates,
    TimeSpan,
    Weighing,
    check_stretches,
    in_stretches,
    rates_of,
)
from modsim3d.learn.voyage.non_ais.tracklets import MIN_S, DurationTypes, Things, kinds_of, things_of

# ---- Where a vessel without a transponder passes a known one ----

_SAME_IOU = 0.5
_NEAR, _MIN_NEAR_PX = 0.25, 5.0  # how far about a vessel its box may be off, in heights of it and in pixels
_PASSES = 0.5  # the largest share of the life of what passes a vessel in which the two are close
_MOSTLY = 0.5  # share of a detection that lies in a box which it may be of


@dataclass(frozen=True, eq=False)
class CrossingTracks:
    """Boxes of vessels without a transponder in each image from the first detection to the last, by image."""

    image: Indices  # (n,), non-decreasing
    boxes_px: Array  # (n, 4)
    thing: Indices  # that each is of, (n,)

    @classmethod
    def of(cls, links: Links, chosen: Mask, labelled: LabelledSet) -> CrossingTracks:
        """Tracks of some linked detections (n,), of which each thing is one vessel."""
        images, none = labelled.images, np.empty(0, dtype=np.int64)
        image, boxes_px, number = [none], [np.empty((0, 4))], [none]
        for thing in np.unique(links.link[chosen]):
            rows = np.flatnonzero(chosen & (links.link == thing))
            rows = rows[np.argsort(links.time_s[rows])]
            seen_s, seen_px = links.time_s[rows], labelled.results.boxes_px[links.rows[rows]]
            same = images.sequence == images.sequence[links.image[rows[0]]]
            there = np.flatnonzero(same & (images.time_s >= seen_s[0]) & (images.time_s <= seen_s[-1]))
            image.append(there)
            number.append(np.full(len(there), thing))
            boxes_px.append(np.column_stack([np.interp(images.time_s[there], seen_s, edge) for edge in seen_px.T]))
        order = np.argsort(np.concatenate(image), kind="stable")
        return cls(np.concatenate(image)[order], np.concatenate(boxes_px)[order], np.concatenate(number)[order])


@dataclass(frozen=True, eq=False)
class Crossings:
    """Annotations and detections without information, since a vessel without a transponder is there."""

    annotations: Mask  # (T,)
    results: Mask  # (D,)


def crossings(tracks: CrossingTracks, links: Links, labelled: LabelledSet, matched: Matched) -> Crossings:
    """Known vessels to whose box a vessel without a transponder comes close; detections about them and at borders."""
    known, results, number = labelled.annotations, labelled.results, len(labelled.images)
    rows, places = _meetings(tracks, labelled, matched.rule)
    met, beside = np.zeros(len(known), dtype=bool), np.zeros(len(tracks.image), dtype=bool)
    met[rows] = beside[places] = True
    found = np.append(met, False)[matched.annotation]
    passing = tracks.image[beside], tracks.boxes_px[beside]
    for there_image, there_px in ((known.image[met], known.boxes_px[met]), passing):
        for row, place in image_pairs(results.image, there_image, number):
            boxes = results.boxes_px[row]
            inside = intersections(boxes, there_px[place]) >= _MOSTLY * areas(boxes)
            found[row[inside & (matched.annotation[row] < 0)]] = True
    found[links.rows[at_the_border(links, labelled)]] = True
    return Crossings(met & ~known.ignored, found)


def _meetings(tracks: CrossingTracks, labelled: LabelledSet, rule: Rule) -> tuple[Indices, Indices]:
    """Annotations and places of a track that touch in an image, or of which a detection may match the other, (n,). What
    stays with one known vessel for most of its life does not pass it: its truth may be off."""
    known, none = labelled.annotations, np.empty(0, dtype=np.int64)
    reach_px = rule.most_distance_px if rule.method == "centre" else 0.0
    met: list[tuple[Indices, Indices, Mask]] = [(none, none, np.empty(0, dtype=bool))]
    for row, place in image_pairs(known.image, tracks.image, len(labelled.images)):
        boxes, passing = known.boxes_px[row], tracks.boxes_px[place]
        margin = np.maximum(_NEAR * (boxes[:, 3:] - boxes[:, 1:2]), _MIN_NEAR_PX)
        overlap = (boxes[:, :2] - margin < passing[:, 2:]) & (passing[:, :2] < boxes[:, 2:] + margin)
        touch = np.asarray(overlap.all(axis=1))
        meet = touch | (np.linalg.norm(centres(boxes) - centres(passing), axis=1) <= reach_px)
        met.append((row[meet], place[meet], touch[meet]))
    rows, places, touch = (np.concatenate(columns) for columns in zip(*met, strict=True))
    # How long each thing is with each known vessel: in touch, and near enough to be matched with it.
    pairs = np.column_stack([tracks.thing[places], known.identity[rows]])
    couples, couple = np.unique(pairs, axis=0, return_inverse=True)
    couple = couple.ravel()
    most = _PASSES * np.bincount(tracks.thing, minlength=1)[couples[:, 0]]
    passes = np.zeros(len(rows), dtype=bool)
    for chosen in (touch, np.ones(len(rows), dtype=bool)):
        together = np.bincount(couple[chosen], minlength=len(couples))
        passes |= chosen & (together <= most)[couple]
    return rows[passes], places[passes]


def at_the_border(links: Links, labelled: LabelledSet) -> Indices:
    """Linked detections of known vessels that come into view or leave it, as places among the links. Where positions
    are not surely known, such a vessel may be in view a few frames earlier or later than the truth has it."""
    known, images = labelled.annotations, labelled.images
    of_known = _border(known.boxes_px, images.sizes_px[known.image])
    rows = np.flatnonzero(of_known.any(axis=1))
    rows = rows[np.argsort(images.time_s[known.image[rows]], kind="stable")]
    of_image = known.image[rows]
    time_s, below = images.time_s[of_image], _below_horizon(labelled, of_image, known.boxes_px[rows])
    found = []
    for place in np.flatnonzero(links.at_border & np.isfinite(links.time_s)).tolist():
        when, row = float(links.time_s[place]), links.rows[place]
        near = np.arange(*np.searchsorted(time_s, [when - links.longest_gap_s, when + links.longest_gap_s]))
        box, image = labelled.results.boxes_px[[row]], links.image[[place]]
        side, (top, bottom) = _border(box, images.sizes_px[image])[0], _below_horizon(labelled, image, box)[0]
        same = images.sequence[known.image[rows[near]]] == images.sequence[links.image[place]]
        same &= (of_known[rows[near]] & side).any(axis=1)
        common = np.minimum(below[near, 1], bottom) - np.maximum(below[near, 0], top)
        both = np.maximum(below[near, 1], bottom) - np.minimum(below[near, 0], top)
        if (same & (common >= _MOSTLY * both)).any():
            found.append(place)
    return np.array(found, dtype=np.int64)


def _below_horizon(labelled: LabelledSet, image: Indices, boxes_px: Array) -> Array:
    """Distances of the upper and the lower edge of boxes (n, 4) below the horizon of their images, (n, 2). On board,
    pitch moves the picture from frame to frame by more than the height of a far vessel. Where the horizon is unknown,
    edges are rows of the image."""
    a, b, c = labelled.images.half_planes[image].T
    with np.errstate(divide="ignore", invalid="ignore"):
        horizon = -(a * (boxes_px[:, 0] + boxes_px[:, 2]) / 2 + c) / b
    return boxes_px[:, [1, 3]] - np.where(np.isfinite(horizon), horizon, 0.0)[:, None]


def _border(boxes_px: Array, sizes_px: Array) -> Mask:
    """Whether boxes (n, 4) in images of a size (n, 2) lie at the left and at the right border, shape (n, 2)."""
    with np.errstate(invalid="ignore"):
        far = boxes_px[:, 2] >= sizes_px[:, 0] - AT_BORDER_PX
    return np.column_stack([boxes_px[:, 0] <= AT_BORDER_PX, far])


def fainter(tracks: CrossingTracks, labelled: LabelledSet, matched: Matched, threshold: float) -> Indices:
    """Rows of detections below the least confidence that lie where a vessel without a transponder is."""
    results = labelled.results
    faint = np.flatnonzero(results.confidence < threshold)
    if not len(faint) or not len(tracks.image):
        return faint[:0]
    faint = faint[match(labelled, replace(matched.rule, by_confidence=True)).annotation[faint] < 0]
    found = [
        faint[a][iou(results.boxes_px[faint[a]], tracks.boxes_px[b]) >= _SAME_IOU]
        for a, b in image_pairs(results.image[faint], tracks.image, len(labelled.images))
    ]
    return np.unique(np.concatenate([faint[:0], *found]))


_LIKELY, _PERHAPS = 0.5, 0.1  # probabilities from which a thing is taken for a vessel, and from which it may be one


@dataclass(frozen=True, eq=False)
class ClassifiedDetections:
    """Classes of the unmatched detections of a labelled set."""

    observed: Observed  # the set with its matches, before anything is left out
    links: Links  # the unmatched detections, linked
    things: Things  # what they are of
    kinds: DurationTypes  # the mixture of lifetimes, in one row
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
    def telling(self) -> Observed:
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
        weights = resampling.weights[:, self.things.first_image]
        kinds = kinds_of(self.things, weights, self.links.gap_s, self.least_s)
        likely, perhaps = self.kinds.lasting[0] >= _LIKELY, self.kinds.at_least(_PERHAPS)
        duration = kinds.of_thing[self.links.link]
        weighing = Weighing(self.links.image, duration, self.tells, kinds.lasting, likely, perhaps, self.empty)
        return rates_of(weighing, resampling, image_state, states, self.kinds.found, self.kinds.inflation)

    def own_rates(self, replicates: int, seed: int) -> tuple[StateRates, ...]:
        """Rates of false positives, resampled in runs that are long against the lifetimes of flicker."""
        images = self.observed.labelled.images
        resampling = resample(images, replicates, seed, run_length_s(images, float(self.kinds.short_s[0])))
        return self.rates(resampling, self.observed.image_state, self.observed.states)

    def corrected(self, learned: Learned) -> Learned:
        """Correct what was learned from `labelled` by the rate of false positives that is used. Detections are left out
        or kept as a whole; the mixture knows that a few of either are of the other kind."""
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


def classify_unmatched(
    observed: Observed, stretches: tuple[TimeSpan, ...] = (), least_s: float = MIN_S
) -> ClassifiedDetections:
    """Link the unmatched detections of a voyage, in images with a state, and judge them. In the stretches, on the clock
    of the images, nothing floats but known vessels; `least_s` is the least mean lifetime of what lasts as vessels do.
    Raises InputError if no image lies in a stretch that is marked as empty."""
    # What lies beside the place of a known vessel may be another one: nothing is taken for its part.
    observed = replace(observed, without=observed.without | {"on_vessels"})
    images = observed.labelled.images
    counts = observed.image_state >= 0
    check_stretches(stretches, images.time_s, counts)
    empty = in_stretches(stretches, images.time_s) & counts
    links = link(observed)
    things = things_of(links, images)
    kinds = kinds_of(things, np.ones((1, len(things.detections))), links.gap_s, least_s)
    return ClassifiedDetections(observed, links, things, kinds, stretches, empty, least_s)


def _free_share(observed: Observed) -> Array:
    """Share of the false detections of each state that are neither second boxes nor parts of vessels, (states,)."""
    results, states = observed.labelled.results, len(observed.states)
    free, every = (
        np.bincount(observed.image_state[results.image[rows]], minlength=states)
        for rows in (observed.false_positives, observed.false)
    )
    return free / np.maximum(every, 1)


def _scaled_share(column: Column, rate: StateRates, free: float) -> Column:
    """The share of false detections with the rate that is used. Of the odds of being false, the part `free`, those that
    are no second boxes or parts, changes with the rate."""
    share_before = np.clip(column.values, 0, 1 - 1e-12)
    odds = share_before / (1 - share_before) * (1 - free + free * rate.factor)
    share = odds / (1 + odds)
    true = float(column.counts * (1 - share_before[0]))
    false = float(rate.used.estimate * rate.used.counts)
    if share[0] > 0:
        # As many observations as give the logarithm of the odds its variance, 1 / false + 1 / true.
        variance = 1 / max(false, 0.5) + 1 / max(true, 0.5)
        counts = 1 / variance / max(float(share[0] * (1 - share[0])), 1e-9)
    else:  # none was false of the true ones in the images that tell the rate
        counts = true * float(rate.used.counts) / max(rate.images, 1)
    return replace(column, values=share, counts=np.array(counts), inflation=max(column.inflation, rate.used.inflation))
