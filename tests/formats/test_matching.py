import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import PAIRS_AT_ONCE, Rule, image_pairs, match
from tests.formats.labelled_files import found, images, random_boxes, random_set, truth


def slow_iou(a, b, crowd):
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    area = (a[2] - a[0]) * (a[3] - a[1])
    common = width * height
    return common / (area if crowd else area + (b[2] - b[0]) * (b[3] - b[1]) - common)


def slow_match(labelled, rule, least_confidence):
    """One image, one detection, one truth after another."""
    found, truth = labelled.results, labelled.annotations
    matches = [-1] * len(found)
    for image in range(len(labelled.images)):
        rows = [d for d in range(len(found)) if found.image[d] == image and found.confidence[d] >= least_confidence]
        taken = set()
        for d in sorted(rows, key=lambda d: (-found.confidence[d], d)):
            best = None
            for t in range(len(truth)):
                if truth.image[t] != image or (t in taken and not truth.crowd[t]):
                    continue
                if rule.by_label and truth.label[t] != found.label[d]:
                    continue
                value = slow_iou(found.boxes_px[d], truth.boxes_px[t], truth.crowd[t])
                rank = (not truth.ignored[t], value, t)
                if value >= rule.least_iou and (best is None or rank > best[0]):
                    best = (rank, t)
            if best:
                matches[d] = best[1]
                taken.add(best[1])
    return matches


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), by_label=st.booleans(), ties=st.booleans())
def test_matches_are_those_of_a_slow_walk_through_every_pair(seed, by_label, ties):
    labelled = random_set(seed, ties=ties)
    rule = Rule(by_label=by_label, least_iou=0.4)
    matched = match(labelled, rule, 0.15)
    slow = np.array(slow_match(labelled, rule, 0.15), dtype=int)
    ignored = np.append(labelled.annotations.ignored, False)[slow]
    assert matched.annotation.tolist() == np.where(ignored, -1, slow).tolist()
    assert matched.counts.tolist() == ((labelled.results.confidence >= 0.15) & ~ignored).tolist()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_optimal_assignment_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 4, 60)
    moved = boxes[rng.permutation(4)] + rng.normal(0, 6, (4, 4))
    nothing = [0] * 4
    there, seen = truth(nothing, nothing, boxes), found(nothing, nothing, moved, rng.random(4))
    labelled = LabelledSet(("a",), ("all",), images(1), there, seen)
    matched = match(labelled, Rule("optimal", least_iou=0.3))
    value = [[slow_iou(a, b, False) for b in boxes] for a in moved]

    def worth(choice):
        good = [value[d][t] for d, t in enumerate(choice) if value[d][t] >= 0.3]
        return len(good), sum(good)

    best = max(worth(choice) for choice in itertools.permutations(range(4)))
    rows, targets = matched.pairs
    assert len(rows) == best[0]
    assert sum(value[d][t] for d, t in zip(rows, targets, strict=True)) == pytest.approx(best[1])


def one_image(boats, seen, ignored=None):
    """An image with boats, of which some are regions to be ignored, and what is detected, the surest first."""
    there = truth([0] * len(boats), [0] * len(boats), boats, ignored, ignored)
    confidence = [0.9, 0.8, 0.7][: len(seen)]
    return LabelledSet(("a",), ("all",), images(1), there, found([0] * len(seen), [0] * len(seen), seen, confidence))


BOATS = [[0, 0, 100, 100], [20, 0, 120, 100]]
CROSSED = [[15, 0, 115, 100], [35, 0, 135, 100]]  # the surer one is nearer to what the other needs
SECOND = [[11, 0, 111, 100], [22, 0, 122, 100]]  # both are nearest to the second, the less sure more so
BESIDE = [[20, 0, 30, 10], [0, 30, 10, 40]]
BY_CENTRE = Rule("centre", most_distance_px=25)
MATCHES = {
    "by confidence one match is lost": (BOATS, CROSSED, Rule(least_iou=0.6), [1, -1]),
    "the optimal assignment finds it": (BOATS, CROSSED, Rule("optimal", least_iou=0.6), [0, 1]),
    "boxes do not overlap": ([[0, 0, 10, 10]], BESIDE, Rule(), [-1, -1]),
    "their centres are near": ([[0, 0, 10, 10]], BESIDE, Rule("centre", most_distance_px=20), [0, -1]),
    "their centres are too far": ([[0, 0, 10, 10]], BESIDE, Rule("centre", most_distance_px=19), [-1, -1]),
    "by centres the nearest pair comes first": (BOATS, SECOND, BY_CENTRE, [0, 1]),
    "for average precision the most confident": (BOATS, SECOND, BY_CENTRE.for_average_precision, [1, 0]),
    "a small box does not take the match": (
        [[0, 0, 300, 60]], [[142, 22, 158, 38], [10, 0, 310, 60]], Rule("centre"), [-1, 0],
    ),
    "of equal truths the later, as COCO's tools do": ([[0, 0, 50, 50]] * 3, [[0, 0, 50, 50]], Rule(), [2]),
}  # fmt: skip


def test_matches_are_those_of_the_rule_in_the_order_that_it_says_whatever_is_ignored_or_split(monkeypatch):
    for case, (boats, seen, rule, matches) in MATCHES.items():
        assert match(one_image(boats, seen), rule).annotation.tolist() == matches, case
    seen = [[10, 10, 40, 40], [60, 60, 90, 90], [400, 0, 450, 50]]
    labelled = one_image([[0, 0, 200, 200], [300, 300, 350, 350]], seen, [True, False])
    for method in ("confidence", "optimal"):
        matched = match(labelled, Rule(method))
        assert matched.counts.tolist() == [False, False, True]  # a crowd takes as many as there are
        assert matched.sought.tolist() == [False, True]
    seen = [[0, 0, 20, 20], [380, 10, 410, 20], [390, 0, 420, 40]]  # in the region wherever its centre
    assert match(one_image([[0, 0, 400, 40]], seen, [True]), Rule("centre")).counts.tolist() == [False, False, True]
    rng = np.random.default_rng(1)
    first, second = np.sort(rng.integers(0, 9, 20)), np.sort(rng.integers(0, 9, 15))
    every = [(i, j) for i in range(20) for j in range(15) if first[i] == second[j]]
    for at_once in (1, 7, PAIRS_AT_ONCE):
        monkeypatch.setattr("modsim3d.formats.matching.PAIRS_AT_ONCE", at_once)
        pairs = [pair for a, b in image_pairs(first, second, 9) for pair in zip(a.tolist(), b.tolist(), strict=True)]
        assert pairs == every
    apart = "centres at most 25 px apart, "
    assert str(BY_CENTRE) == f"{apart}the nearest corners first"
    assert str(BY_CENTRE.for_average_precision) == f"{apart}in order of confidence"
    with pytest.raises(ModsimError, match="needs simulated runs"):
        match(random_set(3), Rule("provenance"))
