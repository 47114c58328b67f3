"""Whether most true detections are lost because their boxes lie too far off for the matching rule."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched, Rule, fits, image_pairs, overlap

_MOST = 0.5


def gate_warning(labelled: LabelledSet, matched: Matched, rule: Rule) -> str | None:
    """What to say, with figures, if the rule does not match most of what could be a match; None if it does.

    Where the set says what each detection is of, those are counted that the rule does not let match their own vessel.
    Elsewhere missed annotations are counted that a false detection overlaps.
    """
    if rule.method == "provenance" or not matched.sought.any():
        return None
    recall = f"recall {len(matched.pairs[0]) / np.count_nonzero(matched.sought):.3f}"
    if labelled.results.origin is not None:
        return _of_own_vessels(labelled, matched, rule, labelled.results.origin, recall)
    missed = matched.sought & (matched.detection < 0)
    near, found = len(_overlapped(labelled, np.flatnonzero(missed), matched.false)), len(matched.pairs[0])
    if near <= _MOST * (near + found):
        return None
    return (
        f"{near:,} of {np.count_nonzero(missed):,} missed annotations overlap a false detection, and only {found:,} "
        f"detections match: if those boxes are meant for each other, {recall} counts them as missed. Use --match "
        "centre with a --distance that is large against the errors of the boxes"
    )


def _of_own_vessels(labelled: LabelledSet, matched: Matched, rule: Rule, origin: Indices, recall: str) -> str | None:
    rows = np.flatnonzero(matched.counts & (origin >= 0))
    good, _ = fits(labelled, rows, origin[rows], rule)
    lost = int(np.count_nonzero(~good))
    if lost <= _MOST * len(rows):
        return None
    far = f"have IoU below {rule.least_iou:g} with their own vessel"
    if rule.method == "centre":
        far = f"have their centre more than {rule.most_distance_px:g} px from that of their own vessel"
    return f"{lost:,} of {len(rows):,} detections {far}: {recall} counts them as missed. Use --match provenance"


def _overlapped(labelled: LabelledSet, annotations: Indices, detections: Indices) -> Indices:
    """Those of some annotations that one of some detections overlaps; all rows in the order of their images."""
    results, there = labelled.results, labelled.annotations
    found = [annotations[:0]]
    for first, second in image_pairs(results.image[detections], there.image[annotations], len(labelled.images)):
        row, target = detections[first], annotations[second]
        touching = overlap(results.boxes_px[row], there.boxes_px[target], there.crowd[target]) > 0
        found.append(np.unique(target[touching]))
    return np.unique(np.concatenate(found))
