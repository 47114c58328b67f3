"""Type of each detection, and how often vessels could have come out as two boxes or two vessels as one.
A run says it. In files the boxes say it (`match_shapes`), and what chance does is taken off. False positives that are
left are put into other frames of their state, half of them at another place across the image too, and what looks like
a second box or a part there is counted. Where one of two overlapping vessels was missed, the box of the other may look
like one around both: errors of boxes of vessels that overlap none, about as large, say how often. Pairs whose boxes do
not tell are no trials. Types that the data do not clearly show count as if they did not exist."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask
from modsim3d.core.boxes import errors_between, iou, move, sizes
from modsim3d.core.text import counted
from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.detector.records import DUPLICATE, FRAGMENT, MERGED, ON_VESSEL, SPLIT
from modsim3d.formats.labelled import Images, LabelledSet
from modsim3d.formats.matching import Matching, Rule
from modsim3d.learn import match_shapes
from modsim3d.learn.bootstrap import SIGNIFICANT, Resampling, resample, spread
from modsim3d.learn.match_shapes import CommonBoxes, FalseBoxes, OverlapPairs, SoughtBoxes, Trials

# ---- How surely a box says whether it is around one ----

_NEIGHBOURS = 60
_LONELY_NEEDED = 20
MAX_MISTAKEN = 0.04  # share of the boxes of one vessel alone that may look like one around both until they tell nothing
_MIN_RECOGNIZED = 0.9


@dataclass(frozen=True, eq=False)
class Recognition:
    """Shares of boxes of p pairs that look like one around both vessels."""

    mistaken: Array  # of boxes of the larger and of the smaller vessel alone, shape (2, p)
    recognized: Array  # of boxes around both, shape (p,)

    @property
    def unambiguous(self) -> Mask:
        """Pairs whose boxes tell whether they are around both, shape (p,)."""
        return np.asarray((self.mistaken.max(axis=0) <= MAX_MISTAKEN) & (self.recognized >= _MIN_RECOGNIZED))

    @classmethod
    def of(cls, sought: SoughtBoxes, pairs: OverlapPairs, whole: Mask) -> Recognition:
        """Find it from the errors of vessels that overlap none, are about as large and are not in two parts (n,). If
        few are known, all boxes of one vessel are mistaken, and none around both is recognized."""
        lonely = sought.found & whole
        touching = OverlapPairs.of(sought, 1e-9)
        lonely[touching.larger] = lonely[touching.smaller] = False
        rows = np.flatnonzero(lonely)
        count = min(_NEIGHBOURS, len(rows))
        if len(rows) < _LONELY_NEEDED or not len(pairs):
            return cls(np.ones((2, len(pairs))), np.zeros(len(pairs)))
        sides = np.tile(np.maximum(sizes(sought.boxes_px[rows]), 1.0), 2)
        errors = errors_between(sought.match_px[rows], sought.boxes_px[rows]) / sides
        order = np.argsort(sides[:, :2].prod(axis=1), kind="stable")
        errors, area = errors[order], sides[order, :2].prod(axis=1)

        def share_that_fits(boxes_px: Array) -> Array:
            """Share of boxes (p, 4) with such errors that fit the box around the pair, shape (p,)."""
            box_sides = np.tile(np.maximum(sizes(boxes_px), 1.0), 2)
            start = np.clip(np.searchsorted(area, box_sides[:, :2].prod(axis=1)) - count // 2, 0, len(area) - count)
            drawn = move(boxes_px[:, None], errors[start[:, None] + np.arange(count)] * box_sides[:, None])
            pair = np.broadcast_to(np.arange(len(pairs))[:, None], drawn.shape[:2])
            return np.asarray(pairs.fits(sought, pair, drawn)[0].mean(axis=1))

        mistaken = np.stack([share_that_fits(sought.boxes_px[member]) for member in (pairs.larger, pairs.smaller)])
        return cls(mistaken, share_that_fits(pairs.union_px))


# ---- False positives put into other frames ----

SHUFFLES = 8  # how often they are put elsewhere


def shuffled(loose: FalseBoxes, images: Images) -> Iterator[FalseBoxes]:
    """False positives in other frames of the same state; every other time moved across the image as well."""
    sequence = np.where(np.isfinite(images.time_s), images.sequence, -1)
    sizes_px = np.nan_to_num(images.sizes_px, nan=-1.0).astype(np.int64)
    keys = np.column_stack([images.condition, images.source, sequence, sizes_px])
    group = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(group, kind="stable")
    first = np.searchsorted(group[order], group)
    number = np.bincount(group)[group]
    position = np.empty(len(images), dtype=np.int64)
    position[order] = np.arange(len(images))
    width = images.sizes_px[loose.image, 0]
    for k in range(SHUFFLES):
        step = (number * (2 * k + 1)) // (2 * SHUFFLES)
        other = order[first + (position - first + step) % number]
        boxes = loose.boxes_px
        if k % 2:
            room = width - sizes(boxes)[:, 0]
            x = (boxes[:, 0] + room * (k + 1) / (SHUFFLES + 2)) % np.maximum(room, 1e-9)
            boxes = boxes + np.where((room > 0) & np.isfinite(x), x - boxes[:, 0], 0.0)[:, None] * [1, 0, 1, 0]
        image, kept = other[loose.image], np.flatnonzero(step[loose.image])  # too few frames have their own vessels
        kept = kept[np.argsort(image[kept], kind="stable")]
        yield FalseBoxes(loose.row[kept], image[kept], boxes[kept])


MIN_OVERLAP = 0.05  # least share of the smaller of two vessels inside the larger for which they may come out as one box


@dataclass(frozen=True, eq=False)
class VesselPairs(Columns):
    """Pairs of annotations, the larger and the smaller, and a box, as rows; shapes (p,)."""

    larger: Indices
    smaller: Indices
    box: Indices
    overlap: Array  # share of the smaller that lies in the larger

    def at_least(self, overlap: float) -> VesselPairs:
        """Pairs that overlap so much."""
        return self.take(self.overlap >= overlap - 1e-9)


@dataclass(frozen=True, eq=False)
class MatchTypes:
    """Types of detections, as rows of results and annotations."""

    doubled: Indices  # second boxes, shape (d,)
    copies: bool  # whether second boxes fit their vessels about as well as the first ones do
    on_vessels: VesselBoxes  # false positives on vessels; second boxes among them unless those are copies
    split: Indices  # annotations in two parts, and the larger parts, shape (2, k)
    fragments: Indices  # the smaller parts, shape (f,)
    perhaps_parts: Indices  # matches of other annotations that look like parts of one with no whole box, shape (q,)
    merged: VesselPairs  # pairs with one box around both
    one_box: VesselPairs  # pairs of which one alone has a match, which may be around both
    ambiguous: VesselPairs  # whose boxes do not tell whether the larger's is around both; either way if hardly so
    trials: dict[str, Trials]  # by the name in `learned.RICHER`


@dataclass(frozen=True, eq=False)
class VesselBoxes:
    """Annotations and a false positive on each, as rows; shapes (k,)."""

    vessel: Indices
    box: Indices


_NO_ROWS = np.empty(0, dtype=np.int64)
NONE = VesselBoxes(_NO_ROWS, _NO_ROWS)
_NO_PAIRS = VesselPairs(_NO_ROWS, _NO_ROWS, _NO_ROWS, np.empty(0))


def kinds_of(labelled: LabelledSet, matched: Matching, used: Mask) -> MatchTypes:
    """Types of the detections of the images that are used (I,): as a run says, or as their boxes look."""
    annotations, results = labelled.annotations, labelled.results
    rows = np.flatnonzero(matched.sought & used[annotations.image])
    match = matched.detection[rows]
    match_px = np.full((len(rows), 4), np.nan)
    match_px[match >= 0] = results.boxes_px[match[match >= 0]]
    sought = SoughtBoxes(annotations.image[rows], annotations.boxes_px[rows], match, match_px)
    false = matched.false[used[results.image[matched.false]]]
    if matched.rule.method == "provenance" and results.kind is not None:
        return _as_the_run_says(labelled, sought, rows, false)
    loose = FalseBoxes(false, results.image[false], results.boxes_px[false])
    return _as_boxes_look(labelled.images, sought, rows, loose, matched.rule)


def _as_the_run_says(labelled: LabelledSet, sought: SoughtBoxes, rows: Indices, false: Indices) -> MatchTypes:
    results = labelled.results
    assert results.kind is not None and results.partner is not None
    place = np.full(len(labelled.annotations) + 1, NOBODY)
    place[rows] = np.arange(len(rows))
    kind, own = results.kind, sought.found
    kind_of_match = np.where(own, np.append(kind, NOBODY)[sought.row], NOBODY)
    merged = np.flatnonzero((kind_of_match == MERGED) & (place[np.append(results.partner, NOBODY)[sought.row]] >= 0))
    smaller = place[results.partner[sought.row[merged]]]
    pairs = OverlapPairs.of(sought, MIN_OVERLAP)
    keys = _unordered(pairs.larger, pairs.smaller, len(rows))
    is_merged = np.isin(keys, _unordered(merged, smaller, len(rows)))
    single, split = own & (kind_of_match != MERGED), np.flatnonzero(kind_of_match == SPLIT)
    doubled = false[kind[false] == DUPLICATE]
    nothing, none = np.zeros(len(rows)), np.zeros(len(pairs), dtype=bool)
    hits = is_merged.astype(np.float64)
    on = false[kind[false] == ON_VESSEL]
    on = on[place[results.partner[on]] >= 0]
    trials = {
        "merges": match_shapes.pair_trials(sought, rows, pairs, is_merged, hits, np.zeros(len(pairs)), ~none, none),
        "splits": match_shapes.vessel_trials(sought, _long(sought, single), split, nothing),
        "duplicates": match_shapes.vessel_trials(sought, single, split[:0], nothing, results.image[doubled]),
        "on_vessels": match_shapes.on_vessel_trials(sought, rows, place[results.partner[on]], nothing),
    }
    return MatchTypes(
        doubled=doubled,
        copies=True,
        on_vessels=VesselBoxes(results.partner[on], on),
        split=np.stack([rows[split], sought.row[split]]),
        fragments=false[kind[false] == FRAGMENT],
        perhaps_parts=_NO_ROWS,
        merged=VesselPairs(rows[merged], rows[smaller], sought.row[merged], np.ones(len(merged))),
        one_box=_NO_PAIRS,
        ambiguous=_NO_PAIRS,
        trials=trials,
    )


def _as_boxes_look(images: Images, sought: SoughtBoxes, rows: Indices, loose: FalseBoxes, rule: Rule) -> MatchTypes:
    parts = match_shapes.two_parts(sought, loose)
    whole = np.ones(len(rows), dtype=bool)
    whole[parts.place] = False
    row = sought.row.copy()
    row[parts.place] = parts.larger
    detected = replace(sought, row=row)  # a vessel in two parts is not missed
    left = loose.without(np.concatenate([parts.larger, parts.smaller]))
    pairs = OverlapPairs.of(sought, MIN_OVERLAP)
    common = match_shapes.common_boxes(sought, left, pairs, whole)
    left = left.without(common.row)
    single = sought.found.copy()
    single[parts.place] = True
    for member in (pairs.larger, pairs.smaller):
        single[member[common.pair]] = False
    place, doubled = match_shapes.second_boxes(sought, left, single & whole, rule)
    copies = _copies(sought, left, place, doubled)
    loose_on, left = left.without(doubled) if copies else left, left.without(doubled)
    chance = _by_chance(sought, left, pairs, single & whole, whole, images, rule)
    vessel, on_vessel = match_shapes.on_vessels(sought, loose_on)
    by_chance = np.zeros(len(sought))
    for moved in shuffled(loose_on, images):
        np.add.at(by_chance, match_shapes.on_vessels(sought, moved)[0], 1 / SHUFFLES)
    # Only those that lie anywhere meet vessels by chance; of F, of which a share c would, (F − H)/(1 − c) lie anywhere.
    meeting = by_chance.sum() / max(len(loose_on.row), 1)
    by_chance *= min((len(loose_on.row) - len(vessel)) / max(len(loose_on.row) * (1 - meeting), 1e-9), 1.0)
    recognition = Recognition.of(sought, pairs, whole)
    merges = _merge_trials(detected, rows, pairs, common, recognition, chance["merges"])
    ambiguous = _ambiguous_pairs(detected, pairs, recognition)
    # A vessel whose box may be around another one, too, is not surely single.
    single[ambiguous.larger[~detected.found[ambiguous.smaller]]] = False
    box, one = common.pair, np.flatnonzero(common.one_box)
    owner = np.where(sought.found[pairs.larger], pairs.larger, pairs.smaller)[one]
    return MatchTypes(
        doubled=doubled,
        copies=copies,
        on_vessels=VesselBoxes(rows[vessel], on_vessel),
        split=np.stack([rows[parts.place], parts.larger]),
        fragments=parts.smaller,
        perhaps_parts=_perhaps_parts(sought, loose),
        merged=VesselPairs(rows[pairs.larger[box]], rows[pairs.smaller[box]], common.row, pairs.share[box]),
        one_box=VesselPairs(rows[pairs.larger[one]], rows[pairs.smaller[one]], sought.row[owner], pairs.share[one]),
        ambiguous=replace(ambiguous, larger=rows[ambiguous.larger], smaller=rows[ambiguous.smaller]),
        trials={
            "merges": merges,
            "splits": match_shapes.vessel_trials(sought, _long(sought, single), parts.place, chance["splits"]),
            "duplicates": match_shapes.vessel_trials(sought, single, place, chance["duplicates"]),
            "on_vessels": match_shapes.on_vessel_trials(sought, rows, vessel, by_chance),
        },
    )


_COPIES = 0.25  # quantile of the IoU of matches that second boxes have at least in the median if they are copies


def _copies(sought: SoughtBoxes, loose: FalseBoxes, place: Indices, doubled: Indices) -> bool:
    """Whether second boxes, with the places of their vessels (d,), fit them about as well as the matches do."""
    if not len(doubled):
        return False
    box = np.searchsorted(loose.row, doubled, sorter=(order := np.argsort(loose.row)))
    second = iou(loose.boxes_px[order[box]], sought.boxes_px[place])
    first = iou(sought.match_px[sought.found], sought.boxes_px[sought.found])
    return bool(np.median(second) >= np.quantile(first, _COPIES))


def _by_chance(
    sought: SoughtBoxes, left: FalseBoxes, pairs: OverlapPairs, tried: Mask, whole: Mask, images: Images, rule: Rule
) -> dict[str, Array]:
    """Numbers of remaining false positives that look like second boxes or parts (n,), or like boxes around two (p,)."""
    chance = {name: np.zeros(len(sought)) for name in ("duplicates", "splits")}
    chance["merges"] = np.zeros(len(pairs))
    for moved in shuffled(left, images):
        parts = match_shapes.two_parts(sought, moved).place
        np.add.at(chance["splits"], parts[tried[parts]], 1 / SHUFFLES)
        np.add.at(chance["duplicates"], match_shapes.second_boxes(sought, moved, tried, rule)[0], 1 / SHUFFLES)
        common = match_shapes.common_boxes(sought, moved, pairs, whole)
        np.add.at(chance["merges"], common.pair[np.isin(common.row, moved.row)], 1 / SHUFFLES)
    return chance


def _merge_trials(
    detected: SoughtBoxes, rows: Indices, pairs: OverlapPairs, common: CommonBoxes, shares: Recognition, by_pair: Array
) -> Trials:
    """Pairs that could have merged, less the boxes of one vessel (p,) and the false positives (p,) that look so."""
    is_merged = np.zeros(len(pairs), dtype=bool)
    is_merged[common.pair] = True
    by_error = np.where(common.one_box, np.where(detected.found[pairs.larger], *shares.mistaken), 0.0)
    margin = np.maximum(shares.recognized - by_error, 0.5)
    probable = np.where(common.one_box, (is_merged - by_error) / margin, 1.0 * is_merged)
    chance, unambiguous = by_error + by_pair, shares.unambiguous
    hits, one_box = probable - by_pair, common.one_box
    return match_shapes.pair_trials(detected, rows, pairs, is_merged, hits, chance, unambiguous, one_box)


def _ambiguous_pairs(detected: SoughtBoxes, pairs: OverlapPairs, recognition: Recognition) -> VesselPairs:
    """Places of pairs of which the box of the first does not tell whether it is around both."""
    unsure, parts = ~recognition.unambiguous, []
    larger, smaller = pairs.larger, pairs.smaller
    for mistaken, first, second in ((np.ones(len(pairs)), larger, smaller), (recognition.mistaken[1], smaller, larger)):
        pair = np.flatnonzero(unsure & (mistaken > MAX_MISTAKEN) & detected.found[first])
        parts.append((first[pair], second[pair], detected.row[first[pair]], pairs.share[pair]))
    return VesselPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _perhaps_parts(sought: SoughtBoxes, loose: FalseBoxes) -> Indices:
    """Rows of detections that look like the parts of an annotation which has no other match, whatever they match."""
    own = np.flatnonzero(sought.found)
    every = FalseBoxes.join([loose, FalseBoxes(sought.row[own], sought.image[own], sought.match_px[own])])
    order = np.argsort(every.image, kind="stable")
    parts = match_shapes.two_parts(replace(sought, row=np.full(len(sought), NOBODY)), every.take(order))
    match = sought.row[parts.place]
    alone = (match < 0) | (match == parts.larger) | (match == parts.smaller)
    return np.concatenate([parts.larger[alone], parts.smaller[alone]])


def _long(sought: SoughtBoxes, single: Mask) -> Mask:
    """Mask of the single vessels that may come out in two parts, shape (n,)."""
    wide = sizes(sought.boxes_px)[:, 0] >= match_shapes.MIN_WIDTH_PX
    return single & wide & (sought.aspect >= match_shapes.MIN_ASPECT)


def _unordered(a: Indices, b: Indices, number: int) -> Indices:
    """A number for each pair of places below a number, whichever comes first, shape (n,)."""
    return np.minimum(a, b) * number + np.maximum(a, b)


# ---- Type that each detection counts as, once the data show whether there are second boxes, splits and merges ----


NAMES = ("on_vessels", "duplicates", "merges", "splits")
"""The keys of the detector file, in its order."""
_WHAT = {
    "on_vessels": ("false positive on a vessel", "false positives on vessels"),
    "duplicates": ("second box", "second boxes"),
    "merges": ("box around two vessels", "boxes around two vessels"),
    "splits": ("vessel in two parts", "vessels in two parts"),
}
THRESHOLDS = {  # key of the threshold, its default and the other values that are tried
    "merges": ("merge_overlap", MergesAndSplits.merge_overlap, np.arange(2, 19) * 0.05),
    "splits": ("split_aspect", MergesAndSplits.split_aspect, np.arange(6, 33) * 0.25),
}
_STRAY = 0.002  # share of hits below a threshold that are a mistake of the rules
_TRIALS, _RUNS = 200, 24


@dataclass(frozen=True, eq=False)
class BoxTypes:
    """Type that each detection counts as: types that the data do not clearly show count as if they did not exist."""

    detection: Indices  # row of the result that detects each annotation, −1 where none does, shape (T,)
    in_merged_box: Mask  # whether an annotation is in the box of another one, shape (T,)
    ambiguous: Mask  # whether an annotation is or may be in another's box, so that nobody knows a miss, shape (T,)
    false: Indices  # rows of false positives, second boxes and smaller parts included, shape (f,)
    false_positives: Indices  # rows of those that are neither, and not on vessels, shape (g,)
    on_vessels: VesselBoxes  # annotations with a false positive on them, if such are shown
    one_vessel: Mask  # whether a detection is surely one whole box of one vessel if it detects one, shape (D,)
    thresholds: dict[str, float]  # of each kind that is shown and has one
    trials: dict[str, Trials]  # of the kinds that are shown, above their threshold
    notes: tuple[str, ...]


def counted_as(labelled: LabelledSet, matched: Matching, used: Mask, without: frozenset[str] = frozenset()) -> BoxTypes:
    """Types that the detections of the images that are used (I,) count as; kinds in `without` are left out."""
    false = matched.false[used[labelled.results.image[matched.false]]]
    one_vessel = np.ones(len(labelled.results), dtype=bool)
    in_merged_box, ambiguous = np.zeros((2, len(labelled.annotations)), dtype=bool)
    wanted = [name for name in NAMES if name not in without]
    if not wanted:
        return BoxTypes(matched.detection, in_merged_box, ambiguous, false, false, NONE, one_vessel, {}, {}, ())
    kinds, notes = kinds_of(labelled, matched, used), list[str]()
    thresholds, trials = dict[str, float](), dict[str, Trials]()
    for name, least in _clear_types(kinds, wanted, labelled.images, notes).items():
        trials[name] = _above(kinds.trials[name], least)
        if least is not None:
            thresholds[name] = least
    detection, of_vessel = matched.detection.copy(), [false[:0]]
    if "splits" in trials:
        detection[kinds.split[0]] = kinds.split[1]
        one_vessel[kinds.split[1]] = one_vessel[kinds.perhaps_parts] = False
        of_vessel.append(kinds.fragments)
    if "merges" in trials:
        least = thresholds["merges"]
        merged = kinds.merged.at_least(least)
        detection[merged.smaller], detection[merged.larger] = NOBODY, merged.box
        in_merged_box[merged.smaller] = ambiguous[merged.smaller] = True
        one_vessel[merged.box] = one_vessel[kinds.one_box.at_least(least).box] = False
        ambiguous[kinds.ambiguous.at_least(least).smaller] = True
    on_vessels = NONE
    if "on_vessels" in trials:
        on_vessels, among = kinds.on_vessels, trials["on_vessels"]
        trials["on_vessels"] = replace(among, hits=among.hits + among.chance)  # those by chance lie there as well
        of_vessel.append(on_vessels.box)
        if not kinds.copies and trials.pop("duplicates", None) is not None:
            notes.append("false_positives.duplicates: none; they fit worse than first boxes do, so they lie on vessels")
    if "duplicates" in trials:
        of_vessel.append(kinds.doubled)
    false = np.setdiff1d(np.flatnonzero(matched.counts & used[labelled.results.image]), detection[detection >= 0])
    free = np.setdiff1d(false, np.concatenate(of_vessel))
    text = tuple(notes)
    return BoxTypes(detection, in_merged_box, ambiguous, false, free, on_vessels, one_vessel, thresholds, trials, text)


def _clear_types(kinds: MatchTypes, wanted: list[str], images: Images, notes: list[str]) -> dict[str, float | None]:
    """The kinds that the data clearly show, with their thresholds; notes on the others."""
    shown = dict[str, float | None]()
    for name in wanted:
        trials = kinds.trials[name]
        least, remark = _least(name, trials)
        above = _above(trials, least)
        seen, chance = float((above.hits + above.chance).sum()), float(above.chance.sum())
        needed = _least_count(chance)
        strength = _strength(above, images) if seen >= needed else 0.0
        if strength >= SIGNIFICANT:
            shown[name] = least
            notes += remark
        elif seen >= needed:
            why = f"{strength:.1f} standard errors from 0 in {len(above.image):,} cases, needs {SIGNIFICANT}"
            notes.append(f"false_positives.{name}: none; {why}")
        else:
            by_chance = f", of which {chance:.1f} by chance" if chance >= 0.05 else ""
            lack = f"had {counted(round(seen), *_WHAT[name])}{by_chance}, needs {needed}"
            notes.append(f"false_positives.{name}: none; {lack}")
    return shown


def _least(name: str, trials: Trials) -> tuple[float | None, list[str]]:
    """The threshold of a kind, its default unless another is clearly likelier, with a remark; None without one."""
    if name not in THRESHOLDS:
        return None, []
    key, default, others = THRESHOLDS[name]
    best = max([default, *others.tolist()], key=lambda value: _likelihood(trials, value))
    if 2 * (_likelihood(trials, best) - _likelihood(trials, default)) <= SIGNIFICANT**2:
        return default, []
    return float(f"{best:.4g}"), [f"false_positives.{key}: {best:.4g}, clearly likelier than {default:g}"]


def _above(trials: Trials, least: float | None) -> Trials:
    return trials if least is None else trials.take(trials.value >= least - 1e-9)


def _least_count(chance: float) -> int:
    """Least number that is surely more than chance makes."""
    square = SIGNIFICANT**2
    return int(np.ceil(chance + (square + np.sqrt(square**2 + 8 * chance * square)) / 2))


def _strength(trials: Trials, images: Images) -> float:
    """Standard errors from 0 of the share, from runs of frames."""
    times = images.time_s
    run_s = float(np.nanmax(times) - np.nanmin(times)) / _RUNS if bool(np.isfinite(times).any()) else 0.0
    sums = hits_and_trials(trials, resample(images, _TRIALS, 0, run_s))
    error = float(spread(sums[1:, 0]))
    return float(sums[0, 0]) / error if error > 0 else 0.0


def hits_and_trials(trials: Trials, resampling: Resampling) -> Array:
    """Number of hits and of trials, the sums of the data first, shape (1 + replicates, 2)."""
    return resampling.sums(trials.image, np.column_stack([trials.hits, trials.weight]))


def _likelihood(trials: Trials, least: float) -> float:
    """Log-likelihood with a share above a threshold and hardly any hits below it, besides those of chance."""
    above = trials.value >= least - 1e-9
    total = 0.0
    for chosen, at_least in ((above, 0.0), (~above, 1.0)):
        part = trials.take(chosen)
        whole = float(part.weight.sum())
        if whole <= 0:
            continue
        hits = float(np.clip(part.hits.sum(), 0, whole))
        share = _STRAY if at_least else float(np.clip(hits / whole, _STRAY, 1 - _STRAY))
        total += hits * np.log(share) + (whole - hits) * np.log(1 - share)
    return total
