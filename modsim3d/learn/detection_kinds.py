"""What each detection is, and how often vessels could have come out as two boxes or two vessels as one.

A run says it. In files the boxes say it (`detection_shapes`), and what chance does is taken off:

- False positives lie on vessels by chance. Those that are left as such are put into other frames of their state, half
  of them at another place across the image too, and what looks like a second box or a part there is counted.
- Where one of two overlapping vessels was missed, the box of the other may look like one around both. The errors of
  boxes of vessels that overlap none, about as large, say how often. Pairs whose boxes do not tell are no trials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import errors_between, move, sizes
from modsim3d.detector.records import DUPLICATE, FRAGMENT, MERGED, SPLIT
from modsim3d.formats.labelled import NOBODY, Images, LabelledSet
from modsim3d.formats.matching import Matched, Rule
from modsim3d.learn.detection_shapes import (
    LEAST_ASPECT,
    LEAST_WIDTH_PX,
    Loose,
    Overlapping,
    Sought,
    common_boxes,
    second_boxes,
    two_parts,
)
from modsim3d.learn.shuffled import SHUFFLES, shuffled

LEAST_OVERLAP = 0.05
"""Least share of the smaller of two vessels inside the larger for which they may come out as one box."""
_NEIGHBOURS = 60
_LONELY_NEEDED = 20
_MOST_ALIKE, _LEAST_TOLD = 0.04, 0.9


@dataclass(frozen=True, eq=False)
class Trials:
    """Vessels, or pairs of vessels, that could have come out as too many boxes or too few; shapes (n,).

    Attributes:
        image: Image of each.
        value: What it depends on: width over height, or the share of the smaller vessel in the larger.
        hits: Whether it did; what chance does is taken off, so it may be below 0 or above 1.
        weight: How much it counts as a trial.
        chance: How many look so by chance.
        vessels: The two annotations of a pair, `NOBODY` for a vessel, shape (n, 2).
    """

    image: Indices
    value: Array
    hits: Array
    weight: Array
    chance: Array
    vessels: Indices

    def where(self, chosen: Mask) -> Trials:
        """Some of them, shape (n,)."""
        return Trials(**{name: column[chosen] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class VesselPairs:
    """Pairs of annotations, the larger and the smaller, and a box, as rows; shapes (p,).

    Attributes:
        overlap: Share of the smaller that lies in the larger, shape (p,).
    """

    larger: Indices
    smaller: Indices
    box: Indices
    overlap: Array

    def at_least(self, overlap: float) -> VesselPairs:
        """Those that overlap so much."""
        chosen = self.overlap >= overlap - 1e-9
        return VesselPairs(**{name: column[chosen] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Kinds:
    """What detections are, as rows of results and annotations.

    Attributes:
        doubled: Second boxes, shape (d,).
        split: Annotations in two parts, and the larger parts, shape (2, k).
        fragments: The smaller parts, shape (f,).
        perhaps_parts: Matches of other annotations that look like parts of one that has no whole box, shape (q,).
        merged: Pairs with one box around both.
        one_box: Pairs of which one alone has a match, which may be around both.
        unclear: Pairs whose boxes do not tell whether that of the larger is around both. Also the other way round,
            where one is hardly larger.
        trials: By the name in `form.RICHER`.
    """

    doubled: Indices
    split: Indices
    fragments: Indices
    perhaps_parts: Indices
    merged: VesselPairs
    one_box: VesselPairs
    unclear: VesselPairs
    trials: dict[str, Trials]


_NO_ROWS = np.empty(0, dtype=np.int64)
_NO_PAIRS = VesselPairs(_NO_ROWS, _NO_ROWS, _NO_ROWS, np.empty(0))


def kinds_of(labelled: LabelledSet, matched: Matched, used: Mask) -> Kinds:
    """What the detections of the images that are used (I,) are: as a run says, or as their boxes look."""
    annotations, results = labelled.annotations, labelled.results
    rows = np.flatnonzero(matched.sought & used[annotations.image])
    match = matched.detection[rows]
    match_px = np.full((len(rows), 4), np.nan)
    match_px[match >= 0] = results.boxes_px[match[match >= 0]]
    sought = Sought(annotations.image[rows], annotations.boxes_px[rows], match, match_px)
    false = matched.false[used[results.image[matched.false]]]
    if matched.rule.method == "provenance" and results.kind is not None:
        return _as_the_run_says(labelled, sought, rows, false)
    loose = Loose(false, results.image[false], results.boxes_px[false])
    return _as_boxes_look(labelled.images, sought, rows, loose, matched.rule)


def _as_the_run_says(labelled: LabelledSet, sought: Sought, rows: Indices, false: Indices) -> Kinds:
    results = labelled.results
    assert results.kind is not None and results.partner is not None
    place = np.full(len(labelled.annotations) + 1, NOBODY)
    place[rows] = np.arange(len(rows))
    kind, own = results.kind, sought.found
    kind_of_match = np.where(own, np.append(kind, NOBODY)[sought.row], NOBODY)
    merged = np.flatnonzero((kind_of_match == MERGED) & (place[np.append(results.partner, NOBODY)[sought.row]] >= 0))
    smaller = place[results.partner[sought.row[merged]]]
    pairs = Overlapping.of(sought, LEAST_OVERLAP)
    keys = _unordered(pairs.larger, pairs.smaller, len(rows))
    is_merged = np.isin(keys, _unordered(merged, smaller, len(rows)))
    single, split = own & (kind_of_match != MERGED), np.flatnonzero(kind_of_match == SPLIT)
    doubled = false[kind[false] == DUPLICATE]
    nothing, none = np.zeros(len(rows)), np.zeros(len(pairs), dtype=bool)
    trials = {
        "merges": _pair_trials(
            sought, rows, pairs, is_merged, is_merged.astype(np.float64), np.zeros(len(pairs)), ~none, none
        ),
        "splits": _vessel_trials(sought, _long(sought, single), split, nothing),
        "duplicates": _vessel_trials(sought, single, split[:0], nothing, results.image[doubled]),
    }
    return Kinds(
        doubled=doubled,
        split=np.stack([rows[split], sought.row[split]]),
        fragments=false[kind[false] == FRAGMENT],
        perhaps_parts=_NO_ROWS,
        merged=VesselPairs(rows[merged], rows[smaller], sought.row[merged], np.ones(len(merged))),
        one_box=_NO_PAIRS,
        unclear=_NO_PAIRS,
        trials=trials,
    )


def _as_boxes_look(images: Images, sought: Sought, rows: Indices, loose: Loose, rule: Rule) -> Kinds:
    parts = two_parts(sought, loose)
    whole = np.ones(len(rows), dtype=bool)
    whole[parts.place] = False
    row = sought.row.copy()
    row[parts.place] = parts.larger
    detected = replace(sought, row=row)  # a vessel in two parts is not missed
    left = loose.without(np.concatenate([parts.larger, parts.smaller]))
    pairs = Overlapping.of(sought, LEAST_OVERLAP)
    alike, told = _telling(sought, pairs, whole)
    common = common_boxes(sought, left, pairs, whole)
    left = left.without(common.row)
    single = sought.found.copy()
    single[parts.place] = True
    for each in (pairs.larger, pairs.smaller):
        single[each[common.pair]] = False
    place, doubled = second_boxes(sought, left, single & whole, rule)
    left = left.without(doubled)

    chance = {name: np.zeros(len(rows)) for name in ("duplicates", "splits")}
    by_pair = np.zeros(len(pairs))
    for moved in shuffled(left, images):
        by_chance = two_parts(sought, moved).place
        np.add.at(chance["splits"], by_chance[(single & whole)[by_chance]], 1 / SHUFFLES)
        np.add.at(chance["duplicates"], second_boxes(sought, moved, single & whole, rule)[0], 1 / SHUFFLES)
        free = common_boxes(sought, moved, pairs, whole)
        np.add.at(by_pair, free.pair[np.isin(free.row, moved.row)], 1 / SHUFFLES)

    is_merged = np.zeros(len(pairs), dtype=bool)
    is_merged[common.pair] = True
    clear = (alike.max(axis=0) <= _MOST_ALIKE) & (told >= _LEAST_TOLD)
    owner_alike = np.where(sought.found[pairs.larger], alike[0], alike[1])
    by_error = np.where(common.one_box, owner_alike, 0.0)
    probable = np.where(common.one_box, (is_merged - by_error) / np.maximum(told - by_error, 0.5), 1.0 * is_merged)
    merges = _pair_trials(
        detected, rows, pairs, is_merged, probable - by_pair, by_error + by_pair, clear, common.one_box
    )
    one, owner = np.flatnonzero(common.one_box), np.where(sought.found[pairs.larger], pairs.larger, pairs.smaller)
    box = common.pair
    unclear = [
        (np.flatnonzero(~clear & (share > _MOST_ALIKE) & detected.found[first]), first, second)
        for share, first, second in (
            (np.ones(len(pairs)), pairs.larger, pairs.smaller),
            (alike[1], pairs.smaller, pairs.larger),
        )
    ]
    # A vessel whose box may be around another one, too, is not surely single.
    for pair, first, second in unclear:
        single[first[pair[~detected.found[second[pair]]]]] = False
    return Kinds(
        doubled=doubled,
        split=np.stack([rows[parts.place], parts.larger]),
        fragments=parts.smaller,
        perhaps_parts=_perhaps_parts(sought, loose),
        merged=VesselPairs(rows[pairs.larger[box]], rows[pairs.smaller[box]], common.row, pairs.share[box]),
        one_box=VesselPairs(
            rows[pairs.larger[one]], rows[pairs.smaller[one]], sought.row[owner[one]], pairs.share[one]
        ),
        unclear=VesselPairs(
            np.concatenate([rows[first[pair]] for pair, first, _ in unclear]),
            np.concatenate([rows[second[pair]] for pair, _, second in unclear]),
            np.concatenate([detected.row[first[pair]] for pair, first, _ in unclear]),
            np.concatenate([pairs.share[pair] for pair, _, _ in unclear]),
        ),
        trials={
            "merges": merges,
            "splits": _vessel_trials(sought, _long(sought, single), parts.place, chance["splits"]),
            "duplicates": _vessel_trials(sought, single, place, chance["duplicates"]),
        },
    )


def _perhaps_parts(sought: Sought, loose: Loose) -> Indices:
    """Rows of detections that look like the parts of an annotation which has no other match, whatever they match."""
    own = np.flatnonzero(sought.found)
    every = Loose(
        np.concatenate([loose.row, sought.row[own]]),
        np.concatenate([loose.image, sought.image[own]]),
        np.concatenate([loose.boxes_px, sought.match_px[own]]),
    )
    order = np.argsort(every.image, kind="stable")
    parts = two_parts(replace(sought, row=np.full(len(sought), NOBODY)), every.at(order))
    match = sought.row[parts.place]
    alone = (match < 0) | (match == parts.larger) | (match == parts.smaller)
    return np.concatenate([parts.larger[alone], parts.smaller[alone]])


def _long(sought: Sought, single: Mask) -> Mask:
    """Which single vessels may come out in two parts, shape (n,)."""
    wide = sizes(sought.boxes_px)[:, 0] >= LEAST_WIDTH_PX
    return single & wide & (sought.aspect >= LEAST_ASPECT)


def _vessel_trials(
    sought: Sought, tried: Mask, hit: Indices, chance: Array, extra_image: Indices | None = None
) -> Trials:
    """Trials of the vessels that are tried (n,), of which some were hit; hits of unknown vessels by their images."""
    hits = np.zeros(len(sought))
    hits[hit] = 1
    extra = _NO_ROWS if extra_image is None else extra_image
    none = np.zeros(len(extra))
    count = int(tried.sum()) + len(extra)
    return Trials(
        image=np.concatenate([sought.image[tried], extra]),
        value=np.concatenate([sought.aspect[tried], none]),
        hits=np.concatenate([(hits - chance)[tried], none + 1]),
        weight=np.concatenate([np.ones(int(tried.sum())), none]),
        chance=np.concatenate([chance[tried], none]),
        vessels=np.full((count, 2), NOBODY),
    )


def _pair_trials(
    sought: Sought,
    rows: Indices,
    pairs: Overlapping,
    is_merged: Mask,
    hits: Array,
    chance: Array,
    clear: Mask,
    one_box: Mask,
) -> Trials:
    """Pairs of detected vessels, and pairs with one box that may be around both.

    Of pairs with a vessel in common the one that overlaps most comes first, so another that came out as one box says
    that it did not, and after it the others had no chance. After one that perhaps did, the others tell nothing.
    """
    free = pairs.share > _most(sought, pairs, is_merged)
    detected = sought.found.copy()
    detected[pairs.larger[is_merged]] = detected[pairs.smaller[is_merged]] = True
    told = pairs.share > _most(sought, pairs, ~clear & (detected[pairs.larger] != detected[pairs.smaller]))
    both = detected[pairs.larger] & detected[pairs.smaller] & free & ~is_merged
    single = one_box & free & ~both & ~is_merged
    chosen = clear & told & (is_merged | both | single)
    hits = np.where(both, 0.0, hits)
    weight = np.where(both, 1.0, hits)
    chance, vessels = np.where(both, 0.0, chance), np.column_stack([rows[pairs.larger], rows[pairs.smaller]])
    return Trials(sought.image[pairs.larger], pairs.share, hits, weight, chance, vessels).where(chosen)


def _most(sought: Sought, pairs: Overlapping, chosen: Mask) -> Array:
    """The largest overlap of either vessel of each pair in chosen pairs, 0 without one, shape (p,)."""
    most = np.zeros(len(sought))
    for each in (pairs.larger, pairs.smaller):
        np.maximum.at(most, each[chosen], pairs.share[chosen])
    return np.maximum(most[pairs.larger], most[pairs.smaller])


def _unordered(a: Indices, b: Indices, number: int) -> Indices:
    """A number for each pair of places below a number, whichever comes first, shape (n,)."""
    return np.minimum(a, b) * number + np.maximum(a, b)


def _telling(sought: Sought, pairs: Overlapping, whole: Mask) -> tuple[Array, Array]:
    """How often a box of one vessel of each pair looks like one around both, and how often a box around both does.

    The box has the errors of vessels that overlap none and are about as large. Shapes (2, p), for the larger and the
    smaller, and (p,); 1 and 0 where too few are known.
    """
    lonely = sought.found & whole
    touching = Overlapping.of(sought, 1e-9)
    lonely[touching.larger] = lonely[touching.smaller] = False
    known = np.flatnonzero(lonely)
    count = min(_NEIGHBOURS, len(known))
    if len(known) < _LONELY_NEEDED or not len(pairs):
        return np.ones((2, len(pairs))), np.zeros(len(pairs))
    sides = np.tile(np.maximum(sizes(sought.boxes_px[known]), 1.0), 2)
    errors = errors_between(sought.match_px[known], sought.boxes_px[known]) / sides
    order = np.argsort(sides[:, :2].prod(axis=1), kind="stable")
    errors, area = errors[order], sides[order, :2].prod(axis=1)

    def share_that_fits(boxes_px: Array) -> Array:
        """Of boxes (p, 4) with such errors, the share that fits the box around the pair, shape (p,)."""
        ours = np.tile(np.maximum(sizes(boxes_px), 1.0), 2)
        middle = np.searchsorted(area, ours[:, :2].prod(axis=1))
        start = np.clip(middle - count // 2, 0, len(area) - count)
        near = errors[start[:, None] + np.arange(count)]
        drawn = move(boxes_px[:, None], near * ours[:, None])
        pair = np.broadcast_to(np.arange(len(pairs))[:, None], drawn.shape[:2])
        share: Array = pairs.fits(sought, pair, drawn)[0].mean(axis=1)
        return share

    alike = np.stack([share_that_fits(sought.boxes_px[each]) for each in (pairs.larger, pairs.smaller)])
    return alike, share_that_fits(pairs.union_px)
