"""What a session at the prompt or in a notebook shows, and the results of verifying and of learning."""

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import write_coco
from modsim3d.io.input_files import data_folder
from modsim3d.learn.learned_detector import RICHER
from modsim3d.world.poses.replay import LivePoses
from tests.command_line import call


@pytest.fixture(scope="module")
def frame(folder):
    """With a false positive and a miss."""
    for frame in modsim3d.open_run(folder).frames():
        if None in frame.detections.vessels and (frame.truth.annotated & ~frame.truth.detected).any():
            return frame


@pytest.fixture(scope="module")
def result(scene, tmp_path_factory):
    return modsim3d.run_scene(scene, tmp_path_factory.mktemp("result") / "run")


@pytest.fixture(scope="module")
def verified(folder):
    return modsim3d.verify_run(folder)


@pytest.fixture(scope="module")
def learned(folder):
    return modsim3d.learn_detector(run=folder, replicates=20)


@pytest.fixture
def shown(scene, folder, frame, result, verified, learned):
    """Every object that a user gets from the top level."""
    parts = frame.truth, frame.detections
    return [scene, scene.detector, result, modsim3d.open_run(folder), frame, *parts, verified, learned]


class Page(HTMLParser):
    """The tags of a page, and whether each is closed; its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.tags.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data + " "


def test_a_scene_is_three_lines_and_a_live_one_is_shown_without_waiting_for_its_steps(scene):
    first, second, third = repr(scene).splitlines()
    assert first.startswith(f"<Scene strait: {len(scene.vessels)} vessels (own, ferry,")
    assert first.endswith("2 cameras (bow, quay)")
    last_s = scene.times_s(29, 30)[0]
    assert second.strip() == f"30 steps in {last_s:g} s, seed 3, truth analytic, mode 2"
    states, labels = [state.name for state in scene.detector.states], scene.detector.labels
    assert third.startswith(f"  detector: {len(states)} state") and third.endswith(")>")
    assert all(name in third for name in (*states, *labels))
    assert all(len(line) < 140 for line in (first, second, third))

    def steps():
        pytest.fail("a step was waited for")
        yield

    live = replace(scene, name="<script>alert(1)</script>", poses=LivePoses(steps(), len(scene.vessels), "stream"))
    assert "steps as they arrive" in repr(live) and "steps as they arrive" in live._repr_html_()
    assert "<script" not in live._repr_html_() and "<script>" in Page(live._repr_html_()).text


def test_all_is_shown_in_few_words_with_a_notebook_table_and_a_frame_as_its_picture(shown, frame, result, monkeypatch):
    assert frame._repr_html_() is None and frame._repr_png_().startswith(b"\x89PNG")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert frame._repr_png_() is None
    text = Page(frame._repr_html_()).text
    for name in (*frame.truth.vessels, *frame.detections.labels, "false_positive", frame.camera):
        assert name in text
    for each in shown:
        text, page = repr(each), Page(each._repr_html_())
        assert text.startswith(f"<{type(each).__name__}") and text.endswith(">") and "array(" not in text
        assert len(text) < 300 + len(str(getattr(each, "folder", "")))
        assert page.open == [] and "table" in page.tags
    assert "<" not in Page(shown[0]._repr_html_()).text
    frames, truth = (modsim3d.open_run(result.folder).table(name) for name in ("frames", "truth"))
    assert f"frames {len(frames)}," in repr(result)
    assert f"detected {np.count_nonzero(truth['detected'])}," in repr(result)


INPUTS = {
    *("LogOptions", "Tracker", "Window", "CameraView", "MomentTable", "Encounter", "ManyDetections", "TrackedFrame"),
    *("ModsimError", "InputError", "OutputError", "RendererError", "RunDirectoryError"),
    *("Mean", "MeanRow", "Verdict"),  # parts of a campaign, in a line as they are
    "SearchResult",  # tests/campaign/test_search.py
}
CAMPAIGN = (
    "scene: simulation_1\nsteps: 2\nseeds: {traffic: 1}\ntrackers: [reference]\nrequire: [{score: hota, at_least: 0}]"
)


def test_every_result_prints_what_its_command_says_in_a_few_lines_and_shows_itself_in_one(
    shown, scene, folder, frame, verified, learned, tmp_path
):
    (tmp_path / "c.yaml").write_text(CAMPAIGN)
    run, campaign = modsim3d.open_run(folder), modsim3d.run_campaign(tmp_path / "c.yaml", tmp_path / "c", workers=1)
    tracked, truth = modsim3d.track_run(folder, tmp_path / "t"), modsim3d.check_truth("simulation_1", every=100)
    check, scores = modsim3d.check_scene(scene), modsim3d.score_run(folder, tmp_path / "t")
    labels = modsim3d.export(folder, tmp_path / "coco", format="coco")
    log = data_folder("scenes").parent / "tests/data/ais/danish.csv"
    boxes, conditions = frame.detections.boxes_px, {"from_condition": "night_clear", "to_condition": "foggy_clear"}
    others = [
        *(modsim3d.locate(scene, frame.camera, frame.step, boxes), modsim3d.RunRows.of(run), scene.at(frame.step)),
        *(frame.id_image(), tracked.tracks, tracked, modsim3d.report(folder, tmp_path / "r.html")),
        *(modsim3d.check_repeat(folder), modsim3d.plan_campaign("example"), modsim3d.ais(log, tmp_path / "ais")),
        modsim3d.guess_detector("vessel", tmp_path / "g.yaml", **conditions),
        modsim3d.detect_truth(labels.path, tmp_path / "d", detector="coastal", horizon=500),
        modsim3d.reproduce_run(campaign, 0, tmp_path / "again"),
    ]
    said = [
        *((check, "horizon at row"), (verified, "nothing in"), (learned, "IoU of the matches"), (truth, "UNEXPLAINED")),
        *((scores, scores.conclusion[:40]), (campaign, "hota at least 0: undecided")),
        (modsim3d.learn_from_figures({"labels": ["boat"], "precision": 0.9, "recall": 0.8}), "Assumed"),
    ]
    for each, phrase in [*((each, "") for each in [*shown, *others]), *said]:
        text, short = str(each), repr(each)
        assert phrase in text and len(text.splitlines()) <= 45 and "array(" not in text and "(name='" not in text, text
        assert short.startswith(f"<{type(each).__name__}") and len(short) < 500 and short.count("\n") < 3, short
    results = {name for name in modsim3d.__all__ if isinstance(getattr(modsim3d, name), type)} - INPUTS
    given = tuple(type(each) for each in [*shown, *others, *(each for each, _ in said)])
    assert {name for name in results if not issubclass(getattr(modsim3d, name), given)} == set()


def test_a_verified_run_tells_and_writes_its_verdicts_and_names_what_differs(verified, thesis_folder, tmp_path):
    assert verified.obeys and verified.failed == () and "obeys its detector file" in repr(verified)
    json_path, page_path = verified.write(tmp_path / "checked")
    report = json.loads(json_path.read_bytes())
    assert report["obeys"] and len(report["parameters"]) == len(verified.verdicts)
    assert page_path.name == "verify.html"
    with pytest.raises(OutputError, match="exists"):
        verified.write(tmp_path / "checked")
    verified.write(tmp_path / "checked", overwrite=True)
    path, text = tmp_path / "never_false.yaml", (data_folder("scenes") / "detectors/thesis.yaml").read_text()
    path.write_text(re.sub(r"false_discovery_rate: [0-9.]+", "false_discovery_rate: 0.9", text))
    wrong = modsim3d.verify_run(thesis_folder, detector=path)
    assert not wrong.obeys and "does NOT obey" in repr(wrong)
    first = Page(wrong._repr_html_()).text.split("verdict", 1)[1]
    assert first.index("DIFFERS") < first.index("obeys") and wrong.failed[0].parameter.name in first


def test_a_learned_detector_is_that_of_its_file_and_of_the_command(learned, folder, scene, tmp_path, monkeypatch):
    path, page = learned.write(tmp_path / "learned.yaml")
    assert page == tmp_path / "learned.html" and "<svg" in page.read_text()
    read = modsim3d.load_detector(path)
    assert read.labels == learned.detector.labels == scene.detector.labels
    for one, other in zip(read.states, learned.detector.states, strict=True):
        np.testing.assert_array_equal(one.confusion, other.confusion)
        np.testing.assert_array_equal(one.box_error.covariance, other.box_error.covariance)
    with pytest.raises(OutputError, match="exists"):
        learned.write(path)
    again = modsim3d.load_scene("strait", detector=path, steps=2, source="analytic")
    assert len(list(modsim3d.simulate_frames(again))) == 3
    out = tmp_path / "command.yaml"
    command = ["learn", folder, "--match", "provenance", "--replicates", 20, "--out", out]
    assert call(monkeypatch, *command) == 0 and path.read_bytes() == out.read_bytes()
    with pytest.raises(InputError, match="the page would be written over the detector file"):
        learned.write(tmp_path / "other.html")
    assert not (tmp_path / "other.html").exists()


def test_learning_from_a_run_goes_by_provenance_and_from_its_files_by_iou(folder, learned, tmp_path):
    assert "matched by provenance" in repr(learned)
    truth, detections = write_coco(labelled_run(folder)[0], tmp_path)
    by_iou = modsim3d.learn_detector(truth=truth, detections=[str(detections)], replicates=20, check=False)
    assert "matched by IoU at least 0.5" in repr(by_iou)
    with pytest.raises(OutputError, match="is read by this command"):
        by_iou.write(truth, overwrite=True)
    assert json.loads(truth.read_bytes())["images"]


def test_states_are_made_of_conditions_and_lost_matches_are_warned_of(thesis_folder):
    learned = modsim3d.learn_detector(run=thesis_folder, match="confidence", replicates=20, check=False)
    assert "WARNING: " in repr(learned) and "<b>Warning: " in learned._repr_html_()
    seen = set(modsim3d.open_run(thesis_folder).table("frames")["state"].to_pylist())
    assert seen < {"excellent", "good", "bad"}
    given = {"fair": ["excellent", "good", "bad"], "foul": "terrible"}
    for states, names in ((given, ["fair"]), (1, ["usual"])):  # no frame of the run is in the other
        options = {"replicates": 20, "without": RICHER, "check": False}
        learned = modsim3d.learn_detector(run=thesis_folder, states=states, **options)
        assert [state.name for state in learned.detector.states] == names


FILES = {"truth": ["a.json"], "detections": ["b.json"]}
WRONG = [  # whether a run is given, what else is, and what is said
    (True, {"match": "iou"}, "match: must be 'confidence', 'optimal', 'centre' or 'provenance' (got 'iou')"),
    (True, {"least_iou": 0}, "least_iou: must be above 0 (got 0)"),
    (True, {"replicates": 2.5}, "replicates: "),
    (True, {"seed": -1}, "seed: "),
    (True, {"confidence": "high"}, "confidence: "),
    (True, {"states": "good"}, "states: a number of states from 1, or a mapping from states to lists of conditions"),
    (True, {"states": 0}, "states: a number of states"),
    (True, {"states": {"good": [1]}}, "states: a number of states"),
    (True, {"states": {"good": ["day"]}}, "unknown condition 'day'"),
    (True, {"truth": "gt.json"}, "1 of truth and 0 of detections are given: give one pair for each condition"),
    (False, {}, "nothing to learn from: give truth and detections, or a run"),
    (False, {"truth": "a.json"}, "1 of truth and 0 of detections are given"),
    (False, FILES | {"conditions": ["x", "y"]}, "2 conditions are named for 1 pairs"),
    (False, FILES, "truth a.json: no such file or folder"),
]


@pytest.mark.parametrize(("of_run", "given", "said"), WRONG)
def test_a_wrong_argument_of_learning_is_named(folder, of_run, given, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModsimError, match=re.escape(said)):
        modsim3d.learn_detector(**({"run": folder} if of_run else {}), **given)
