"""A camera before a scene from AIS: the scene that its registration has written, and means known beforehand."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.wrong_camera import WRONG, Voyage
from modsim3d import InputError, ModsimError, Scene, load_scene, run_scene
from modsim3d.io.atomic_write import write_files
from modsim3d.learn.voyage import camera_registration
from modsim3d.learn.voyage.camera_registration import KnownMeans, Registering, parse_known, with_moved_vessels
from modsim3d.learn.voyage.clock import noted_clock_s, read_reports
from modsim3d.learn.voyage.exclusions import ReportAge
from modsim3d.learn.voyage.labelled_voyage import Registered, VoyageOptions, labelled_voyage, scene_files
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.reference_error import TruthNoise
from modsim3d.learn.voyage.registration.parameters import ConfoundedGroup
from modsim3d.learn.voyage.report import delay_of, exchanges, registration_table
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.scene.ais.traffic import read_traffic
from tests.learn.voyage import strait_logs

KNOWN = KnownMeans(mean_x_px=6.0, delay_s=2.0)


def write_sample(folder: Path) -> None:
    """The scene `ais` of the sample of a receiver."""
    traffic = read_traffic([Path("tests/data/ais/receiver.nmea")], Options())
    write_scene(traffic, folder / "ais", Path("benchmarks/voyages/one_label.yaml"))


def registered(scene: Scene, log: Path) -> tuple[Registered, tuple[str, ...]]:
    """The registration of the log's camera, and the remarks on the log."""
    read = on_scene(read_log(log), scene)
    found = Registering(("k1",)).of(scene, read.cameras[0], read.source)
    assert found is not None
    return Registered(read.source, found, read.cameras[0].clock_s), read.notes


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
def first(log: Path) -> Registered:
    return registered(load_scene(log.parent / "ais"), log)[0]


@pytest.fixture(scope="module")
def written(log: Path, first: Registered) -> Path:
    """The folder with the registered scene."""
    write_files(scene_files(load_scene(log.parent / "ais"), [first], log.parent / "written"))
    return log.parent / "written"


def test_a_second_registration_finds_nothing_and_without_one_the_clock_is_kept(log, first, written) -> None:
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


def test_the_folder_is_a_scene_with_all_that_ais_knows(log: Path, written: Path) -> None:
    was, now = load_scene(log.parent / "ais"), load_scene(written)
    assert (now.name, now.vessel_names) == ("written", was.vessel_names)
    np.testing.assert_array_equal(now.poses.poses(0, 9).positions_m, was.poses.poses(0, 9).positions_m)
    np.testing.assert_array_equal(TruthNoise.of(now, 10).std, TruthNoise.of(was, 10).std)
    assert TruthNoise.of(now).reasons == TruthNoise.of(was).reasons
    fresh = [ReportAge(scene, read_reports(scene.path)).at(np.arange(0, 360, 7.0)).since_s for scene in (was, now)]
    np.testing.assert_array_equal(*fresh)
    assert {path.name for path in written.iterdir()} == {
        *("scene.yaml", "vessels.json", "detector.yaml", "poses.json.gz"),
        *("report.json", "report_times.json.gz", "registration.json"),
    }


LENSES = {
    "view": {"hfov_deg": 50},
    "matrix": {"K": [[1400, 0, 960], [0, 1400, 540], [0, 0, 1]]},
    "pixels": {"focal_px": [1400, 1300]},
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_focal_length_of_each_form_of_a_lens_is_registered(
    log: Path, first: Registered, tmp_path: Path, lens
) -> None:
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


# ---- Means that are known beforehand: given, taken off, and told ----


def test_known_means_are_taken_off_and_told_and_vessels_are_where_they_were(tmp_path: Path) -> None:
    """Boxes are 6 px too far to the right, which looks like 0.24° of yaw, and reports are two seconds late, which looks
    like as much of the clock."""
    write_sample(tmp_path)
    scene = load_scene(tmp_path / "ais", source="analytic", steps=200)
    found = Voyage.of(KNOWN.scene_of(scene), "shore", {}).detections(0)
    boxes_px = found.boxes_px + np.array([6.0, 0, 6.0, 0])
    log = strait_logs.written(tmp_path / "log.csv", found.times_s[found.frame], boxes_px)
    known = labelled_voyage(on_scene(read_log(log), scene), VoyageOptions(Registering(("k1",), known=KNOWN)))
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
    with pytest.raises(InputError, match="--fixed all leaves out"):
        camera_registration.check_known(KnownMeans(mean_x_px=1), ("all",))
    camera_registration.check_known(KnownMeans(delay_s=1), ("all",))
