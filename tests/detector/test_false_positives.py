"""False positives: where they come from, how many and how large; duplicates, merged boxes and boxes in two parts."""

import itertools
from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.core.boxes import centres, sizes, unions
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Streams
from modsim3d.detector import records
from modsim3d.detector.false_positives import persistent_false_positives
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.merges_and_splits import MergesAndSplits, halves
from modsim3d.detector.records import FALSE_POSITIVE, PERSISTENT, Detections, Targets
from tests.detector import detector_builders as build

BOX = build.centred(80, 40)


def detected(kind: str, rate: float, boxes: np.ndarray, confusion: Any = build.ALL_SEEN, **options: Any) -> Detections:
    """Detections of vessels in boxes of shape (frames, vessels, 4); options are of the frames."""
    data = build.one_state_data(false_discovery_rate=rate, confusion=confusion, box_error=build.no_error())
    data["false_positives"] = {"model": kind} | ({"rate": 4} if kind == "per_image" else {})
    return build.run(data, build.make_frames(len(boxes), **options), build.make_targets(boxes))


def false_boxes(detections: Detections) -> np.ndarray:
    return detections.boxes_px[detections.kind == FALSE_POSITIVE]


def inside(boxes_px: np.ndarray) -> np.ndarray:
    return np.all((boxes_px > 0) & (boxes_px < [*build.IMAGE_PX, *build.IMAGE_PX]), axis=1)


def count_per_frame(detections: Detections, frames: int) -> np.ndarray:
    return np.bincount(detections.frame[detections.kind == FALSE_POSITIVE], minlength=frames)


def test_calibrated_counts_are_poisson_with_sizes_of_the_vessels_of_the_same_frame() -> None:
    counts = count_per_frame(detected("calibrated", 0.25, build.same_boxes(20_000, 6, BOX)), 20_000)
    assert abs(counts.mean() - 2) < 4 * np.sqrt(2 / 20_000)
    assert abs(counts.var() - 2) < 4 * np.sqrt((2 + 2 * 4) / 20_000)  # fourth central moment 3λ² + λ, less λ²
    boxes, swapped, missed = build.same_boxes(500, 6, BOX), [[0, 1], [1, 0], [0, 0]], [[0, 0], [0, 0], [1, 1]]
    right, wrong, none = (detected("calibrated", 0.5, boxes, each) for each in (build.ALL_SEEN, swapped, missed))
    assert np.array_equal(count_per_frame(right, 500), count_per_frame(wrong, 500))
    assert count_per_frame(wrong, 500).sum() > 0 == len(none)
    fewer = detected("calibrated", 0.5, boxes[:, :5])
    assert np.all(count_per_frame(fewer, 500) <= count_per_frame(right, 500))
    places, all_places = ({tuple(box) for box in false_boxes(found).tolist()} for found in (fewer, right))
    assert places < all_places
    boxes = build.same_boxes(6000, 3, BOX)
    boxes[::2, :2] = [1000, 1000, 1100, 1010]  # even frames: two thirds 100 × 10
    found = detected("calibrated", 0.5, boxes)
    false = (found.kind == FALSE_POSITIVE) & inside(found.boxes_px)
    size, even = sizes(found.boxes_px), found.frame % 2 == 0
    wide = (np.abs(size - [100, 10]) <= 0.5).all(axis=1)
    assert np.abs(size[false & ~(even & wide)] - [80, 40]).max() <= 0.5
    assert abs(wide[false & even].mean() - 2 / 3) < 4 * np.sqrt(2 / 9 / np.sum(false & even))
    for rows in (false & wide, false & ~wide):
        assert abs(found.label[rows].mean() - 0.75) < 4 * np.sqrt(0.75 * 0.25 / rows.sum())


@pytest.mark.parametrize(("n", "rate", "trials"), [
    (20, 0.5, 10), (28, 0.2, 5), (5, 0.4, 2), (1, 0.1, 0), (5, 0.1, 0),  # 0.1 · 5 − 0.2 rounds to no trial at all
])  # fmt: skip
def test_thesis_counts_are_binomial_in_the_rounded_rule(n: int, rate: float, trials: int) -> None:
    """Jessen & Mohr (2023), eq. 7.35."""
    found = detected("thesis", rate, build.same_boxes(3000, n, BOX))
    counts = count_per_frame(found, 3000)
    assert counts.max() <= trials and len(found) == 3000 * n + counts.sum()
    assert abs(counts.mean() - trials * rate) <= 4 * np.sqrt(trials * rate * (1 - rate) / 3000)


@pytest.mark.parametrize("kind", ["calibrated", "thesis"])
def test_false_positives_are_centred_below_the_horizon(kind: str) -> None:
    boxes = false_boxes(detected(kind, 0.5, build.same_boxes(300, 20, BOX), sea=(0.0, 1.0, -1500.0)))
    boxes = boxes[boxes[:, 3] < build.IMAGE_PX[1]]
    centre_y = (boxes[:, 1] + boxes[:, 3]) / 2
    assert len(centre_y) > 1000 and 1500 <= centre_y.min() < 1510


def test_thesis_boxes_are_a_hundred_pixels_and_all_have_the_rate_and_labels_of_the_state() -> None:
    boxes = false_boxes(detected("thesis", 0.5, build.same_boxes(300, 20, BOX)))
    np.testing.assert_allclose(sizes(boxes[inside(boxes)]), 100)
    assert 0.9 < inside(boxes).mean() < 1
    data = build.detector_data(transition_matrix=[[0.9, 0.1], [0.1, 0.9]])
    data["states"]["fog"]["false_positive_labels"] = [0.9, 0.1]
    found = build.run(data, build.make_frames(4000), build.steady_targets(4000, 6, build.centred(600, 600)))
    state, false = found.states[found.frame], found.kind == FALSE_POSITIVE
    for index, (rate, second_label) in enumerate([(0.2, 0.75), (0.4, 0.1)]):
        ours = false & (state == index)
        n_true = np.sum(~false & (state == index))
        standard_error = np.sqrt(n_true * rate / (1 - rate)) * n_true / np.sum(state == index) ** 2
        assert abs(np.sum(ours) / np.sum(state == index) - rate) < 4 * standard_error
        label_error = np.sqrt(second_label * (1 - second_label) / np.sum(ours))
        assert abs(found.label[ours].mean() - second_label) < 4 * label_error
    targets = build.steady_targets(500, 1, BOX, vessel_ids=["0"])
    found = build.run(build.one_state_data(false_discovery_rate=0.5), build.make_frames(500), targets)
    false = found.kind == FALSE_POSITIVE
    assert not np.intersect1d(found.confidence[false], found.confidence[~false & (found.confidence < 1)]).size
    tiny = build.same_boxes(2000, 3, [3.0, 3.0, 3.2, 3.1])
    boxes = false_boxes(detected("calibrated", 0.7, tiny, image_px=(8, 6)))
    assert len(boxes) > 1000 and sizes(boxes).min() >= 1
    assert boxes.min() >= 0 and np.all(boxes[:, 2:] <= [8, 6])


@pytest.mark.parametrize("kind", ["calibrated", "per_image"])
def test_sides_of_false_positives_are_no_more_often_whole_pixels_or_equal_than_those_of_vessels(kind: str) -> None:
    """Boxes of rendered vessels have whole sides, detected ones have errors: sizes of vessels must not tell."""
    side = sizes(false_boxes(detected(kind, 0.4, build.same_boxes(500, 6, BOX)))).ravel()
    assert len(side) > 2000
    whole = np.abs(side - side.round()) < 0.05
    assert abs(whole.mean() - 0.1) < 4 * np.sqrt(0.1 * 0.9 / len(side)) + 0.02
    assert len(np.unique(side.round(4))) > 0.9 * len(side)


FRAMES = 20_000


def watch(rates: Any, lifetime_s: float, frames: int = FRAMES, step_s: float = 0.1, seed: int = 1) -> Any:
    """False positives that persist."""
    seen, each = build.make_frames(frames, time_step_s=step_s), np.broadcast_to(np.asarray(rates, dtype=float), frames)
    return persistent_false_positives(Streams(seed), seen, each, lifetime_s)


@pytest.mark.parametrize("step_s", [0.1, 0.7])
@pytest.mark.parametrize("rate", [0.6, 2.3])
def test_each_frame_shows_a_poisson_number_with_its_rate(rate: float, step_s: float) -> None:
    counts = np.bincount(watch(rate, 2.0, step_s=step_s).frame, minlength=FRAMES)
    kept = np.exp(-step_s / 2.0)  # counts Δt apart are correlated by it
    assert abs(counts.mean() - rate) < 4 * np.sqrt(rate / FRAMES * (1 + kept) / (1 - kept))
    apart = counts[:: int(10 / step_s)]
    seen = np.bincount(np.minimum(apart, 6), minlength=7)
    law = stats.poisson.pmf(np.arange(6), rate)
    assert stats.chisquare(seen, np.append(law, 1 - law.sum()) * len(apart)).pvalue > 1e-4


def test_numbers_follow_a_rate_that_changes_and_lifetimes_are_exponential() -> None:
    rates = np.where(np.arange(FRAMES) % 2, 0.3, 1.4)
    counts = np.bincount(watch(rates, 2.0).frame, minlength=FRAMES)
    for rate in (0.3, 1.4):
        ours = counts[rates == rate]
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate / len(ours) * 2 * 2.0 / 0.2)
    counts = [len(watch(3.0, 5.0, frames=1, seed=seed).frame) for seed in range(250)]
    assert abs(np.mean(counts) - 3) < 4 * np.sqrt(3 / 250)
    seen = watch(0.0, 2.0, frames=10)
    assert seen.uniforms.shape == (0, 5) and len(seen.frame) == len(seen.age_s) == len(seen.sign) == 0
    assert watch(np.where(np.arange(400) < 200, 0.0, 2.5), 2.0, frames=400).frame.min() >= 200
    seen = watch(0.3, 0.5)
    _, births = np.unique(seen.uniforms[:, 0], return_index=True)
    numbers = np.column_stack([seen.uniforms[births], (seen.sign[births] + 1) / 2])
    for column in numbers[:, :5].T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4
    correlations = np.corrcoef(numbers.T)[np.triu_indices(6, 1)]
    assert np.abs(correlations).max() < 4.5 / np.sqrt(len(births))
    assert abs(numbers[:, 5].mean() - 0.5) < 4 * 0.5 / np.sqrt(len(births))
    found = watch(1.0, 2.0)
    _, one = np.unique(found.uniforms[:, 0], return_inverse=True)
    shown = np.bincount(one)
    # In whole frames: one that is seen at all is seen once more with probability e^(−Δt/τ), again and again.
    again = np.exp(-0.1 / 2.0)
    assert abs(shown.mean() - 1 / (1 - again)) < 4 / (1 - again) / np.sqrt(len(shown))
    edges = np.array([1, 5, 12, 25, 50])
    law = -np.diff([again ** (edge - 1) for edge in edges], append=0)
    seen = np.histogram(shown, [*edges, np.inf])[0]
    assert stats.chisquare(seen, law * len(shown)).pvalue > 1e-4
    for rows in (one == number for number in range(20)):
        assert len(np.unique(found.uniforms[rows], axis=0)) == len(set(found.sign[rows])) == 1
        np.testing.assert_allclose(np.diff(found.age_s[rows]), 0.1 * np.diff(found.frame[rows]))


def detect(frames: int = 6000, **persistence: float) -> Detections:
    data = build.one_state_data(false_discovery_rate=0.2, box_error=build.no_error())
    size = {"model": "fixed", "px": [40, 20]}
    data["false_positives"] = {"model": "calibrated", "size": size, "persistence": persistence}
    return build.run(data, build.make_frames(frames), build.steady_targets(frames, 6, BOX))


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_the_false_discovery_rate_holds_with_persistent_ones(share: float) -> None:
    found = detect(lifetime_s=1.0, share=share)
    false = found.false()
    n_true, kept = np.sum(~false), np.exp(-0.1)
    error = np.sqrt(n_true * 0.25 * (1 + kept) / (1 - kept)) * n_true / len(found) ** 2
    assert abs(false.mean() - 0.2) < 4 * error
    assert abs(np.sum(found.kind == PERSISTENT) / np.sum(false) - share) < 0.06
    assert (share == 1.0) == (not np.any(found.kind == FALSE_POSITIVE))


def test_they_drift_along_the_horizon_at_their_speed() -> None:
    found = detect(600, lifetime_s=20.0, drift_px_s=30.0)
    persistent = found.kind == PERSISTENT
    boxes, frame = found.boxes_px[persistent], found.frame[persistent]
    tracks: dict[float, list[tuple[int, float]]] = {}
    for row, box in zip(frame.tolist(), boxes.tolist(), strict=True):
        tracks.setdefault(round(box[3], 6), []).append((row, box[0]))
    pairs = [pair for track in tracks.values() for pair in itertools.pairwise(track)]
    speeds = [abs(later[1] - earlier[1]) / (0.1 * (later[0] - earlier[0])) for earlier, later in pairs]
    assert len(speeds) > 200
    assert np.mean(np.isclose(speeds, 30, rtol=1e-6)) > 0.9  # but for those that turn or are cut at the edge


VESSEL_FRAMES, VESSELS = 6000, 3
LAW = {"share": 0.2, "mean": [0.1, -0.2, 0.3, -0.4], "std": [0.3, 0.1, 0.2, 0.4]}
BOXES = np.array([[600.0 + 700 * k, 900, 700 + 700 * k, 940] for k in range(VESSELS)])


def detector(lifetime_s: float = 0.0, missed: float = 0.5, **keys):
    confusion = [[1 - missed, 0], [0, 1 - missed], [missed, missed]]
    data = build.one_state_data(confusion=confusion, false_positives_per_image=0.0, box_error=build.no_error())
    del data["states"]["only"]["false_discovery_rate"]
    on = LAW | ({"lifetime_s": lifetime_s} if lifetime_s else {}) | keys
    return data | {"false_positives": {"model": "per_image", "on_vessels": on}}


def shown(lifetime_s: float = 0.0, missed: float = 0.5):
    """Whether each vessel has one in each frame (frames, vessels), its place (..., 4), and all detections."""
    targets = build.make_targets(np.tile(BOXES, (VESSEL_FRAMES, 1, 1)))
    found = build.run(detector(lifetime_s, missed), build.make_frames(VESSEL_FRAMES), targets, 3)
    rows = np.flatnonzero(found.kind == records.ON_VESSEL)
    there, place = np.zeros((VESSEL_FRAMES, VESSELS), dtype=bool), np.full((VESSEL_FRAMES, VESSELS, 4), np.nan)
    at = found.frame[rows], targets.vessel[found.target[rows]]
    true, box = targets.boxes_px[found.target[rows]], found.boxes_px[rows]
    there[at] = True
    place[at] = np.hstack([(centres(box) - centres(true)) / sizes(true), np.log(sizes(box) / sizes(true))])
    return there, place, found, targets


def test_they_are_on_found_and_missed_vessels_alike_with_the_asked_place_size_and_share():
    there, place, found, targets = shown()
    error = np.sqrt(0.2 * 0.8 / there.size)
    assert abs(there.mean() - 0.2) < 4 * error
    seen = np.zeros(len(targets), dtype=bool)
    seen[found.target[found.kind == records.TRUE]] = True
    assert abs(there.ravel()[seen].mean() - there.ravel()[~seen].mean()) < 6 * error
    values = place[there]
    assert np.all(np.abs(values.mean(axis=0) - LAW["mean"]) < 4 * np.array(LAW["std"]) / np.sqrt(len(values)))
    assert np.all(np.abs(values.std(axis=0) / LAW["std"] - 1) < 4 / np.sqrt(2 * len(values)))
    assert np.all(np.abs(np.corrcoef(values.T) - np.eye(4)) < 4 / np.sqrt(len(values)))
    assert np.all(found.false() == (found.kind == records.ON_VESSEL))
    assert not np.any(found.gated)
    # With 0.1 s between frames one is there in the next with e^(−1/τ) + (1 − e^(−1/τ)) · share.
    there, place, _, _ = shown(lifetime_s=0.4)
    kept = np.exp(-0.1 / 0.4)
    inflation = (1 + kept) / (1 - kept)
    assert abs(there.mean() - 0.2) < 4 * np.sqrt(0.16 * inflation / there.size)
    again = there[1:][there[:-1]]
    expected = kept + (1 - kept) * 0.2
    assert abs(again.mean() - expected) < 4 * np.sqrt(expected * (1 - expected) / len(again))
    both = there[1:] & there[:-1]
    same = np.abs(place[1:][both] - place[:-1][both]).max(axis=1) < 1e-9
    assert abs(same.mean() - kept / expected) < 4 * np.sqrt(0.25 / len(same))


def test_nothing_else_changes_no_box_leaves_the_image_and_what_cannot_be_is_refused():
    """Streams of their own: the other detections are those of the detector without them."""
    targets = build.make_targets(np.tile([[1.0, 1.0, 40.0, 20.0]], (400, 1, 1)))
    frames, data = build.make_frames(400), detector()
    found = build.run(data, frames, targets, 5)
    del data["false_positives"]["on_vessels"]
    plain = build.run(data, frames, targets, 5)
    others = found.kind != records.ON_VESSEL
    assert np.array_equal(found.boxes_px[others], plain.boxes_px)
    assert np.all(sizes(found.boxes_px) >= 1 - 1e-9) and np.all(found.boxes_px >= 0)
    assert 0 < np.count_nonzero(~others) < 0.2 * 400 * 1.3
    wrong = {
        ".share": {"on_vessels": LAW | {"share": 1.0}},
        ".std": {"on_vessels": LAW | {"std": [0.1, -0.1, 0.1, 0.1]}},
        ": model calibrated counts those on vessels too": {"model": "calibrated"},
    }
    for message, change in wrong.items():
        data = detector()
        data["false_positives"] |= change
        with pytest.raises(InputError, match=f"false_positives.on_vessels{message}"):
            parse_detector(data)


PAIR_FRAMES = 4000
LONG, SQUARE = build.centred(400, 40), [100.0, 1000.0, 200.0, 1080.0]
PAIR = [[1000.0, 1000.0, 1100.0, 1050.0], [1050.0, 1000.0, 1250.0, 1060.0]]  # half of the smaller is in both


def detect_boxes(boxes: list[list[float]], false_positives: dict[str, Any], **state: Any) -> tuple[Targets, Detections]:
    return run(false_positives, np.tile(np.array(boxes), (PAIR_FRAMES, 1, 1)), **{"false_discovery_rate": 0.2, **state})


def run(false_positives: dict[str, Any], boxes: np.ndarray, seed=1, gates=None, **state) -> tuple[Targets, Detections]:
    data = build.one_state_data(**{"confusion": build.ALL_SEEN, "box_error": build.no_error(), **state})
    data |= {"false_positives": {"model": "calibrated"} | false_positives, "gates": gates or {}}
    targets = build.make_targets(boxes)
    return targets, build.run(data, build.make_frames(len(boxes)), targets, seed)


def near(count: int, trials: int, p: float) -> bool:
    return abs(count / trials - p) < 4 * np.sqrt(p * (1 - p) / trials)


@pytest.mark.parametrize("rate", [0.2, 0.4])
def test_the_false_discovery_rate_counts_second_boxes(rate: float) -> None:
    keys = {"duplicates": 0.1, "splits": 0.05, "merges": 0.5}
    _, found = detect_boxes([LONG, SQUARE, *PAIR], keys, false_discovery_rate=rate)
    kinds = {"true", "false_positive", "duplicate", "merged", "split", "fragment"}
    assert {records.KINDS[kind] for kind in found.kind} == kinds
    n_true = np.sum(~found.false())
    error = np.sqrt(n_true * rate / (1 - rate)) * n_true / len(found) ** 2
    assert abs(found.false().mean() - rate) < 4 * error
    thesis = build.one_state_data(false_discovery_rate=0.05) | {"false_positives": keys | {"model": "thesis"}}
    assert parse_detector(thesis).merges_and_splits.duplicates == 0.1  # whose rule counts no second boxes


def test_duplicates_come_as_often_as_asked_and_split_boxes_are_parts_of_a_long_vessels_box() -> None:
    covariance = {"unit": "px", "mean": [0] * 4, "covariance": np.diag([9.0, 9, 4, 4]).tolist()}
    targets, found = detect_boxes([LONG, SQUARE], {"duplicates": 0.1}, box_error=covariance)
    second = found.kind == records.DUPLICATE
    assert near(int(second.sum()), len(targets), 0.1)
    own = np.full(len(targets), -1)
    own[found.target[found.kind == records.TRUE]] = np.flatnonzero(found.kind == records.TRUE)
    pairs = own[found.target[second]]
    assert np.all(found.label[pairs] == found.label[second])
    assert np.all(np.abs(np.cov(found.errors_px[second].T) - covariance["covariance"]) < 2)
    correlation = np.corrcoef(found.errors_px[second][:, 0], found.errors_px[pairs][:, 0])[0, 1]
    assert abs(correlation) < 4 / np.sqrt(second.sum())
    targets, found = detect_boxes([LONG, SQUARE], {"splits": 0.2})
    split, fragment = (np.flatnonzero(found.kind == kind) for kind in (records.SPLIT, records.FRAGMENT))
    assert near(len(split), PAIR_FRAMES, 0.2)
    assert np.array_equal(np.sort(found.target[split]), np.sort(found.target[fragment]))
    assert np.all(targets.vessel[found.target[split]] == 0)
    larger = found.boxes_px[split[np.argsort(found.target[split])]]
    smaller = found.boxes_px[fragment[np.argsort(found.target[fragment])]]
    np.testing.assert_allclose(unions(larger, smaller), np.tile(LONG, (len(split), 1)))
    width = sizes(larger)[:, 0]
    assert np.all((width >= 200 - 1e-9) & (width <= 0.7 * 400 + 1e-9))
    np.testing.assert_allclose(width + sizes(smaller)[:, 0], 400)
    assert not np.any(found.kind[found.target == 1] == records.SPLIT)
    from_4 = MergesAndSplits(split_aspect=4.0).looks_long(np.array([[0.0, 0, w, 10] for w in (39, 40, 41)]))
    assert from_4.tolist() == [False, True, True]
    assert parse_detector(build.one_state_data()).merges_and_splits == MergesAndSplits()
    larger, smaller = halves(np.array([[0.0, 0, 8, 2]]), np.array([0.5]))
    assert (larger.tolist(), smaller.tolist()) == ([[0, 0, 4, 2]], [[4, 0, 8, 2]])


def test_a_merged_box_counts_for_both_vessels_needs_overlap_and_is_not_split():
    targets, found = detect_boxes([*PAIR, SQUARE], {"merges": 0.3}, false_discovery_rate=0)
    merged = found.kind == records.MERGED
    assert near(int(merged.sum()), PAIR_FRAMES, 0.3)
    np.testing.assert_allclose(found.boxes_px[merged], np.tile([1000, 1000, 1250, 1060], (merged.sum(), 1)))
    assert np.all(targets.vessel[found.target[merged]] == 1)  # the larger
    assert np.all(targets.vessel[found.partner[merged]] == 0)
    assert np.all(found.partner[~merged] == -1)
    assert np.array_equal(np.sort([*found.target, *found.partner[merged]]), np.arange(len(targets)))
    # Of three in one place two are in one box.
    three = [[0.0, 0, 100, 50], [20.0, 0, 120, 50], [40.0, 0, 140, 50]]
    targets, found = detect_boxes(three, {"merges": 1.0}, false_discovery_rate=0)
    assert np.sum(found.kind == records.MERGED) == PAIR_FRAMES and np.sum(found.kind == records.TRUE) == PAIR_FRAMES
    sources = np.sort([*found.target, *found.partner[found.partner >= 0]])
    assert np.array_equal(sources, np.arange(len(targets)))
    keys = {"duplicates": 0.1, "splits": 0.05, "merges": 0.5, "persistence": {"lifetime_s": 1, "share": 0.5}}
    apart = {"true": {"mean": 0.8, "std": 0}, "false": {"mean": 0.4, "std": 0}}
    _, found = detect_boxes([LONG, SQUARE, *PAIR], keys | {"size": {"model": "fixed", "px": [9, 9]}}, confidence=apart)
    assert set(found.kind) == {*range(len(records.KINDS))} - {records.ON_VESSEL}
    assert np.array_equal(found.confidence == 0.4, found.false())
    assert np.array_equal(found.confidence == 0.8, ~found.false())
    apart = [[0.0, 0, 100, 50], [100.5, 0, 200, 50], [0.0, 50.5, 100, 90]]
    sliver = [[0.0, 0, 100, 50], [99.5, 0, 200, 50]]  # half a pixel of 100 is in both
    overlaps = ((PAIR, 0.51, 0.49), (sliver, 0.0051, 0.00499), (apart, 1e-6, None))
    for boxes, too_much, little_enough in overlaps:
        _, found = detect_boxes(boxes, {"merges": 1.0, "merge_overlap": too_much})
        assert not np.any(found.kind == records.MERGED), boxes
        if little_enough:
            _, found = detect_boxes(boxes, {"merges": 1.0, "merge_overlap": little_enough})
            assert np.all(found.kind[found.kind != records.FALSE_POSITIVE] == records.MERGED), boxes
    boxes = np.tile(PAIR, (200, 1, 1))
    swapped = boxes.copy()
    swapped[::2] = boxes[::2, ::-1]
    one, two = (run({"merges": 0.5}, each)[1] for each in (boxes, swapped))
    assert np.array_equal(one.frame[one.kind == records.MERGED], two.frame[two.kind == records.MERGED])
    targets, found = detect_boxes([PAIR[0], PAIR[0]], {"merges": 1.0}, false_discovery_rate=0)
    assert np.all(targets.vessel[found.target] == 0)
    keys = {"merges": 1.0, "splits": 0.5, "duplicates": 0.4}
    for seed in range(20):
        _, found = run(keys, np.array([PAIR]), seed, false_discovery_rate=0.5)
        assert set(found.kind) <= {records.MERGED, records.FALSE_POSITIVE}
        assert found.partner[found.kind == records.MERGED].tolist() == [0]
    wide = {"unit": "px", "mean": [0] * 4, "covariance": np.diag([1.0, 1.0, 150.0**2, 1.0]).tolist()}
    _, found = detect_boxes([LONG], {"splits": 0.5}, box_error=wide, false_discovery_rate=0.4)
    assert found.redrawn[np.isin(found.kind, (records.TRUE, records.SPLIT))].any()
    assert (found.kind == records.FRAGMENT).any()
    assert not found.redrawn[~np.isin(found.kind, (records.TRUE, records.SPLIT))].any()
    boxes = np.tile(np.array([*PAIR, SQUARE]), (50, 1, 1))
    targets, found = run({"merges": 1.0}, boxes, gates={"max_detections": 1}, false_discovery_rate=0)
    merged = set(found.frame[found.kind == records.MERGED].tolist())
    assert len(found) == 50 and 0 < len(merged) < 50
    for frame in range(50):
        gated = set(targets.vessel[found.gated & (targets.frame == frame)])
        assert gated == ({2} if frame in merged else {0, 1})
