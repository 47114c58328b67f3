import json
import re
from dataclasses import replace
from typing import Any, cast, get_args

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import modsim3d
from modsim3d import ModsimError, open_run, verify_run
from modsim3d.cli.main import app
from modsim3d.core.errors import InputError
from modsim3d.detector.chain import MODELS, DetectorPart
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS, PerImage
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.file.schema_models import DropoutSection
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.bootstrap import entries_of
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import LEARNERS, RICHER, LearnSettings
from modsim3d.learn.report import NearGate
from modsim3d.learn.report_page import tables
from tests.detector.test_parts import WITHOUT_LEARNER
from tests.formats.labelled_files import found, images, random_set, truth
from tests.learn import one_state, round_trip
from tests.learn.round_trip import DETECTOR, asked_of, outside, simulate


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return simulate("simulation_1", tmp_path_factory.mktemp("run"), mode=0, steps=700)


@pytest.fixture(scope="module")
def exported(run):
    folder = run.parent / "coco"
    assert "gt.json" in round_trip.command("export", run, "--format", "coco", "--out", folder).output
    return folder


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A run where what is learned is not held against what was asked for."""
    return simulate("simulation_1", tmp_path_factory.mktemp("short"), mode=0, steps=200)


def command(*parts):
    return round_trip.command("learn", *parts, "--no-check")


def test_exported_coco_is_the_run(run, exported):
    first, _ = labelled_run(run)
    again = read_coco("all", exported / "gt.json", exported / "dt.json")
    assert again.conditions == ("clear", "haze") or again.conditions == ("haze", "clear")
    names = [again.conditions[k] for k in again.images.condition]
    assert names == [first.conditions[k] for k in first.images.condition]
    np.testing.assert_array_equal(again.annotations.identity >= 0, True)
    found = first.results  # which a tracker may read: rounded, and the most confident of an image first
    order = np.lexsort((-found.confidence, found.image))
    for column in ("image", "label", "boxes_px"):
        true = getattr(again.annotations, column), getattr(first.annotations, column)
        np.testing.assert_allclose(*true, atol=1e-6)
        np.testing.assert_allclose(getattr(again.results, column), getattr(found, column)[order], atol=1.1e-3)
    np.testing.assert_array_equal(again.images.time_s, first.images.time_s)
    a, b, c = first.images.half_planes.T
    np.testing.assert_allclose(again.images.half_planes.T, [a / b, b / b, c / b], atol=2e-3)


@pytest.mark.parametrize("method", ["confidence", "optimal", "provenance"])
def test_every_number_comes_back_inside_its_interval(method, run, exported):
    labelled = labelled_run(run)[0]
    if method != "provenance":
        labelled = read_coco("all", exported / "gt.json", exported / "dt.json")
    learned = one_state.learned_by_condition(labelled, Rule(method), replicates=150)
    asked = asked_of()
    total = sum(value.size for value in asked.values())
    assert total == 90 and outside(asked, learned.intervals(1 - 0.01 / total)) == {}
    model = parse_detector(learned.detector())
    assert model.persistence.class_s > 0 and model.persistence.box_s > 0 and not model.needs_target_statistics
    # And not because they are as wide as can be.
    intervals = {each.key.path: each for each in learned.intervals(0.95)}
    for path, most in (("states.clear.box_error_std", 1.25), ("persistence.class_s", 1.7), ("persistence.box_s", 1.2)):
        assert np.all(intervals[path].high / intervals[path].low < most)


def test_the_command_writes_a_file_and_a_page_the_same_bytes_of_the_same_data(short, tmp_path):
    truth, detections = write_coco(labelled_run(short)[0], tmp_path)
    files = ["--truth", truth, "--detections", detections]
    folders = tmp_path / "first", tmp_path / "second"
    for folder in folders:
        folder.mkdir()
        out = folder / "detector.yaml"
        result = command(*files, "--time-step", 1, "--out", out, "--replicates", 40)
        assert result.exit_code == 0
    for file in ("detector.yaml", "detector.html"):
        first, second = ((folder / file).read_bytes() for folder in folders)
        assert first == second
    model = load_detector(out)
    assert {state.name for state in model.states} == {"clear", "haze"} and model.transition_interval_s == 1
    for state, share in model.stationary_shares.items():
        table = result.output.partition("States in the long run")[2].splitlines()
        row = next(line.split() for line in table if line.startswith(state))
        assert row[-1] == "%" and float(row[-2]) == pytest.approx(100 * share, abs=0.1)
    assert out.read_text().startswith("# Learned by modsim3d learn. 200 images, ")
    for title in ("Precision, recall, F1", "Box errors in pixels", "Correlation coefficients", "Confusion matrix of",
                  "points gained if corrected", "Left simple", "Never learned"):  # fmt: skip
        assert title in result.output
    page = out.with_suffix(".html").read_text()
    assert page.count("<svg") == 3 + 2 + 1 and "http" not in page
    said = page.partition('<p class="lead">')[2]
    assert said.startswith("detector.yaml: ") and "in 200 images of " in said.partition("</p>")[0]
    assert "its share of misses is known to within ±" in said
    assert "e_x in widths" in page and "e_h in heights" in page  # as the file has them


BOATS_PX = [[100.0, 100, 180, 160], [300.0, 300, 400, 380]]


def pairs_of_conditions(tmp_path, count):
    """Conditions with ever more misses."""
    rng, image, arguments = np.random.default_rng(8), np.repeat(np.arange(60), 2), []
    boxes = np.tile(BOATS_PX, (60, 1))
    for number in range(count):
        seen = rng.random(120) > 0.05 + 0.1 * number
        moved = boxes + rng.normal(0, 2, boxes.shape)
        results = found(image[seen], image[seen] * 0, moved[seen], 0.5 + rng.random(sum(seen)) / 2)
        labelled = one_state.of_boats(images(60), truth(image, image * 0, boxes), results, f"c{number}")
        arguments += options_of(labelled, tmp_path)
    return arguments


def options_of(labelled, folder):
    """Options that learn from a set of one condition."""
    (name,) = labelled.conditions
    truth, detections = write_coco(labelled, folder / name)
    return ["--condition", name, "--truth", truth, "--detections", detections]


def test_what_was_left_out_is_remarked_in_every_place(tmp_path):
    arguments = pairs_of_conditions(tmp_path, 1)
    results = json.loads(arguments[5].read_text())
    arguments[5].write_text(json.dumps([*results, {"image_id": 99999}]))
    result = command(*arguments, "--skip-bad", "--out", tmp_path / "d.yaml", "--replicates", 20)
    for text in (result.output, (tmp_path / "d.yaml").read_text(), (tmp_path / "d.html").read_text()):
        assert "1 entries left out, the first because" in text
    assert "Left simple: det" not in (tmp_path / "d.yaml").read_text()


def test_states_from_conditions_and_from_clusters(tmp_path):
    out, arguments = tmp_path / "d.yaml", pairs_of_conditions(tmp_path, 4)
    named = command(*arguments, "--states", "good=c0,c1", "--states", "bad=c2", "--out", out, "--replicates", 30)
    assert "States: good = c0, c1" in out.read_text()
    model = load_detector(out)
    assert [state.name for state in model.states] == ["good", "bad"]
    assert model.transition_matrix.tolist() == [[1, 0], [0, 1]] and "had 0 transitions" in named.output
    assert "persistence: none; frames have no times" in named.output
    (tmp_path / "sequence.txt").write_text("excellent\nexcellent\nbad\n" * 10)
    command(*arguments, "--states", "3", "--sequence", tmp_path / "sequence.txt", "--time-step", 5, "--out", out,
            "--overwrite", "--replicates", 30)  # fmt: skip
    model = load_detector(out)
    assert [state.name for state in model.states] == ["excellent", "good", "bad"] and model.transition_interval_s == 5
    np.testing.assert_allclose(model.transition_matrix[:, 0], [11 / 23, 1 / 23, 11 / 23], atol=1e-7)


def test_conditions_that_no_image_has_make_no_state():
    labelled = replace(random_set(4), conditions=("all", "unseen"))
    settings = LearnSettings(replicates=20)
    assert dict(learn_detector(labelled, settings, LearnOptions(clusters=1)).state_map.states) == {"usual": ("all",)}
    with pytest.raises(InputError, match="there are only 1 conditions"):
        learn_detector(labelled, settings, LearnOptions(clusters=2))


def test_intervals_rest_on_the_images_of_their_own_state_whatever_its_name():
    labelled, states = random_set(4, image_count=40), np.repeat([0, 1], [30, 10])
    observed = (one_state.observed_as(labelled, names, states) for names in (("day", "night"), ("all", "all.night")))
    plain, dotted = (one_state.learned_in(each).intervals(0.95) for each in observed)
    for first, second in zip(plain, dotted, strict=True):
        assert first.key.names == second.key.names
        np.testing.assert_array_equal((first.low, first.high), (second.low, second.high))
    assert {each.key.state for each in dotted} == {"all", "all.night", None}


def test_what_does_not_fit_together_is_refused(tmp_path):
    arguments = pairs_of_conditions(tmp_path, 2)
    empty, nothing = tmp_path / "empty.json", tmp_path / "nothing.json"
    empty.write_text(json.dumps({"images": [], "annotations": [], "categories": [{"id": 1, "name": "boat"}]}))
    nothing.write_text("[]")
    horizon = r"--horizon:\n  must be ROW, or X1,Y1,X2,Y2, in pixels, as 400 \(got 'far'\)"
    for error, message, parts in (
        (ModsimError, "nothing to learn from", ()),
        (ModsimError, "1 of truth and 0 of detections are given", ("--truth", arguments[3])),
        (ModsimError, "1 conditions are named for 2 pairs", arguments[2:]),
        (ModsimError, "--states 2: must be NAME=CONDITION", (*arguments, "--states", "a=c0", "--states", 2)),
        (ModsimError, "needs simulated runs", (*arguments, "--match", "provenance")),
        (InputError, "must be W,H in pixels", (*arguments, "--image-size", "big")),
        (InputError, horizon, (*arguments, "--horizon", "far")),
        (InputError, r"--horizon:\n  lies below images", (*arguments, "--horizon", "1e5")),
        (InputError, "most_distance_px: must be above 0", (*arguments, "--match", "centre:-1")),
        (ModsimError, "no annotation is there", ("--truth", empty, "--detections", nothing)),
        (InputError, r"must be some of .*persistence.* \(got 'boxes' ", (*arguments, "--without", "effects,boxes")),
    ):
        with pytest.raises(error, match=message):
            command("--out", tmp_path / "d.yaml", *parts)
    with pytest.raises(InputError, match="must be some of relative"):
        modsim3d.learn_detector(truth=arguments[3], detections=arguments[5], without=["boxes"])


def blank(count):
    """Two boats in every image, and nothing detected."""
    image = np.repeat(np.arange(count), 2)
    boxes = np.tile([[200.0, 200, 260, 260], [500.0, 500, 560, 560]], (count, 1))
    return one_state.of_boats(images(count, (800, 800)), truth(image, image * 0, boxes))


def detected_boats(std_px, count=1500):
    """The boats as a detector with such errors sees them."""
    box_error = {"unit": "px", "mean": [0] * 4, "covariance": (std_px**2 * np.eye(4)).tolist()}
    detector = one_state.detector_file(missed=0.15, false=0.1, box_error=box_error)
    return one_state.detected(blank(count), detector, seed=3)


def test_a_gate_makes_misses_and_false_detections_of_large_errors_and_leaves_the_box_errors():
    labelled = detected_boats(8.0)
    labelled = replace(labelled, results=replace(labelled.results, origin=None))
    learned = one_state.learned_in(one_state.observed_in(labelled), false_positives="calibrated")
    values = {entry.key.path: entry.estimate for entry in entries_of(learned.numbers)}
    assert np.abs(values["states.usual.confusion"] - [[0.85], [0.15]]).mean() > 0.02
    assert values["states.usual.false_discovery_rate"] > 0.12
    np.testing.assert_allclose(values["states.usual.box_error_std"], 8.0, atol=0.35)


def test_a_run_is_learned_by_provenance(short, tmp_path):
    result = command(short, "--match", "provenance", "--replicates", 30, "--out", tmp_path / "d.yaml")
    assert result.exit_code == 0 and "matched by provenance" in result.output
    labelled = labelled_run(short)[0]
    false = labelled.results.image[(labelled.results.origin < 0) & (labelled.results.confidence >= 0.2)]
    images, false = np.bincount(labelled.images.condition), np.bincount(labelled.images.condition[false], minlength=2)
    for state, rate in zip(labelled.conditions, false / images, strict=True):
        said = f"states.{state}.false_positives_per_image (not written)  {rate:.4g}"
        assert said in re.sub(r" {2,}", "  ", result.output)
    assert "per_image" not in (tmp_path / "d.yaml").read_text()
    assert load_detector(tmp_path / "d.yaml").transition_interval_s == 1  # the run knows


def test_a_simulation_with_the_learned_file_passes_verify_against_the_original(run, exported, tmp_path):
    files = ["--truth", exported / "gt.json", "--detections", exported / "dt.json", "--time-step", 1]
    command(*files, "--out", tmp_path / "learned.yaml", "--replicates", 20)
    # Shorter than what was learned from: verify counts the noise of the run alone, not that of learning.
    again = simulate("simulation_1", tmp_path / "again", mode=0, steps=250, seed=5, detector=tmp_path / "learned.yaml")
    verified = verify_run(open_run(again), DETECTOR).verification
    assert [verdict.parameter.name for verdict in verified.failed] == [] and len(verified.verdicts) > 80


def test_hardly_any_data_give_a_file_that_can_be_read_and_says_so(tmp_path):
    truth = {"images": [{"id": 1, "width": 640, "height": 480}]}
    truth |= {"categories": [{"id": 3, "name": "boat"}, {"id": 9, "name": "buoy"}]}
    truth |= {"annotations": [{"image_id": 1, "category_id": 3, "bbox": [10, 10, 50, 40]}]}
    results = [{"image_id": 1, "category_id": 3, "bbox": [11, 10, 50, 40], "score": 0.9}]
    for name, content in (("gt", truth), ("dt", results)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    files = ["--truth", tmp_path / "gt.json", "--detections", tmp_path / "dt.json", "--out", tmp_path / "d.yaml"]
    result = command(*files, "--replicates", 20)
    assert result.exit_code == 0 and "needs 20" in result.output
    assert not re.search(r"\b(nan|inf)\b", result.output + (tmp_path / "d.html").read_text())
    np.testing.assert_allclose(load_detector(tmp_path / "d.yaml").states[0].confusion.sum(axis=0), 1)
    assert "confusion, column buoy: found as often as the other labels" in (tmp_path / "d.yaml").read_text()


@pytest.mark.parametrize("width", [80, 130, 300])
def test_tables_fit_the_terminal_and_lose_nothing(width, tmp_path):
    arguments = pairs_of_conditions(tmp_path, 2)
    arguments[3].write_text(arguments[3].read_text().replace('"c0"', '"c [red]0"'))
    files = [*arguments, "--states", 1, "--out", tmp_path / "d.yaml", "--replicates", 20, "--no-check"]
    output = CliRunner().invoke(app, ["learn", *map(str, files)], env={"COLUMNS": str(width)}).output
    assert max(len(line) for line in output.splitlines() if not line.strip().startswith("/")) <= width
    for column in ("precision", "recall", "F-2", "FDR", "height"):
        assert column in output
    words = output.split()
    assert "[red]0" in words and "…" not in output
    assert "states.usual.box_error_mean[e_x]" in words and "transition_matrix[usual" in words


def test_the_page_has_the_labels_of_every_condition(tmp_path):
    rng, arguments = np.random.default_rng(3), []
    image, label, boxes = np.repeat(np.arange(40), 2), np.tile([0, 1], 40), np.tile(BOATS_PX, (40, 1))
    for name in ("day", "fog"):
        moved = boxes + rng.normal(0, 1, boxes.shape) * np.tile([[1.0], [6.0]], (40, 1))
        results = found(image, label, moved, np.full(80, 0.9))
        labelled = LabelledSet(("kayak", "ferry"), (name,), images(40), truth(image, label, boxes), results)
        arguments += options_of(labelled, tmp_path)
    result = command(*arguments, "--states", "all=day,fog", "--out", tmp_path / "d.yaml", "--replicates", 20)
    page = (tmp_path / "d.html").read_text()
    for group in ("day", "fog", "state all"):
        for title in ("Labels in {}:", "Confusion matrix of {}:", "Box errors in pixels by what was there, in {}<"):
            assert title.format(group) in page
    assert "Labels in day" not in result.output and "Labels in state all" in result.output
    assert "Covariances of the box errors in square pixels" in page


def test_matches_that_the_gate_cuts_off_and_labels_that_are_off_by_one_are_remarked(tmp_path):
    settings = LearnSettings(replicates=20, false_positives="calibrated")

    def remarks(std_px, method="confidence", shift=0):
        labelled = detected_boats(std_px, 700)
        results = replace(labelled.results, label=labelled.results.label + shift)
        labelled = replace(labelled, labels=("boat", "buoy"), results=results)
        return learn_detector(labelled, replace(settings, rule=Rule(method)), LearnOptions()).remarks

    assert remarks(2.0) == ()
    unknown, of_vessels, near = remarks(8.0)
    assert "of the matches have an IoU of less than 0.6" in near
    assert of_vessels.startswith("Not known: false_positives.on_vessels.lifetime_s, false_positives.on_vessels.mean, ")
    start = "Not known: states.usual.confidence.false, false_positives.size; "
    assert re.match(rf"{start}some [12]\d\d of \d\d\d false positives are boxes", unknown)
    assert remarks(8.0, "provenance") == ()
    assert "100 % of the matches have the label after" in remarks(2.0, shift=1)[0]
    moved = "In MOT, --labels can give the numbers of both files one name; in COCO, --category-offset -1 moves results"
    assert moved in remarks(2.0, shift=1)[0]
    with pytest.raises(ModsimError, match="none of 0 detections matches any of 40 annotations"):
        learn_detector(blank(20), settings, LearnOptions())


def test_a_rare_state_whose_errors_are_cut_off_is_named_though_few_matches_in_all_are_near_the_gate():
    rng, image = np.random.default_rng(3), np.repeat(np.arange(200), 2)
    haze = np.arange(200) >= 188
    boxes = np.tile([[100.0, 100, 160, 160], [300.0, 300, 360, 360]], (200, 1))
    moved = boxes + rng.normal(0, np.where(haze[image], 10, 1)[:, None], boxes.shape)
    pictures, results = replace(images(200), condition=haze.astype(int)), found(image, 0 * image, moved, [0.9] * 400)
    labelled = LabelledSet(("boat",), ("clear", "haze"), pictures, truth(image, 0 * image, boxes), results)
    settings = LearnSettings(replicates=20, false_positives="calibrated")
    unknown, remark = learn_detector(labelled, settings, LearnOptions()).remarks
    assert unknown.startswith("Not known: states.haze.confidence.false")
    assert "of the matches in haze have an IoU of less than 0.6" in remark
    (unknown,) = learn_detector(labelled, settings, LearnOptions(states=("all=clear,haze",))).remarks
    assert unknown.startswith("Not known: states.all.confidence.false, false_positives.size; some 3 of 3 false")
    states = NearGate((("clear", 0.12), ("haze", 0.34)), 0.6, "another rule cuts off less", several=True)
    assert ["in clear have" in states.remarks[0], "in haze have" in states.remarks[1]] == [True, True]
    assert "(12 % in clear, 34 % in haze)" in states.remark and states.remark.count("larger errors were cut off") == 1
    assert replace(states, shares=states.shares[:1]).remark == states.remarks[0] and NearGate().remark == ""


def test_a_run_s_operating_threshold_is_the_least_that_its_detector_claims(tmp_path):
    settings, without = {"detector.operating_threshold": 0.5}, ",".join(RICHER)
    modsim3d.run_scene(modsim3d.load_scene("strait", steps=40, settings=settings), tmp_path / "run")
    for asked, least in ((None, 0.5), (0.3, 0.5), (0.6, 0.6)):
        out, options = tmp_path / f"{asked}.yaml", ("--confidence", asked) if asked else ()
        result = command(tmp_path / "run", "--replicates", 20, "--without", without, *options, "--out", out)
        assert yaml.safe_load(out.read_text())["confidence_threshold"] == least
        assert ("operating_threshold dropped detections below 0.5" in result.output) == (least == 0.5)
    learned = modsim3d.learn_detector(run=tmp_path / "run", replicates=20, without=RICHER, check=False)
    assert learned.detector.confidence_threshold == 0.5


def estimates() -> dict[tuple[str, str], str]:
    report = learn_detector(random_set(4), LearnSettings(replicates=20), LearnOptions())
    (table,) = (each for each in tables(report) if each.title == "Models that can be learned")
    return {(row[0], row[1]): row[2] for row in table.rows}


def test_the_report_says_of_every_registered_model_and_of_no_other_whether_it_is_learned(monkeypatch) -> None:
    models = [(part, name) for part, names in MODELS.items() for name in names]
    assert estimates() == {each: "not learned" if each in WITHOUT_LEARNER else "learned" for each in models}
    assert all(set(learners) <= set(MODELS[part]) for part, learners in LEARNERS.items())
    assert set(get_args(DropoutSection.model_fields["model"].annotation)) == set(MODELS[DetectorPart.CLASS])
    monkeypatch.setitem(cast(dict[str, Any], FALSE_POSITIVE_MODELS), "fourth", PerImage())
    assert estimates()[DetectorPart.FALSE_POSITIVES, "fourth"] == "not learned"


def kept(content) -> set[str]:
    section, confidence = content["false_positives"], content["states"]["clear"]["confidence"]
    has = {"effects": "dropout" in content, "persistence": "persistence" in content, "confidence": "true" in confidence}
    has |= {"sizes": "size" in section, "places": "placement" in section}
    return {name for name, there in has.items() if there}


def test_each_model_is_left_out_by_its_name_and_without_all_it_is_the_thesis_s(run) -> None:
    every = {"effects", "persistence", "sizes", "places", "confidence"}
    # No two names are left out in the same of the cases, so each is known by where it is missing.
    quick = {"run": run, "replicates": 20, "check": False}
    for without in ((), ("effects", "places"), ("persistence", "places", "confidence"), ("sizes", "confidence")):
        assert kept(modsim3d.learn_detector(without=without, **quick).content) == every - set(without)
    content = modsim3d.learn_detector(without=RICHER, **quick).content
    assert kept(content) == set() and set(content["false_positives"]) == {"model"}
    for state in content["states"].values():
        assert state["box_error"].keys() == {"unit", "mean", "covariance"} and state["box_error"]["unit"] == "px"
        assert state["confidence"].keys() == {"mean", "std"}
