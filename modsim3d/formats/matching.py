"""Matching of detections and annotations.
All images are matched at once: pairs that could match are found by arithmetic over all pairs within images, and only
those few are walked through. A detection matches at most one annotation, and an annotation at most one detection. What
COCO ignores (crowds, `ignore`) is matched only by detections that match nothing else, and then neither counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.boxes import areas, centres, intersections, iou
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.io.input_files import MAX_PAIRS
from modsim3d.io.validation import shown

PAIRS_AT_ONCE = 2_000_000
_IN_CROWD = 0.5  # a detection of which a larger share lies in a crowd is in it, however far from its centre
NOT_SCORED = "the detections have none (-1)"  # said where something needs confidences that are not given


@dataclass(frozen=True)
class Rule:
    """Matching of boxes, by `method`. `confidence`: the most confident detection chooses first, the annotation with the
    largest IoU; `optimal`: as many matches as possible, and of those the largest sum of IoU; `centre`: of boxes with
    centres near each other, the pair whose corners are nearest; `provenance`: what a simulated run says."""

    method: str = "confidence"
    least_iou: float = 0.5  # a pair with less is no match
    most_distance_px: float = 50.0  # between the centres of a match, for `centre`
    by_label: bool = False  # only boxes of the same label match
    by_confidence: bool = False  # for `centre`, too, the most confident detection chooses first

    def __str__(self) -> str:
        """The rule in words, for a report."""
        if self.method == "provenance":
            return "provenance"
        if self.method == "centre":
            order = "in order of confidence" if self.by_confidence else "the nearest corners first"
            return f"centres at most {self.most_distance_px:g} px apart, {order}"
        order = "optimal assignment" if self.method == "optimal" else "in order of confidence"
        return f"IoU at least {self.least_iou:g}, {order}"

    @property
    def for_average_precision(self) -> Rule:
        """Rule for average precision: label by label, and in order of confidence. It is of the most confident
        detections at every threshold, and other orders may give an annotation to a less confident one."""
        method = "confidence" if self.method == "optimal" else self.method
        return replace(self, method=method, by_label=True, by_confidence=method == "centre")


def usual_method(labelled: LabelledSet, position_m: float = 0.0) -> str:
    """Provenance where the set says what each detection is of, as runs do; else in order of confidence, by IoU. Without
    confidences, the optimal assignment; centres where true positions are off, as boxes may hardly overlap."""
    if labelled.results.origin is not None:
        return "provenance"
    if position_m:
        return "centre"
    return "confidence" if labelled.scored else "optimal"


@dataclass(frozen=True, eq=False)
class Matching:
    """Matches of the detections that take part."""

    annotation: Indices  # row of the annotation that each detection matches, −1 for none: (D,)
    counts: Mask  # whether a detection counts: it took part, and does not match something ignored: (D,)
    sought: Mask  # whether an annotation is to be detected: (T,)
    rule: Rule = Rule()

    @cached_property
    def pairs(self) -> tuple[Indices, Indices]:
        """Rows of detections and of their annotations where both count, shapes (m,)."""
        rows = np.flatnonzero(self.counts & (self.annotation >= 0))
        return rows, self.annotation[rows]

    @cached_property
    def false(self) -> Indices:
        """Rows of false positives, shape (f,)."""
        return np.flatnonzero(self.counts & (self.annotation < 0))

    @cached_property
    def detection(self) -> Indices:
        """Row of the detection that matches each annotation, −1 for none, shape (T,)."""
        matches = np.full(len(self.sought), NOBODY)
        rows, annotation = self.pairs
        matches[annotation] = rows
        return matches


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rows of detections and annotations that could match, and how well they do, the more the better, shapes (n,)."""

    detection: Indices
    annotation: Indices
    quality: Array

    def where(self, chosen: Mask) -> Candidates:
        """Some of the pairs, shape (n,)."""
        return Candidates(self.detection[chosen], self.annotation[chosen], self.quality[chosen])


def overlap(boxes_px: Array, annotated_px: Array, crowd: Mask) -> Array:
    """IoU of boxes (n, 4), pair by pair; for crowds the share of the detection inside, as COCO has it; shape (n,)."""
    inside: Array = intersections(boxes_px, annotated_px) / np.maximum(areas(boxes_px), 1e-300)
    return np.where(crowd, inside, iou(boxes_px, annotated_px))


def image_pairs(first: Indices, second: Indices, images: int) -> Iterator[tuple[Indices, Indices]]:
    """Rows of all pairs in the same image, shapes (pairs,), about `PAIRS_AT_ONCE` at a time. `first` (n,) and `second`
    (m,) are the image of each row of two tables, non-decreasing; `images` is the number of images."""
    starts = np.searchsorted(second, np.arange(images + 1))
    others = np.diff(starts)[first]  # pairs that each of the first has
    ends = np.cumsum(others)
    begin = 0
    while begin < len(first):
        before = int(ends[begin - 1]) if begin else 0
        stop = max(int(np.searchsorted(ends, before + PAIRS_AT_ONCE, side="right")), begin + 1)
        rows = np.repeat(np.arange(begin, stop), others[begin:stop])
        offset = np.arange(len(rows)) - np.repeat(ends[begin:stop] - others[begin:stop] - before, others[begin:stop])
        yield rows, starts[first[rows]] + offset
        begin = stop


def match(labelled: LabelledSet, rule: Rule, least_confidence: float = 0.0) -> Matching:
    """Match the detections that are confident enough, or whose confidence is not given. Raises ModsimError if the set
    does not say where detections come from for the rule `provenance`, or has no confidences for `confidence`."""
    takes_part = ~(labelled.results.confidence < least_confidence)
    if rule.method == "confidence" and not labelled.scored:
        raise ModsimError(f"matching in order of confidence needs confidences, and {NOT_SCORED}: give --match optimal")
    if rule.method == "provenance":
        matches = _by_provenance(labelled, takes_part, rule)
    else:
        assign = _optimal if rule.method == "optimal" else _greedy
        matches = assign(labelled, _candidates(labelled, takes_part, rule), rule)
    ignored = np.append(labelled.annotations.ignored, False)[matches]
    return Matching(np.where(ignored, NOBODY, matches), takes_part & ~ignored, ~labelled.annotations.ignored, rule)


def _by_provenance(labelled: LabelledSet, takes_part: Mask, rule: Rule) -> Indices:
    origin = _origins(labelled)
    rows = np.flatnonzero(takes_part & (origin >= 0))
    good, _ = fits(labelled, rows, origin[rows], rule)
    matches = np.full(len(origin), NOBODY)
    matches[rows[good]] = origin[rows[good]]
    return matches


def _origins(labelled: LabelledSet) -> Indices:
    """Row of the annotation that each detection is of, −1 for none, shape (D,)."""
    if labelled.results.origin is None:
        raise ModsimError("matching by provenance needs simulated runs: files do not say whose a detection is")
    return labelled.results.origin


def _candidates(labelled: LabelledSet, takes_part: Mask, rule: Rule) -> Candidates:
    """Pairs of detections that take part and annotations that may match by the rule. Raises ModsimError if too many."""
    rows, images = np.flatnonzero(takes_part), len(labelled.images)
    kept, count = [(rows[:0], rows[:0], np.empty(0))], 0
    for first, second in image_pairs(labelled.results.image[rows], labelled.annotations.image, images):
        good, quality = fits(labelled, rows[first], second, rule)
        kept.append((rows[first][good], second[good], quality[good]))
        count += len(kept[-1][0])
        if count > MAX_PAIRS:
            image = labelled.images.names[int(labelled.annotations.image[second[-1]])]
            problem = f"more than {MAX_PAIRS:,} pairs of boxes could match: are boxes repeated?"
            raise ModsimError(f"up to image {shown(image)} {problem}")
    return Candidates(*(np.concatenate(column) for column in zip(*kept, strict=True)))


def fits(labelled: LabelledSet, detection: Indices, annotation: Indices, rule: Rule) -> tuple[Mask, Array]:
    """Whether pairs of rows (n,) in the same image may match by a rule, and how well they do, the more the better:
    (n,). The set has the origins of its detections if the rule is `provenance`."""
    results, annotations = labelled.results, labelled.annotations
    a_px, b_px = results.boxes_px[detection], annotations.boxes_px[annotation]
    if rule.method == "provenance":
        good = _origins(labelled)[detection] == annotation
        quality = good.astype(np.float64)
    elif rule.method == "centre":
        quality = -np.linalg.norm(a_px - b_px, axis=1)  # a small box on a large vessel is no match for it
        good = np.linalg.norm(centres(a_px) - centres(b_px), axis=1) <= rule.most_distance_px
        crowd = np.flatnonzero(annotations.crowd[annotation])
        good[crowd] |= overlap(a_px[crowd], b_px[crowd], np.ones(len(crowd), dtype=bool)) >= _IN_CROWD
    else:
        quality = overlap(a_px, b_px, annotations.crowd[annotation])
        good = quality >= min(rule.least_iou, 1 - 1e-10)
    if rule.by_label:
        good = good & (results.label[detection] == annotations.label[annotation])
    return good, quality


def _greedy(labelled: LabelledSet, pairs: Candidates, rule: Rule) -> Indices:
    """Most confident detection first; or, by centres or without confidences, the pair that fits best first. Ties are
    broken as COCO's own tools do: the later of equal annotations, the earlier of equal detections."""
    annotations, results = labelled.annotations, labelled.results
    target, detection, ignored = pairs.annotation, pairs.detection, annotations.ignored[pairs.annotation]
    matches = np.full(len(results), NOBODY)
    order = np.lexsort((-target, -pairs.quality, ignored, detection, -results.confidence[detection]))
    if not labelled.scored or (rule.method == "centre" and not rule.by_confidence):
        order = np.lexsort((-target, detection, -pairs.quality, ignored))
    taken, done = set[int](), set[int]()
    crowd = annotations.crowd[target[order]].tolist()
    for row, box, many in zip(detection[order].tolist(), target[order].tolist(), crowd, strict=True):
        if row in done or (box in taken and not many):
            continue
        matches[row] = box
        done.add(row)
        taken.add(box)
    return matches


def _optimal(labelled: LabelledSet, pairs: Candidates, rule: Rule) -> Indices:
    """As many matches as possible, of those the largest sum; ignored annotations take detections that are left."""
    matches = np.full(len(labelled.results), NOBODY)
    sought = ~labelled.annotations.ignored[pairs.annotation]
    _assign(pairs.where(sought), matches)
    rest = _greedy(labelled, pairs.where(~sought & (matches[pairs.detection] < 0)), rule)
    return np.where(matches >= 0, matches, rest)


def _assign(pairs: Candidates, matches: Indices) -> None:
    """Solve an assignment problem for each cluster of boxes that can match each other; writes to the matches."""
    if not len(pairs.detection):
        return
    quality = pairs.quality
    rows, row = np.unique(pairs.detection, return_inverse=True)
    columns, column = np.unique(pairs.annotation, return_inverse=True)
    size = len(rows) + len(columns)
    graph = coo_array((np.ones(len(row)), (row, len(rows) + column)), shape=(size, size))
    _, cluster = connected_components(graph, directed=False)
    order = np.argsort(cluster[row], kind="stable")
    edges = np.flatnonzero(np.diff(cluster[row][order])) + 1
    for part in np.split(order, edges):
        if len(part) == 1:
            matches[rows[row[part[0]]]] = columns[column[part[0]]]
            continue
        part_rows, i = np.unique(row[part], return_inverse=True)
        part_columns, j = np.unique(column[part], return_inverse=True)
        gain = np.zeros((len(part_rows), len(part_columns)))
        gain[i, j] = quality[part] - quality.min() + 1 + min(gain.shape) * (1 + np.ptp(quality))
        for a, b in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[a, b] > 0:
                matches[rows[part_rows[a]]] = columns[part_columns[b]]
