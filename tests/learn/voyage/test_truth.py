"""The truth of a scene at the times of a log."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d import InputError, Scene, load_scene
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.voyage.attitude import Sampler, read_attitude
from modsim3d.learn.voyage.clock import within_scene
from modsim3d.learn.voyage.labelled_voyage import VoyageOptions, camera_truth, labelled_voyage
from modsim3d.learn.voyage.log_to_scene import Correction, SceneLog, on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from tests.scenes import crossing

FRAMES_S = np.arange(5) * 0.2
HEAD = "time_s,roll_rad,pitch_rad,heading_rad\n"


@pytest.fixture(scope="module")
def log(voyage: Path, strait: Scene) -> SceneLog:
    return on_scene(read_log(voyage / "run"), strait)


def test_at_the_steps_of_a_scene_its_truth_is_that_of_a_run(log: SceneLog, labelled: LabelledSet) -> None:
    """To the last bit, with waves, meshes, obstacles, and vessels that hide each other."""
    found = labelled_voyage(log).labelled
    for mine, theirs, names in (
        (found.annotations, labelled.annotations, "image label boxes_px visible_fraction depth_m ignored crowd"),
        (found.images, labelled.images, "sizes_px sequence source time_s half_planes"),
    ):
        for name in names.split():
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    assert (found.annotations.visible_fraction < 1).any()


def test_between_two_steps_vessels_are_between_their_places(tmp_path: Path) -> None:
    crossed = load_scene(crossing(tmp_path, 40), source="analytic")
    step = float(crossed.times_s(0, 3)[1])
    found, known = Sampler(crossed).at(np.array([0, 0.25 * step, step, 1.5 * step])), crossed.motion.at(np.arange(3))
    shares = np.array([[1, 0, 0], [0.75, 0.25, 0], [0, 1, 0], [0, 0.5, 0.5]])
    expected = np.einsum("ts,svk->tvk", shares, known.poses.positions_m)
    np.testing.assert_allclose(found.poses.positions_m, expected, atol=1e-9)
    assert (np.ptp(expected, axis=0) > 0).any()
    # Headings turn along the shorter arc.
    keys = {"length_m": 10, "beam_m": 4, "air_draft_m": 3, "label": "Vessel"}
    lens = {"focal_length_m": 0.02, "pixel_size_m": [1e-5, 1e-5], "principal_point_px": [320, 240]}
    camera = lens | {"image_size_px": [640, 480], "pose": {"position_m": [-60, 0, 4]}}
    places = np.array([[[0, 0], [50, 0]], [[1, 0], [np.nan, np.nan]]])
    poses = {"positions_m": places, "headings_rad": np.array([[3.1, 0], [-3.1, np.nan]]), "time_step_s": 1.0}
    parts = {"vessels": {"a": keys, "b": keys}, "poses": poses, "cameras": {"shore": camera}, "detector": "thesis"}
    found = Sampler(Scene.from_dict(parts)).at(np.array([0.0, 0.5]))
    assert math.isclose(math.cos(found.poses.headings_rad[1, 0]), -1)
    assert found.poses.present.tolist() == [[True, True], [True, False]]


def test_a_late_clock_shows_what_was_before_and_one_that_leaves_no_frame_is_refused(voyage, strait, log, labelled):
    """The log's times are 0.4 s too small: its first frame shows the third step."""
    found = labelled_voyage(log, VoyageOptions(Correction(clock_s=0.4))).labelled
    late = labelled.annotations.boxes_px[labelled.annotations.image == 2]
    np.testing.assert_array_equal(found.annotations.boxes_px[found.annotations.image == 0], late)
    assert any("2 of 24 frames are before or after the scene" in note for note in found.notes)
    with pytest.raises(InputError, match="24 of 24 frames are before or after the scene"):
        labelled_voyage(log, VoyageOptions(Correction(clock_s=100)))
    text = r"has frames from 7200 s to 7204.6 s, and scene .* is from 0 s to 4.6 s: .* after the scene's last step"
    read = read_log(voyage / "run")
    with pytest.raises(InputError, match=text):
        on_scene(replace(read, time_s=read.time_s + 7200), strait)


CHANGES = {"pitch_deg": 1.5, "yaw_deg": 2, "roll_deg": 3, "height_m": 1, "focal_share": 0.02, "k1": -0.05}


@pytest.mark.parametrize("name", CHANGES)
def test_a_camera_that_is_changed_sees_what_such_a_camera_sees(tmp_path: Path, name: str) -> None:
    correction, path = Correction(**{name: CHANGES[name]}), crossing(tmp_path, 5)
    scene = load_scene(path, source="analytic")
    (camera,), times = scene.cameras, scene.times_s(0, 5)
    assert camera.mount.vessel is None
    lens = scene.copy.document["cameras"][camera.name]
    w1, w2, w3 = camera.mount.position_m
    turns = {
        f"{axis}_rad": getattr(camera.mount, f"{axis}_rad") + math.radians(getattr(correction, f"{axis}_deg"))
        for axis in ("roll", "pitch", "yaw")
    }
    settings = {
        f"cameras.{camera.name}.pose": {"position_m": [w1, w2, w3 + correction.height_m], **turns},
        f"cameras.{camera.name}.focal_length_m": lens["focal_length_m"] * (1 + correction.focal_share),
        f"cameras.{camera.name}.distortion": {"k1": correction.k1},
    }
    other = load_scene(path, source="analytic", settings=settings)
    found, expected, usual = (
        camera_truth(of, 0, eye, times, None)
        for of, eye in ((scene, correction.camera(camera)), (other, other.cameras[0]), (scene, camera))
    )
    np.testing.assert_allclose(found.truth.full_boxes_px, expected.truth.full_boxes_px, atol=1e-6)
    np.testing.assert_allclose(found.half_planes, expected.half_planes, atol=1e-9)
    assert np.abs(found.truth.full_boxes_px - usual.truth.full_boxes_px).max() > 0.5


def test_a_clock_that_is_off_by_less_than_half_a_frame_loses_no_frame_and_others_are_left_out() -> None:
    times_s, inside = within_scene(FRAMES_S, -0.0007, 0.8)
    assert inside.all() and times_s[0] == 0
    np.testing.assert_allclose(times_s[1:], FRAMES_S[1:] - 0.0007)
    late_s, inside = within_scene(FRAMES_S, 0.05, 0.8)
    assert inside.all() and late_s[-1] == 0.8
    # Of frames every 0.02 s, 0.011 s is more than half; without a registered clock all that are outside are left out.
    for frames_s, clock_s in ((FRAMES_S, -0.15), (FRAMES_S * 0.1, -0.011), (FRAMES_S - 0.01, 0.0)):
        assert within_scene(frames_s, clock_s, 0.8)[1].tolist() == [False, True, True, True, True]
    assert within_scene(FRAMES_S - 1e-9, 0.0, 0.8)[1].all()


def test_a_measured_attitude_takes_the_place_of_waves(voyage: Path, strait: Scene) -> None:
    """The exported attitude on a calm sea looks the same way as the waves that it is of."""
    calm = load_scene("strait", steps=24, settings={"waves.level": "none"})
    attitude = read_attitude(voyage / "csv" / "ownship.csv", calm)
    assert attitude.vessel == "own"
    times = strait.times_s(0, 24)
    rough, mine, still = (
        scene.camera_poses(scene.cameras[0], Sampler(scene, measured).at(times), np.arange(24)).camera_R_world
        for scene, measured in ((strait, None), (calm, attitude), (calm, None))
    )
    np.testing.assert_allclose(mine, rough, atol=1e-7)
    assert np.abs(still - rough).max() > 1e-3
    parquet = read_attitude(voyage / "run" / "ownship.parquet", calm)
    np.testing.assert_allclose(parquet.angles_rad, attitude.angles_rad, atol=1e-7)


def test_the_yaw_of_an_attitude_is_added_to_its_heading_which_may_go_on_counting(strait: Scene, tmp_path: Path) -> None:
    """As that of a vessel that goes in circles does, in a run and in recorders."""
    path, turns = tmp_path / "attitude.csv", 20 * math.pi
    for rows, heading, expected in (
        (f"{HEAD.strip()},yaw_rad\n0,0,0,0,0.1\n1,0,0,0,0.3\n", -3.0, 3.2 - 2 * math.pi),
        (f"{HEAD}0,0,0,{turns + 0.1}\n1,0,0,{turns + 0.3}\n", 0.0, 0.2),
    ):
        path.write_text(rows)
        found = read_attitude(path, strait).at(np.array([0.5]), np.array([heading]))
        assert found.round(9).tolist() == [[0, 0, round(expected, 9)]]
    path.write_text(HEAD + "".join(f"{k / 2:g},0,0,0\n" for k in range(46)))  # far longer than the scene
    assert len(read_attitude(path, strait).time_s) == 46


def test_frames_without_attitude_are_left_out(log: SceneLog, tmp_path: Path) -> None:
    path = tmp_path / "attitude.csv"
    path.write_text(HEAD + "".join(f"{time},0,0.01,0.02\n" for time in (1, 1.5, 2, 4.2, 4.6)))
    found = labelled_voyage(log, VoyageOptions(attitude=read_attitude(path, log.scene))).labelled
    bow = found.images.sequence == 0
    np.testing.assert_allclose(found.images.time_s[bow], [1, 1.2, 1.4, 1.6, 1.8, 2, 4.2, 4.4, 4.6])
    assert "camera 'bow': 15 frames without attitude are left out" in found.notes
    assert "camera 'quay' is not on board 'own', so the attitude is not used for it" in found.notes


WRONG = {
    "columns": ("time_s,roll_rad\n0,1\n", "the columns pitch_rad, heading_rad are missing"),
    "a number": (f"{HEAD}0,1,0,3\n1,x,0,3\n", "line 3: roll_rad must be a number"),
    "the order": (f"{HEAD}1,1,2,3\n0,1,2,3\n", "line 3: its time must be later than"),
    "one row": (f"{HEAD}1,1,2,3\n", r"at least two rows are needed \(got 1\)"),
    "degrees": (f"{HEAD}0,1,0,3\n1,2.5,0,190\n", r"line 3: .* \(got 2.5, 0, 190\): are these"),
    "degrees of headings": (
        f"{HEAD}0,1,0,350\n1,1,0,353.5\n",
        r"line 3: .* must be in radians \(got 1, 0, 353.5\): are these degrees",
    ),
    "degrees of a steady heading": (
        f"{HEAD}0,1,0,190\n1,1,0,190.2\n",
        r"its headings are 92° off those of 'own' in .*: heading_rad counts .*, in radians: are these degrees",
    ),
    "milliseconds": (
        HEAD + "".join(f"{k * 100:g},0,0,0\n" for k in range(46)),
        r"98% of its rows are after .*, of 4.6 s: they seem to be milliseconds",
    ),
    "another day": (f"{HEAD}90000,0,0,0\n90001,0,0,0\n", "its rows are from 90000 s to"),
    "compass": (
        f"{HEAD}0,0,0,1.57\n1,0,0,1.57\n",
        r"its headings are 90° off those of 'own' in .*: heading_rad counts counter-clockwise from w1",
    ),
    "the vessel": ("vessel,time_s,roll_rad,pitch_rad,heading_rad\nowl,0,1,2,3\n", "no row of own"),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG)
def test_a_wrong_attitude_is_refused(strait: Scene, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "attitude.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_attitude(tmp_path / "attitude.csv", strait)
