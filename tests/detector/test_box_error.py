import numpy as np
import pytest
from scipy import stats

from modsim3d.core.boxes import sizes
from modsim3d.core.errors import ModsimError
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import Detections
from tests.detector import detector_builders as build

SEEN = {"confusion": build.ALL_SEEN, "false_discovery_rate": 0}


def misplaced(box_px: list[float], error: dict[str, object], frames: int = 1, vessels: int = 1) -> Detections:
    model = parse_detector(build.one_state_data(**SEEN, box_error=error))
    return build.run(model, build.make_frames(frames), build.steady_targets(frames, vessels, box_px))


@pytest.fixture(scope="module")
def small() -> Detections:
    return misplaced(
        build.centred(20, 20), build.box_error(build.MEAN_PX, build.COVARIANCE_PX2), frames=1000, vessels=20
    )


def test_small_boxes_never_degenerate(small: Detections) -> None:
    assert len(small) == 20_000 and sizes(small.boxes_px).min() >= 1
    assert small.boxes_px.min() >= 0 and np.all(small.boxes_px[:, 2:] <= build.IMAGE_PX)


def test_small_boxes_are_redrawn_as_often_as_the_normal_says(small: Detections) -> None:
    # In the middle of the image only a width or height below one pixel is redrawn: −e_w < 19 and −e_h < 19.
    mean, covariance = -np.array(build.MEAN_PX[2:]), np.array(build.COVARIANCE_PX2)[2:, 2:]
    p = 1 - stats.multivariate_normal(mean, covariance).cdf([19, 19])
    assert abs(small.redrawn.mean() - p) < 4 * np.sqrt(p * (1 - p) / len(small))


def test_truncation_makes_small_boxes_wider_than_asked(small: Detections) -> None:
    e_w, std = small.errors_px[:, 2], np.sqrt(build.COVARIANCE_PX2[2][2])
    assert e_w.min() >= -19 and e_w.mean() > build.MEAN_PX[2] + 100 * std / np.sqrt(len(e_w))


def test_redrawn_errors_have_the_truncated_normal_distribution() -> None:
    error = build.box_error([0, 0, 0, 0], np.diag([1.0, 1.0, 400.0, 1.0]))
    e_w = misplaced(build.centred(11, 100), error, frames=2000, vessels=10).errors_px[:, 2]
    truncated = stats.truncnorm(-10 / 20, np.inf, scale=20)
    assert stats.kstest(e_w, truncated.cdf).pvalue > 1e-4


def test_a_redraw_leaves_the_first_draws_of_other_steps_alone() -> None:
    frames, error = build.make_frames(300), build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)
    model = parse_detector(build.one_state_data(**SEEN, box_error=error))
    boxes = build.same_boxes(300, 1, build.centred(600, 600))
    large = build.run(model, frames, build.make_targets(boxes))
    boxes[::2] = build.centred(5, 5)
    mixed = build.run(model, frames, build.make_targets(boxes))
    assert mixed.redrawn[::2].mean() > 0.5
    assert np.array_equal(mixed.errors_px[1::2], large.errors_px[1::2])


@pytest.mark.parametrize(
    "box_px", [[10.25, 20.5, 30.125, 90.7], [0, 0, 3600, 2400], [0.1, 0.2, 1.1, 1.2], [3599, 2399, 3600, 2400]]
)
def test_a_detector_without_errors_gives_the_truth_exactly(box_px: list[float]) -> None:
    assert misplaced(box_px, build.no_error()).boxes_px.tolist() == [box_px]


@pytest.mark.parametrize(
    ("box_px", "pixel"),
    [
        ([10.4, 20.5, 10.7, 20.8], [10, 20, 11, 21]),
        ([3599.7, 5, 3600, 9], [3599, 5, 3600, 9]),
        ([0, 2399.9, 7, 2400], [0, 2399, 7, 2400]),
        ([3600, 2400, 3600, 2400], [3599, 2399, 3600, 2400]),
    ],
)
def test_a_truth_box_thinner_than_a_pixel_is_the_pixel_it_is_in(box_px: list[float], pixel: list[float]) -> None:
    assert misplaced(box_px, build.no_error()).boxes_px.tolist() == [pixel]


@pytest.mark.parametrize("box_px", [[0, 0, 4, 4], [3599.7, 1200, 3600, 1201], [1800, 2399.5, 1900, 2400]])
def test_boxes_at_the_edge_stay_in_the_image_and_a_pixel_wide(box_px: list[float]) -> None:
    found = misplaced(box_px, build.box_error(build.MEAN_PX, build.COVARIANCE_PX2), frames=300)
    assert len(found) == 300 and sizes(found.boxes_px).min() >= 1
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= build.IMAGE_PX)
    assert found.redrawn.any()


def test_errors_are_told_as_drawn_before_the_box_is_clipped() -> None:
    found = misplaced([0, 1000, 200, 1200], build.box_error([-50, 0, 0, 0], np.zeros((4, 4))))
    assert found.errors_px.tolist() == [[-50, 0, 0, 0]]
    assert found.boxes_px.tolist() == [[0, 1000, 150, 1200]]


def test_a_singular_covariance_moves_boxes_along_one_line_only() -> None:
    direction = np.array([1.0, 2.0, -3.0, 0.5])
    error = build.box_error([0, 0, 0, 0], np.outer(direction, direction))
    errors = misplaced(build.centred(600, 600), error, frames=2000).errors_px
    along = errors @ direction / (direction @ direction)
    np.testing.assert_allclose(errors, along[:, None] * direction, atol=1e-5)
    assert abs(along.std() - 1) < 4 / np.sqrt(2 * 2000)


def test_the_root_times_itself_is_the_covariance() -> None:
    root = symmetric_root(np.array(build.COVARIANCE_PX2, dtype=float))
    np.testing.assert_allclose(root @ root, build.COVARIANCE_PX2, rtol=1e-12)


@pytest.mark.parametrize(
    "error",
    [build.box_error([0, 0, -50, 0], np.zeros((4, 4))), build.box_error([9000, 0, 0, 0], np.eye(4))],
    ids=["inside out", "outside the image"],
)
def test_a_hopeless_box_is_an_error_that_says_where_and_what_to_do(error: dict[str, object]) -> None:
    model = parse_detector(build.one_state_data(**SEEN, box_error=error))
    boxes = np.full((3, 2, 4), np.nan)
    boxes[2, 1] = build.centred(3, 2)
    with pytest.raises(ModsimError) as caught:
        build.run(model, build.make_frames(3, first_step=40), build.make_targets(boxes, vessel_ids=["near", "far"]))
    for part in ("'far'", "step 42", "'C0'", "'only'", "10000", "3 × 2 px", "min_box_px"):
        assert part in str(caught.value)
