"""A scene that registration has written: every command takes it, and there is nothing left to register."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.voyages.wrong_camera import WRONG, Voyage
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.atomic_write import write_files
from modsim3d.learn.voyage.camera_registration import Registering
from modsim3d.learn.voyage.clock import noted_clock_s, read_reports
from modsim3d.learn.voyage.exclusions import ReportAge
from modsim3d.learn.voyage.labelled_voyage import Registered, scene_files
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.reference_error import TruthNoise
from modsim3d.runs.run import run_scene
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

SAMPLE = Path("tests/data/ais/receiver.nmea")
BENCHMARKS = Path("benchmarks/voyages")


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
    write_scene(read_traffic([SAMPLE], Options()), folder / "ais", BENCHMARKS / "one_label.yaml")
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


@pytest.fixture(scope="module")
def run(written: Path) -> Path:
    """A run of the registered scene."""
    run_scene(load_scene(written, steps=5), written.parent / "run")
    return written.parent / "run"


def test_a_second_registration_finds_nothing(log: Path, first: Registered, written: Path) -> None:
    second, notes = registered(load_scene(written), log)
    assert any("s are added to its times of camera 'shore'" in note for note in notes)
    assert second.clock_s == first.registration.values["clock_s"] == pytest.approx(WRONG["clock_s"], abs=0.5)
    for estimate in second.registration.estimates:
        if not estimate.held:
            assert abs(estimate.value) < 0.02 * (estimate.high - estimate.low), estimate
    assert second.registration.rms_before_px == pytest.approx(first.registration.rms_after_px, rel=0.05)


def test_a_clock_is_kept_where_a_camera_is_not_registered_again_and_two_registrations_are_refused(
    log: Path, first: Registered, written: Path
) -> None:
    scene = load_scene(written)
    noted = json.loads(scene_files(scene, (), written)[written / "registration.json"])
    assert noted["cameras"]["shore"]["clock_s"] == noted_clock_s(scene.path, "shore") != 0
    with pytest.raises(ModsimError, match="camera 'shore' was registered in several logs: join them, or give one"):
        scene_files(load_scene(log.parent / "ais"), [first, first], log.parent / "twice")


def test_the_folder_is_a_scene_with_all_that_ais_knows(log: Path, written: Path) -> None:
    was, now = load_scene(log.parent / "ais"), load_scene(written)
    assert now.name == "written"
    assert [each.name for each in now.vessels] == [each.name for each in was.vessels]
    np.testing.assert_array_equal(now.poses.poses(0, 9).positions_m, was.poses.poses(0, 9).positions_m)
    np.testing.assert_array_equal(TruthNoise.of(now, 10).std, TruthNoise.of(was, 10).std)
    assert TruthNoise.of(now).reasons == TruthNoise.of(was).reasons
    times_s = np.arange(0, 360, 7.0)
    fresh = [ReportAge(scene, read_reports(scene.path)).at(times_s).since_s for scene in (was, now)]
    np.testing.assert_array_equal(*fresh)
    assert {path.name for path in written.iterdir()} == {
        *("scene.yaml", "vessels.json", "detector.yaml", "poses.json.gz"),
        *("report.json", "report_times.json.gz", "registration.json"),
    }


def test_the_clock_is_added_to_a_file_beside_a_run_and_not_to_the_run(run: Path, log: Path, written: Path) -> None:
    """Whose times are the scene's own."""
    scene = load_scene(written)
    for name in ("", "tracker_input_shore.jsonl", "detections_shore.json", "detections.parquet"):
        (found,) = on_scene(read_log(run / name), scene).cameras
        assert (found.clock_s, found.time_s[0]) == (0, 0), name
    shutil.copy(log, run / "log.csv")
    (found,) = on_scene(read_log(run / "log.csv"), scene).cameras
    assert found.clock_s == noted_clock_s(written / "scene.yaml", "shore")


def test_a_wrong_note_of_a_clock_is_refused(tmp_path: Path) -> None:
    for text, said in (
        ("[]", r"must be a mapping with cameras \(got \[\]\)"),
        ('{"cameras": {"shore": {"clock_s": "3"}}}', r"cameras\.shore\.clock_s: must be the seconds to add"),
    ):
        (tmp_path / "registration.json").write_text(text)
        with pytest.raises(InputError, match=said):
            noted_clock_s(tmp_path / "scene.yaml", "shore")
