"""A voyage with a wrong clock and a wrong camera, from the log to the detector file."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import orjson
import pytest

import modsim3d
from benchmarks.voyages.wrong_camera import Voyage
from modsim3d import InputError, VoyageResult, learn_voyage, load_scene
from modsim3d.learn.voyage import labelled_voyage
from modsim3d.learn.voyage.coverage import unmatched_stretches
from modsim3d.learn.voyage.log_to_scene import Correction
from modsim3d.learn.voyage.non_ais.classification import TimeSpan, classify_unmatched
from modsim3d.learn.voyage.non_ais.linking import Behaviour
from modsim3d.learn.voyage.report import registration_lead, voyage_json
from tests.cli.bad_input.builders import Call, answer, refusal
from tests.learn.voyage.strait_logs import REALLY, strait_scene, written
from tests.learn.voyage.test_learn_voyage import QUICK, WITHOUT

OPTIONS = ("--camera", "bow", "--replicates", 20, "--without", ",".join(WITHOUT))
BOW = {"camera": "bow", **QUICK}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene `strait.json` and the log `bow.csv`."""
    folder = tmp_path_factory.mktemp("strait")
    found = Voyage.of(load_scene(strait_scene(folder)), "bow", REALLY).detections(0)
    written(folder / "bow.csv", found.times_s[found.frame], found.boxes_px)
    return folder


@pytest.fixture(scope="module")
def learned(folder: Path) -> VoyageResult:
    return learn_voyage(folder / "strait.json", folder / "bow.csv", **BOW)


def recall(content: dict) -> float:
    return 1 - content["states"]["voyage"]["confusion"][-1][0]


def test_empty_stretches_are_by_the_clock_of_the_log(learned: VoyageResult) -> None:
    """The log ends 3.7 s before the scene, by its own clock; a stretch is what a user reads there."""
    observed = learned.told.judged.observed
    last = 59.8 - REALLY["clock_s"]
    assert classify_unmatched(observed, (TimeSpan(last - 0.9, last + 9),)).empty.sum() == 5
    with pytest.raises(InputError, match=r"no frame lies in it; they are from -3\.7 s to 56"):
        classify_unmatched(observed, (TimeSpan(last + 0.5, 59.8),))


def test_an_empty_stretch_outside_the_log_is_refused_before_registration(folder, tmp_path, call, monkeypatch) -> None:
    def never(*_: object) -> Correction:
        raise AssertionError("registered")

    scene, log, stretch = folder / "strait.json", folder / "bow.csv", f"{60 - REALLY['clock_s']}-59.8"
    with pytest.raises(InputError, match=r"no frame lies in it; they are from -3\.7 s to 56"):
        learn_voyage(scene, log, camera="bow", registration=never, empty=stretch)
    monkeypatch.setattr(labelled_voyage, "labelled_voyage", never)
    line = ("learn-voyage", scene, "--detections", log, "--camera", "bow", "--empty", stretch)
    assert "no frame lies in it" in " ".join(refusal(call, (*line, "--out", tmp_path / "d.yaml")).split())


def test_json_and_page_say_what_was_registered_covered_and_false_and_what_residuals_rest_on(learned) -> None:
    said = json.loads(orjson.dumps(voyage_json(learned.told)))
    (registration,) = said["registration"]
    parameters = {each["name"]: each for each in registration["parameters"]}
    assert parameters["yaw_deg"]["low"] < parameters["yaw_deg"]["value"] < parameters["yaw_deg"]["high"]
    assert parameters["mean_x_px"]["held"] == "mean errors are taken to be zero"
    (rates,) = said["false_positives_per_image"]
    assert rates["by_lifetimes"] is None and rates["like_vessels"] is None  # nothing lasts as vessels do
    (coverage,) = said["coverage"]
    matched, whole = np.array(coverage["matched"]), np.array(coverage["to_be_detected"])
    assert matched.shape == (len(coverage["bearings_deg"]) - 1, len(coverage["ranges_m"]) - 1)
    assert whole.sum() == learned.told.judged.observed.matched.sought.sum()
    assert matched.sum() == len(learned.told.judged.observed.matched.pairs[0])
    (registered,) = learned.registered
    found = registered.registration
    assert "registered ones, with vessels off their reports as fits them best (root" in registration_lead(registered)
    still = replace(found, values=replace(found.values, vessels=np.zeros_like(found.values.vessels)))
    assert "registered ones (root" in registration_lead(replace(registered, registration=still))
    unseen = replace(registered, registration=replace(found, rms_before_px=np.nan))
    assert "off by more than the lens shows with the scene's" in registration_lead(unseen)
    judged = learned.told.judged
    jumps = np.full_like(judged.things.behaviour, Behaviour.JUMPS)
    for behaviour, said in ((judged.things.behaviour * 0, "false"), (jumps, "false: moves unsteadily")):
        other = replace(judged, things=replace(judged.things, behaviour=behaviour))
        assert {each.what for each in unmatched_stretches(learned.told.voyage, other)} == {said}


def test_the_detector_is_learned_back_and_is_visibly_worse_without_registration(folder, learned) -> None:
    known, wrong = (
        learn_voyage(folder / "strait.json", folder / "bow.csv", **BOW, **given).content
        for given in ({"registration": Correction(**REALLY)}, {"fixed": "all"})
    )
    mine = learned.content
    assert recall(mine) == pytest.approx(recall(known), abs=0.01)
    spreads = [np.sqrt(np.diag(each["states"]["voyage"]["box_error"]["covariance"])) for each in (mine, known, wrong)]
    np.testing.assert_allclose(spreads[0], spreads[1], rtol=0.15)
    assert recall(wrong) < 0.5 < 0.8 < recall(mine) and spreads[2][0] > 3 * spreads[1][0]


def test_the_command_tells_the_registration_writes_the_page_and_the_scene(call, folder, tmp_path) -> None:
    given = (folder / "strait.json", "--detections", folder / "bow.csv", *OPTIONS, "--fixed", "roll,k1")
    out, scene = tmp_path / "detector.yaml", tmp_path / "scene"
    said = answer(call, ("learn-voyage", *given, "--out", out, "--write-scene", scene, "--empty", "0-9"))
    parts = "Camera 'bow' was registered by", "fixed by the user", "What camera 'bow' matched and missed, by range"
    for part in parts:
        assert part in " ".join(said.split())
    page = out.with_suffix(".html").read_text()
    sketches = [part.split("</svg>")[0] for part in page.split('aria-label="Frame of camera')[1:]]
    assert sketches
    for sketch in sketches:  # a title may be as wide as the sketch
        assert len(re.findall(r'<text x="[\d.]+" y="11.0"', sketch)) == 1 and "px wide</text>" in sketch
    for title in ("Registration", "What AIS does not see", "Coverage of the sea", "The longest without a match"):
        assert f">{title}</h2>" in page
    modsim3d.load_detector(out)
    (camera,) = (each for each in load_scene(scene).cameras if each.name == "bow")
    assert np.degrees(camera.mount.yaw_rad) == pytest.approx(REALLY["yaw_deg"], abs=0.1)
    assert np.degrees(camera.mount.pitch_rad) == pytest.approx(np.degrees(0.03) + REALLY["pitch_deg"], abs=0.05)
    noted = json.loads((scene / "registration.json").read_text())["cameras"]["bow"]
    assert noted["clock_s"] == pytest.approx(REALLY["clock_s"], abs=0.03)


def test_a_detector_is_no_file_of_the_written_scene(call: Call, voyage: Path, tmp_path: Path) -> None:
    scene, out = voyage / "run" / "scene" / "strait.json", tmp_path / "scene" / "scene.yaml"
    line = ("learn-voyage", scene, "--detections", voyage / "run", "--fixed", "all", "--out", out)
    said = refusal(call, (*line, "--write-scene", out.parent), kept=tmp_path)
    assert "is a file of the scene: give --out another folder or name" in " ".join(said.split())


def test_a_log_that_cannot_be_of_the_scene_is_refused_with_the_reason(call: Call, folder: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(folder / "bow.csv", delimiter=",", skiprows=1)
    times, boxes = rows[:, 0], rows[:, 1:]
    late = written(tmp_path / "late.csv", times + 3 * 3600, boxes)
    sizes_px = boxes[:, 2:] - boxes[:, :2]
    corners_px = np.random.default_rng(0).uniform(0, (1900, 1000) - sizes_px)
    elsewhere = written(tmp_path / "other.csv", times, np.column_stack([corners_px, corners_px + sizes_px]))
    astern = strait_scene(tmp_path / "astern", **{"cameras.bow.mount.yaw_rad": 1.5})
    wrong = {
        late: (folder / "strait.json", "the log is after the scene's last step, by 3.0 hours"),
        elsewhere: (folder / "strait.json", "The log may be of another place, camera or time"),
        folder / "bow.csv": (astern, "the camera looks another way than"),
    }
    for log, (scene, problem) in wrong.items():
        said = refusal(call, ("learn-voyage", scene, "--detections", log, *OPTIONS, "--out", tmp_path / "d.yaml"))
        assert problem in " ".join(said.split())
    assert not (tmp_path / "d.yaml").exists()
    # Of several logs of one camera the message says which.
    short = written(tmp_path / "short.csv", np.zeros(1), np.array([[10.0, 500.0, 40.0, 520.0]]))
    with pytest.raises(InputError, match=r"^detections .*short\.csv, camera 'bow':\n +registration: too little"):
        learn_voyage(folder / "strait.json", short, camera="bow")


def test_a_file_that_exists_is_refused_before_the_log_is_read(call: Call, folder: Path, tmp_path: Path) -> None:
    """A registration may take minutes."""
    there = tmp_path / "d.uncertainty.json"
    there.write_text("mine")
    line = ("learn-voyage", folder / "strait.json", "--detections", folder / "none.csv", "--out", tmp_path / "d.yaml")
    refusal(call, line, f"{there} exists: use --overwrite", kept=tmp_path)
