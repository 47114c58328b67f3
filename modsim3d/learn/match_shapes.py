"""Boxes that look like a second box of a vessel, one of its two parts, or one box around two vessels.
Files do not say what a detection is. These rules read it from the boxes, in this order. Two parts: two boxes side by
side on an annotation, of which one may be its match, that together fit it better than either does, with an IoU of at
least `MIN_FIT`; the larger part detects it. One box around two: a box fits the box around two annotations that overlap
better than either of the two, with at least that IoU, and no other detection matches either of them. A second box: a
false positive that the matching rule would let match an annotation which has a match already. A false positive that
lies on a vessel by chance looks like one of these as well: `match_types` counts how many do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask
from modsim3d.core.boxes import areas, centres, intersections, iou, sizes, unions
from modsim3d.formats.matching import Rule, image_pairs

MIN_FIT = 0.5  # least IoU of two parts together with the vessel, and of a box around two vessels with their common one
MIN_ASPECT = 1.5  # least width over height of a vessel that may come out in two parts
MIN_WIDTH_PX = 4.0  # narrower ones never do: each part is at least a pixel wide
_MIN_INSIDE = 0.5
_SAME_HEIGHT = 0.6
_MAX_COMMON = 0.25
_MAX_OF_WIDTH = 0.9


@dataclass(frozen=True, eq=False)
class SoughtBoxes(Columns):
    """Annotations that are to be detected, ordered by image."""

    image: Indices  # shape (n,)
    boxes_px: Array  # shape (n, 4)
    row: Indices  # of the match in the results, −1 without one, shape (n,)
    match_px: Array  # its box, NaN without one, shape (n, 4)

    @property
    def found(self) -> Mask:
        """Mask of the boxes with a match, shape (n,)."""
        return self.row >= 0

    @property
    def aspect(self) -> Array:
        """Width over height, shape (n,)."""
        width, height = sizes(self.boxes_px).T
        return np.asarray(width / np.maximum(height, 1e-9))


@dataclass(frozen=True, eq=False)
class FalseBoxes(Columns):
    """False positives, ordered by image: row in the results (f,), image (f,) and box (f, 4)."""

    row: Indices
    image: Indices
    boxes_px: Array

    def without(self, rows: Indices) -> FalseBoxes:
        """All but those with some rows in the results."""
        return self.take(~np.isin(self.row, rows))

    def pairs(self, sought: SoughtBoxes) -> tuple[Indices, Indices]:
        """Places of these and of annotations in the same image that overlap, shapes (m,)."""
        pairs = [np.empty((2, 0), dtype=np.int64)]
        images = int(max(self.image.max(initial=-1), sought.image.max(initial=-1))) + 1
        for first, second in image_pairs(self.image, sought.image, images):
            near = intersections(self.boxes_px[first], sought.boxes_px[second]) > 0
            pairs.append(np.stack([first[near], second[near]]))
        first, second = np.concatenate(pairs, axis=1)
        return first, second


@dataclass(frozen=True, eq=False)
class Parts:
    """Annotations in two parts: places of the annotations, rows of the larger and of the smaller part, shapes (k,)."""

    place: Indices
    larger: Indices
    smaller: Indices


def two_parts(sought: SoughtBoxes, loose: FalseBoxes) -> Parts:
    """Annotations that two boxes side by side fit together."""
    first, place = loose.pairs(sought)
    part = _looks_part(loose.boxes_px[first], sought.boxes_px[place])
    part &= (sought.aspect[place] >= MIN_ASPECT) & (sizes(sought.boxes_px[place])[:, 0] >= MIN_WIDTH_PX)
    first, place = first[part], place[part]
    own = sought.found[place] & _looks_part(sought.match_px[place], sought.boxes_px[place])
    a, b = _twos(np.where(sought.found[place], NOBODY, place))
    where = np.concatenate([place[own], place[a]])
    loose_row, loose_px = loose.row[first], loose.boxes_px[first]
    own_row, own_px = sought.row[place[own]], sought.match_px[place[own]]
    rows = np.concatenate([[own_row, loose_row[own]], [loose_row[a], loose_row[b]]], axis=1)
    boxes = np.concatenate([[own_px, loose_px[own]], [loose_px[a], loose_px[b]]], axis=1)
    true_px, together = sought.boxes_px[where], iou(unions(*boxes), sought.boxes_px[where])
    apart = intersections(*boxes) <= _MAX_COMMON * np.minimum(*areas(boxes))
    level = _common_height(*boxes) >= _SAME_HEIGHT
    good = np.flatnonzero(apart & level & (together > np.maximum(*iou(boxes, true_px))) & (together >= MIN_FIT))
    kept = good[best_of(together[good], ~where[good], rows[0, good], rows[1, good])]
    larger = areas(boxes)[:, kept].argmax(axis=0)
    return Parts(where[kept], rows[larger, kept], rows[1 - larger, kept])


def _looks_part(boxes_px: Array, true_px: Array) -> Mask:
    """Mask of the boxes (m, 4) that lie on part of the width of annotations (m, 4)."""
    inside = intersections(boxes_px, true_px) >= _MIN_INSIDE * np.maximum(areas(boxes_px), 1e-9)
    narrow = sizes(boxes_px)[:, 0] <= _MAX_OF_WIDTH * sizes(true_px)[:, 0]
    return inside & narrow & (_common_height(boxes_px, true_px) >= _MIN_INSIDE)


def _common_height(a_px: Array, b_px: Array) -> Array:
    """Common height of boxes (m, 4) over the height of both together, shape (m,)."""
    common = np.minimum(a_px[:, 3], b_px[:, 3]) - np.maximum(a_px[:, 1], b_px[:, 1])
    whole = np.maximum(a_px[:, 3], b_px[:, 3]) - np.minimum(a_px[:, 1], b_px[:, 1])
    return np.asarray(common / np.maximum(whole, 1e-9))


def _twos(group: Indices) -> tuple[Indices, Indices]:
    """All pairs of places with the same group (n,) of at least 0."""
    order = np.argsort(group, kind="stable")
    order = order[group[order] >= 0]
    ordered, pairs = group[order], [np.empty((2, 0), dtype=np.int64)]
    for apart in range(1, int(np.bincount(ordered, minlength=1).max())):
        first = np.flatnonzero(ordered[apart:] == ordered[:-apart])
        pairs.append(np.stack([order[first], order[first + apart]]))
    a, b = np.concatenate(pairs, axis=1)
    return a, b


def second_boxes(sought: SoughtBoxes, loose: FalseBoxes, single: Mask, rule: Rule) -> tuple[Indices, Indices]:
    """Places of annotations (n,) with one vessel's match that have a second box, and rows of these boxes, (k,) each."""
    first, place = loose.pairs(sought)
    box_px, true_px = loose.boxes_px[first], sought.boxes_px[place]
    if rule.method == "centre":
        quality = -np.hypot(*(centres(box_px) - centres(true_px)).T)
        fits = quality >= -rule.most_distance_px
    else:
        quality = iou(box_px, true_px)
        fits = quality >= min(rule.least_iou, 1 - 1e-10)
    good = np.flatnonzero(fits & sought.found[place] & single[place])
    good = good[best_of(quality[good], ~place[good], loose.row[first[good]])]
    return place[good], loose.row[first[good]]


def on_vessels(sought: SoughtBoxes, loose: FalseBoxes) -> tuple[Indices, Indices]:
    """Places of annotations (n,) on which a false positive lies, and of these, (k,): each is of what shares most of
    it, and each annotation has one."""
    first, place = loose.pairs(sought)
    box_px = loose.boxes_px[first]
    share = intersections(box_px, sought.boxes_px[place]) / np.maximum(sizes(box_px).prod(axis=1), 1e-9)
    best = best_of(share, ~place, loose.row[first])
    return place[best], loose.row[first[best]]


def best_of(quality: Array, *taken: Indices) -> Indices:
    """Places of the best candidates (m,), by quality, each of numbers that no better one took in any column, (k,)."""
    gone, chosen = set[int](), []
    for place in np.argsort(-quality, kind="stable").tolist():
        wanted = {int(column[place]) for column in taken}
        if gone.isdisjoint(wanted):
            gone |= wanted
            chosen.append(place)
    return np.array(sorted(chosen), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class OverlapPairs(Columns):
    """Pairs of annotations that overlap, shapes (p,)."""

    larger: Indices  # place of the larger one
    smaller: Indices
    share: Array  # of the smaller that lies in the larger
    union_px: Array  # the box around both, shape (p, 4)

    @classmethod
    def of(cls, sought: SoughtBoxes, least_share: float) -> OverlapPairs:
        """All pairs of which so much of the smaller lies in the larger."""
        parts = [np.empty((2, 0), dtype=np.int64)]
        for first, second in image_pairs(sought.image, sought.image, int(sought.image.max(initial=-1)) + 1):
            near = (first < second) & (intersections(sought.boxes_px[first], sought.boxes_px[second]) > 0)
            parts.append(np.stack([first[near], second[near]]))
        pairs = np.concatenate(parts, axis=1)
        area = areas(sought.boxes_px)[pairs]
        larger, smaller = np.where(area[1] > area[0], pairs[::-1], pairs)
        a_px, b_px = sought.boxes_px[larger], sought.boxes_px[smaller]
        share = intersections(a_px, b_px) / np.maximum(area.min(axis=0), 1e-9)
        near = share >= least_share
        return cls(larger[near], smaller[near], share[near], unions(a_px, b_px)[near])

    def fits(self, sought: SoughtBoxes, pair: Indices, boxes_px: Array) -> tuple[Mask, Array]:
        """Whether boxes (..., 4) fit the box around pairs (...) and better than either; and their IoU with it."""
        together = iou(boxes_px, self.union_px[pair])
        alone = (iou(boxes_px, sought.boxes_px[member[pair]]) for member in (self.larger, self.smaller))
        fits: Mask = (together >= MIN_FIT) & (together > np.maximum(*alone))
        return fits, together


@dataclass(frozen=True, eq=False)
class CommonBoxes:
    """One box for two vessels, and pairs of which one vessel alone has a match."""

    pair: Indices  # index of the pair, shape (k,)
    row: Indices  # row of its box in the results, shape (k,)
    one_box: Mask  # pairs that have one box, be it around both or around one, shape (p,)


def common_boxes(sought: SoughtBoxes, loose: FalseBoxes, pairs: OverlapPairs, free: Mask) -> CommonBoxes:
    """Boxes around two annotations, of which at most one has a match, and which are both free (n,)."""
    found = np.stack([sought.found[pairs.larger], sought.found[pairs.smaller]])
    both_free = free[pairs.larger] & free[pairs.smaller]
    one_box = (found[0] != found[1]) & both_free
    alone = np.flatnonzero(one_box)
    owner = np.where(found[0], pairs.larger, pairs.smaller)[alone]
    fits, quality = pairs.fits(sought, alone, sought.match_px[owner])
    neither = np.flatnonzero(~found.any(axis=0) & both_free)
    order = neither[np.argsort(sought.image[pairs.larger[neither]], kind="stable")]
    union_px = pairs.union_px[order]
    around = SoughtBoxes(sought.image[pairs.larger[order]], union_px, np.full(len(order), NOBODY), union_px)
    first, place = loose.pairs(around)
    empty = order[place]
    free_fits, free_quality = pairs.fits(sought, empty, loose.boxes_px[first])
    pair = np.concatenate([alone[fits], empty[free_fits]])
    row = np.concatenate([sought.row[owner[fits]], loose.row[first[free_fits]]])
    quality = np.concatenate([quality[fits], free_quality[free_fits]])
    kept = best_of(quality, row, *(~member for member in (pairs.larger[pair], pairs.smaller[pair])))
    return CommonBoxes(pair[kept], row[kept], one_box)


# ---- Vessels and pairs of vessels that could have come out as two boxes or as one ----


@dataclass(frozen=True, eq=False)
class Trials(Columns):
    """Vessels, or pairs of vessels, that could have come out as too many boxes or too few; shapes (n,)."""

    image: Indices
    value: Array  # on which it depends: width over height, or the share of the smaller vessel in the larger
    hits: Array  # whether it did; what chance does is taken off, so it may be below 0 or above 1
    weight: Array  # how much it counts as a trial
    chance: Array  # how many look so by chance
    vessels: Indices  # the two annotations of a pair, `NOBODY` for a vessel, shape (n, 2)


def vessel_trials(
    sought: SoughtBoxes, tried: Mask, hit: Indices, chance: Array, extra_image: Indices | None = None
) -> Trials:
    """Trials of the vessels that are tried (n,), of which some were hit; hits of unknown vessels by their images."""
    hits = np.zeros(len(sought))
    hits[hit] = 1
    extra = np.empty(0, dtype=np.int64) if extra_image is None else extra_image
    none, number = np.zeros(len(extra)), int(tried.sum())
    return Trials(
        image=np.concatenate([sought.image[tried], extra]),
        value=np.concatenate([sought.aspect[tried], none]),
        hits=np.concatenate([(hits - chance)[tried], none + 1]),
        weight=np.concatenate([np.ones(number), none]),
        chance=np.concatenate([chance[tried], none]),
        vessels=np.full((number + len(extra), 2), NOBODY),
    )


def on_vessel_trials(sought: SoughtBoxes, rows: Indices, hit: Indices, chance: Array) -> Trials:
    """Trials of all annotations (n,), on some of which a false positive lies; `rows` are those of the annotations."""
    trials = vessel_trials(sought, np.ones(len(sought), dtype=bool), hit, chance)
    return replace(trials, vessels=np.column_stack([rows, rows]))


def pair_trials(
    sought: SoughtBoxes,
    rows: Indices,
    pairs: OverlapPairs,
    is_merged: Mask,
    hits: Array,
    chance: Array,
    unambiguous: Mask,
    one_box: Mask,
) -> Trials:
    """Pairs whose larger vessel is detected, and those with one box that may be around both. Of pairs with a vessel in
    common the one that overlaps most comes first; after one that came out, or perhaps did, the others had no chance."""
    free = pairs.share > _most(sought, pairs, is_merged)
    detected = sought.found.copy()
    detected[pairs.larger[is_merged]] = detected[pairs.smaller[is_merged]] = True
    clear = pairs.share > _most(sought, pairs, ~unambiguous & (detected[pairs.larger] != detected[pairs.smaller]))
    both = detected[pairs.larger] & detected[pairs.smaller]
    apart = detected[pairs.larger] & free & ~is_merged & (both | ~one_box)
    single = one_box & free & ~both & ~is_merged
    chosen = unambiguous & clear & (is_merged | apart | single)
    hits = np.where(apart, 0.0, hits)
    weight = np.where(apart | (single & detected[pairs.larger]), 1.0, hits)
    chance, vessels = np.where(apart, 0.0, chance), np.column_stack([rows[pairs.larger], rows[pairs.smaller]])
    return Trials(sought.image[pairs.larger], pairs.share, hits, weight, chance, vessels).take(chosen)


def _most(sought: SoughtBoxes, pairs: OverlapPairs, chosen: Mask) -> Array:
    """The largest overlap of either vessel of each pair in chosen pairs, 0 without one, shape (p,)."""
    most = np.zeros(len(sought))
    for member in (pairs.larger, pairs.smaller):
        np.maximum.at(most, member[chosen], pairs.share[chosen])
    return np.maximum(most[pairs.larger], most[pairs.smaller])
