"""The truth record without rows, joined and chosen, what modes annotate; a camera inside a body."""

from dataclasses import fields, replace
from typing import get_args

import numpy as np
import pytest

from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.scene.keys import AnnotationKeys
from modsim3d.truth.outlines import first_body_around, solid_angle
from modsim3d.truth.record import SOURCES, Annotation, Truth, annotated_rows, annotation_boxes, concatenate, no_truth
from modsim3d.world.bodies import Bodies, vessel_bodies
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import vessel


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


def test_a_record_without_rows_is_empty_and_records_are_joined_and_rows_chosen_in_order():
    nothing, something = no_truth(), two_rows(0, (0, 1), 5)
    assert len(nothing) == 0 and nothing.occluder_offsets.tolist() == [0]
    for field in fields(Truth):
        empty, column = getattr(nothing, field.name), getattr(something, field.name)
        assert (empty.dtype.kind, empty.shape[1:]) == (column.dtype.kind, column.shape[1:]), field.name
        assert field.name == "occluder_offsets" or len(empty) == 0
    first, second = two_rows(3, (1, 2), 5), two_rows(1, (0, 4), 6)
    for parts in ([first, second], [second, no_truth(), first]):
        joined = concatenate(parts)
        assert joined.step.tolist() == [1, 1, 3, 3] and joined.vessel.tolist() == [0, 4, 1, 2]
        assert [joined.occluders_of(row) for row in range(4)] == [[], [(6, 60.0)], [], [(5, 50.0)]]
        assert sorted(joined.intersections.tolist()) == [[1, 0, 0, 4], [3, 0, 1, 2]]
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


WHOLE, SEEN, HIDDEN, UNKNOWN = range(4)


def four_rows() -> Truth:
    """One vessel each that is seen as a whole, seen in part, hidden, and of which it is not known what is seen."""
    full = np.array([[0.0, 0.0, 40.0, 20.0]] * 4)
    visible = np.array([[0.0, 0, 40, 20], [10, 0, 15, 20], [np.nan] * 4, [np.nan] * 4])
    silhouette, seen = np.full(4, 800.0), np.array([800.0, 100.0, 0.0, np.nan])
    pixels = {"silhouette_px": silhouette, "visible_px": seen, "visible_fraction": seen / silhouette}
    step = np.zeros(4, dtype=np.int64)
    return replace(no_truth(), step=step, full_boxes_px=full, visible_boxes_px=visible, **pixels)


def test_mode_and_filters_keep_these_rows_and_nothing_is_filtered_unasked():
    for mode, filters, kept in (
        (0, {}, [WHOLE, SEEN, HIDDEN, UNKNOWN]),
        (1, {}, [WHOLE, SEEN]),
        (2, {}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 1e-9}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 100.0}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 100.5}, [WHOLE]),
        (2, {"min_visible_px": 800.5}, []),
        (0, {"min_visible_fraction": 1e-9}, [WHOLE, SEEN]),
        (0, {"min_visible_fraction": 0.125}, [WHOLE, SEEN]),
        (1, {"min_visible_fraction": 0.126}, [WHOLE]),
        (0, {"min_visible_fraction": 1.0}, [WHOLE]),
        (0, {"min_box_px": 20.0}, [WHOLE, SEEN, HIDDEN, UNKNOWN]),
        (0, {"min_box_px": 20.5}, []),
        (1, {"min_box_px": 6.0}, [WHOLE, SEEN]),
        (2, {"min_box_px": 5.0}, [WHOLE, SEEN]),
        (2, {"min_box_px": 6.0}, [WHOLE]),
        (2, {"min_box_px": 6.0, "min_visible_px": 801.0}, []),
        (0, {"min_visible_px": 50.0, "min_visible_fraction": 0.5}, [WHOLE]),
    ):
        assert np.flatnonzero(annotated_rows(four_rows(), Annotation(mode=mode, **filters))).tolist() == kept, filters
    one_pixel = replace(four_rows(), visible_px=np.array([1.0, 0.25, 0.0, np.nan]))
    assert np.flatnonzero(annotated_rows(one_pixel, Annotation(mode=1))).tolist() == [WHOLE, SEEN]
    truth = four_rows()
    for mode, expected in enumerate((truth.full_boxes_px, truth.full_boxes_px, truth.visible_boxes_px)):
        np.testing.assert_array_equal(annotation_boxes(truth, mode), expected)
    assert Annotation() == Annotation(0, "rendered", 1, "regions", 0.0, 0.0, 0.0, False)
    assert get_args(AnnotationKeys.model_fields["source"].annotation) == (*SOURCES, "labels")


ORIGIN = np.zeros(3)


def test_solid_angles_add_up_to_the_sphere_and_the_first_frame_with_the_camera_in_a_body_counts(monkeypatch):
    octant = np.diag([1.0, 2.0, 3.0])[None]
    assert solid_angle(ORIGIN, octant) == pytest.approx(np.pi / 2)
    assert solid_angle(ORIGIN, octant[:, ::-1]) == pytest.approx(-np.pi / 2)
    rng = np.random.default_rng(0)
    for corners in rng.normal([0, 0, 2], 1, (100, 3, 3)):
        whole = solid_angle(ORIGIN, corners[None])
        assert solid_angle(ORIGIN, (corners * rng.uniform(0.1, 9, (3, 1)))[None]) == pytest.approx(whole, rel=1e-9)
        middle = rng.dirichlet(np.ones(3)) @ corners
        parts = [[a, b, middle] for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        assert solid_angle(ORIGIN, np.array(parts)) == pytest.approx(whole, rel=1e-9)
    box = shoebox().vertices[shoebox().faces] * [5.0, 2.0, 3.0]
    rng = np.random.default_rng(1)
    inside = rng.uniform([-2.4, -0.9, 0.1], [2.4, 0.9, 2.9], (50, 3))
    outside = inside + rng.choice([-1, 1], (50, 1)) * np.eye(3)[rng.integers(0, 3, 50)] * 6
    np.testing.assert_allclose(solid_angle(inside, box), 4 * np.pi, atol=1e-9)
    np.testing.assert_allclose(solid_angle(outside, box), 0.0, atol=1e-9)
    for cameras, present, expected in CASES:
        assert first_body_around(np.array(cameras, dtype=float), fleet(present)) == expected, (cameras, present)
    monkeypatch.setattr("modsim3d.truth.outlines.solid_angle", None)  # needed in the box around a body only
    assert first_body_around(np.array([(0, 3, 1), (6, 0, 1.0)]), fleet([[1, 1]] * 2)) is None
    monkeypatch.undo()
    (bodies,) = fleet([[1, 1]] * 2)
    later, sooner = (replace(bodies, present=np.array(there, dtype=bool)) for there in ([[0, 0], [1, 0]], [[1, 0]] * 2))
    sooner = replace(sooner, occluder=sooner.occluder + 2)
    assert first_body_around(np.array([[0.0, 0.0, 1.0]] * 2), [later, sooner]) == (0, 2)
    inward = Solid(shoebox().vertices, shoebox().faces[:, ::-1])
    assert first_body_around(np.array([[20.0, 0.0, 1.0]] * 2), [replace(bodies, solid=inward)]) == (0, 1)


def fleet(present: list[list[int]]) -> list[Bodies]:
    """A boat at the origin, 8 m long and 2 m wide and high, and one 20 m ahead of it that lies across."""
    boats, steps = [vessel("along", 8, 2, 2), vessel("across", 8, 2, 2)], len(present)
    places = np.tile([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]], (steps, 1, 1))
    headings = np.tile([0.0, np.pi / 2], (steps, 1))
    return vessel_bodies(boats, np.array(present, dtype=bool), places, world_R_vehicle(headings))


CASES = [
    ([(3.9, 0.9, 1)], [[1, 1]], (0, 0)),
    ([(20.9, 3.9, 1)], [[1, 1]], (0, 1)),
    ([(23.9, 0.9, 1)], [[1, 1]], None),
    ([(30, 0, 1), (20, 0, 1), (0, 0, 1)], [[1, 1]] * 3, (1, 1)),
    ([(0, 0, 1), (0, 0, 1), (0, 0, 1)], [[0, 1], [0, 1], [1, 1]], (2, 0)),
    ([(0, 0, 1), (20, 0, 1)], [[0, 1], [1, 0]], None),
]
