"""Confidences: those that are missing or meant otherwise; slopes and persistence come back as they were asked for."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d import InputError, ModsimError, learn_detector, load_detector
from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.confidence_fit import ObservedConfidences, SlopeForm, _Point, product_limit
from modsim3d.learn.confidence_laws import Inflation
from modsim3d.learn.learned_detector import Estimates, uncertainty_text
from modsim3d.learn.self_check import simulated
from tests.formats.labelled_files import found, images, truth
from tests.learn import round_trip
from tests.learn.one_state import detected, detector, learned_from, of_boats, truth_of

FRAMES = 60


@pytest.fixture(scope="module")
def mot(tmp_path_factory):
    """A function that writes detections with given confidences beside the `gt.txt` of two boats."""
    folder, rng = tmp_path_factory.mktemp("mot"), np.random.default_rng(5)
    boats, frame = np.array([[100.0, 100, 60, 50], [300.0, 200, 80, 60]]), np.repeat(np.arange(1, FRAMES + 1), 2)
    boxes = np.tile(boats, (FRAMES, 1))
    seen = rng.random(len(boxes)) < 0.8
    moved = boxes + rng.normal(0, 2, boxes.shape)
    (folder / "gt.txt").write_text(_lines(frame, np.tile([1, 2], FRAMES), boxes, np.ones(len(boxes))))
    (folder / "seqinfo.ini").write_text("[Sequence]\nimWidth=640\nimHeight=480\nframeRate=10\n")

    def write(name: str, confidence) -> Path:
        path = folder / f"{name}.txt"
        count = int(seen.sum())
        path.write_text(_lines(frame[seen], np.full(count, -1), moved[seen], np.broadcast_to(confidence, count)))
        return path

    return write


def _lines(frame, identity, boxes, last) -> str:
    rows = zip(frame, identity, boxes, last, strict=True)
    return "".join(f"{f},{i},{','.join(f'{x:.3f}' for x in box)},{c:g},-1,-1,-1\n" for f, i, box, c in rows)


def command(detections: Path, folder: Path, *parts):
    """The command on detections, with the truth that lies beside them."""
    words = ("learn", "--truth", detections.with_stem("gt"), "--detections", detections, "--out", folder / "d.yaml")
    return round_trip.command(*words, "--replicates", 20, "--no-check", *parts, "--overwrite")


def test_detections_without_confidences_give_all_but_what_needs_them(mot, tmp_path):
    path = mot("none", -1)
    result = command(path, tmp_path)
    assert result.exit_code == 0
    text, page = (tmp_path / "d.yaml").read_text(), (tmp_path / "d.html").read_text()
    for each in (result.output, text, page):
        assert "the detections have no confidences (-1): all of them count, average precision" in each
        assert "confidence: 1 for every detection" in each
    assert "optimal assignment, without confidences" in result.output and "cross-entropy" not in result.output
    assert "What average precision is lost to" not in page and "Precision against recall" not in page
    model = load_detector(tmp_path / "d.yaml")
    assert model.confidence_threshold == 0
    labelled = read_pair("usual", path.with_stem("gt"), path)
    again = simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), model, seed=1)
    assert len(again.results) > 50 and set(again.results.confidence.tolist()) == {1.0}
    said = json.loads(command(path, tmp_path, "--json").stdout)
    assert said["lost_average_precision"] is None and said["states"][0]["average_precision"] is None
    assert said["states"][0]["recall"]["value"] == pytest.approx(0.8, abs=0.15)
    # The nearest centres match first.
    boxes = [[100.0, 100, 160, 160], [130.0, 100, 190, 160]]
    first = [[120.0, 100, 180, 160], [131.0, 100, 191, 160]]  # the first is nearer to the second boat too
    labelled = of_boats(images(1), truth([0, 0], [0, 0], boxes), found([0, 0], [0, 0], first, [np.nan, np.nan]))
    assert match(labelled, Rule("centre"), 0.5).annotation.tolist() == [0, 1]


def test_options_that_need_confidences_and_scales_that_are_none_are_refused(mot, tmp_path):
    none, given = mot("none", -1), mot("all", 0.7)
    scales = ((given, "--confidence-scale", text, "must be LOW,HIGH, two numbers that rise, as 0,100")
              for text in ("5", "3,2", "1,1", "a,b", "0,inf"))  # fmt: skip
    for path, option, value, problem in (
        (none, "--match", "confidence", "needs confidences, and the detections have none .-1.: give --match optimal"),
        (none, "--confidence", "0.5", "--confidence 0.5 needs confidences"),
        (none, "--confidence-scale", "-2,5", "--confidence-scale: every confidence is -1, which means not given"),
        *scales,
    ):
        with pytest.raises(ModsimError, match=problem):
            command(path, tmp_path, option, value)
    with pytest.raises(InputError, match="confidence_scale: must be two numbers that rise"):
        learn_detector(truth=given.with_stem("gt"), detections=given, confidence_scale=(3.0, 2.0))


def test_confidences_of_some_detections_alone_are_refused(mot, tmp_path):
    every = mot("all", 0.7)
    some = np.full(len(every.read_text().splitlines()), 0.7)
    some[[3, 8]] = -1
    path = mot("some", some)
    with pytest.raises(InputError) as error:
        command(path, tmp_path)
    assert list(error.value.problems) == [
        f"some.txt line {line}: has no confidence (-1), but some.txt line 1 has 0.7: give one everywhere, or nowhere"
        for line in (4, 9)
    ]
    assert "2 entries left out" in command(path, tmp_path, "--skip-bad").output
    pairs = {"truth": [path.with_stem("gt")] * 2, "detections": [mot("none", -1), every], "conditions": ["fog", "day"]}
    with pytest.raises(ModsimError, match=r"the detections of fog have no confidences \(-1\), and those of day do"):
        learn_detector(**pairs)


@pytest.mark.parametrize(("low", "high", "example"), [(-1.871, 3.249, "-1.88,3.25"), (5.0, 98.0, "0,100")])
def test_a_range_that_is_not_from_0_to_1_is_named_with_the_option_that_maps_it(low, high, example, mot, tmp_path):
    scores = np.linspace(high, low, len(mot("all", 0.7).read_text().splitlines()))
    scores[scores.size // 2] = -1 if low < -1 else scores[scores.size // 2]  # on such a scale −1 is a confidence
    path = mot("other", scores)
    with pytest.raises(InputError, match=f"confidences are from {low:g} to {high:g} here: .* {example}$"):
        command(path, tmp_path)
    result = command(path, tmp_path, "--confidence-scale", example)
    ends = [float(part) for part in example.split(",")]
    for said in (result.output, (tmp_path / "d.yaml").read_text()):
        assert f"confidences from {ends[0]:g} to {ends[1]:g} were mapped onto 0 to 1" in said
    labelled = read_pair("usual", path.with_stem("gt"), path, ReadOptions(confidence_scale=tuple(ends)))
    expected = (np.round(scores, 5) - ends[0]) / (ends[1] - ends[0])
    np.testing.assert_allclose(labelled.results.confidence, expected, atol=1e-5)


WIDTH, HEIGHT = 1920, 1080


def write_sets(folder, box, seed=0, shift_px=0.0, noise_px=2.0, stray=4):
    """COCO: two vessels in each image, detected, with as many less confident false positives as asked for."""
    rng, image = np.random.default_rng(seed), np.repeat(np.arange(FRAMES), 2)
    corner = np.array([[570, 388], [1170, 488]]) + np.cumsum(rng.normal(0, 6, (FRAMES, 2, 2)), axis=0)
    true = np.concatenate([corner, corner + np.array([60, 24])], axis=2).reshape(-1, 4)
    low = rng.uniform(0, 900, (stray * FRAMES, 2))
    false = np.hstack([low, low + rng.uniform(10, 90, low.shape)])
    seen = np.concatenate([true + rng.normal(0, noise_px, true.shape) + shift_px, false])
    of, score = np.r_[image, np.repeat(np.arange(FRAMES), stray)], np.repeat([0.9, 0.3], [len(true), len(false)])
    shots, annotations = images(FRAMES, (float(WIDTH), float(HEIGHT))), truth(image, 0 * image, true)
    files = write_coco(of_boats(shots, annotations, found(of, 0 * of, seen, score)), folder)
    rows = [row | {"bbox": [float(n) for n in box(*row["bbox"])]} for row in json.loads(files[1].read_text())]
    files[1].write_text(json.dumps(rows))
    return files


WRONG = {
    "centres": (lambda x, y, w, h: (x + w / 2, y + h / 2, w, h), "but are centre x, centre y, width, height"),
    "scaled": (lambda x, y, w, h: (x / 3, y / 3, w / 3, h / 3), "are those of an image of 640 x 360 px"),
    "from below": (lambda x, y, w, h: (x, HEIGHT - y - h, w, h), "y is counted from the lower edge of the image"),
}


@pytest.mark.parametrize(("box", "what"), WRONG.values(), ids=WRONG)
def test_boxes_in_another_form_are_named_and_nothing_is_written(tmp_path, box, what):
    truth, detections = write_sets(tmp_path, box)
    for learn in (lambda: command(detections, tmp_path), lambda: learn_detector(truth=truth, detections=detections)):
        with pytest.raises(ModsimError) as error:
            learn()
        assert f"detections {detections}:" in str(error.value) and what in str(error.value)
    assert not (tmp_path / "d.yaml").exists()


def test_right_boxes_are_read_as_they_are_and_a_pixel_off_is_remarked_where_that_is_clear(tmp_path):
    def notes(**keys):  # a real detector may have such a bias, which is learned
        return read_pair("day", *write_sets(tmp_path, lambda *box: box, **keys)).notes

    assert [notes(seed=seed) for seed in range(3)] == [()] * 3
    (note,) = notes(shift_px=1.0, noise_px=0.3)
    assert "pixels are counted from 1, must be counted from 0" in note and "such a bias" in note
    assert notes(shift_px=1.0, noise_px=5.0) == ()


SEQUENCE = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))


def test_mot_pixels_from_zero_and_frames_that_are_one_off_are_named(tmp_path):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 12, (60, 2)), axis=0) + 400

    def pair(shift_px, late, noise_px):
        seen = corner + shift_px + rng.normal(0, noise_px, corner.shape)
        files = {"gt": (corner, 2, 7, "1,1,1"), "det": (seen, 2 + late, -1, "0.9,-1,-1,-1")}
        for name, (places, first, identity, last) in files.items():
            rows = (f"{k + first},{identity},{x},{y},60,24,{last}\n" for k, (x, y) in enumerate(places))
            (tmp_path / f"{name}.txt").write_text("".join(rows))
        return read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", SEQUENCE)

    assert any("pixels are counted from 0, must be counted from 1" in note for note in pair(-1, 0, 0).notes)
    for late, noise_px in ((1, 0), (1, 2.5), (-1, 2.5)):
        said = "frames are one too high" if late > 0 else "frames count from 0"
        with pytest.raises(ModsimError, match=said):
            pair(0, late, noise_px)


def test_corners_in_yolo_are_named(tmp_path):
    for name in ("set/labels", "found"):
        (tmp_path / name).mkdir(parents=True)
    corner = np.cumsum(np.random.default_rng(1).normal(0, 8, (60, 2)), axis=0) + 300
    size = np.array([WIDTH, HEIGHT])
    for k, place in enumerate(corner):
        low, high = place / size, (place + np.array([60, 24])) / size
        true = [*(low + high) / 2, 60 / WIDTH, 24 / HEIGHT]
        (tmp_path / f"set/labels/{k}.txt").write_text(f"0 {' '.join(map(str, true))}\n")
        (tmp_path / f"found/{k}.txt").write_text(f"0 {' '.join(map(str, [*low, *high]))} 0.9\n")
    with pytest.raises(ModsimError, match="are read as centre x, centre y, width, height, but are the corners"):
        read_pair("day", tmp_path / "set", tmp_path / "found", SEQUENCE)


def test_detections_of_which_none_matches_are_refused(tmp_path):
    rng = np.random.default_rng(4)
    _, away = write_sets(tmp_path / "away", lambda x, y, w, h: (*rng.uniform(0, 300, 2), 9, 9), stray=0)
    _, right = write_sets(tmp_path / "right", lambda *box: box)
    for path, confidence, said in (
        (away, 0.2, "none of 120 detections matches any of 120 annotations"),
        (right, 0.95, r"none of 360 detections .* 0 of them have a confidence of at least 0.95"),
    ):
        with pytest.raises(ModsimError, match=said):
            command(path, tmp_path, "--confidence", confidence)
    assert not (tmp_path / "d.yaml").exists()


SLOPES = {"visibility_slope": 0.4, "size_slope": 0.06, "size_reference_px": 64}
NORMAL = {"true": {"mean": 0.8, "std": 0.1}, "false": {"mean": 0.45, "std": 0.12}}
CLIPPED = {"true": {"mean": 1.0, "std": 0.15}, "false": {"mean": 0.45, "std": 0.12}}
SKEW = {"true": {"quantiles": [0.3, 0.5, 0.8, 0.95, 0.97, 0.98]}, "false": {"mean": 0.45, "std": 0.12}}


def outside(learned: Estimates, asked: dict[str, Any]) -> dict[str, int]:
    """Asked numbers of confidence outside their intervals of 99.9 %, or without one; ends of quantiles do not count."""
    flat = {key: value for key, value in asked.items() if not isinstance(value, dict)}
    flat |= {f"{kind}.{key}": asked[kind][key] for kind in ("true", "false") for key in asked[kind]}
    for key, value in flat.items():
        if key.endswith("quantiles"):
            flat[key] = np.interp(np.linspace(0, 1, 21), np.linspace(0, 1, len(value)), value)
            flat[key][[0, 1, -2, -1]] = np.nan
    paths = {f"states.usual.confidence.{key}": value for key, value in flat.items()}
    return round_trip.outside({path: np.array(value) for path, value in paths.items()}, learned.intervals(0.999))


@pytest.fixture(scope="module")
def boats() -> LabelledSet:
    return truth_of(500, 1)


@pytest.fixture(scope="module")
def sloped(boats: LabelledSet) -> LabelledSet:
    return detected(boats, detector(NORMAL | SLOPES), 4)


@pytest.fixture(scope="module")
def learned_lasting(boats: LabelledSet) -> Estimates:
    """What is learned from confidences with slopes that persist for a second."""
    return learned_from(detected(boats, detector(NORMAL | SLOPES, persistence={"confidence_s": 1.0}), 4))


@pytest.mark.parametrize(
    ("scores", "method"),
    [(NORMAL, "provenance"), (NORMAL, "confidence"), (CLIPPED, "provenance"), (SKEW, "provenance")],
    ids=["provenance", "confidence", "many are 1", "quantiles"],
)
def test_slopes_come_back_inside_their_intervals_and_no_persistence_that_is_not_there(boats, scores, method) -> None:
    labelled = detected(boats, detector(scores | SLOPES), 4)
    if scores is CLIPPED:
        assert (labelled.results.confidence == 1).mean() > 0.15
    learned = learned_from(labelled, Rule(method))
    assert outside(learned, scores | SLOPES) == {}
    section = learned.detector()["states"]["usual"]["confidence"]
    assert section.keys() == {"true", "false", *SLOPES}
    assert parse_detector(learned.detector()).states[0].confidence.visibility_slope == section["visibility_slope"]
    assert "persistence" not in learned.detector()
    (note,) = (note for note in learned.notes if note.startswith("persistence.confidence_s: 0; "))
    assert note.endswith("includes 0")


def test_slopes_that_are_none_below_zero_or_not_shown_by_the_data_are_left_out(boats, sloped: LabelledSet) -> None:
    learned = learned_from(detected(boats, detector(NORMAL), 4))
    assert outside(learned, NORMAL) == {}
    assert learned.detector()["states"]["usual"]["confidence"].keys() == {"true", "false"}
    for key in ("visibility_slope", "size_slope"):
        (note,) = (note for note in learned.notes if note.startswith(f"states.usual.confidence.{key}: 0; "))
        assert "standard errors above 0" in note and note.endswith("needs 3.3")
    risen = replace(sloped.results, confidence=np.maximum(1.1 - sloped.results.confidence, 0.21))
    learned = learned_from(replace(sloped, results=risen))
    assert learned.detector()["states"]["usual"]["confidence"].keys() == {"true", "false"}
    assert sum("only slopes above 0 are simulated" in note for note in learned.notes) == 2
    unknown = learned_from(detected(truth_of(200, 1, hidden=False), detector(NORMAL | SLOPES), 4))
    assert "states.usual.confidence.visibility_slope: 0; visibility is not given" in unknown.notes
    assert unknown.detector()["states"]["usual"]["confidence"].keys() >= {"size_slope"}
    few = learned_from(detected(truth_of(10, 1), detector(NORMAL | SLOPES), 4))
    (note,) = (note for note in few.notes if "no slopes" in note)
    assert note.endswith("true detections of different confidence, needs 50")


def test_models_that_are_to_be_left_out_are(sloped: LabelledSet) -> None:
    section = learned_from(sloped, without=("slopes",)).detector()["states"]["usual"]["confidence"]
    assert section.keys() == {"true", "false"}
    learned = learned_from(sloped, without=("confidence", "effects", "persistence"))
    section = learned.detector()["states"]["usual"]["confidence"]
    assert section["mean"] == pytest.approx(sloped.results.confidence.mean(), abs=0.03)
    assert section.keys() == {"mean", "std"} and not learned.detector().keys() & {"dropout", "persistence"}
    assert not any("dropout" in note or "persistence.class_s" in note for note in learned.notes)


@pytest.mark.parametrize("scores", [NORMAL | SLOPES, CLIPPED, SKEW], ids=["normal", "many are 1", "quantiles"])
def test_how_long_confidence_persists_comes_back(boats: LabelledSet, learned_lasting: Estimates, scores) -> None:
    learned = learned_lasting
    if scores in (CLIPPED, SKEW):
        learned = learned_from(detected(boats, detector(scores, persistence={"confidence_s": 1.0}), 4))
    (interval,) = (each for each in learned.intervals(0.999) if each.key.path == "persistence.confidence_s")
    assert interval.low < 1.0 < interval.high < 2.0
    assert learned.detector()["persistence"].keys() == {"confidence_s"} and learned.run_s > 3
    assert outside(learned, scores) == {}


def test_a_campaign_draws_slopes_and_their_reference(learned_lasting: Estimates) -> None:
    known = LearnedUncertainty.model_validate_json(uncertainty_text(learned_lasting, ""))
    drawn = [drawn_detector(known, seed) for seed in range(3)]
    for key in ("states.usual.confidence.visibility_slope", "states.usual.confidence.size_reference_px",
                "persistence.confidence_s"):  # fmt: skip
        values = [each[f"detector.{key}"] for each in drawn]
        assert len(set(values)) == 3 and min(values) > 0


def test_the_product_limit_is_the_mean_over_what_each_bound_leaves_open() -> None:
    # Self-consistent (Efron (1967)): a bound counts as the part of the distribution below it.
    rng = np.random.default_rng(2)
    base, clipped, weights = rng.normal(size=60), rng.random(60) < 0.4, rng.integers(1, 4, 60).astype(float)
    clipped[base.argmin()] = False
    values, mass = product_limit(base, clipped, weights)
    for at in np.linspace(-2, 2, 15):
        parts = np.where(clipped, 0.0, base <= at)
        for row in np.flatnonzero(clipped):
            parts[row] = mass[values <= min(at, base[row])].sum() / mass[values <= base[row]].sum()
        assert mass[values <= at].sum() == pytest.approx((weights * parts).sum() / weights.sum(), abs=1e-12)


def test_the_curvature_of_the_fit_is_the_derivative_of_its_gradient() -> None:
    rng = np.random.default_rng(3)
    count = 40
    scores = ObservedConfidences(
        np.clip(rng.normal(0.8, 0.3, count), 0.2, 1), np.arange(count), np.zeros(count, dtype=np.int64),
        rng.uniform(0, 1, count), rng.uniform(3, 7, count), np.arange(count),
    )  # fmt: skip
    point = _Point(np.array([0.8, 0.25, 0.3, 0.05]), (scores,), (False,), SlopeForm(True, True, 6.0), 0.2)
    gradient, curvature = point.newton()
    for k, move in enumerate(1e-5 * np.eye(4)):
        ahead, behind = (replace(point, values=point.values + sign * move) for sign in (1, -1))
        np.testing.assert_allclose(-(ahead.newton()[0] - behind.newton()[0]) / 2e-5, curvature[k], rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose((ahead.likelihood() - behind.likelihood()) / 2e-5, gradient[k], rtol=1e-5, atol=1e-4)


def test_parts_of_confidence_that_things_keep_widen_its_means_and_spreads() -> None:
    rng, thing = np.random.default_rng(5), np.repeat(np.arange(2000), 10)
    values = np.sqrt(0.3) * rng.standard_normal(2000)[thing] + np.sqrt(0.7) * rng.standard_normal(20_000)
    kept, alone = Inflation.by_things(values, thing), Inflation.by_things(values, np.arange(20_000))
    assert kept.mean == pytest.approx(1 + 9 * 0.3, rel=0.1) and kept.std == pytest.approx(1 + 9 * 0.3**2, rel=0.1)
    assert alone.mean == pytest.approx(1, abs=1e-3) and Inflation.by_things(values[:5], thing[:5]) == Inflation()
