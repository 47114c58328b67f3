"""Rows that are put in order by few of their columns first, against a plain sort by all of them."""

from __future__ import annotations

import numpy as np
import pytest

from modsim3d.runs import workers
from modsim3d.runs.tracker_view import anonymised


@pytest.mark.parametrize("count", [0, 1, 300])
def test_detections_are_told_by_frame_confidence_box_and_label(count: int) -> None:
    rng = np.random.default_rng(count)
    frame, label = np.sort(rng.integers(0, 9, count)), rng.integers(0, 3, count)
    boxes, confidence = rng.integers(0, 2, (count, 4)) / 1.0, rng.integers(0, 3, count) / 2
    found = anonymised(frame, label, boxes, confidence)
    keys = zip(frame.tolist(), (-confidence).tolist(), boxes.tolist(), label.tolist(), strict=True)
    told_keys = zip(
        found.frame.tolist(), (-found.confidence).tolist(), found.boxes_px.tolist(), found.label.tolist(), strict=True
    )
    assert list(told_keys) == sorted(keys)


@pytest.mark.parametrize("count", [0, 1, 400])
@pytest.mark.parametrize("distinct_keys", [3, 10_000])
def test_the_sample_keeps_the_boxes_with_the_least_keys_of_each_state(count: int, distinct_keys: int) -> None:
    rng = np.random.default_rng(count)
    rows = np.column_stack([rng.integers(0, distinct_keys, count), *rng.integers(0, 3, (6, count))]) / 1.0
    ordered = sorted(rows.tolist(), key=lambda row: (row[1], row[0], row[2:]))
    plain = [row for state in range(3) for row in [r for r in ordered if r[1] == state][: workers.BOXES_A_STATE]]
    assert workers._least(rows).tolist() == plain
