"""Box errors: normal, Student's t, relative and mixed ones, and what redrawing those without a box does to them."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.core.boxes import inside_image, move, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams, grid_normals
from modsim3d.detector import truncation
from modsim3d.detector.box_error import BoxErrorSource, TrueBoxes
from modsim3d.detector.draws import BOX_ERROR_REDRAW_STREAMS, Normal, StudentT, standardised
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import Detections
from modsim3d.detector.truncation import truncated_errors
from tests.detector import detector_builders as build

SEEN = {"confusion": build.ALL_SEEN, "false_discovery_rate": 0}
THESIS = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)
HEAVY = THESIS | {"law": "student_t", "degrees_of_freedom": 6.0}


def source_of(error: dict[str, Any]) -> BoxErrorSource:
    return BoxErrorSource.from_model(parse_detector(build.one_state_data(**SEEN, box_error=error)))


def misplaced(box_px: list[float], error: dict[str, Any], frames: int = 1, vessels: int = 1) -> Detections:
    data = build.one_state_data(**SEEN, box_error=error)
    return build.run(data, build.make_frames(frames), build.steady_targets(frames, vessels, box_px))


def test_small_boxes_never_degenerate_and_a_detector_without_errors_gives_the_truth_or_a_pixel():
    found = misplaced(build.centred(20, 20), THESIS, frames=1000, vessels=20)
    assert len(found) == 20_000 and sizes(found.boxes_px).min() >= 1
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= build.IMAGE_PX)
    # In the middle of the image only a width or height below one pixel is redrawn: −e_w < 19 and −e_h < 19.
    mean, covariance = -np.array(build.MEAN_PX[2:]), np.array(build.COVARIANCE_PX2)[2:, 2:]
    p = 1 - stats.multivariate_normal(mean, covariance).cdf([19, 19])
    assert abs(found.redrawn.mean() - p) < 4 * np.sqrt(p * (1 - p) / len(found))
    e_w, std = found.errors_px[:, 2], np.sqrt(build.COVARIANCE_PX2[2][2])
    assert e_w.min() >= -19 and e_w.mean() > build.MEAN_PX[2] + 100 * std / np.sqrt(len(e_w)), "wider than asked"
    exact = [[10.25, 20.5, 30.125, 90.7], [0, 0, 3600, 2400], [0.1, 0.2, 1.1, 1.2], [3599, 2399, 3600, 2400]]
    thin = [
        ([10.4, 20.5, 10.7, 20.8], [10, 20, 11, 21]),
        ([3599.7, 5, 3600, 9], [3599, 5, 3600, 9]),
        ([0, 2399.9, 7, 2400], [0, 2399, 7, 2400]),
        ([3600, 2400, 3600, 2400], [3599, 2399, 3600, 2400]),
    ]
    for box_px, expected in (*zip(exact, exact, strict=True), *thin):
        assert misplaced(box_px, build.no_error()).boxes_px.tolist() == [expected], box_px
    found = misplaced([0, 1000, 200, 1200], build.box_error([-50, 0, 0, 0], np.zeros((4, 4))))
    assert found.errors_px.tolist() == [[-50, 0, 0, 0]] and found.boxes_px.tolist() == [[0, 1000, 150, 1200]]


@pytest.mark.parametrize("box_px", [[0, 0, 4, 4], [3599.7, 1200, 3600, 1201], [1800, 2399.5, 1900, 2400]])
def test_boxes_at_the_edge_stay_in_the_image_and_a_pixel_wide(box_px: list[float]) -> None:
    found = misplaced(box_px, THESIS, frames=300)
    assert len(found) == 300 and sizes(found.boxes_px).min() >= 1 and found.redrawn.any()
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= build.IMAGE_PX)


@pytest.mark.parametrize(("mean", "covariance"), [([0, 0, -50, 0], np.zeros((4, 4))), ([9000, 0, 0, 0], np.eye(4))])
def test_a_box_inside_out_or_outside_the_image_is_an_error_that_says_where_and_what_to_do(mean, covariance) -> None:
    data = build.one_state_data(**SEEN, box_error=build.box_error(mean, covariance))
    boxes = np.full((3, 2, 4), np.nan)
    boxes[2, 1] = build.centred(3, 2)
    with pytest.raises(ModsimError) as caught:
        build.run(data, build.make_frames(3, first_step=40), build.make_targets(boxes, vessel_ids=["near", "far"]))
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


@pytest.mark.parametrize("error", [THESIS, HEAVY], ids=["normal", "student_t"])
def test_all_boxes_at_once_have_the_redrawn_errors_of_one_at_a_time(error: dict[str, Any]) -> None:
    source, steps, vessels = source_of(error), 40, 25
    low = np.random.default_rng(1).uniform(0, np.array(build.IMAGE_PX) - 4, (steps, vessels, 2))
    targets = build.make_targets(np.concatenate([low, low + 3], axis=-1))
    true = TrueBoxes.of(build.make_frames(steps, first_step=9), np.zeros(steps, dtype=np.int64), targets)
    latent = np.full((len(targets.frame), 4 + source.extra_normals), -9.0)  # nothing is left of any box
    placed = source.misplace(Streams(4), true, latent)
    assert placed.redrawn.all()
    rows = range(0, steps * vessels, 7)
    assert np.array_equal(placed.errors_px[rows], [one_at_a_time(source, true, row) for row in rows])


RELATIVE = {
    "unit": "relative",
    "mean": [0.01, -0.02, 0.03, 0.0],
    "covariance": [[0.01, 0, 0.004, 0], [0, 0.0025, 0, -0.001], [0.004, 0, 0.0064, 0], [0, -0.001, 0, 0.0036]],
}
MIXED = {
    "unit": "mixed",
    "mean": [1, 2, -3, 0],
    "covariance": [[4, 1, 0, 0], [1, 9, 0, 0], [0, 0, 16, -6], [0, 0, -6, 9]],
    "growth": [0.02, 0.05, 0.1, 0],
}


def assert_moments(errors: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> None:
    assert np.all(np.abs(errors.mean(axis=0) - mean) < 4 * np.sqrt(np.diag(covariance) / len(errors)))
    variance = np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2
    assert np.all(np.abs(np.cov(errors.T) - covariance) < 4 * np.sqrt(variance / len(errors)))


@pytest.mark.parametrize(("width", "height"), [(100, 80), (900, 300)])
def test_relative_errors_are_in_sides_of_the_box_and_mixed_ones_spread_with_them(width: float, height: float) -> None:
    sides = np.array([width, height, width, height])
    found = misplaced(build.centred(width, height), RELATIVE, 2000, 10)
    assert not found.redrawn.any()
    assert_moments(found.errors_px, RELATIVE["mean"] * sides, RELATIVE["covariance"] * np.outer(sides, sides))
    found, asked = misplaced(build.centred(width, height), MIXED, 2000, 10), np.array(MIXED["covariance"], dtype=float)
    std = np.sqrt(np.diag(asked))
    grown = 1 + np.array(MIXED["growth"]) * sides / std
    assert_moments(found.errors_px, np.array(MIXED["mean"]), asked * np.outer(grown, grown))


def test_a_singular_covariance_moves_boxes_along_one_line_and_states_may_have_different_units() -> None:
    direction = np.array([1.0, 2.0, -3.0, 0.5])
    error = build.box_error([0, 0, 0, 0], np.outer(direction, direction))
    errors = misplaced(build.centred(600, 600), error, frames=2000).errors_px
    along = errors @ direction / (direction @ direction)
    np.testing.assert_allclose(errors, along[:, None] * direction, atol=1e-5)
    assert abs(along.std() - 1) < 4 / np.sqrt(2 * 2000)
    data = build.one_state_data(**SEEN)
    only = data["states"]["only"]
    states = {"px": only, "relative": only | {"box_error": RELATIVE}}
    data |= {"states": states, "initial_state": "px", "transition_matrix": [[0.5, 0.5], [0.5, 0.5]]}
    found = build.run(data, build.make_frames(2000), build.steady_targets(2000, 5, build.centred(900, 500)))
    relative = found.states[found.frame] == 1
    assert_moments(found.errors_px[~relative], np.array(build.MEAN_PX), np.array(build.COVARIANCE_PX2, dtype=float))
    sides = np.array([900, 500, 900, 500])
    covariance = RELATIVE["covariance"] * np.outer(sides, sides)
    assert_moments(found.errors_px[relative], RELATIVE["mean"] * sides, covariance)
    found = misplaced([100.2, 100.2, 100.5, 140.2], RELATIVE, 200, 10)
    assert np.all(found.boxes_px[:, 2:] - found.boxes_px[:, :2] >= 1)


AT_EDGES = ([0, 1000, 60, 1040], [3590, 1000, 3600, 1100], [1800, 2395, 1900, 2400])
BOXES = [build.centred(20, 20), build.centred(47, 67), *AT_EDGES]


@pytest.mark.parametrize(("error", "box_px", "stray"), [
    *((THESIS, box_px, 0.02) for box_px in BOXES), *((HEAVY, box_px, 0.06) for box_px in BOXES[:3:2]),
])  # fmt: skip
def test_truncated_moments_are_those_of_what_the_detector_draws(error, box_px, stray) -> None:
    found, sampling = misplaced(box_px, error, 2000, 20), 4 / np.sqrt(40_000)
    asked = truncated_errors(source_of(error), 0, np.array([box_px]), build.IMAGE_PX)
    std = np.sqrt(np.diag(asked.covariances()[0]))
    assert np.all(np.abs(found.errors_px.mean(axis=0) - asked.means[0]) < (0.02 + sampling) * std)
    assert np.all(np.abs(found.errors_px.std(axis=0) / std - 1) < stray + sampling)  # heavy tails stray farther
    assert abs(found.redrawn.mean() - (1 - asked.accepted[0])) < 0.015


POINTS = 512


def test_truncated_moments_are_one_sided_normals_and_points_in_a_tail_have_the_plain_bits():
    error = build.box_error([0, 0, 0, 0], np.diag([1.0, 1.0, 400.0, 1.0]))
    found = truncated_errors(source_of(error), 0, np.array([build.centred(11, 100)]), build.IMAGE_PX)
    law = stats.truncnorm(-10 / 20, np.inf, scale=20)
    drawn = misplaced(build.centred(11, 100), error, frames=2000, vessels=10).errors_px[:, 2]
    assert stats.kstest(drawn, law.cdf).pvalue > 1e-4
    assert abs(found.means[0, 2] - law.mean()) < 0.02 * law.std()
    assert abs(np.sqrt(found.covariances()[0, 2, 2]) / law.std() - 1) < 0.02
    assert abs(found.accepted[0] - stats.norm.sf(-0.5)) < 2e-3
    large = truncated_errors(source_of(THESIS), 0, np.array([build.centred(900, 900)]), build.IMAGE_PX)
    std = np.sqrt(np.diag(build.COVARIANCE_PX2))
    assert large.accepted[0] == 1 and np.all(np.abs(large.means[0] - build.MEAN_PX) < 0.01 * std)
    for error in (RELATIVE, MIXED):
        boxes = np.array([build.centred(500, 400), build.centred(900, 300)])
        found = truncated_errors(source_of(error), 0, boxes, build.IMAGE_PX, in_file_units=True)
        std = np.sqrt(np.diag(error["covariance"]))
        assert np.all(np.abs(found.means - error["mean"]) < 0.02 * std)
        assert np.all(np.abs(found.covariances() - error["covariance"]) < 0.03 * np.outer(std, std))
    generator = np.random.default_rng(3)
    uniforms = generator.random((9, POINTS))
    uniforms[:, 0] = 2.0**-53  # the least that is not 0
    spread = generator.random((9, POINTS))
    low = np.array([-40, -20, -14, -12, -7, -1, -20, -30, 2.0])[:, None] - spread
    high = np.array([1, 9, 30, 8, 9, 1, -14, -29, 12.0])[:, None] + spread / 2
    below, above = truncation._probabilities(low, high)
    plain_below, plain_above = special.ndtr(low), special.ndtr(high)
    inside, plain_inside = above - below, plain_above - plain_below
    np.testing.assert_array_equal(inside, plain_inside)
    np.testing.assert_array_equal(below + uniforms * inside, plain_below + uniforms * plain_inside)
    assert below.shape == (9, POINTS)
    below, above = truncation._probabilities(np.full((3, POINTS), -50.0), np.full((3, POINTS), 20.0))
    assert below.shape == above.shape == (3, 1) and (above - below == 1).all()  # rows that all lie in tails


@pytest.mark.parametrize("distribution", [Normal(), StudentT(4.0)])
def test_boxes_far_from_their_bounds_have_the_bits_of_the_plain_way(monkeypatch, distribution):
    generator = np.random.default_rng(2)
    middles, halves = generator.uniform(0, 1000, (64, 2)), generator.choice([1.0, 30, 300], (64, 1))
    boxes = np.clip(np.concatenate([middles - halves, middles + halves], axis=1), 0, 1000)
    mix = generator.normal(size=(4, 4))
    law = generator.normal(size=4), mix @ mix.T
    images = np.full((64, 2), 1000.0)

    def parts():
        return list(truncation.accepted_errors(boxes, images, *law, distribution, POINTS, 16 * POINTS))

    found, far = parts(), []

    def none_far(*given):
        far.append(plain(*given).mean())
        return np.zeros(len(given[1]), dtype=bool)

    plain = truncation._far_from_bounds
    monkeypatch.setattr(truncation, "_far_from_bounds", none_far)
    for part, other in zip(found, parts(), strict=True):
        np.testing.assert_array_equal(part.errors, other.errors)
        np.testing.assert_array_equal(part.weights, other.weights)
    assert any(0 < share < 1 for share in far)
    # A box 100 px wide is gone at a growth of −99 px: given −50 to 50 px, one end is near.
    wide, growth, given = np.array([[400.0, 400, 500, 500]]), np.zeros((1, 1)), np.array([[-50.0, 50.0]])
    near, away = (plain(2, wide, images[:1], growth, part * given, np.full((1, 2), 5.0)) for part in (1, 0.2))
    assert away and not near
    assert not truncation._uniforms(4, POINTS, 0, 2).flags.writeable  # kept for the next call


NU = 6.0
C = np.array(build.COVARIANCE_PX2, dtype=float)
LARGE = build.centred(2400, 1800)


def t_error(nu: float = NU, **changes: Any) -> dict[str, Any]:
    error = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)
    return error | {"law": "student_t", "degrees_of_freedom": nu} | changes


def drawn(error: dict[str, Any], box_px: list[float] = LARGE, frames: int = 4000, **sections: Any) -> Detections:
    model = parse_detector(build.one_state_data(**SEEN, box_error=error) | sections)
    return build.detector(model).detect(build.make_frames(frames), build.steady_targets(frames, 20, box_px))


@pytest.fixture(scope="module", params=[{}, {"persistence": {"box_s": 0.05}}], ids=["independent", "persistent"])
def errors(request: pytest.FixtureRequest) -> np.ndarray:
    found = drawn(t_error(), **request.param)
    assert found.redrawn.mean() < 1e-4
    return found.errors_px


def test_errors_have_the_moments_lengths_and_kurtosis_of_a_t_law_with_scales_of_a_chi_square_number(errors):
    worth, moved = len(errors) / 1.4, errors - build.MEAN_PX  # those that persist for 0.05 s count for fewer
    assert np.all(np.abs(moved.mean(axis=0)) < 4 * np.sqrt(np.diag(C) / worth))
    fourth = (NU - 2) / (NU - 4)  # of a t law over that of a normal one
    variance = fourth * (2 * C**2 + np.outer(np.diag(C), np.diag(C))) - C**2
    assert np.all(np.abs(np.cov(errors.T) - C) < 4 * np.sqrt(variance / worth))
    q = np.einsum("ni,ij,nj->n", moved, np.linalg.inv(C * (NU - 2) / NU), moved)
    sample = q[::401]  # of other vessels and far from each other in time
    assert stats.kstest(q[::7] / 4, stats.f(4, NU).cdf).statistic < 0.02
    assert stats.kstest(sample / 4, stats.f(4, NU).cdf).pvalue > 1e-4
    nu, moved = 20.0, drawn(t_error(nu=20.0)).errors_px - build.MEAN_PX
    eighth = 105 * (nu - 2) ** 3 / ((nu - 4) * (nu - 6) * (nu - 8))  # moment of a t number with variance one
    standard_error = np.sqrt(eighth / len(moved))
    kurtosis = stats.kurtosis(moved)
    assert kurtosis == pytest.approx(np.full(4, 6 / (nu - 4)), abs=4 * standard_error)
    assert kurtosis.min() > 2 * standard_error
    levels = (np.arange(2000) + 0.5) / 2000
    scales = StudentT(NU).scales(special.ndtri(levels)[:, None])
    np.testing.assert_allclose(np.sort((NU - 2) / scales**2), stats.chi2(NU).ppf(levels))
    many = StudentT(NU).scales(np.random.default_rng(0).standard_normal((400_000, 1)))
    assert np.mean(many**2) == pytest.approx(1, abs=0.02)
    normal = {"law": "normal", "degrees_of_freedom": None}
    with_t, without = (drawn(t_error() | law, frames=200).errors_px - build.MEAN_PX for law in ({}, normal))
    scale = with_t / without
    np.testing.assert_allclose(scale, scale[:, :1] * np.ones(4), rtol=1e-6)
    latent = np.random.default_rng(0).standard_normal((4000, 5))
    np.testing.assert_allclose(standardised(StudentT(degrees_of_freedom=1e7), latent), latent[:, :4], rtol=1e-2)


def test_a_t_law_in_one_state_leaves_the_bytes_of_another_alone_and_scales_persist_like_errors():
    frames, targets = build.make_frames(300), build.steady_targets(300, 3, build.centred(30, 20))
    plain, mixed = (
        build.run(build.detector_data(states={"clear": build.state_data(), "fog": fog}), frames, targets)
        for fog in (build.state_data(), build.state_data(box_error=t_error()))
    )
    clear = plain.states[plain.frame] == 0
    assert np.array_equal(plain.errors_px[clear], mixed.errors_px[clear], equal_nan=True)
    assert plain.redrawn[clear].any()
    assert not np.array_equal(plain.errors_px[~clear], mixed.errors_px[~clear], equal_nan=True)
    found = drawn(t_error(), frames=1500, persistence={"box_s": 1.0})
    moved = build.by_frame(found, found.errors_px - build.MEAN_PX, 1500, 20)
    lengths = np.log(np.einsum("tvi,ij,tvj->tv", moved, np.linalg.inv(C), moved))
    near, far = (np.corrcoef(lengths[lag:].ravel(), lengths[:-lag].ravel())[0, 1] for lag in (1, 60))
    assert near > 0.8 and abs(far) < 0.1
