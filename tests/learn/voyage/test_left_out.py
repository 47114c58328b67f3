"""Vessels that are left out because their AIS says too little: stale, jumping, off."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d import InputError, Scene, load_scene
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.io.input_files import data_folder
from modsim3d.learn.voyage.camera_registration import with_moved_vessels
from modsim3d.learn.voyage.clock import read_reports
from modsim3d.learn.voyage.exclusions import ReportAge, stale_limit_s
from modsim3d.learn.voyage.labelled_voyage import NO_OPTIONS, VoyageOptions, labelled_voyage
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.log import Clock
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses
from tests.scene.ais.ais_builders import old_file, row, traffic_of

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


def test_a_scene_of_ais_knows_when_its_vessels_have_reported_if_it_is_not_older(scene: Scene, tmp_path: Path) -> None:
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


def test_vessels_are_left_out_while_their_ais_is_stale_jumps_or_is_off(scene: Scene, tmp_path: Path) -> None:
    """The one that lies still has reported 90 s before the fourth frame, and after it."""
    labelled = labelled_at(scene, tmp_path, [50, 200, 207, 270, 400, 700])
    for mmsi, left_out in {FRESH: (), STALE: (1, 2), JUMPING: (1, 2), OFF: (1, 2, 3, 4), LYING: ()}.items():
        assert [ignored(scene, labelled, mmsi, k) for k in range(6)] == [[k in left_out] for k in range(6)], mmsi
    said = "\n".join(labelled.notes)
    assert f"vessel '{STALE}' is left out of frames: its AIS is stale, no report within 60 s (180 s below 2 kn)" in said
    assert f"vessel '{JUMPING}' is left out of frames: its AIS is jumping in 2 of 6" in said
    assert f"vessel '{OFF}' is left out of frames: its AIS is off in 4 of 6" in said
    assert str(FRESH) not in said and str(LYING) not in said


def test_a_vessel_that_is_left_out_is_neither_missed_nor_a_false_detection(scene: Scene, tmp_path: Path) -> None:
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


def test_a_vessel_is_left_out_just_before_its_first_report_and_just_after_its_last(tmp_path: Path) -> None:
    """It goes straight on; a scene lasts as long as any vessel."""
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


def test_a_vessel_that_has_jumped_is_not_moved_on(tmp_path: Path) -> None:
    strait = load_scene("strait", steps=6)
    poses = strait.poses.poses(0, 6)
    present, places = poses.present.copy(), poses.positions_m.copy()
    present[3:, 1], places[2, 1] = False, places[1, 1] + 500.0
    jumped = replace(strait, poses=RecordedPoses(strait.poses.timestamps, Poses(present, places, poses.headings_rad)))
    known = ReportAge(jumped, None).at(jumped.times_s(0, 6))
    np.testing.assert_array_equal(known.guessed.positions_m[3:5, 1], places[[2, 2], 1])


def test_slow_vessels_have_three_minutes_and_the_limit_is_an_option(scene: Scene, tmp_path: Path) -> None:
    """Transponders of slow vessels report every three minutes; the nearest report may be before or after."""
    labelled = labelled_at(scene, tmp_path, [159, 161, 239, 241])
    assert [ignored(scene, labelled, STALE, image) for image in range(4)] == [[False], [True], [True], [False]]
    assert ignored(scene, labelled_at(scene, tmp_path, [90]), SLOW, 0) == [False]
    longer = VoyageOptions(stale_s=stale_limit_s(scene, 110))
    assert ignored(scene, labelled_at(scene, tmp_path, [200], options=longer), STALE, 0) == [False]
    shorter = VoyageOptions(stale_s=stale_limit_s(scene, 2))
    assert ignored(scene, labelled_at(scene, tmp_path, [205], options=shorter), FRESH, 0) == [True]
    with pytest.raises(InputError, match=r"--stale:\n +must be seconds above 0"):
        stale_limit_s(scene, 0)
    with pytest.raises(InputError, match=r"--stale:\n.* was not made by modsim3d ais"):
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


def test_vessels_that_overlap_by_their_positions_are_left_out_where_their_order_is_unknown(tmp_path: Path) -> None:
    """Two that lie alongside, 4 m apart and 8 m wide; they are seen, so their detections are no false positives."""
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
