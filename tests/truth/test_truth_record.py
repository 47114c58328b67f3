"""The truth record without rows, and as records are joined and rows chosen."""

from dataclasses import fields, replace

import numpy as np

from modsim3d.truth.record import Truth, concatenate, no_truth


def two_rows(step: int, vessels: tuple[int, int], hider: int) -> Truth:
    """Two vessels at a step, of which a hider hides the second."""
    numbers = np.array(vessels, dtype=np.float64)
    plain = ("silhouette_px", "visible_px", "visible_fraction", "in_frame_fraction", "depth_m")
    return replace(
        no_truth(),
        **{"step": np.full(2, step), "camera": np.zeros(2, dtype=np.int64), "vessel": np.array(vessels)},
        **dict.fromkeys(("full_boxes_px", "visible_boxes_px"), np.tile(numbers[:, None], 4)),
        **dict.fromkeys(plain, numbers),
        occluder_offsets=np.array([0, 0, 1]),
        occluder=np.array([hider]),
        occluder_px=np.array([10.0 * hider]),
        annotated=numbers > 0,
        drawn=numbers < 1,
        intersections=np.array([[step, 0, *vessels]]),
    )


def test_record_without_rows_has_every_column_empty_and_of_its_kind():
    nothing, something = no_truth(), two_rows(0, (0, 1), 5)
    assert len(nothing) == 0 and nothing.occluder_offsets.tolist() == [0]
    for field in fields(Truth):
        empty, column = getattr(nothing, field.name), getattr(something, field.name)
        assert (empty.dtype.kind, empty.shape[1:]) == (column.dtype.kind, column.shape[1:]), field.name
        assert field.name == "occluder_offsets" or len(empty) == 0


def test_records_are_joined_in_order_of_steps_with_their_hiders():
    first, second = two_rows(3, (1, 2), 5), two_rows(1, (0, 4), 6)
    for parts in ([first, second], [second, no_truth(), first]):
        joined = concatenate(parts)
        assert joined.step.tolist() == [1, 1, 3, 3] and joined.vessel.tolist() == [0, 4, 1, 2]
        assert [joined.occluders_of(row) for row in range(4)] == [[], [(6, 60.0)], [], [(5, 50.0)]]
        assert sorted(joined.intersections.tolist()) == [[1, 0, 0, 4], [3, 0, 1, 2]]


def test_rows_are_chosen_by_indices_masks_and_slices():
    truth = concatenate([two_rows(1, (0, 4), 6), two_rows(3, (1, 2), 5)])
    for rows in (np.array([1, 3]), np.array([False, True, False, True]), slice(1, None, 2)):
        chosen = truth.take(rows)
        assert chosen.vessel.tolist() == [4, 2]
        assert [chosen.occluders_of(row) for row in range(2)] == [[(6, 60.0)], [(5, 50.0)]]
        assert chosen.intersections.tolist() == truth.intersections.tolist()
    assert truth.take(np.array([3, 1])).vessel.tolist() == [2, 4]
    other = truth.with_annotated(~truth.annotated)
    np.testing.assert_array_equal(other.annotated, ~truth.annotated)
    assert other.vessel is truth.vessel
