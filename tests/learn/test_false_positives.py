"""False positives that stay, and where they lie relative to the horizon, are learned back from simulated ones."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.detector.file.reading import parse_detector
from modsim3d.learn.bootstrap import entries_of, resample
from modsim3d.learn.match_types import NAMES
from modsim3d.learn.persistent_false_positives import LifetimeFit, find_lifetime
from tests.formats.labelled_files import found, images, truth
from tests.learn.one_state import PROVENANCE, detected, detector_file, learned_from, observed_in, of_boats

FRAMES, RATE_HZ = 1200, 4.0
SIZE = {"model": "lognormal", "px": [60, 30], "log_std": 0.3}
STAYS = {"lifetime_s": 5.0, "drift_px_s": 8.0, "share": 0.6}
BAND = {"placement": "horizon_band", "band_px": 60.0, "persistence": STAYS}


def on_a_rolling_camera(seed=0, **section):
    """Two boats before a camera that rolls and pitches, and false positives as a detector file describes them."""
    frame = np.arange(FRAMES)
    roll, pitch = 0.05 * np.sin(frame / 17), 15 * np.sin(frame / 11)
    half_planes = np.column_stack([np.sin(roll), np.cos(roll), -(300 + pitch)])
    image = np.repeat(frame, 2)
    boxes = np.tile([[100.0, 350, 200, 400], [1000, 350, 1100, 400]], (FRAMES, 1))
    there = truth(image, 0 * image, boxes, identity=np.tile([0, 1], FRAMES))
    labelled = of_boats(images(FRAMES, (1200.0, 900.0), frame / RATE_HZ, half_planes), there, name="day")
    section = {"model": "per_image", "rate": 1.2, "size": SIZE, **section}
    return detected(labelled, detector_file("day", false=0.3) | {"false_positives": section}, seed)


def inside(learned, **asked):
    """Whether each number asked for is inside its interval of 99.9 %."""
    intervals = {each.key.names[-1]: each for each in learned.intervals(0.999)}
    return {name: bool(intervals[name].low <= value <= intervals[name].high) for name, value in asked.items()}


@pytest.fixture(scope="module")
def staying():
    """False positives in a band below the horizon, most of which stay."""
    return on_a_rolling_camera(**BAND)


@pytest.fixture(scope="module")
def learned_staying(staying):
    return learned_from(staying)


def check(learned, placing, **section):
    form, stays = learned.form.false_positives, section["persistence"]
    assert form.placing == placing and form.drifts == ("drift_px_s" in stays)
    asked = {key: value for key, value in {**section, **stays}.items() if isinstance(value, float)}
    assert all(inside(learned, **asked, false_positives_per_image=1.2, log_std=0.3).values())
    assert learned.run_s == pytest.approx(FRAMES / RATE_HZ / 24, rel=0.01)  # as long as leaves enough runs
    written = parse_detector(learned.detector()).false_positives
    assert written.lifetime_s == pytest.approx(5, rel=0.35)
    assert written.persistent_share == pytest.approx(stays["share"], abs=0.12)
    assert written.drift_px_s == pytest.approx(stays.get("drift_px_s", 0), rel=0.01)


def test_false_positives_that_stay_in_a_band_or_far_away_come_back_inside_their_intervals(learned_staying):
    check(learned_staying, "horizon_band", **BAND)
    section = {"far_half_px": 80.0, "persistence": {"lifetime_s": 5.0, "share": 1.0}}
    check(learned_from(on_a_rolling_camera(**section)), "far_half_px", **section)


def test_neither_persistence_nor_a_placement_is_learned_where_there_is_none():
    learned = learned_from(on_a_rolling_camera(rate=3.0))
    form = learned.form.false_positives
    assert (form.lifetime_s, form.placing, form.drifts) == (0, "uniform", False)
    assert set(learned.detector()["false_positives"]) == {"model", "size"}
    persistence, placement = (note for note in learned.notes if note.startswith("false_positives.p"))
    assert "have another near their place in the next frame" in persistence
    assert "no other is clearly likelier; 0.0 % of" in placement and "above the horizon" in placement


def test_boxes_that_jitter_from_frame_to_frame_still_stay(staying):
    results, rng = staying.results, np.random.default_rng(1)
    sides = np.tile(results.boxes_px[:, 2:] - results.boxes_px[:, :2], 2)
    jittered = replace(results, boxes_px=results.boxes_px + rng.normal(0, 0.1, (len(results), 4)) * sides)
    assert all(inside(learned_from(replace(staying, results=jittered)), **STAYS).values())


@pytest.mark.parametrize("sea", [np.nan, [0.0, 0.0, 1.0]])  # of files, and of a run of labels
def test_without_a_horizon_places_are_a_map_and_a_note_says_so(staying, sea):
    learned = learned_from(replace(staying, images=replace(staying.images, half_planes=np.full((FRAMES, 3), sea))))
    assert learned.form.false_positives.placing == "density"
    assert "false_positives.placement: a map; the horizon of some images is not known (--horizon)" in learned.notes


def test_models_that_are_left_out_are_not_learned(staying):
    left = {"lasting": "persistence", "places": "band_px", "sizes": "size"}
    for name, key in left.items():
        assert set(left.values()) - set(learned_from(staying, without={name}).detector()["false_positives"]) == {key}


def test_what_was_learned_is_learned_again_with_the_same_numbers(staying, learned_staying):
    again = learned_from(detected(staying, learned_staying.detector(), seed=1))
    numbers = {each.key.names[-1]: each.estimate for each in entries_of(again.numbers)}
    for name, value, share in (("band_px", 60, 0.03), ("drift_px_s", 8, 0.02), ("lifetime_s", 5, 0.5)):
        assert numbers[name] == pytest.approx(value, rel=share)
    # Of data without false positives the same numbers are learned.
    results = staying.results
    kept = {name: None if column is None else column[results.origin >= 0] for name, column in vars(results).items()}
    nothing = observed_in(replace(staying, results=type(results)(**kept)), PROVENANCE, name="day")
    none = learned_staying.form.estimate(nothing, resample(staying.images, 0, 0))
    assert none.false_positives.persistence.share.estimate == 0
    assert len([*entries_of(none)]) == len([*entries_of(learned_staying.numbers)])


FEW_FRAMES = 300


def learned_to_stay(rate: float, seed: int, stays: int = 0) -> bool:
    """Whether false positives of a rate an image, and so many that stay for 20 frames, are learned to stay."""
    rng = np.random.default_rng(seed)
    image = np.repeat(np.arange(FEW_FRAMES), rng.poisson(rate, FEW_FRAMES))
    centre = rng.uniform(40, 560, (len(image), 2))
    for _ in range(stays):
        begin = int(rng.integers(0, FEW_FRAMES - 20))
        image = np.append(image, np.arange(begin, begin + 20))
        centre = np.concatenate([centre, np.tile(rng.uniform(40, 560, 2), (20, 1))])
    order = np.argsort(image, kind="stable")
    image, centre = image[order], centre[order]
    side = rng.uniform(15, 30, (len(image), 1))
    detections = found(image, 0 * image, np.hstack([centre - side, centre + side]), np.full(len(image), 0.5))
    frames = images(FEW_FRAMES, time_s=np.arange(FEW_FRAMES) * 0.25)
    observed = observed_in(of_boats(frames, truth([], [], []), detections), without=NAMES)  # which belong to vessels
    return isinstance(find_lifetime(observed, np.full(FEW_FRAMES, len(image) / FEW_FRAMES)), LifetimeFit)


def test_none_is_invented_in_two_hundred_sets_and_those_that_stay_are_found() -> None:
    for rate in (0.02, 0.1, 0.6):
        assert sum(learned_to_stay(rate, seed) for seed in range(200)) == 0, rate
    # Two may lie at one place, far apart in time.
    assert sum(learned_to_stay(0.1, seed, stays=4) for seed in range(10)) >= 9
