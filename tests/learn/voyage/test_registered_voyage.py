"""A voyage with a wrong clock and camera, from the log to the detector file and to the scene that is written of it."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import orjson
import pytest

import modsim3d
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.wrong_camera import WRONG, Voyage
from modsim3d import InputError, ModsimError, Scene, VoyageResult, learn_voyage, load_scene, run_scene
from modsim3d.io.atomic_write import write_files
from modsim3d.learn.voyage import camera_registration
from modsim3d.learn.voyage.camera_registration import KnownMeans, RegistrationOptions, parse_known, with_moved_vessels
from modsim3d.learn.voyage.clock import noted_clock_s, read_reports
from modsim3d.learn.voyage.coverage import unmatched_stretches
from modsim3d.learn.voyage.exclusions import ReportAge
from modsim3d.learn.voyage.labelled_voyage import CameraFit, VoyageOptions, labelled_voyage, scene_files
from modsim3d.learn.voyage.log_to_scene import Correction, on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.non_ais.classification import TimeSpan, classify_unmatched
from modsim3d.learn.voyage.non_ais.linking import Behaviour
from modsim3d.learn.voyage.reference_error import ReferenceNoise
from modsim3d.learn.voyage.registration.parameters import ConfoundedGroup
from modsim3d.learn.voyage.report import delay_of, exchanges, registration_lead, registration_table, voyage_json
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.scene.ais.traffic import read_traffic
from tests.cli.bad_input.builders import Call, answer, refusal
from tests.learn.voyage import strait_logs
from tests.learn.voyage.strait_logs import REALLY, strait_scene
from tests.learn.voyage.test_learn_voyage import QUICK, WITHOUT

OPTIONS = ("--camera", "bow", "--replicates", 20, "--without", ",".join(WITHOUT))
BOW = {"camera": "bow", **QUICK}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene `strait.json` and the log `bow.csv`."""
    folder = tmp_path_factory.mktemp("strait")
    found = Voyage.of(load_scene(strait_scene(folder)), "bow", REALLY).detections(0)
    strait_logs.written(folder / "bow.csv", found.times_s[found.frame], found.boxes_px)
    return folder


@pytest.fixture(scope="module")
def learned(folder: Path) -> VoyageResult:
    return learn_voyage(folder / "strait.json", folder / "bow.csv", **BOW)


def recall(content: dict) -> float:
    return 1 - content["states"]["voyage"]["confusion"][-1][0]


def test_an_empty_stretch_outside_the_log_is_refused_before_registration(folder, tmp_path, call, monkeypatch) -> None:
    def never(*_: object) -> Correction:
        raise AssertionError("registered")

    scene, log, stretch = folder / "strait.json", folder / "bow.csv", f"{60 - REALLY['clock_s']}-59.8"
    with pytest.raises(InputError, match=r"no frame lies in it; they are from -3\.7 s to 56"):
        learn_voyage(scene, log, camera="bow", registration=never, empty=stretch)
    monkeypatch.setattr("modsim3d.learn.voyage.labelled_voyage.labelled_voyage", never)
    line = ("learn-voyage", scene, "--detections", log, "--camera", "bow", "--empty", stretch)
    assert "no frame lies in it" in " ".join(refusal(call, (*line, "--out", tmp_path / "d.yaml")).split())


def test_empty_stretches_are_by_the_clock_of_the_log_and_page_and_json_say_what_was_registered(learned):
    """The log ends 3.7 s before the scene, by its own clock; a stretch is what a user reads there."""
    observed = learned.voyage_report.classification.observed
    last = 59.8 - REALLY["clock_s"]
    assert classify_unmatched(observed, (TimeSpan(last - 0.9, last + 9),)).empty.sum() == 5
    with pytest.raises(InputError, match=r"no frame lies in it; they are from -3\.7 s to 56"):
        classify_unmatched(observed, (TimeSpan(last + 0.5, 59.8),))
    said = json.loads(orjson.dumps(voyage_json(learned.voyage_report)))
    (registration,) = said["registration"]
    parameters = {each["name"]: each for each in registration["parameters"]}
    assert parameters["yaw_deg"]["low"] < parameters["yaw_deg"]["value"] < parameters["yaw_deg"]["high"]
    assert parameters["mean_x_px"]["held"] == "mean errors are taken to be zero"
    (rates,) = said["false_positives_per_image"]
    assert rates["by_lifetimes"] is None and rates["like_vessels"] is None  # nothing lasts as vessels do
    (coverage,) = said["coverage"]
    matched, whole = np.array(coverage["matched"]), np.array(coverage["to_be_detected"])
    assert matched.shape == (len(coverage["bearings_deg"]) - 1, len(coverage["ranges_m"]) - 1)
    assert whole.sum() == learned.voyage_report.classification.observed.matched.sought.sum()
    assert matched.sum() == len(learned.voyage_report.classification.observed.matched.pairs[0])
    (registered,) = learned.registered
    found = registered.registration
    assert "registered ones, with vessels off their reports as fits them best (root" in registration_lead(registered)
    still = replace(found, values=replace(found.values, vessels=np.zeros_like(found.values.vessels)))
    assert "registered ones (root" in registration_lead(replace(registered, registration=still))
    unseen = replace(registered, registration=replace(found, rms_before_px=np.nan))
    assert "off by more than the lens shows with the scene's" in registration_lead(unseen)
    judged = learned.voyage_report.classification
    jumps = np.full_like(judged.tracklets.behaviour, Behaviour.JUMPS)
    for behaviour, said in ((judged.tracklets.behaviour * 0, "false"), (jumps, "false: moves unsteadily")):
        other = replace(judged, tracklets=replace(judged.tracklets, behaviour=behaviour))
        assert {each.what for each in unmatched_stretches(learned.voyage_report.voyage, other)} == {said}


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


def test_a_log_that_cannot_be_of_the_scene_and_a_file_that_exists_are_refused(call, folder, tmp_path):
    rows = np.loadtxt(folder / "bow.csv", delimiter=",", skiprows=1)
    times, boxes = rows[:, 0], rows[:, 1:]
    late = strait_logs.written(tmp_path / "late.csv", times + 3 * 3600, boxes)
    sizes_px = boxes[:, 2:] - boxes[:, :2]
    corners_px = np.random.default_rng(0).uniform(0, (1900, 1000) - sizes_px)
    elsewhere = strait_logs.written(tmp_path / "other.csv", times, np.column_stack([corners_px, corners_px + sizes_px]))
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
    short = strait_logs.written(tmp_path / "short.csv", np.zeros(1), np.array([[10.0, 500.0, 40.0, 520.0]]))
    with pytest.raises(InputError, match=r"^detections .*short\.csv, camera 'bow':\n +registration: too little"):
        learn_voyage(folder / "strait.json", short, camera="bow")
    # A registration may take minutes
    there = tmp_path / "d.uncertainty.json"
    there.write_text("mine")
    line = ("learn-voyage", folder / "strait.json", "--detections", folder / "none.csv", "--out", tmp_path / "d.yaml")
    refusal(call, line, f"{there} exists: use --overwrite", kept=tmp_path)


KNOWN = KnownMeans(mean_x_px=6.0, delay_s=2.0)


def write_sample(folder: Path) -> None:
    """The scene `ais` of the sample of a receiver."""
    traffic = read_traffic([Path("tests/data/ais/receiver.nmea")], Options())
    write_scene(traffic, folder / "ais", Path("benchmarks/voyages/one_label.yaml"))


def registered(scene: Scene, log: Path) -> tuple[CameraFit, tuple[str, ...]]:
    """The registration of the log's camera, and the remarks on the log."""
    read = on_scene(read_log(log), scene)
    found = RegistrationOptions(("k1",)).of(scene, read.cameras[0], read.source)
    assert found is not None
    return CameraFit(read.source, found, read.cameras[0].clock_s), read.notes


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a camera that differs from that of the scene `ais` beside it, and whose clock is late."""
    folder = tmp_path_factory.mktemp("sample")
    write_sample(folder)
    scene = folder / "ais" / "scene.yaml"
    scene.write_text(scene.read_text().replace("source: rendered", "source: analytic"))
    Voyage.of(load_scene(scene, steps=200), "shore", WRONG).write_log(0, folder / "log.csv")
    return folder / "log.csv"


@pytest.fixture(scope="module")
def first(log: Path) -> CameraFit:
    return registered(load_scene(log.parent / "ais"), log)[0]


@pytest.fixture(scope="module")
def written(log: Path, first: CameraFit) -> Path:
    """The folder with the registered scene."""
    write_files(scene_files(load_scene(log.parent / "ais"), [first], log.parent / "written"))
    return log.parent / "written"


def test_a_second_registration_finds_nothing_and_the_folder_is_a_scene_with_all_that_ais_knows(log, first, written):
    second, notes = registered(load_scene(written), log)
    assert any("s are added to its times of camera 'shore'" in note for note in notes)
    assert second.clock_s == first.registration.values["clock_s"] == pytest.approx(WRONG["clock_s"], abs=0.5)
    for estimate in second.registration.estimates:
        if not estimate.held:
            assert abs(estimate.value) < 0.02 * (estimate.high - estimate.low), estimate
    assert second.registration.rms_before_px == pytest.approx(first.registration.rms_after_px, rel=0.05)
    scene = load_scene(written)
    noted = json.loads(scene_files(scene, (), written)[written / "registration.json"])
    assert noted["cameras"]["shore"]["clock_s"] == noted_clock_s(scene.path, "shore") != 0
    with pytest.raises(ModsimError, match="camera 'shore' was registered in several logs: join them, or give one"):
        scene_files(load_scene(log.parent / "ais"), [first, first], log.parent / "twice")
    was, now = load_scene(log.parent / "ais"), load_scene(written)
    assert (now.name, now.vessel_names) == ("written", was.vessel_names)
    np.testing.assert_array_equal(now.poses.poses(0, 9).positions_m, was.poses.poses(0, 9).positions_m)
    np.testing.assert_array_equal(ReferenceNoise.of(now, 10).std, ReferenceNoise.of(was, 10).std)
    assert ReferenceNoise.of(now).reasons == ReferenceNoise.of(was).reasons
    fresh = [ReportAge(scene, read_reports(scene.path)).at(np.arange(0, 360, 7.0)).since_s for scene in (was, now)]
    np.testing.assert_array_equal(*fresh)
    assert {path.name for path in written.iterdir()} == {
        *("scene.yaml", "vessels.json", "detector.yaml", "poses.json.gz"),
        *("report.json", "report_times.json.gz", "registration.json"),
    }


LENSES = [{"hfov_deg": 50}, {"K": [[1400, 0, 960], [0, 1400, 540], [0, 0, 1]]}, {"focal_px": [1400, 1300]}]


@pytest.mark.parametrize("lens", LENSES, ids=["view", "matrix", "pixels"])
def test_the_focal_length_of_each_form_of_a_lens_is_registered(log: Path, first: CameraFit, tmp_path, lens) -> None:
    was = load_scene(log.parent / "ais", settings={f"cameras.shore.{key}": value for key, value in lens.items()})
    write_files(scene_files(was, [first], tmp_path))
    before, after = (scene.cameras[0].intrinsics.focal_px for scene in (was, load_scene(tmp_path)))
    share = 1 + first.registration.values["focal_share"]
    assert share != 1 and after == pytest.approx((share * before[0], share * before[1]))


def test_the_clock_is_added_to_a_file_beside_a_run_and_not_to_the_run_unless_its_note_is_wrong(log, written, tmp_path):
    """Whose times are the scene's own."""
    scene, run = load_scene(written), written.parent / "run"
    run_scene(load_scene(written, steps=5), run)
    for name in ("", "tracker_input_shore.jsonl", "detections_shore.json", "detections.parquet"):
        (found,) = on_scene(read_log(run / name), scene).cameras
        assert (found.clock_s, found.time_s[0]) == (0, 0), name
    shutil.copy(log, run / "log.csv")
    (found,) = on_scene(read_log(run / "log.csv"), scene).cameras
    assert found.clock_s == noted_clock_s(written / "scene.yaml", "shore")
    for text, said in (
        ("[]", r"must be a mapping with cameras \(got \[\]\)"),
        ('{"cameras": {"shore": {"clock_s": "3"}}}', r"cameras\.shore\.clock_s: must be the seconds to add"),
    ):
        (tmp_path / "registration.json").write_text(text)
        with pytest.raises(InputError, match=said):
            noted_clock_s(tmp_path / "scene.yaml", "shore")


def test_known_means_are_taken_off_and_told_and_vessels_are_where_they_were(tmp_path: Path) -> None:
    """Boxes are 6 px too far to the right, which looks like 0.24° of yaw, and reports are two seconds late, which looks
    like as much of the clock."""
    write_sample(tmp_path)
    scene = load_scene(tmp_path / "ais", source="analytic", steps=200)
    found = Voyage.of(KNOWN.scene_of(scene), "shore", {}).detections(0)
    boxes_px = found.boxes_px + np.array([6.0, 0, 6.0, 0])
    log = strait_logs.written(tmp_path / "log.csv", found.times_s[found.frame], boxes_px)
    known = labelled_voyage(on_scene(read_log(log), scene), VoyageOptions(RegistrationOptions(("k1",), known=KNOWN)))
    registration = known.registered[0].registration
    assert registration["yaw_deg"].value == pytest.approx(0, abs=0.04)
    assert registration["clock_s"].value == pytest.approx(0, abs=0.5) and registration["mean_x_px"].value == 6
    moved = known.scene.poses.poses(100, 101).positions_m
    reported = load_scene(known.scene.path).poses.poses(102, 103).positions_m
    np.testing.assert_allclose(moved, reported, atol=1e-6)
    assert "reports of vessels are taken to be 2 s late, as was given" in known.labelled.notes
    (registered,) = known.registered
    rows = {row[0]: row[-1] for row in registration_table(registered, known.scene).rows}
    assert rows["mean box error in x"] == "given as +6 px"
    assert rows["mean box error in y"] == "mean errors are taken to be zero"
    assert rows["mean delay of all reports"] == "given as +2 s" and delay_of(registered).value == 2
    files = scene_files(load_scene(known.scene.path), known.registered, Path("there"))
    noted = json.loads(files[Path("there/registration.json")])["cameras"]["shore"]
    assert noted["known"] == {"mean_x_px": 6, "delay_s": 2}
    # What looks alike is told for a step of 0.01 of shares and coefficients, and for one unit of all others.
    held = {"k1": (("focal_share", -0.08), ("yaw_deg", 2.0)), "mean_x_px": (("yaw_deg", -0.04),)}
    groups = tuple(ConfoundedGroup(*each) for each in held.items())
    assert exchanges(replace(registration, groups=groups)) == [
        "lens distortion k1 is held; +0.01 of it would look like -0.08 % of focal length, +0.02° of yaw of the camera",
        "mean box error in x is held; +1 px of it would look like -0.04° of yaw of the camera",
    ]


def test_antennas_and_delays_are_taken_off_again_and_vessels_without_offsets_stay(strait: Scene) -> None:
    reported, wrong = as_reported(strait, 0, AisErrors(along_m=3.0, across_m=1.0, delay_s=0.5))
    scenes = strait, reported, with_moved_vessels(reported, wrong)
    true, off, back = (each.poses.poses(0, strait.steps).positions_m[8:-8, :, :2] for each in scenes)
    assert np.abs(off - true).max() > 3 and np.abs(back - true).max() < 0.05
    assert with_moved_vessels(strait, np.zeros((len(strait.vessels), 3))) is strait


def test_names_and_values_are_read_and_what_is_no_mean_is_refused() -> None:
    assert parse_known("mean_x=1.5, mean_height=-0.02,delay=2") == KnownMeans(1.5, None, None, -0.02, 2)
    assert parse_known({"delay": 3}) == KnownMeans(delay_s=3)
    assert parse_known(None) == KnownMeans()
    for text, said in (
        ("", "must be NAME=VALUE,..., such as mean_x=1.5,delay=2, with the names mean_x, mean_y, mean_width"),
        ("mean_x", "(got 'mean_x')"),
        ("mean_z=1", "no mean 'mean_z' (did you mean 'mean_y'?)"),
        ("yaw=1", "no mean 'yaw' (known: mean_x, mean_y, mean_width, mean_height, delay)"),
        ("delay=1,delay=2", "delay: is given twice"),
        ("delay=soon", "delay: must be a number (got 'soon')"),
        ("mean_width=-1", "mean_width: must be a share above -1 and below 1, such as 0.02 (got '-1')"),
        ("mean_x=inf", "mean_x: must be a number (got 'inf')"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            parse_known(text)
    with pytest.raises(InputError, match=r"fixed=.all. leaves out"):
        camera_registration.check_known(KnownMeans(mean_x_px=1), ("all",))
    camera_registration.check_known(KnownMeans(delay_s=1), ("all",))
