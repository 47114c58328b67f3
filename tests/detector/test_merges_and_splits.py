"""Duplicates, merged boxes and boxes in two parts."""

from typing import Any

import numpy as np
import pytest

from modsim3d.core.boxes import sizes, unions
from modsim3d.detector import records
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.merges_and_splits import MergesAndSplits, halves
from modsim3d.detector.records import Detections, Targets
from tests.detector import detector_builders as build

FRAMES = 4000
LONG, SQUARE = build.centred(400, 40), [100.0, 1000.0, 200.0, 1080.0]
PAIR = [[1000.0, 1000.0, 1100.0, 1050.0], [1050.0, 1000.0, 1250.0, 1060.0]]  # half of the smaller is in both


def detect(boxes: list[list[float]], false_positives: dict[str, Any], **state: Any) -> tuple[Targets, Detections]:
    return run(false_positives, np.tile(np.array(boxes), (FRAMES, 1, 1)), **{"false_discovery_rate": 0.2, **state})


def run(
    false_positives: dict[str, Any], boxes: np.ndarray, seed: int = 1, gates: Any = None, **state: Any
) -> tuple[Targets, Detections]:
    data = build.one_state_data(**{"confusion": build.ALL_SEEN, "box_error": build.no_error(), **state})
    data |= {"false_positives": {"model": "calibrated"} | false_positives, "gates": gates or {}}
    targets = build.make_targets(boxes)
    return targets, build.run(data, build.make_frames(len(boxes)), targets, seed)


def near(count: int, trials: int, p: float) -> bool:
    return abs(count / trials - p) < 4 * np.sqrt(p * (1 - p) / trials)


@pytest.mark.parametrize("rate", [0.2, 0.4])
def test_the_false_discovery_rate_counts_second_boxes(rate: float) -> None:
    keys = {"duplicates": 0.1, "splits": 0.05, "merges": 0.5}
    _, found = detect([LONG, SQUARE, *PAIR], keys, false_discovery_rate=rate)
    kinds = {"true", "false_positive", "duplicate", "merged", "split", "fragment"}
    assert {records.KINDS[kind] for kind in found.kind} == kinds
    n_true = np.sum(~found.false())
    error = np.sqrt(n_true * rate / (1 - rate)) * n_true / len(found) ** 2
    assert abs(found.false().mean() - rate) < 4 * error
    thesis = build.one_state_data(false_discovery_rate=0.05) | {"false_positives": keys | {"model": "thesis"}}
    assert parse_detector(thesis).merges_and_splits.duplicates == 0.1  # whose rule counts no second boxes


def test_duplicates_come_as_often_as_asked_and_split_boxes_are_parts_of_a_long_vessels_box() -> None:
    covariance = {"unit": "px", "mean": [0] * 4, "covariance": np.diag([9.0, 9, 4, 4]).tolist()}
    targets, found = detect([LONG, SQUARE], {"duplicates": 0.1}, box_error=covariance)
    second = found.kind == records.DUPLICATE
    assert near(int(second.sum()), len(targets), 0.1)
    own = np.full(len(targets), -1)
    own[found.target[found.kind == records.TRUE]] = np.flatnonzero(found.kind == records.TRUE)
    pairs = own[found.target[second]]
    assert np.all(found.label[pairs] == found.label[second])
    assert np.all(np.abs(np.cov(found.errors_px[second].T) - covariance["covariance"]) < 2)
    correlation = np.corrcoef(found.errors_px[second][:, 0], found.errors_px[pairs][:, 0])[0, 1]
    assert abs(correlation) < 4 / np.sqrt(second.sum())
    targets, found = detect([LONG, SQUARE], {"splits": 0.2})
    split, fragment = (np.flatnonzero(found.kind == kind) for kind in (records.SPLIT, records.FRAGMENT))
    assert near(len(split), FRAMES, 0.2)
    assert np.array_equal(np.sort(found.target[split]), np.sort(found.target[fragment]))
    assert np.all(targets.vessel[found.target[split]] == 0)
    larger = found.boxes_px[split[np.argsort(found.target[split])]]
    smaller = found.boxes_px[fragment[np.argsort(found.target[fragment])]]
    np.testing.assert_allclose(unions(larger, smaller), np.tile(LONG, (len(split), 1)))
    width = sizes(larger)[:, 0]
    assert np.all((width >= 200 - 1e-9) & (width <= 0.7 * 400 + 1e-9))
    np.testing.assert_allclose(width + sizes(smaller)[:, 0], 400)
    assert not np.any(found.kind[found.target == 1] == records.SPLIT)
    from_4 = MergesAndSplits(split_aspect=4.0).looks_long(np.array([[0.0, 0, w, 10] for w in (39, 40, 41)]))
    assert from_4.tolist() == [False, True, True]
    assert parse_detector(build.one_state_data()).merges_and_splits == MergesAndSplits()
    larger, smaller = halves(np.array([[0.0, 0, 8, 2]]), np.array([0.5]))
    assert (larger.tolist(), smaller.tolist()) == ([[0, 0, 4, 2]], [[4, 0, 8, 2]])


def test_a_merged_box_counts_for_both_vessels_needs_overlap_and_is_not_split():
    targets, found = detect([*PAIR, SQUARE], {"merges": 0.3}, false_discovery_rate=0)
    merged = found.kind == records.MERGED
    assert near(int(merged.sum()), FRAMES, 0.3)
    np.testing.assert_allclose(found.boxes_px[merged], np.tile([1000, 1000, 1250, 1060], (merged.sum(), 1)))
    assert np.all(targets.vessel[found.target[merged]] == 1)  # the larger
    assert np.all(targets.vessel[found.partner[merged]] == 0)
    assert np.all(found.partner[~merged] == -1)
    assert np.array_equal(np.sort([*found.target, *found.partner[merged]]), np.arange(len(targets)))
    # Of three in one place two are in one box.
    three = [[0.0, 0, 100, 50], [20.0, 0, 120, 50], [40.0, 0, 140, 50]]
    targets, found = detect(three, {"merges": 1.0}, false_discovery_rate=0)
    assert np.sum(found.kind == records.MERGED) == FRAMES and np.sum(found.kind == records.TRUE) == FRAMES
    sources = np.sort([*found.target, *found.partner[found.partner >= 0]])
    assert np.array_equal(sources, np.arange(len(targets)))
    keys = {"duplicates": 0.1, "splits": 0.05, "merges": 0.5, "persistence": {"lifetime_s": 1, "share": 0.5}}
    apart = {"true": {"mean": 0.8, "std": 0}, "false": {"mean": 0.4, "std": 0}}
    _, found = detect([LONG, SQUARE, *PAIR], keys | {"size": {"model": "fixed", "px": [9, 9]}}, confidence=apart)
    assert set(found.kind) == {*range(len(records.KINDS))} - {records.ON_VESSEL}
    assert np.array_equal(found.confidence == 0.4, found.false())
    assert np.array_equal(found.confidence == 0.8, ~found.false())
    apart = [[0.0, 0, 100, 50], [100.5, 0, 200, 50], [0.0, 50.5, 100, 90]]
    sliver = [[0.0, 0, 100, 50], [99.5, 0, 200, 50]]  # half a pixel of 100 is in both
    overlaps = ((PAIR, 0.51, 0.49), (sliver, 0.0051, 0.00499), (apart, 1e-6, None))
    for boxes, too_much, little_enough in overlaps:
        _, found = detect(boxes, {"merges": 1.0, "merge_overlap": too_much})
        assert not np.any(found.kind == records.MERGED), boxes
        if little_enough:
            _, found = detect(boxes, {"merges": 1.0, "merge_overlap": little_enough})
            assert np.all(found.kind[found.kind != records.FALSE_POSITIVE] == records.MERGED), boxes
    boxes = np.tile(PAIR, (200, 1, 1))
    swapped = boxes.copy()
    swapped[::2] = boxes[::2, ::-1]
    one, two = (run({"merges": 0.5}, each)[1] for each in (boxes, swapped))
    assert np.array_equal(one.frame[one.kind == records.MERGED], two.frame[two.kind == records.MERGED])
    targets, found = detect([PAIR[0], PAIR[0]], {"merges": 1.0}, false_discovery_rate=0)
    assert np.all(targets.vessel[found.target] == 0)
    keys = {"merges": 1.0, "splits": 0.5, "duplicates": 0.4}
    for seed in range(20):
        _, found = run(keys, np.array([PAIR]), seed, false_discovery_rate=0.5)
        assert set(found.kind) <= {records.MERGED, records.FALSE_POSITIVE}
        assert found.partner[found.kind == records.MERGED].tolist() == [0]
    wide = {"unit": "px", "mean": [0] * 4, "covariance": np.diag([1.0, 1.0, 150.0**2, 1.0]).tolist()}
    _, found = detect([LONG], {"splits": 0.5}, box_error=wide, false_discovery_rate=0.4)
    assert found.redrawn[np.isin(found.kind, (records.TRUE, records.SPLIT))].any()
    assert (found.kind == records.FRAGMENT).any()
    assert not found.redrawn[~np.isin(found.kind, (records.TRUE, records.SPLIT))].any()
    boxes = np.tile(np.array([*PAIR, SQUARE]), (50, 1, 1))
    targets, found = run({"merges": 1.0}, boxes, gates={"max_detections": 1}, false_discovery_rate=0)
    merged = set(found.frame[found.kind == records.MERGED].tolist())
    assert len(found) == 50 and 0 < len(merged) < 50
    for frame in range(50):
        gated = set(targets.vessel[found.gated & (targets.frame == frame)])
        assert gated == ({2} if frame in merged else {0, 1})
