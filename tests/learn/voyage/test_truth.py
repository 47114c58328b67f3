"""The truth of a scene at the times of a log, and vessels that are left out because their AIS says too little."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d import InputError, Scene, load_scene
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.io.input_files import data_folder
from modsim3d.learn.voyage.attitude import Sampler, read_attitude
from modsim3d.learn.voyage.camera_registration import with_moved_vessels
from modsim3d.learn.voyage.clock import read_reports, within_scene
from modsim3d.learn.voyage.exclusions import ReportAge, stale_limit_s
from modsim3d.learn.voyage.labelled_voyage import NO_OPTIONS, VoyageOptions, camera_truth, labelled_voyage
from modsim3d.learn.voyage.log_to_scene import Correction, SceneLog, on_scene
from modsim3d.learn.voyage.logs.log import Clock
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses
from tests.scene.ais.ais_builders import old_file, row, traffic_of
from tests.scenes import crossing

FRAMES_S = np.arange(5) * 0.2
HEAD = "time_s,roll_rad,pitch_rad,heading_rad\n"


@pytest.fixture(scope="module")
def log(voyage: Path, strait: Scene) -> SceneLog:
    return on_scene(read_log(voyage / "run"), strait)


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


def test_a_measured_attitude_takes_the_place_of_waves_and_its_yaw_is_added_to_its_heading(voyage, strait, tmp_path):
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
    # As that of a vessel that goes in circles does, in a run and in recorders
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


def test_at_the_steps_its_truth_is_that_of_a_run_and_frames_without_attitude_are_left_out(log, labelled, tmp_path):
    """To the last bit, with waves, meshes, obstacles, and vessels that hide each other."""
    found = labelled_voyage(log).labelled
    for mine, theirs, names in (
        (found.annotations, labelled.annotations, "image label boxes_px visible_fraction depth_m ignored crowd"),
        (found.images, labelled.images, "sizes_px sequence source time_s half_planes"),
    ):
        for name in names.split():
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    assert (found.annotations.visible_fraction < 1).any()
    path = tmp_path / "attitude.csv"
    path.write_text(HEAD + "".join(f"{time},0,0.01,0.02\n" for time in (1, 1.5, 2, 4.2, 4.6)))
    found = labelled_voyage(log, VoyageOptions(attitude=read_attitude(path, log.scene))).labelled
    bow = found.images.sequence == 0
    np.testing.assert_allclose(found.images.time_s[bow], [1, 1.2, 1.4, 1.6, 1.8, 2, 4.2, 4.4, 4.6])
    assert "camera 'bow': 15 frames without attitude are left out" in found.notes
    assert "camera 'quay' is not on board 'own', so the attitude is not used for it" in found.notes


TURNED = "its headings are {}° off those of 'own' in .*: heading_rad counts"
WRONG = {
    "columns": ("time_s,roll_rad\n0,1\n", "the columns pitch_rad, heading_rad are missing"),
    "a number": (f"{HEAD}0,1,0,3\n1,x,0,3\n", "line 3: roll_rad must be a number"),
    "the order": (f"{HEAD}1,1,2,3\n0,1,2,3\n", "line 3: its time must be later than"),
    "one row": (f"{HEAD}1,1,2,3\n", r"at least two rows are needed \(got 1\)"),
    "degrees": (f"{HEAD}0,1,0,3\n1,2.5,0,190\n", r"line 3: .* \(got 2.5, 0, 190\): are these"),
    "turning degrees": (f"{HEAD}0,1,0,350\n1,1,0,353.5\n", r"line 3: .*radians \(got 1, 0, 353.5\): are these degrees"),
    "steady degrees": (f"{HEAD}0,1,0,190\n1,1,0,190.2\n", TURNED.format(92) + ".*, in radians: are these degrees"),
    "milliseconds": (
        HEAD + "".join(f"{k * 100:g},0,0,0\n" for k in range(46)),
        r"98 % of its rows are after .*, of 4.6 s: they seem to be milliseconds",
    ),
    "another day": (f"{HEAD}90000,0,0,0\n90001,0,0,0\n", "its rows are from 90000 s to"),
    "compass": (f"{HEAD}0,0,0,1.57\n1,0,0,1.57\n", TURNED.format(90) + " counter-clockwise from w1"),
    "the vessel": ("vessel,time_s,roll_rad,pitch_rad,heading_rad\nowl,0,1,2,3\n", "no row of own"),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG)
def test_a_wrong_attitude_is_refused(strait: Scene, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "attitude.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_attitude(tmp_path / "attitude.csv", strait)


FRESH, STALE, OFF, JUMPING, LYING, SLOW = range(219000001, 219000007)
LAST_S, LATITUDE_M, LONGITUDE_M = 720, 111_200, 62_250
CAMERA = {"position_m": [0, 0, 30], "yaw_rad": 0}


def reports(mmsi: int, times: list[int], speed_kn: float = 3.0) -> list[str]:
    """A vessel 800 m east of the origin that goes east, each in a lane of its own."""
    latitude = 56 + 60 * (mmsi - JUMPING + 1) / LATITUDE_M
    east = 12 + (800 + 0.5144 * speed_kn * np.array(times)) / LONGITUDE_M
    return [row(time, latitude, at, speed_kn, 90, 90, mmsi, 70, 30, 8) for time, at in zip(times, east, strict=True)]


def scene_of(folder: Path, rows: list[str], **settings: object) -> Scene:
    traffic = traffic_of(old_file(folder, *rows), origin=(56.0, 12.0))
    write_scene(traffic, folder / "scene", data_folder("scenes") / "detectors" / "thesis.yaml")
    return load_scene(folder / "scene", source="analytic", settings={"cameras.shore.pose": CAMERA, **settings})


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    every, seldom = list(range(0, LAST_S + 1, 10)), list(range(0, LAST_S + 1, 180))
    rows = [
        *reports(FRESH, every),
        *reports(STALE, [time for time in every if not 100 < time < 300]),
        *reports(OFF, [time for time in every if not 100 < time < 600]),
        *reports(JUMPING, every),
        row(205, 56.4, 12.0, 2, 90, 90, JUMPING, 70, 30, 8),
        *reports(LYING, seldom, 0.0),
        *reports(SLOW, seldom, 1.0),
    ]
    return scene_of(tmp_path_factory.mktemp("ais"), rows)


def labelled_at(scene: Scene, folder: Path, times: list[int], *detections: str, options=NO_OPTIONS) -> LabelledSet:
    """The voyage with a frame at each time, and detections as rows without their scores."""
    rows = [f"2024-01-04T10:{time // 60:02d}:{time % 60:02d}Z,,,,,," for time in times]
    (folder / "log.csv").write_text("\n".join(["utc,left,top,right,bottom,label,score", *rows, *detections, ""]))
    log = read_log(folder / "log.csv")
    assert log.clock is Clock.UTC
    return labelled_voyage(on_scene(log, scene), options).labelled


def vessel(scene: Scene, mmsi: int) -> int:
    return scene.vessel_names.index(str(mmsi))


def ignored(scene: Scene, labelled: LabelledSet, mmsi: int, image: int) -> list[bool]:
    rows = labelled.annotations
    return rows.ignored[(rows.identity == vessel(scene, mmsi)) & (rows.image == image)].tolist()


def test_a_scene_of_ais_knows_when_vessels_have_reported_and_leaves_stale_ones_out(scene, tmp_path):
    found = read_reports(scene.path)
    assert found.start_s == 1704362400 and found.used_s[str(LYING)].tolist() == [0, 180, 360, 540, 720]
    assert found.jumps_s[str(JUMPING)].tolist() == [205] and not len(found.jumps_s[str(FRESH)])
    # One that was made by an older version says what it does not know.
    shutil.copytree(scene.path.parent, tmp_path / "older")
    (tmp_path / "older" / "report_times.json.gz").unlink()
    older = replace(scene, path=tmp_path / "older" / scene.path.name)
    labelled = labelled_at(older, tmp_path, [200])
    assert any("has no report times beside it" in note for note in labelled.notes)
    assert ignored(older, labelled, STALE, 0) == [False]
    # The one that lies still has reported 90 s before the fourth frame, and after it
    labelled = labelled_at(scene, tmp_path, [50, 200, 207, 270, 400, 700])
    for mmsi, left_out in {FRESH: (), STALE: (1, 2), JUMPING: (1, 2), OFF: (1, 2, 3, 4), LYING: ()}.items():
        assert [ignored(scene, labelled, mmsi, k) for k in range(6)] == [[k in left_out] for k in range(6)], mmsi
    said = "\n".join(labelled.notes)
    assert f"vessel '{STALE}' is left out of frames: its AIS is stale, no report within 60 s (180 s below 2 kn)" in said
    assert f"vessel '{JUMPING}' is left out of frames: its AIS is jumping in 2 of 6" in said
    assert f"vessel '{OFF}' is left out of frames: its AIS is off in 4 of 6" in said
    assert str(FRESH) not in said and str(LYING) not in said


def test_a_vessel_is_left_out_just_before_its_first_report_and_just_after_its_last(tmp_path: Path) -> None:
    rows = [*reports(FRESH, list(range(0, LAST_S + 1, 10))), *reports(OFF, list(range(100, 301, 10)), 20.0)]
    scene, times = scene_of(tmp_path, rows), [96, 98, 100, 101, 300, 302, 304]
    labelled = labelled_at(scene, tmp_path, times)
    there = [[], [True], [False], [False], [False], [True], []]
    assert [ignored(scene, labelled, OFF, image) for image in range(len(times))] == there
    boxes = {image: box for image, box, identity in zip(
        labelled.annotations.image.tolist(), labelled.annotations.boxes_px, labelled.annotations.identity, strict=True
    ) if identity == vessel(scene, OFF)}  # fmt: skip
    for inside, outside in ((2, 1), (4, 5)):
        assert (boxes[outside][:2] < boxes[inside][:2]).all() and (boxes[outside][2:] > boxes[inside][2:]).all()
    fresh = ReportAge(scene, None).at(np.array([98.0, 302.0]))
    ends = np.searchsorted(scene.times_s(0, scene.steps), [100, 300])
    at_ends_m = scene.poses.poses(0, scene.steps).positions_m[ends, vessel(scene, OFF), 0]
    moved_m = fresh.guessed.positions_m[:, vessel(scene, OFF), 0] - at_ends_m
    np.testing.assert_allclose(moved_m, 0.5144 * 20 * np.array([-2, 2]), rtol=0.02)
    said = "\n".join(labelled.notes)
    around = "up to 3 s before the first place that the scene has, or after the last: 2 boxes"
    assert f"1 vessel is left out of frames {around}" in said and "its AIS is" not in said


def test_a_vessel_left_out_is_neither_missed_nor_false_and_slow_ones_have_three_minutes(scene, tmp_path):
    """Detections of a stale vessel and of one that is off, both beside their straight ways, and one of nothing."""
    rows = labelled_at(scene, tmp_path, [200]).annotations
    boxes = [rows.boxes_px[rows.identity == vessel(scene, mmsi)][0] for mmsi in (STALE, OFF)]
    boxes.append(np.array([100.0, 100.0, 120.0, 110.0]))
    found = [  # the regions are some 60 m, 80 px, wider than the vessels at both sides
        f"2024-01-04T10:03:20Z,{left + 10},{(top + bottom) / 2},{left + 30},{bottom - 2},Vessel,0.9"
        for left, top, right, bottom in boxes
    ]
    assert all(right - left > 130 for left, _, right, _ in boxes[:2])
    labelled = labelled_at(scene, tmp_path, [], *found)
    matched = match(labelled, Rule())
    assert matched.counts.sum() == 1 and matched.false.tolist() == [int(np.argmin(labelled.results.boxes_px[:, 1]))]
    assert matched.sought.sum() == 3  # the fresh one, the one that lies still and the slow one
    # Transponders of slow vessels report every three minutes; the nearest report may be before or after
    labelled = labelled_at(scene, tmp_path, [159, 161, 239, 241])
    assert [ignored(scene, labelled, STALE, image) for image in range(4)] == [[False], [True], [True], [False]]
    assert ignored(scene, labelled_at(scene, tmp_path, [90]), SLOW, 0) == [False]
    longer = VoyageOptions(stale_s=stale_limit_s(scene, 110))
    assert ignored(scene, labelled_at(scene, tmp_path, [200], options=longer), STALE, 0) == [False]
    shorter = VoyageOptions(stale_s=stale_limit_s(scene, 2))
    assert ignored(scene, labelled_at(scene, tmp_path, [205], options=shorter), FRESH, 0) == [True]
    with pytest.raises(InputError, match=r"stale_s:\n +must be seconds above 0"):
        stale_limit_s(scene, 0)
    with pytest.raises(InputError, match=r"stale_s:\n.* was not made by modsim3d.ais"):
        stale_limit_s(load_scene("strait", steps=2), 90)


@pytest.mark.parametrize("moved_m", [(60, 0), (-60, 0), (0, 60), (0, -60)])
def test_a_region_covers_the_vessel_wherever_it_may_be(scene: Scene, tmp_path: Path, moved_m) -> None:
    """A hundred seconds from a report it is off by 60 m: along the line of sight, or across."""
    offsets = np.zeros((len(scene.vessels), 3))
    offsets[vessel(scene, STALE), :2] = moved_m
    ours, theirs = (
        labelled_at(each, tmp_path, [200], options=VoyageOptions(stale_s=stale_s)).annotations
        for each, stale_s in ((scene, 60), (with_moved_vessels(scene, offsets), 1e9))
    )
    (region,), (box,) = (rows.boxes_px[rows.identity == vessel(scene, STALE)] for rows in (ours, theirs))
    assert (region[:2] <= box[:2]).all() and (region[2:] >= box[2:]).all()
    assert region[3] - box[3] < 8  # and is not much larger


def test_a_vessel_that_has_jumped_is_not_moved_on_and_those_that_overlap_are_left_out(tmp_path: Path) -> None:
    strait = load_scene("strait", steps=6)
    poses = strait.poses.poses(0, 6)
    present, places = poses.present.copy(), poses.positions_m.copy()
    present[3:, 1], places[2, 1] = False, places[1, 1] + 500.0
    jumped = replace(strait, poses=RecordedPoses(strait.poses.timestamps, Poses(present, places, poses.headings_rad)))
    known = ReportAge(jumped, None).at(jumped.times_s(0, 6))
    np.testing.assert_array_equal(known.guessed.positions_m[3:5, 1], places[[2, 2], 1])
    # Two that lie alongside, 4 m apart and 8 m wide; they are seen, so their detections are no false positives
    rows = [
        row(time, 56 + north_m / LATITUDE_M, 12 + 800 / LONGITUDE_M, 0, 90, 90, mmsi, 70, 30, 8)
        for time in range(0, LAST_S + 1, 10)
        for mmsi, north_m in ((FRESH, 0.0), (STALE, 4.0), (OFF, 100.0))
    ]
    alongside = scene_of(tmp_path, rows, **{"annotation.mode": 2})
    labelled = labelled_at(alongside, tmp_path, [50, 200])
    for mmsi, left_out in ((FRESH, True), (STALE, True), (OFF, False)):
        assert [ignored(alongside, labelled, mmsi, image) for image in range(2)] == [[left_out]] * 2, mmsi
    assert np.isfinite(labelled.annotations.boxes_px).all()
    said = "\n".join(labelled.notes)
    assert f"vessel '{STALE}' is left out of frames: it overlaps another one in 2 of 2" in said and str(OFF) not in said
