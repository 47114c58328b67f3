"""The boxes of the model, and what hides their edges, against the truth of the same scene."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.voyages.wrong_camera import Voyage, really
from modsim3d.learn.voyage.registration.boxes_at_times import BoxesAtTimes, match, predict
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic, crosses, planes_of
from modsim3d.learn.voyage.registration.parameters import Values
from modsim3d.scene.reading import load_scene
from modsim3d.truth.record import Truth


@pytest.fixture(scope="module")
def quay() -> Voyage:
    return Voyage.of(load_scene("strait", settings={"annotation.source": "analytic"}), "quay", {})


@pytest.fixture(scope="module")
def model(quay: Voyage) -> BoxModel:
    return BoxModel.of(quay.scene, KnownTraffic.of(quay.scene, quay.scene.cameras[0]))


def none(model: BoxModel) -> Values:
    return Values.none(len(model.hulls_m))


def times_of(quay: Voyage, truth: Truth) -> np.ndarray:
    return quay.scene.times_s(0, quay.scene.steps)[truth.step]


def test_boxes_are_those_of_the_truth_where_the_image_does_not_cut_them(quay: Voyage, model: BoxModel) -> None:
    whole = quay.truth.take(quay.truth.in_frame_fraction == 1)
    boxes, corners = model.boxes(none(model), times_of(quay, whole), whole.vessel)
    assert len(whole) > 200
    np.testing.assert_allclose(boxes, whole.full_boxes_px, atol=1e-6)
    np.testing.assert_allclose(model.edges(none(model), times_of(quay, whole), whole.vessel, corners), boxes)


def test_an_edge_that_the_truth_hides_is_found_hidden(quay: Voyage, model: BoxModel) -> None:
    known = quay.truth.take(np.isfinite(quay.truth.visible_boxes_px).all(axis=1))
    gone = np.abs(known.full_boxes_px - known.visible_boxes_px) > 1
    predicted = predict(model, HidingBodies.of(quay.scene, model), none(model), np.unique(times_of(quay, known)))
    frame = np.searchsorted(np.unique(known.step), known.step)
    rows = {pair: row for row, pair in enumerate(zip(predicted.frame.tolist(), predicted.vessel.tolist(), strict=True))}
    pairs = list(zip(frame.tolist(), known.vessel.tolist(), strict=True))
    # A vessel is not predicted if all its edges are behind the box around another, whose mesh may show some of it.
    usable = np.array([predicted.usable[rows[pair]] if pair in rows else np.zeros(4, bool) for pair in pairs])
    assert np.mean([pair in rows for pair in pairs]) > 0.99
    assert gone.sum() > 30
    assert not np.any(usable & gone)
    assert usable.mean() > 0.6


def test_parameters_do_what_changing_the_camera_does(quay: Voyage, model: BoxModel) -> None:
    changes = {"roll_deg": 2.0, "pitch_deg": -1.0, "yaw_deg": 3.0, "height_m": 2.0, "focal_share": 0.05}
    real = really(quay.scene, "quay", changes)
    times_s, vessel = np.repeat([5.0, 20.0], 9), np.tile(np.arange(9), 2)
    expected, _ = BoxModel.of(real, KnownTraffic.of(real, real.cameras[0])).boxes(none(model), times_s, vessel)
    found, _ = model.boxes(none(model).changed(clock_s=1.5, **changes), times_s - 1.5, vessel)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_delayed_vessel_is_where_it_reports_to_be_later_and_an_antenna_is_off_its_centre(model: BoxModel) -> None:
    times_s, vessel = np.array([10.0]), np.array([3])
    values = none(model)
    values.vessels[3] = 4.0, 1.0, 2.0
    (point,) = model.points_world(values, times_s, vessel, np.zeros((1, 1, 3)))[0]
    (late, rotation) = (part[0] for part in model.traffic.at(times_s + 2.0, vessel))
    np.testing.assert_allclose(point, late - rotation @ (4.0, 1.0, 0.0))


def test_two_vessels_that_a_detection_may_be_are_not_matched(model: BoxModel, quay: Voyage) -> None:
    predicted = predict(model, HidingBodies.of(quay.scene, model), none(model), np.array([10.0]))
    box = predicted.boxes_px[:1]
    gates = np.full((len(predicted.frame), 2), 50.0)
    found = BoxesAtTimes(np.array([10.0]), np.array([0]), box)
    assert match(found, predicted, (1920, 1080), gates).vessel.tolist() == predicted.vessel[:1].tolist()
    twice = BoxesAtTimes(np.array([10.0]), np.array([0, 0]), np.concatenate([box - 5, box + 5]))
    assert not len(match(twice, predicted, (1920, 1080), gates))


def test_a_ray_is_hidden_by_a_solid_on_its_way_and_by_none_before_or_behind_it() -> None:
    block = planes_of(np.array([(x, y, z) for x in (4.0, 6.0) for y in (-1.0, 1.0) for z in (0.0, 3.0)]))
    assert block is not None
    ends = np.array([[10.0, 0.0, 1.0], [3.0, 0.0, 1.0], [10.0, 5.0, 1.0], [10.0, 0.0, 9.0], [-10.0, 0.0, 1.0]])
    assert crosses(np.zeros((5, 3)), ends, block).tolist() == [True, False, False, False, False]
