from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.core.boxes import inside_image, move, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams, grid_normals
from modsim3d.detector.box_error import BoxErrorSource, TrueBoxes
from modsim3d.detector.draws import BOX_ERROR_REDRAW_STREAMS
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import Detections
from tests.detector import detector_builders as build

SEEN = {"confusion": build.ALL_SEEN, "false_discovery_rate": 0}
THESIS = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)


def misplaced(box_px: list[float], error: dict[str, Any], frames: int = 1, vessels: int = 1) -> Detections:
    model = parse_detector(build.one_state_data(**SEEN, box_error=error))
    return build.run(model, build.make_frames(frames), build.steady_targets(frames, vessels, box_px))


def test_small_boxes_never_degenerate_and_are_redrawn_as_often_as_the_normal_says() -> None:
    found = misplaced(build.centred(20, 20), THESIS, frames=1000, vessels=20)
    assert len(found) == 20_000 and sizes(found.boxes_px).min() >= 1
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= build.IMAGE_PX)
    # In the middle of the image only a width or height below one pixel is redrawn: −e_w < 19 and −e_h < 19.
    mean, covariance = -np.array(build.MEAN_PX[2:]), np.array(build.COVARIANCE_PX2)[2:, 2:]
    p = 1 - stats.multivariate_normal(mean, covariance).cdf([19, 19])
    assert abs(found.redrawn.mean() - p) < 4 * np.sqrt(p * (1 - p) / len(found))
    e_w, std = found.errors_px[:, 2], np.sqrt(build.COVARIANCE_PX2[2][2])
    assert e_w.min() >= -19 and e_w.mean() > build.MEAN_PX[2] + 100 * std / np.sqrt(len(e_w)), "wider than asked"


def test_redrawn_errors_have_the_truncated_normal_distribution() -> None:
    error = build.box_error([0, 0, 0, 0], np.diag([1.0, 1.0, 400.0, 1.0]))
    e_w = misplaced(build.centred(11, 100), error, frames=2000, vessels=10).errors_px[:, 2]
    assert stats.kstest(e_w, stats.truncnorm(-10 / 20, np.inf, scale=20).cdf).pvalue > 1e-4


def test_a_detector_without_errors_gives_the_truth_exactly_or_the_pixel_that_a_thinner_box_is_in() -> None:
    exact = [[10.25, 20.5, 30.125, 90.7], [0, 0, 3600, 2400], [0.1, 0.2, 1.1, 1.2], [3599, 2399, 3600, 2400]]
    thin = [
        ([10.4, 20.5, 10.7, 20.8], [10, 20, 11, 21]),
        ([3599.7, 5, 3600, 9], [3599, 5, 3600, 9]),
        ([0, 2399.9, 7, 2400], [0, 2399, 7, 2400]),
        ([3600, 2400, 3600, 2400], [3599, 2399, 3600, 2400]),
    ]
    for box_px, expected in (*zip(exact, exact, strict=True), *thin):
        assert misplaced(box_px, build.no_error()).boxes_px.tolist() == [expected], box_px


@pytest.mark.parametrize("box_px", [[0, 0, 4, 4], [3599.7, 1200, 3600, 1201], [1800, 2399.5, 1900, 2400]])
def test_boxes_at_the_edge_stay_in_the_image_and_a_pixel_wide(box_px: list[float]) -> None:
    found = misplaced(box_px, THESIS, frames=300)
    assert len(found) == 300 and sizes(found.boxes_px).min() >= 1 and found.redrawn.any()
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= build.IMAGE_PX)


def test_errors_are_told_as_drawn_before_the_box_is_clipped() -> None:
    found = misplaced([0, 1000, 200, 1200], build.box_error([-50, 0, 0, 0], np.zeros((4, 4))))
    assert found.errors_px.tolist() == [[-50, 0, 0, 0]] and found.boxes_px.tolist() == [[0, 1000, 150, 1200]]


def test_a_singular_covariance_moves_boxes_along_one_line_only() -> None:
    direction = np.array([1.0, 2.0, -3.0, 0.5])
    error = build.box_error([0, 0, 0, 0], np.outer(direction, direction))
    errors = misplaced(build.centred(600, 600), error, frames=2000).errors_px
    along = errors @ direction / (direction @ direction)
    np.testing.assert_allclose(errors, along[:, None] * direction, atol=1e-5)
    assert abs(along.std() - 1) < 4 / np.sqrt(2 * 2000)


@pytest.mark.parametrize(("mean", "covariance"), [([0, 0, -50, 0], np.zeros((4, 4))), ([9000, 0, 0, 0], np.eye(4))])
def test_a_box_inside_out_or_outside_the_image_is_an_error_that_says_where_and_what_to_do(mean, covariance) -> None:
    model = parse_detector(build.one_state_data(**SEEN, box_error=build.box_error(mean, covariance)))
    boxes = np.full((3, 2, 4), np.nan)
    boxes[2, 1] = build.centred(3, 2)
    with pytest.raises(ModsimError) as caught:
        build.run(model, build.make_frames(3, first_step=40), build.make_targets(boxes, vessel_ids=["near", "far"]))
    for part in ("'far'", "step 42", "'C0'", "'only'", "10000", "3 × 2 px", "min_box_px"):
        assert part in str(caught.value)


def one_at_a_time(source: BoxErrorSource, true: TrueBoxes, row: int) -> np.ndarray:
    """The first draw of a box's own generators that leaves it in the image."""
    targets, frames, streams = true.targets, true.frames, Streams(4)
    vessel, step = targets.vessel_ids[targets.vessel[row]], int(frames.steps[targets.frame[row]])
    widths = BOX_ERROR_REDRAW_STREAMS.widths(source.extra_normals)
    generators = [(streams.generator(purpose, "C0", vessel, step=step), width) for purpose, width in widths.items()]
    box, state = true.boxes_px[[row]], true.state[[row]]
    while True:
        uniforms = np.concatenate([generator.random(width) for generator, width in generators])
        error = source.errors_px(state, sizes(box), grid_normals(uniforms[None]))
        if inside_image(move(box, error), build.IMAGE_PX).all():
            return error[0]


@pytest.mark.parametrize("law", [{}, {"law": "student_t", "degrees_of_freedom": 6.0}], ids=["normal", "student_t"])
def test_all_boxes_at_once_have_the_redrawn_errors_of_one_at_a_time(law: dict[str, Any]) -> None:
    source = BoxErrorSource.from_model(parse_detector(build.one_state_data(box_error=THESIS | law)))
    steps, vessels = 40, 25
    low = np.random.default_rng(1).uniform(0, np.array(build.IMAGE_PX) - 4, (steps, vessels, 2))
    targets = build.make_targets(np.concatenate([low, low + 3], axis=-1))
    true = TrueBoxes.of(build.make_frames(steps, first_step=9), np.zeros(steps, dtype=np.int64), targets)
    latent = np.full((len(targets.frame), 4 + source.extra_normals), -9.0)  # nothing is left of any box
    placed = source.misplace(Streams(4), true, latent)
    assert placed.redrawn.all()
    rows = range(0, steps * vessels, 7)
    assert np.array_equal(placed.errors_px[rows], [one_at_a_time(source, true, row) for row in rows])
