"""The chain of a detector: noise, chunks, columns, statistics, and the same bits where libraries' functions differ."""

import hashlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats
from scipy.stats import qmc

import modsim3d
from modsim3d.core.boxes import inside_image, move, sizes
from modsim3d.core.random_streams import GRID, grid_normals, normals, on_grid
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.draws import choose, cumulative, poisson_quantile, select
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import FALSE_POSITIVE, TRUE, CameraFrames, Detections, Targets
from modsim3d.detector.truncation import MAX_DIMENSIONS, sobol_points
from tests.detector import detector_builders as build
from tests.detector.test_states import RICH, rich_frames, rich_targets
from tests.detector_variants import CHANGES, variant

STEPS, VESSELS = 120, 5


def scattered_targets(seed: int = 0, image_px: tuple[int, int] = build.IMAGE_PX) -> Targets:
    """Boxes of all sizes, small ones at the edges too; each vessel is missing in a third of the frames."""
    random = np.random.default_rng(seed)
    corners = random.uniform(0, 1, (STEPS, VESSELS, 2, 2)) * image_px
    corners[:, 0, 1] = corners[:, 0, 0] + random.uniform(0, 4, (STEPS, 2))
    corners = np.clip(corners, 0, image_px)
    boxes = np.concatenate([corners.min(axis=2), corners.max(axis=2)], axis=-1)
    boxes[random.random((STEPS, VESSELS)) < 1 / 3] = np.nan
    return build.make_targets(boxes, np.arange(VESSELS) % 2)


@pytest.fixture(params=["calibrated", "thesis"])
def detector_file(request: pytest.FixtureRequest) -> dict[str, Any]:
    model = {"model": request.param}
    return build.detector_data(false_positives=model, confidence_threshold=0.1, transition_interval_s=0.7)


@pytest.mark.parametrize("borders", [[0, 120], [0, 1, 2, 60, 60, 119, 120], list(range(121))])
def test_chunk_borders_change_nothing(detector_file: dict[str, Any], borders: list[int]) -> None:
    frames, targets = build.make_frames(STEPS, first_step=33), scattered_targets()
    whole = build.run(detector_file, frames, targets)
    assert np.sum(whole.kind == FALSE_POSITIVE) > 10 and whole.redrawn.sum() > 10
    assert len(set(whole.states)) == 2
    split = build.detect_in_chunks(build.detector(detector_file), frames, targets, borders)
    assert build.all_bytes(split) == build.all_bytes(whole)


def rows_of(detections: Detections, targets: Targets) -> dict[tuple[int, str], tuple[Any, ...]]:
    rows = np.flatnonzero(detections.kind == TRUE)
    names = [targets.vessel_ids[vessel] for vessel in targets.vessel[detections.target[rows]]]
    columns = np.column_stack([detections.label, detections.confidence, detections.boxes_px])[rows].tolist()
    return dict(zip(zip(detections.frame[rows].tolist(), names, strict=True), map(tuple, columns), strict=True))


def test_noise_belongs_to_the_seed_a_vessels_name_and_a_camera_also_of_fewer_frames():
    model, frames, targets = parse_detector(build.detector_data()), build.make_frames(STEPS), scattered_targets()
    whole = build.run(model, frames, targets)
    plain, all_rows = build.all_bytes(whole), rows_of(whole, targets)
    fewer = select(targets, np.flatnonzero(targets.vessel != 2))
    without = rows_of(build.run(model, frames, fewer), fewer)
    assert without == {key: row for key, row in all_rows.items() if key[1] != "vessel2"} != all_rows
    renumbered = replace(targets, vessel=targets.vessel + 1, vessel_ids=("newcomer", *targets.vessel_ids))
    assert build.all_bytes(build.run(model, frames, renumbered)) == plain
    assert build.all_bytes(build.run(model, frames, targets)) == plain
    other = build.all_bytes(build.run(model, frames, targets, seed=8))
    # Of the other seed all differs but for what there is none of: nothing is merged or gated.
    assert {name for name, value in plain.items() if other[name] == value} <= {"partner", "gated"}
    model, targets = parse_detector(build.detector_data()), scattered_targets()
    one, two = (build.run(model, build.make_frames(STEPS, camera=name), targets) for name in ("C0", "C1"))
    assert np.array_equal(one.states, two.states)
    assert not np.intersect1d(one.boxes_px[:, 0], two.boxes_px[:, 0][two.boxes_px[:, 0] > 0]).size
    assert not np.intersect1d(one.confidence[one.confidence > 0.2], two.confidence[two.confidence < 1]).size
    model, targets = parse_detector(build.detector_data(transition_interval_s=0.7)), scattered_targets()
    frames, part = build.make_frames(STEPS), select(targets, np.flatnonzero(targets.frame % 3 == 0))
    fewer = {name: getattr(frames, name)[::3] for name in ("steps", "times_s", "sea_half_planes")}
    whole = build.run(model, frames, targets)
    some = build.run(model, replace(frames, **fewer), replace(part, frame=part.frame // 3))
    assert np.array_equal(some.boxes_px, whole.boxes_px[whole.frame % 3 == 0])
    assert np.array_equal(some.states, whole.states[::3])


def test_rows_are_ordered_by_frame_confidence_is_clipped_and_no_frames_give_no_detections():
    data = build.one_state_data(confusion=build.ALL_SEEN, box_error=build.no_error())
    boxes = np.tile([1000.0, 1000, 1100, 1100], (3000, 4, 1))
    found = build.run(data, build.make_frames(3000), build.make_targets(boxes))
    assert np.all(np.diff(found.frame) >= 0)
    first = np.flatnonzero(np.diff(found.frame, prepend=-1))
    # Each of four vessels and the one false positive a frame has on average come first about equally often.
    source = found.target[first] % 4
    for vessel in range(4):
        assert abs(np.mean((source == vessel) & (found.kind[first] == TRUE)) - 0.2) < 0.04
    assert np.mean(found.kind[first] == FALSE_POSITIVE) > 0.15
    first_is_surer = found.confidence[first] > found.confidence[first + 1]
    assert abs(first_is_surer.mean() - 0.5) < 4 * 0.5 / np.sqrt(len(first))
    targets = scattered_targets()
    found = build.run(build.detector_data(), build.make_frames(STEPS), targets)
    false = found.kind == FALSE_POSITIVE
    assert np.all(found.target[false] == -1) and np.all(np.isnan(found.errors_px) == false[:, None])
    assert found.redrawn.dtype == bool and not found.redrawn[false].any()
    assert np.array_equal(targets.frame[found.target[~false]], found.frame[~false])
    assert len(np.unique(found.target[~false])) == np.sum(~false) and found.states.shape == (STEPS,)
    state = found.states[found.frame]
    assert found.confidence[state == 0].mean() > found.confidence[state == 1].mean() + 0.15
    data = build.one_state_data(confidence={"mean": 0.2, "std": 0.1}, confusion=build.ALL_SEEN)
    targets = scattered_targets()
    found = build.run(data, build.make_frames(STEPS), targets)
    assert np.sum(found.kind == TRUE) == len(targets)
    at_threshold = np.mean(found.confidence == 0.2)
    assert abs(at_threshold - 0.5) < 4 * 0.5 / np.sqrt(len(found)) and found.confidence.min() == 0.2
    detector, nothing = build.detector(build.detector_data()), build.make_targets(np.empty((0, 3, 4)))
    assert len(detector.detect(build.make_frames(0), nothing)) == 0
    empty_sea = detector.detect(build.make_frames(9), nothing)
    assert len(empty_sea) == 0 and len(empty_sea.states) == 9


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    width=st.integers(50, 4000),
    height=st.integers(50, 4000),
    spread=st.floats(0, 200),
    rate=st.floats(0, 0.8),
    horizon=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3000, 3000)),
    model=st.sampled_from(["calibrated", "thesis"]),
)
def test_every_detection_is_in_the_image_and_at_least_a_pixel(seed, width, height, spread, rate, horizon, model):
    root = np.random.default_rng(seed).normal(0, spread, (4, 4))
    covariance = root @ root.T + spread**2 * np.eye(4)  # else thin boxes may have no way to grow on both sides
    error = build.box_error([0, 0, 0, 0], covariance)
    data = build.one_state_data(false_discovery_rate=rate, box_error=error) | {"false_positives": {"model": model}}
    frames = build.make_frames(STEPS, image_px=(width, height), sea=horizon)
    found = build.run(data, frames, scattered_targets(seed, (width, height)), seed)
    assert len(found) > 0
    assert sizes(found.boxes_px).min() >= 1 - 1e-9  # but for rounding
    assert found.boxes_px.min() >= 0 and np.all(found.boxes_px[:, 2:] <= [width, height])
    assert np.all((found.confidence >= 0.2) & (found.confidence <= 1))


SAMPLE_FRAMES, SAMPLE_VESSELS = 10_000, 20
LABEL = np.arange(SAMPLE_VESSELS) % 2


@pytest.fixture(scope="module")
def found() -> Detections:
    """What comes out has the statistics that went in, over 200,000 untruncated boxes."""
    targets = build.steady_targets(SAMPLE_FRAMES, SAMPLE_VESSELS, build.centred(600, 600), LABEL)
    return build.run(build.one_state_data(), build.make_frames(SAMPLE_FRAMES), targets, seed=20)


def test_labels_false_positives_confidences_and_boxes_are_as_asked_for(found):
    label = build.by_frame(found, found.label, SAMPLE_FRAMES, SAMPLE_VESSELS, 2)  # a miss is the last row
    for vessels, column in enumerate(np.array([[0.7, 0.1, 0.2], [0.1, 0.6, 0.3]])):
        detected_label = label[:, vessels == LABEL]
        rates = np.bincount(detected_label.astype(int).ravel(), minlength=3) / detected_label.size
        assert np.all(np.abs(rates - column) < 4 * np.sqrt(column * (1 - column) / detected_label.size))
    labels = found.label[found.kind == FALSE_POSITIVE]
    n_true = len(found) - len(labels)
    # Given the true detections the count is Poisson with mean n·r / (1 − r); the rest is the delta method.
    assert abs(len(labels) / len(found) - 0.2) < 4 * np.sqrt(n_true * 0.2 / 0.8) * n_true / len(found) ** 2
    assert abs(labels.mean() - 0.75) < 4 * np.sqrt(0.75 * 0.25 / len(labels))
    for kind in (TRUE, FALSE_POSITIVE):
        confidence = found.confidence[found.kind == kind]
        # Clipping at 0.2 and 1, 4.7 and 3.3 standard deviations away, changes the mean by less than 1e-5.
        assert abs(confidence.mean() - 0.67) < 4 * 0.1 / np.sqrt(len(confidence))
        assert abs(confidence.std() - 0.1) < 4 * 0.1 / np.sqrt(2 * len(confidence))
    true, truth = found.kind == TRUE, np.array(build.centred(600, 600))
    boxes = found.boxes_px[true]
    centre_error = (boxes[:, :2] + boxes[:, 2:]) / 2 - (truth[:2] + truth[2:]) / 2
    size_error = boxes[:, 2:] - boxes[:, :2] - 600
    np.testing.assert_allclose(np.hstack([centre_error, size_error]), found.errors_px[true], atol=1e-9)
    assert not found.redrawn.any()
    errors, c = found.errors_px[found.kind == TRUE], np.array(build.COVARIANCE_PX2, dtype=float)
    variances = np.diag(c)
    assert np.all(np.abs(errors.mean(axis=0) - build.MEAN_PX) < 4 * np.sqrt(variances / len(errors)))
    # Of a normal sample: var(s_ij) = (c_ii c_jj + c_ij²) / (n − 1)
    standard_error = np.sqrt((np.outer(variances, variances) + c**2) / (len(errors) - 1))
    assert np.all(np.abs(np.cov(errors.T) - c) < 4 * standard_error)
    series = build.by_frame(found, found.errors_px[:, 0], SAMPLE_FRAMES, SAMPLE_VESSELS)
    for one, other in [(series[:-1], series[1:]), (series[:, :-1], series[:, 1:])]:
        both = ~np.isnan(one) & ~np.isnan(other)
        assert abs(np.corrcoef(one[both], other[both])[0, 1]) < 4 / np.sqrt(both.sum())


def test_quantiles_are_scipys_and_drawn_normal_numbers_are_on_the_grid():
    u = np.random.default_rng(3).random(3000)
    u[:2] = 0.0, 1 - 2.0**-53
    mean = np.repeat([1e-9, 0.1, 1.0, 7.5, 300.0, 9000.0], 500)
    assert np.array_equal(poisson_quantile(u, mean), np.maximum(stats.poisson.ppf(u, mean), 0))
    k, mean = (grid.ravel() for grid in np.meshgrid(np.arange(40), [0.5, 3.0, 20.0]))
    u = stats.poisson.cdf(k, mean)
    below_one = u < 1 - 1e-9
    assert np.array_equal(poisson_quantile(u[below_one], mean[below_one]), k[below_one])
    assert poisson_quantile(np.array([0.0, 0.999]), np.zeros(2)).tolist() == [0, 0]
    assert np.all(np.abs(normals(np.array([0.0, 1 - 2.0**-53]))) < 9)
    assert normals(np.array([0.5, 0.975])).round(6).tolist() == [0, 1.959964]
    distribution = cumulative(np.array([0.0, 0.1, 0.2, 0.0, 0.7, 0.0]))
    uniforms = np.array([0.0, 0.05, 0.1, 0.2999, 0.3001, 1 - 2.0**-53])
    assert choose(distribution, uniforms).tolist() == [1, 1, 2, 2, 4, 4]
    assert cumulative(np.full(10, 0.1))[-1] == 1
    uniforms = np.append(np.random.default_rng(1).random(100_000), [0, 2.0**-53, 1 - 2.0**-53])
    drawn = grid_normals(uniforms)
    assert np.array_equal(drawn / GRID, np.rint(drawn / GRID))
    assert np.abs(drawn - normals(uniforms)).max() <= GRID / 2
    for step in (GRID, 2.0**-40, 1.0):
        values = on_grid(np.array([0.0, -0.0, 0.49, 0.51, -7.3, 1e6 + 0.7]) * step, step)
        assert (values / step).tolist() == [0, 0, 0, 1, -7, 1e6 + 1], "rounded to the nearest multiple"
        assert np.array_equal(on_grid(values, step), values)
    random = np.random.default_rng(0)
    for rank in (1, 2, 3, 4) * 20:
        factor = random.standard_normal((4, rank)) * 10 ** random.uniform(-2, 2, (4, 1))
        root, std = symmetric_root(factor @ factor.T), np.linalg.norm(factor, axis=1)
        assert np.abs((root @ root - factor @ factor.T) / np.outer(std, std)).max() < 1e-12
        assert np.abs(root - root.T).max() <= 1e-12 * std.max()


@pytest.mark.parametrize("dimensions", range(1, MAX_DIMENSIONS + 1))
@pytest.mark.parametrize("count", [1, 2, 1024])
def test_points_are_those_of_scipy(dimensions: int, count: int) -> None:
    ours = sobol_points(dimensions, count, np.random.default_rng(7).spawn(1)[0])
    np.testing.assert_array_equal(ours, qmc.Sobol(dimensions, rng=np.random.default_rng(7)).random(count))


INEXACT = [
    *((special, name) for name in ("ndtri", "ndtr", "exp2", "xlogy", "log1p", "expit", "logit", "gammaincinv")),
    *((np, name) for name in ("exp", "exp2", "log", "log2", "power", "sin", "cos", "interp", "hypot")),
    *((math, name) for name in ("exp", "log")),
    *((np.linalg, name) for name in ("eigh", "cholesky", "inv")),
]
SMALL = [1800.0, 1195.0, 1808.0, 1205.0]


def with_other_last_bits(function: Any) -> Any:
    """The function, its results moved by up to two units in the last place to either side."""
    random = np.random.default_rng(0)

    def moved(*arguments: Any, **options: Any) -> Any:
        result = function(*arguments, **options)
        if isinstance(result, tuple):
            return tuple(part * (1 + random.integers(-2, 3, np.shape(part)) * 2.0**-53) for part in result)
        return result * (1 + random.integers(-2, 3, np.shape(result)) * 2.0**-53)

    return moved


@pytest.fixture
def other_processor(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for module, name in INEXACT:
        monkeypatch.setattr(module, name, with_other_last_bits(getattr(module, name)))
    return monkeypatch


def many_kinds() -> dict[str, tuple[DetectorModel, CameraFrames, Targets]]:
    """Every model of a detector, over boxes of which many errors are drawn again."""
    frames, targets = build.make_frames(150, sea=(0.02, 0.9998, -800.0)), build.steady_targets(150, 8, SMALL)
    thesis = {name: parse_detector(variant(name)) for name in CHANGES}
    small = {name: (model, frames, replace(targets, label=0 * targets.label)) for name, model in thesis.items()}
    return {**small, "rich": (load_detector(RICH), rich_frames(), rich_targets())}


KINDS = many_kinds()


@pytest.mark.parametrize("name", KINDS)
def test_the_last_bits_of_functions_do_not_reach_the_detections(name: str, other_processor: pytest.MonkeyPatch) -> None:
    model, frames, targets = KINDS[name]
    there = build.run(model, replace(frames, sea_half_planes=frames.sea_half_planes * (1 + 2.0**-50)), targets)
    other_processor.undo()
    here = build.run(model, frames, targets)
    assert len(here) > 200 and build.all_bytes(there) == build.all_bytes(here)


def digest(*columns: np.ndarray) -> str:
    """Of seven digits of each number: more would hash the rounding of the machine's sine."""
    text = "\n".join(f"{value:.6e}" for column in columns for value in np.asarray(column, dtype=float).ravel())
    return hashlib.sha256(text.encode()).hexdigest()


# Digests of these tests, from the chain as it was when false positives got sides of their own parts of a pixel.
def test_redrawn_errors_are_those_of_plain_rejection_and_simulation_1_is_detected_as_it_was() -> None:
    error, box_px = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2), build.centred(20, 20)
    data = build.one_state_data(confusion=build.ALL_SEEN, false_discovery_rate=0, box_error=error)
    found = build.run(data, build.make_frames(1500), build.steady_targets(1500, 10, box_px))
    errors, random = found.errors_px[found.redrawn], np.random.default_rng(5)
    plain = random.multivariate_normal(build.MEAN_PX, build.COVARIANCE_PX2, 200_000)
    plain = plain[inside_image(move(np.array(box_px), plain), build.IMAGE_PX)]
    assert len(errors) > 5000
    for component in range(4):
        assert stats.ks_2samp(errors[:, component], plain[:, component]).pvalue > 1e-4
    error = 4 * np.sqrt(1 / len(errors) + 1 / len(plain))  # of a mean in deviations, and at most of a correlation
    assert np.all(np.abs(errors.mean(axis=0) - plain.mean(axis=0)) < np.std(plain, axis=0, ddof=1) * error)
    assert np.all(np.abs(np.corrcoef(errors.T) - np.corrcoef(plain.T)) < error)
    scene = modsim3d.load_scene("simulation_1", steps=300, source="analytic")
    found = [frame.detections for frame in modsim3d.simulate_frames(scene)]
    columns = [column for each in found for column in (each.boxes_px, each.confidence, each.errors_px)]
    assert sum(len(column) for column in columns) > 3000
    assert digest(*columns) == "72ded7f86c419a7370ebae5b39baf0daf7f273d8715fb55415d2c26dfcce6d23"
    random = np.random.default_rng(7)
    corners = np.sort(random.uniform(0, 1, (400, 6, 2, 2)) * [3600, 2400], axis=2)
    boxes = np.concatenate([corners[:, :, 0], corners[:, :, 1]], axis=-1)
    boxes[random.random((400, 6)) < 1 / 4] = np.nan
    model = load_detector(RICH.with_name("three_labels.yaml"))
    found = build.run(model, build.make_frames(400), build.make_targets(boxes, np.arange(6) % 3), seed=11)
    columns = (found.states, found.frame, found.target, found.kind, found.label)
    columns += (found.boxes_px, found.confidence, found.errors_px, found.redrawn)
    assert digest(*columns) == "e6fbb59940cd836b958449d76a2eacb6aaa9d673d775172c697ba6be32e63c7c"
