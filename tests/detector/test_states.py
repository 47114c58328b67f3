"""Performance states: chain, shares of time, forced states, chains of cameras; all models at once."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modsim3d.core.boxes import sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.classification import PerformanceStates, StateSequence
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel, stationary_shares
from modsim3d.detector.records import FALSE_KINDS, KINDS, ON_VESSEL, CameraFrames, Detections, Targets
from tests.detector import detector_builders as build
from tests.detector.detector_builders import all_bytes, chunk, clock, detect_in_chunks, detector_data, make_frames
from tests.detector_variants import variant


def sequence(model: DetectorModel, seed: int = 1) -> StateSequence:
    return StateSequence(model, Streams(seed))


def model(**changes: object) -> DetectorModel:
    return parse_detector(detector_data(**changes))


@pytest.fixture(scope="module")
def whole() -> np.ndarray:
    return sequence(model()).at(make_frames(9010))


@given(starts=st.lists(st.integers(0, 9000), min_size=1, max_size=5))
def test_states_are_the_same_in_whatever_order_they_are_asked_for(whole: np.ndarray, starts: list[int]) -> None:
    scattered = sequence(model())
    for start in starts:
        part = scattered.at(make_frames(10, camera="other", first_step=start))
        assert np.array_equal(part, whole[start : start + 10])


def test_the_first_step_is_in_the_initial_state_and_states_hold_between_multiples_of_the_interval() -> None:
    for seed in range(20):
        assert sequence(model(initial_state="fog"), seed).at(make_frames(1)).tolist() == [1]
    chain = model()
    uniforms = Streams(5).uniforms(Purpose.STATE, first=0, count=5000)[:, 0]
    state, slow = 0, [0]
    for u in uniforms[1:]:
        state = 0 if u < chain.transition_matrix[0, state] else 1
        slow.append(state)
    assert sequence(chain, seed=5).at(make_frames(5000)).tolist() == slow
    each_step = sequence(model()).at(make_frames(200))
    slower = sequence(model(transition_interval_s=0.3)).at(make_frames(600, time_step_s=0.1))
    assert np.array_equal(slower, np.repeat(each_step, 3))
    fine = sequence(model(transition_interval_s=1.0)).at(make_frames(2000, time_step_s=0.05))
    coarse = sequence(model(transition_interval_s=1.0)).at(make_frames(200, time_step_s=0.5))
    assert np.array_equal(fine[::10], coarse) and 0 < coarse.mean() < 1
    times_s = np.array([round(0.2 * k, 1) for k in range(2000)])
    assert np.any(np.floor(times_s / 0.2) < np.arange(2000))  # 0.6 / 0.2 is 2.9999999999999996
    frames = dataclasses.replace(make_frames(2000), times_s=times_s)
    each_step = sequence(model()).at(frames)
    assert np.array_equal(sequence(model(transition_interval_s=0.2)).at(frames), each_step)
    frames = make_frames(5, time_step_s=0.7)
    assert frames.times_s[3] < 2.1
    forced = model(performance={"schedule": [[0, "clear"], [2.1, "fog"]]})
    assert PerformanceStates(forced, Streams(1)).at(frames).tolist() == [0, 0, 0, 1, 1]


def states_of(camera: str = "C0", frames: int = 3000, **changes: object) -> np.ndarray:
    return PerformanceStates(model(**changes), Streams(1)).at(make_frames(frames, camera))


def test_a_schedule_forces_states_and_they_are_shared_as_their_rates_of_leaving():
    found = states_of(performance={"schedule": [[0, "clear"], [60, "fog"], [70, "clear"]]})
    times_s = make_frames(3000).times_s
    assert np.array_equal(found == 1, (times_s > 60 - 1e-6) & (times_s < 70 - 1e-6))
    plain, forced = states_of(), states_of(performance={"schedule": [[60, "fog"], [70, None]]})
    assert np.all(forced[600:700] == 1) and 0 < plain[600:700].mean() < 1
    assert np.array_equal(np.delete(forced, slice(600, 700)), np.delete(plain, slice(600, 700)))
    with pytest.raises(ModsimError, match="longer transition_interval_s than 1e-09"):
        sequence(model(transition_interval_s=1e-9)).at(make_frames(100))
    assert sequence(model()).at(make_frames(0)).shape == (0,)
    assert np.array_equal(states_of("C0"), states_of("C1"))
    one, two = (states_of(camera, 60_000, performance={"scope": "per_camera"}) for camera in ("C0", "C1"))
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.05
    for found in (one, two):
        assert abs(found.mean() - 1 / 3) < 0.02  # what the chain's columns make in the long run
    both = PerformanceStates(model(performance={"scope": "per_camera"}), Streams(1))
    both.at(make_frames(500, "C0"))
    assert np.array_equal(both.at(make_frames(500, "C1")), two[:500])
    for matrix, shares in (
        ([[0.99, 0.05], [0.01, 0.95]], [5 / 6, 1 / 6]),  # left with 0.01 and with 0.05 a step: 5 to 1
        ([[0.5, 0.0], [0.5, 1.0]], [0, 1]),  # the second is never left
        ([[0.0, 1.0], [1.0, 0.0]], [0.5, 0.5]),
        (np.eye(2), []),  # the first state decides
    ):
        np.testing.assert_allclose(stationary_shares(np.array(matrix)), shares, atol=1e-12)
    # Jessen & Mohr (2023), eq. 9.1: 10.5/59, 19/59, 19/59, 10.5/59, by hand from its four columns.
    chain = load_detector("thesis")
    assert list(chain.stationary_shares) == ["excellent", "good", "bad", "terrible"]
    shares = list(chain.stationary_shares.values())
    np.testing.assert_allclose(shares, np.array([21, 38, 38, 21]) / 118, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.matrix_power(chain.transition_matrix, 100_000)[:, 0], shares)


@given(weights=st.integers(1, 6).flatmap(lambda n: arrays(float, (n, n), elements=st.floats(1e-3, 1))))
def test_a_transition_leaves_the_shares_as_they_are(weights):
    matrix = weights / weights.sum(axis=0)
    shares = stationary_shares(matrix)
    np.testing.assert_allclose(matrix @ shares, shares, atol=1e-9)
    assert shares.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.linalg.matrix_power(matrix, 10_000) @ np.eye(len(shares))[0], shares, atol=1e-6)


RICH = Path(__file__).resolve().parents[2] / "scenes" / "detectors" / "rich.yaml"
STEPS, VESSELS, STEP_S = 600, 9, 0.2
MODEL = load_detector(RICH)


def rich_frames(steps: int = STEPS) -> CameraFrames:
    return build.make_frames(steps, time_step_s=STEP_S, sea=(0.02, 1.0, -800.0))


def rich_targets(seed: int = 3) -> Targets:
    """Boxes that drift, some long, some overlapping, some hidden, some absent for a while."""
    random = np.random.default_rng(seed)
    centre = random.uniform([200, 900], [3400, 1200], (VESSELS, 2)) + random.normal(0, 5, (STEPS, VESSELS, 2)).cumsum(0)
    side = np.exp(random.normal(np.log([120, 30]), 0.6, (VESSELS, 2)))
    boxes = np.clip(np.concatenate([centre - side / 2, centre + side / 2], axis=-1), 0, [3600, 2400, 3600, 2400])
    boxes[100:200, 4] = np.nan
    boxes[random.random((STEPS, VESSELS)) < 0.1] = np.nan
    targets = build.make_targets(boxes, np.arange(VESSELS) % 3)
    targets.visible_fraction[:] = np.minimum(random.uniform(0, 1.2, len(targets)), 1)
    targets.depth_m[:] = random.uniform(50, 3300, len(targets))
    return targets


@pytest.fixture(scope="module")
def example() -> Detections:
    return detector().detect(rich_frames(), rich_targets())


def detector(seed: int = 5) -> Detector:
    return Detector(MODEL, seed, target_statistics(MODEL, [(rich_frames(), rich_targets())]), clock(STEP_S))


def test_the_example_is_short_with_every_kind_of_detection_and_chunks_change_nothing(example):
    assert len(RICH.read_text().splitlines()) < 60
    kinds = {*range(len(KINDS))} - {ON_VESSEL}  # which `per_image` alone has
    assert set(example.kind) == kinds and example.gated.any()
    assert sizes(example.boxes_px).min() >= 1 - 1e-9 and example.boxes_px.min() >= 0
    assert np.all(example.boxes_px[:, 2:] <= [3600, 2400])
    assert np.all((example.confidence >= 0.2) & (example.confidence <= 1))
    own = ~np.isin(example.kind, FALSE_KINDS)
    sources = np.concatenate([example.target[own], example.partner[example.partner >= 0]])
    assert len(np.unique(sources)) == len(sources) and not example.gated[sources].any()
    for borders in ([0, 1, 2, 250, 250, 599, 600], [0, 600], [*range(0, 601, 37), 600]):
        found = detect_in_chunks(detector(), rich_frames(), rich_targets(), borders)
        assert all_bytes(found) == all_bytes(example), borders
    one = detector()
    late, early = (detect_in_chunks(one, rich_frames(), rich_targets(), part) for part in ([400, 600], [0, 400]))
    assert np.array_equal(np.concatenate([early.boxes_px, late.boxes_px]), example.boxes_px)


PERSISTENCE = {"class_s": 1.0, "box_s": 0.7, "confidence_s": 2.0, "merge_s": 2.0, "box_vessel_share": 0.3}
MODELS = ("plain", "Student's t box errors", "persistent false positives", "doubled, split and merged boxes", "gates")


@pytest.mark.parametrize("name", MODELS)
def test_chunk_borders_change_nothing_in_what_persists(name: str) -> None:
    model = parse_detector(variant(name) | {"persistence": PERSISTENCE})
    frames, targets = rich_frames(), replace(rich_targets(), label=np.zeros_like(rich_targets().label))
    statistics = target_statistics(model, [(frames, targets)])
    example = Detector(model, 5, statistics, clock(STEP_S)).detect(frames, targets)
    split = detect_in_chunks(Detector(model, 5, statistics, clock(STEP_S)), frames, targets, [0, 1, 513, 514, STEPS])
    assert all_bytes(split) == all_bytes(example)
    part = chunk(frames, targets, 400, STEPS)[:2]
    later = Detector(model, 5, statistics, clock(STEP_S)).detect(*part)  # as another worker would
    np.testing.assert_array_equal(later.boxes_px, example.boxes_px[example.frame >= 400])


def test_target_statistics_do_not_depend_on_how_the_scene_is_split() -> None:
    frames, targets = rich_frames(), rich_targets()
    halves = (chunk(frames, targets, *part)[:2] for part in ((0, 333), (333, STEPS)))
    first, second = (target_statistics(MODEL, [half]) for half in halves)
    joined, one = first + second, target_statistics(MODEL, [(frames, targets)])
    for name in ("log_odds", "sides"):
        for column in ("rows", "counts"):
            assert np.array_equal(getattr(getattr(joined, name), column), getattr(getattr(one, name), column))
