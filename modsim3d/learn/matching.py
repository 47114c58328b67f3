"""Which detection is of which truth.

All images are matched at once: pairs that could match are found by arithmetic over all pairs within images, and only
those few are walked through. A detection is at most one truth's, and a truth at most one detection's; what COCO ignores
(crowds, `ignore`) is matched only by what would otherwise match nothing, and then neither counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import areas, intersections, iou
from modsim3d.errors import ModsimError
from modsim3d.learn.labelled import NOBODY, Found, Labelled, Truth

PAIRS_AT_ONCE = 2_000_000
METHODS = ("confidence", "optimal", "centre", "provenance")


@dataclass(frozen=True)
class Rule:
    """How boxes are matched.

    Attributes:
        method: `confidence`: the surest detection chooses first, the truth with the largest IoU; `optimal`: as many
            matches as there can be, and of those the largest sum of IoU; `centre`: like `confidence`, but the nearest
            centre; `provenance`: what a simulated run says itself.
        least_iou: Less is no match.
        most_distance_px: Between centres; farther is no match.
        by_label: Whether only boxes of the same label match.
    """

    method: str = "confidence"
    least_iou: float = 0.5
    most_distance_px: float = 50.0
    by_label: bool = False

    def __str__(self) -> str:
        """For a report."""
        if self.method == "provenance":
            return "provenance"
        if self.method == "centre":
            return f"centres at most {self.most_distance_px:g} px apart, in order of confidence"
        order = "optimal assignment" if self.method == "optimal" else "in order of confidence"
        return f"IoU at least {self.least_iou:g}, {order}"


@dataclass(frozen=True, eq=False)
class Matched:
    """Matches of the detections that take part.

    Attributes:
        truth: Row of the truth of each detection, −1 for none, shape (D,).
        counts: Whether a detection counts: it took part, and is not of something ignored, shape (D,).
        truth_counts: Whether a truth is to be found, shape (T,).
    """

    truth: Indices
    counts: Mask
    truth_counts: Mask

    @property
    def pairs(self) -> tuple[Indices, Indices]:
        """Rows of detections and of their truths, where both count."""
        found = np.flatnonzero(self.counts & (self.truth >= 0))
        return found, self.truth[found]

    @property
    def false(self) -> Indices:
        """Rows of false detections."""
        return np.flatnonzero(self.counts & (self.truth < 0))

    def detection(self) -> Indices:
        """Row of the detection of each truth, −1 for none, shape (T,)."""
        rows = np.full(len(self.truth_counts), NOBODY)
        found, truth = self.pairs
        rows[truth] = found
        return rows


def overlap(boxes_px: Array, truth_px: Array, crowd: Mask) -> Array:
    """IoU; of crowds the share of the detection inside, as COCO has it; shape (n,)."""
    inside: Array = intersections(boxes_px, truth_px) / np.maximum(areas(boxes_px), 1e-300)
    return np.where(crowd, inside, iou(boxes_px, truth_px))


def image_pairs(first: Indices, second: Indices, images: int) -> Iterator[tuple[Indices, Indices]]:
    """All pairs of rows in the same image, some at a time.

    Args:
        first: Images of the one, non-decreasing.
        second: Of the other.
        images: How many there are.
    """
    starts = [np.searchsorted(rows, np.arange(images + 1)) for rows in (first, second)]
    others = np.diff(starts[1])[first]  # pairs that each of the first has
    ends = np.cumsum(others)
    begin = 0
    while begin < len(first):
        before = int(ends[begin - 1]) if begin else 0
        stop = max(int(np.searchsorted(ends, before + PAIRS_AT_ONCE, side="right")), begin + 1)
        rows = np.repeat(np.arange(begin, stop), others[begin:stop])
        offset = np.arange(len(rows)) - np.repeat(ends[begin:stop] - others[begin:stop] - before, others[begin:stop])
        yield rows, starts[1][first[rows]] + offset
        begin = stop


def candidates(labelled: Labelled, takes_part: Mask, rule: Rule) -> tuple[Indices, Indices, Array]:
    """Pairs that could match, and how well: detections, truths and a quality that is better the greater it is."""
    found, truth = labelled.found, labelled.truth
    rows = np.flatnonzero(takes_part)
    kept: list[tuple[Indices, Indices, Array]] = []
    for first, second in image_pairs(found.image[rows], truth.image, len(labelled.images)):
        detection = rows[first]
        good, quality = _good(found, truth, detection, second, rule)
        kept.append((detection[good], second[good], quality[good]))
    if not kept:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
    return tuple(np.concatenate(column) for column in zip(*kept, strict=True))  # type: ignore[return-value]


def _good(found: Found, truth: Truth, detection: Indices, second: Indices, rule: Rule) -> tuple[Mask, Array]:
    a, b = found.boxes_px[detection], truth.boxes_px[second]
    if rule.method == "centre":
        between = np.hypot(*((a[:, :2] + a[:, 2:] - b[:, :2] - b[:, 2:]) / 2).T)
        good, quality = between <= rule.most_distance_px, -between
    else:
        quality = overlap(a, b, truth.crowd[second])
        good = quality >= min(rule.least_iou, 1 - 1e-10)
    if rule.by_label:
        good = good & (found.label[detection] == truth.label[second])
    return good, quality


def match(labelled: Labelled, rule: Rule, least_confidence: float = 0.0) -> Matched:
    """Match the detections that are sure enough.

    Raises:
        ModsimError: Provenance is asked for and not known.
    """
    found, truth = labelled.found, labelled.truth
    takes_part = found.confidence >= least_confidence
    if rule.method == "provenance":
        return _by_provenance(labelled, takes_part)
    detection, target, quality = candidates(labelled, takes_part, rule)
    assign: Callable[[Labelled, Indices, Indices, Array], Indices] = _optimal if rule.method == "optimal" else _greedy
    matches = assign(labelled, detection, target, quality)
    return _counted(truth, takes_part, matches)


def _counted(truth: Truth, takes_part: Mask, matches: Indices) -> Matched:
    ignored = np.append(truth.ignored, False)[matches]
    return Matched(np.where(ignored, NOBODY, matches), takes_part & ~ignored, ~truth.ignored)


def _by_provenance(labelled: Labelled, takes_part: Mask) -> Matched:
    if labelled.found.origin is None:
        raise ModsimError("matching by provenance needs simulated runs (--run): files do not say whose a detection is")
    return _counted(labelled.truth, takes_part, np.where(takes_part, labelled.found.origin, NOBODY))


def _greedy(labelled: Labelled, detection: Indices, target: Indices, quality: Array) -> Indices:
    """The surest first; ties as COCO's own tools break them: the later of equal truths, the earlier of detections."""
    truth, found = labelled.truth, labelled.found
    matches = np.full(len(found), NOBODY)
    order = np.lexsort((-target, -quality, truth.ignored[target], detection, -found.confidence[detection]))
    taken: set[int] = set()
    done: set[int] = set()
    crowd = truth.crowd[target[order]].tolist()
    for row, box, many in zip(detection[order].tolist(), target[order].tolist(), crowd, strict=True):
        if row in done or (box in taken and not many):
            continue
        matches[row] = box
        done.add(row)
        taken.add(box)
    return matches


def _optimal(labelled: Labelled, detection: Indices, target: Indices, quality: Array) -> Indices:
    """As many as there can be, then the largest sum; what is ignored is left to the detections that remain."""
    truth, matches = labelled.truth, np.full(len(labelled.found), NOBODY)
    sought = ~truth.ignored[target]
    _assign(detection[sought], target[sought], quality[sought], matches)
    left = ~sought & (matches[detection] < 0)
    rest = _greedy(labelled, detection[left], target[left], quality[left])
    return np.where(matches >= 0, matches, rest)


def _assign(detection: Indices, target: Indices, quality: Array, matches: Indices) -> None:
    """Assignment problems, one for each cluster of boxes that can match each other."""
    if not len(detection):
        return
    rows, row = np.unique(detection, return_inverse=True)
    columns, column = np.unique(target, return_inverse=True)
    size = len(rows) + len(columns)
    graph = coo_array((np.ones(len(row)), (row, len(rows) + column)), shape=(size, size))
    _, cluster = connected_components(graph, directed=False)
    order = np.argsort(cluster[row], kind="stable")
    edges = np.flatnonzero(np.diff(cluster[row][order])) + 1
    for part in np.split(order, edges):
        if len(part) == 1:
            matches[rows[row[part[0]]]] = columns[column[part[0]]]
            continue
        ours, i = np.unique(row[part], return_inverse=True)
        theirs, j = np.unique(column[part], return_inverse=True)
        gain = np.zeros((len(ours), len(theirs)))
        gain[i, j] = quality[part] - quality.min() + 1 + min(gain.shape) * (1 + np.ptp(quality))
        for a, b in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[a, b] > 0:
                matches[rows[ours[a]]] = columns[theirs[b]]
