"""Frames and tracks have the features that they are said to have; a classifier finds what differs, and only that."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.stand_in.classifier import Rows, _folds, between_seeds, tell_apart
from benchmarks.stand_in.features import Table, frame_features, track_features
from benchmarks.stand_in.sighted import Sighted, on_one_grid, pairs_of_images
from modsim3d.core.boxes import unions
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import Annotations, LabelledSet
from tests.formats.labelled_files import found, images, truth

IMAGES, VESSELS = 24, 4
FILMS = tuple(f"film {number}" for number in range(6))


def film_truth(seed: int, visible: float = 1.0) -> LabelledSet:
    """Four vessels of 60 × 30 px that drift to the right through the images of a film, one below the other."""
    rng = np.random.default_rng(seed)
    image, vessel = np.divmod(np.arange(IMAGES * VESSELS), VESSELS)
    left = rng.uniform(50, 200, VESSELS)[vessel] + 3.0 * image
    top = 80.0 + 130 * vessel
    boxes_px = np.stack([left, top, left + 60, top + 30], axis=1)
    rows = truth(image, 0 * image, boxes_px, identity=vessel, visible=np.full(len(image), visible))
    return LabelledSet(("boat",), ("all",), images(IMAGES, time_s=np.arange(IMAGES) / 4), rows, found([], [], [], []))


def seen(film: LabelledSet, rows, boxes_px, confidence) -> LabelledSet:
    image = film.annotations.image[rows]
    return replace(film, results=found(image, 0 * image, boxes_px, confidence).by_image())


def detected(film: LabelledSet, seed: int, spread_px: float = 1.0, misses: float = 0.2) -> LabelledSet:
    """A detector that misses at random, and whose edges and confidence have errors."""
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(rng.random(len(film.annotations)) >= misses)
    boxes_px = film.annotations.boxes_px[rows] + rng.normal(0, spread_px, (len(rows), 4))
    return seen(film, rows, boxes_px, rng.uniform(0.3, 0.9, len(rows)))


def output(seed: int, **detector) -> dict[str, LabelledSet]:
    """A detector's output for every film."""
    return {name: detected(film_truth(k), 100 * seed + k, **detector) for k, name in enumerate(FILMS)}


def column(table, name: str) -> np.ndarray:
    return table.values[:, table.names.index(name)]


@pytest.fixture(scope="module")
def usual():
    return [output(seed) for seed in (1, 2, 3)]


def test_pairs_are_all_of_equal_images_and_rounding_order_and_threshold_leave_no_trace():
    first, second = np.array([2, 0, 1, 0]), np.array([0, 1, 0, 3])
    ours, theirs = pairs_of_images(first, second)
    expected = {(i, j) for i, a in enumerate(first) for j, b in enumerate(second) if a == b}
    assert set(zip(ours.tolist(), theirs.tolist(), strict=True)) == expected and len(ours) == len(expected)
    film = film_truth(0)
    exact, rng = detected(film, 1), np.random.default_rng(5)
    shuffled = rng.permutation(len(exact.results))
    results = exact.results
    image, label = results.image[shuffled], results.label[shuffled]
    boxes_px = np.round(results.boxes_px[shuffled] * 2, 0) / 2 + 1e-4
    coarse = found(image, label, boxes_px, np.round(results.confidence[shuffled], 2) + 1e-6)
    a, b = (on_one_grid(each, 0.4).results for each in (exact, replace(exact, results=coarse.by_image())))
    np.testing.assert_array_equal(a.boxes_px, b.boxes_px)
    np.testing.assert_array_equal(a.confidence, b.confidence)
    assert a.confidence.min() >= 0.4 and len(a) < len(results)
    outside = seen(film, np.array([0]), [[-20.0, 10.0, 700.0, 50.0]], [0.9])
    assert on_one_grid(outside, 0.2).results.boxes_px.tolist() == [[0.0, 10.0, 600.0, 50.0]]


def test_a_track_tells_its_gaps_errors_and_confidence():
    film = film_truth(0)
    annotations: Annotations = film.annotations
    rows = np.flatnonzero(annotations.identity == 0)
    hit = np.ones(IMAGES, dtype=bool)
    hit[[0, 5, 6, 7, 12]] = False  # misses at the start, then gaps of 3 and 1
    rows = rows[hit]
    boxes_px = annotations.boxes_px[rows] + np.array([3.0, 0, 3, 6])  # 0.05 widths to the right, 0.2 heights higher
    table = track_features(Sighted.of(seen(film, rows, boxes_px, np.full(len(rows), 0.7)), 0.25))
    assert len(table.values) == VESSELS
    told = dict(zip(table.names, table.values[0].tolist(), strict=True))
    expected = {"images": IMAGES, "share of images detected": 19 / 24, "gaps for each image": 2 / 24, "mean gap": 2,
                "longest gap": 3, "longest stretch of sightings": 11, "mean confidence": 0.7}  # fmt: skip
    assert {name: told[name] for name in expected} == pytest.approx(expected)
    assert column(table, "share of images detected")[1:].tolist() == [0, 0, 0]
    assert np.isnan(column(table, "mean confidence")[1:]).all()
    assert told["mean error of x"] == pytest.approx(0.05, abs=0.01)
    assert told["spread of the error of width"] == pytest.approx(0, abs=0.01)
    assert table.groups[table.names.index("mean error of x")] == "box errors"


def test_a_frame_tells_false_detections_by_what_they_lie_on():
    film = film_truth(0)
    boxes_px = film.annotations.boxes_px
    part = boxes_px[1] - [0, 0, 40, 0]  # the left third of a vessel that is not detected
    both = unions(boxes_px[4:5], boxes_px[5:6])[0]  # around two of the next image
    at_sea = np.array([500.0, 500, 540, 520])
    image = np.array([0, 0, 0, 1, 1])
    boxes = np.stack([boxes_px[0], part, at_sea, at_sea + 4, both])
    rows = replace(film, results=found(image, 0 * image, boxes, [0.9, 0.5, 0.4, 0.4, 0.6]))
    table = frame_features(Sighted.of(rows, 0.25))
    assert column(table, "false positives")[:3].tolist() == [2, 2, 0]
    assert column(table, "second boxes and parts")[:3].tolist() == [1, 0, 0]
    assert column(table, "boxes around two vessels")[:3].tolist() == [0, 1, 0]
    assert column(table, "share of false positives that go on")[:2].tolist() == [0, 0.5]
    assert column(table, "share of vessels detected")[:2].tolist() == pytest.approx([1 / 4, 0])
    assert column(table, "share newly missed")[1] == 1


def test_a_simulated_detector_cannot_be_told_from_itself_nor_by_a_film_that_was_learned_from(usual):
    simulated = {name: [each[name] for each in usual[:2]] for name in FILMS}
    told = between_seeds(FILMS, simulated, 0.25)
    assert told["frames"]["auc"] == pytest.approx(0.5, abs=0.1)
    assert told["tracks"]["auc"] == pytest.approx(0.5, abs=0.25)  # 24 tracks
    assert len(told["tracks"]["aucs"]) == 2
    told = tell_apart(FILMS, usual[2], simulated, 0.25, kinds=("frames",), importance=False)["frames"]
    assert told["low"] < 0.5 < told["high"] and told["rows"] == len(FILMS) * IMAGES
    films = FILMS[:4]  # so large a difference needs no more
    simulated = {name: [usual[0][name]] for name in films}
    told = tell_apart(films, output(7, spread_px=2.5), simulated, 0.25, kinds=("frames",))["frames"]
    assert told["auc"] > 0.9
    assert told["low"] > 0.6 and next(iter(told["groups"])) == "box errors"
    first = told["features"][0]
    assert first["group"] == "box errors" and abs(first["alone"] - 0.5) > 0.2
    alone = {each["name"]: each["alone"] for each in told["features"]}
    assert alone["mean IoU"] < 0.1  # the real detector's are smaller
    assert told["groups"]["confidence"]["importance"] < 0.05
    simulated = {name: [usual[1][name]] for name in FILMS}
    with pytest.raises(ModsimError, match=r"at least 3 films with tracks are needed .* \(got 2\)"):
        tell_apart(FILMS[:2], usual[0], simulated, 0.25, kinds=("tracks",))
    film = np.repeat(np.arange(10), 6)
    rows = Rows(Table(("value",), ("misses",), film[:, None] * 1.0), film, np.tile([True, False], 30), 10, 1)
    asked = [fold.rows for fold in _folds(rows, 1, 0)]
    assert np.array_equal(np.sort(np.concatenate(asked)), np.arange(60))
    assert sum(map(len, [set(film[each].tolist()) for each in asked])) == 10
