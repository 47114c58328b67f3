"""All models at once, as the shipped example has them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d.core.boxes import sizes
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.records import FALSE_KINDS, KINDS, ON_VESSEL, CameraFrames, Detections, Targets
from tests.detector import detector_builders as build
from tests.detector.detector_builders import all_bytes, chunk, clock, detect_in_chunks
from tests.detector_variants import variant

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
def whole() -> Detections:
    return detector().detect(rich_frames(), rich_targets())


def detector(seed: int = 5) -> Detector:
    return Detector(MODEL, seed, target_statistics(MODEL, [(rich_frames(), rich_targets())]), clock(STEP_S))


def test_the_example_is_short_and_has_every_kind_of_detection_and_each_vessel_one_that_is_not_false(whole) -> None:
    assert len(RICH.read_text().splitlines()) < 60
    assert set(whole.kind) == {*range(len(KINDS))} - {ON_VESSEL} and whole.gated.any()  # which `per_image` alone has
    assert sizes(whole.boxes_px).min() >= 1 - 1e-9 and whole.boxes_px.min() >= 0
    assert np.all(whole.boxes_px[:, 2:] <= [3600, 2400])
    assert np.all((whole.confidence >= 0.2) & (whole.confidence <= 1))
    own = ~np.isin(whole.kind, FALSE_KINDS)
    sources = np.concatenate([whole.target[own], whole.partner[whole.partner >= 0]])
    assert len(np.unique(sources)) == len(sources) and not whole.gated[sources].any()


def test_chunks_in_any_order_change_nothing_with_every_model_on(whole: Detections) -> None:
    for borders in ([0, 1, 2, 250, 250, 599, 600], [0, 600], [*range(0, 601, 37), 600]):
        found = detect_in_chunks(detector(), rich_frames(), rich_targets(), borders)
        assert all_bytes(found) == all_bytes(whole), borders
    one = detector()
    late, early = (detect_in_chunks(one, rich_frames(), rich_targets(), part) for part in ([400, 600], [0, 400]))
    assert np.array_equal(np.concatenate([early.boxes_px, late.boxes_px]), whole.boxes_px)


PERSISTENCE = {"class_s": 1.0, "box_s": 0.7, "confidence_s": 2.0, "merge_s": 2.0, "box_vessel_share": 0.3}
MODELS = ("plain", "Student's t box errors", "persistent false positives", "doubled, split and merged boxes", "gates")


@pytest.mark.parametrize("name", MODELS)
def test_chunk_borders_change_nothing_in_what_persists(name: str) -> None:
    model = parse_detector(variant(name) | {"persistence": PERSISTENCE})
    frames, targets = rich_frames(), replace(rich_targets(), label=np.zeros_like(rich_targets().label))
    statistics = target_statistics(model, [(frames, targets)])
    whole = Detector(model, 5, statistics, clock(STEP_S)).detect(frames, targets)
    split = detect_in_chunks(Detector(model, 5, statistics, clock(STEP_S)), frames, targets, [0, 1, 513, 514, STEPS])
    assert all_bytes(split) == all_bytes(whole)
    part = chunk(frames, targets, 400, STEPS)[:2]
    later = Detector(model, 5, statistics, clock(STEP_S)).detect(*part)  # as another worker would
    np.testing.assert_array_equal(later.boxes_px, whole.boxes_px[whole.frame >= 400])


def test_target_statistics_do_not_depend_on_how_the_scene_is_split() -> None:
    frames, targets = rich_frames(), rich_targets()
    halves = (chunk(frames, targets, *part)[:2] for part in ((0, 333), (333, STEPS)))
    first, second = (target_statistics(MODEL, [half]) for half in halves)
    joined, one = first + second, target_statistics(MODEL, [(frames, targets)])
    for name in ("log_odds", "sides"):
        for column in ("rows", "counts"):
            assert np.array_equal(getattr(getattr(joined, name), column), getattr(getattr(one, name), column))
