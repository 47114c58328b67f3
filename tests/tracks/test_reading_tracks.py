"""Tracks from somebody's own files, and what is said of wrong ones."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from modsim3d import load_scene, track_run
from modsim3d.core.boxes import centre_form as centred
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.formats.writing.mot import files as mot_files
from modsim3d.io.input_files import data_folder
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.tracks import Tracks, camera_sequence_names
from modsim3d.tracks.true_tracks import TrueTracks
from tests.run_folders import finished
from tests.tracks.track_files import IMAGE_PX, csv_text, detected_tracks, mot_texts, scene_run, top_left, write_mot

CENTRES = "centre_x_px,centre_y_px,width_px,height_px"
HEADER = "camera,step,track,x_min_px,y_min_px,x_max_px,y_max_px"
ATTRIBUTES = "bow,0,1,10,20,30,40,"


@pytest.fixture
def read(small_run, small_rows, tmp_path):
    """Reads the text of a CSV file."""

    def read_text(text):
        (tmp_path / "mine.csv").write_text(text, encoding="utf-8")
        return read_tracks(tmp_path / "mine.csv", small_run, small_rows)

    return read_text


@pytest.fixture
def read_mot(small_run, small_rows, tmp_path):
    return lambda texts: read_tracks(write_mot(tmp_path / "mine", texts), small_run, small_rows)


def assert_close(one, other):
    np.testing.assert_array_equal(one.frame, other.frame)
    np.testing.assert_array_equal(one.track, other.track)
    np.testing.assert_allclose(one.boxes_px, other.boxes_px, atol=2e-5)


def said(call, *arguments):
    """What the error of a call says, nothing where there is none."""
    try:
        call(*arguments)
    except InputError as error:
        return str(error)
    return ""


def test_boxes_in_any_form_and_order_and_with_optional_columns_are_the_same_tracks(read, small_rows, small_tracks):
    text = csv_text(small_rows, small_tracks)
    found = read(text)
    assert (found.name, found.origin) == ("mine", None)
    head, *lines = text.splitlines()
    by_centres = csv_text(small_rows, small_tracks, centred(small_tracks.boxes_px), CENTRES)
    by_times = csv_text(small_rows, small_tracks, when="time_s")
    backwards = "\n".join([head, *reversed(lines), "", ""])
    for each in (found, read(by_centres), read(by_times), read(backwards)):
        assert_close(each.tracks, small_tracks)
    labels = small_rows.scene.detector.labels
    text = f"{HEADER},label,confidence,var_x_px2,cov_xy_px2,var_y_px2\n"
    found = read(f"{text}bow,0,1,10,20,30,40,{labels[1]},0.5,4,1,9\nbow,0,2,10,20,30,40,,,,,\n").tracks
    np.testing.assert_array_equal(found.label, [1, -1])
    np.testing.assert_array_equal(found.confidence, [0.5, np.nan])
    np.testing.assert_array_equal(found.covariance_px2, [[[4, 1], [1, 9]], np.full((2, 2), np.nan)])
    text = '\ufeff"camera", step,track ,x_min_px,y_min_px,x_max_px,y_max_px\n\n"bow", 1 ,7, 10,20,+30.5,4e1\n \n'
    for end in ("\n", "\r\n", "\r"):
        np.testing.assert_array_equal(read(text.replace("\n", end)).tracks.boxes_px, [[10, 20, 30.5, 40]])


def test_a_tracker_may_have_found_nothing_and_a_confidence_of_minus_one_is_none(read, read_mot):
    for text in (f"{HEADER}\n", HEADER, f"{HEADER}\n\n"):
        assert len(read(text).tracks) == 0
    assert len(read_mot({"bow.txt": "", "quay.txt": "\n"}).tracks) == 0
    found = read_mot({"bow.txt": "1,7,10,20,30,40,-1\n1,8,10,20,30,40,0.25\n", "quay.txt": ""}).tracks
    np.testing.assert_array_equal(found.confidence, [np.nan, 0.25])


def test_a_mot_folder_of_our_own_or_of_evaluators_has_a_file_a_camera(small_run, small_rows, small_tracks, tmp_path):
    assert np.isin(small_tracks.step[small_tracks.camera == 1], [1, 3, 5, 7]).all()  # frames are not steps
    texts = mot_texts(small_rows, small_tracks)
    plain = write_mot(tmp_path / "mine", texts)
    data = write_mot(tmp_path / "tracks" / "modsim3d-all" / "mine" / "data", texts)
    for path in (plain, data.parent, data):
        found = read_tracks(path, small_run, small_rows)
        assert found.name == "mine"
        assert_close(found.tracks, small_tracks)


def test_the_only_camera_needs_no_name(one_camera_run, tmp_path):
    rows = RunRows.of(one_camera_run)
    tracks = detected_tracks(rows)
    (text,) = mot_texts(rows, tracks).values()
    (tmp_path / "any.txt").write_text(text)
    assert_close(read_tracks(tmp_path / "any.txt", one_camera_run, rows).tracks, tracks)
    lines = [line.split(",", 1)[1] for line in csv_text(rows, tracks).splitlines()]
    (tmp_path / "any.csv").write_text("\n".join(lines))
    assert_close(read_tracks(tmp_path / "any.csv", one_camera_run, rows).tracks, tracks)


def test_sequences_have_the_names_of_the_export(small_run):
    names = camera_sequence_names([camera.name for camera in small_run.scene.cameras])
    request = ExportRequest(small_run, (0, 1), False, "measured")
    assert {f"modsim3d-all/{name}/det/det.txt" for name in names} <= set(mot_files(request))
    assert camera_sequence_names(["A_B", "a b"]) == ("A_B", "a_b-2")
    assert camera_sequence_names(["a b", "A_B", "name"]) == ("a_b", "A_B-2", "name-2")


def test_a_wrong_line_is_named(read):
    for line, what in (
        ("bov,0,1,1,2,3,4", "there is no camera 'bov' (did you mean 'bow'?)"),
        ("bow,8,1,1,2,3,4", "there is no step 8: the run has steps 0 to 7"),
        ("quay,4,1,1,2,3,4", "camera 'quay' takes no frame at step 4; the nearest is 3"),
        ("bow,-1,1,1,2,3,4", "step must be a whole number, at least 0 (got '-1')"),
        ("bow,0.5,1,1,2,3,4", "step must be a whole number, at least 0 (got '0.5')"),
        ("bow,0,boat,1,2,3,4", "track must be a number (got 'boat')"),
        ("bow,0,1.5,1,2,3,4", "track must be a whole number, at least 0 (got '1.5')"),
        ("bow,0,1e16,1,2,3,4", "track must be at most 1e15 (got '1e16')"),
        ("bow,0,1,nan,2,3,4", "x_min_px must be a number (got 'nan')"),
        ("bow,0,1,1,2,,4", "x_max_px must be a number (got '')"),
        ("bow,0,1,1,2,inf,4", "x_max_px must be a number (got 'inf')"),
        ("bow,0,1,5,2,3,4", "the box has width -2 and height 2, must be above 0"),
        ("bow,0,1,1,2,3,2", "the box has width 2 and height 0, must be above 0"),
        ("bow,0,1,9000,2,9010,4", "lies more than an image away from the image, as does all of its track; the image"),
        ("bow,0,1,1,2,3", "has 6 cells, must have 7"),
        ("bow", "has 1 cell, must have 7"),
        ("bow,0,1,1,2,3,4,5", "has 8 cells, must have 7"),
        (f"{ATTRIBUTES}submarine,0.5,4,1,9", "there is no label 'submarine'"),
        (f"{ATTRIBUTES},1.5,4,1,9", "confidence must be from 0 to 1 (got 1.5)"),
        (f"{ATTRIBUTES},,4,,9", "the covariance needs all three numbers, or none"),
        (f"{ATTRIBUTES},,4,6,9", "are no covariance"),
        (f"{ATTRIBUTES},,-4,1,-9", "are no covariance"),
    ):
        more = ",label,confidence,var_x_px2,cov_xy_px2,var_y_px2" if line.startswith(ATTRIBUTES) else ""
        message = said(read, f"{HEADER}{more}\nbow,0,7,10,20,30,40{',' * more.count(',')}\n\n{line}\n")
        assert "\n  line 4: " in message and what in message, (line, message)
    twice = said(read, f"{HEADER}\nquay,1,3,1,2,3,4\nbow,0,3,1,2,3,4\nbow,2,3,1,2,3,4\nbow,0,3,1,2,3,5\n")
    assert "line 5: track 3 is at step 0 of camera 'bow' already (line 3)" in twice
    many = said(read, "\n".join([HEADER, *["bow,x,1,1,2,3,4"] * 500]))
    assert len(many.splitlines()) == 12 and many.endswith("… and 490 more lines")


def test_wrong_columns_are_named_and_a_track_may_coast_out_of_the_image_as_far_as_it_likes(read):
    for header, what in (
        ("camera;step;track", "line 1 must name the columns, with commas between them: camera,step,track,x_min_px,"),
        ("", "line 1 must name the columns"),
        ("a" * 200_000, "line 1 must name the columns"),
        (HEADER.removeprefix("camera,"), "'camera' is missing: the run has several cameras"),
        (HEADER.replace("step,", ""), "'step' or 'time_s' is needed"),
        (HEADER.replace("track,", ""), "the column 'track' is missing"),
        ("camera,step,track,x_min_px,y_min_px,width_px,height_px", "columns of the box must be either"),
        ("camera,step,track", "columns of the box must be either"),
        (f"{HEADER},confidance", "unknown column 'confidance' (did you mean 'confidence'?)"),
        (f"{HEADER},step", "the column 'step' is there twice"),
        (f"{HEADER},var_x_px2", "belong together"),
        (HEADER.replace(",", ";"), "must have commas"),
        (f"sep=,\n{HEADER}", ": line 1 is for spreadsheets alone, leave it out"),
    ):
        assert what in said(read, f"{header}\n"), header[:100]
    lines = ["bow,0,1,10,20,30,40", "bow,1,1,9000,20,9030,40", "bow,2,1,-99000,20,-98000,40"]
    assert len(read("\n".join([HEADER, *lines])).tracks) == 3
    message = said(read, "\n".join([HEADER, *lines, "quay,1,1,9000,20,9030,40"]))
    assert "line 5: the box lies more than an image away" in message  # another camera's track 1
    assert len(message.splitlines()) == 2


def test_times_in_another_unit_are_named_and_tracks_that_fit_nothing_read_as_they_are(read, small_rows, small_tracks):
    head, *lines = csv_text(small_rows, small_tracks, when="time_s").splitlines()
    cells = [line.split(",") for line in lines]
    for unit, scale in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
        scaled = (",".join([camera, f"{float(time) * scale:.12g}", *rest]) for camera, time, *rest in cells)
        what = f"(seconds since the first step): they seem to be {unit}, must be seconds"
        assert what in said(read, "\n".join([head, *scaled])), unit
    corner = np.random.default_rng(5).uniform(0, [1800, 1000], (len(small_tracks), 2))
    found = read(csv_text(small_rows, small_tracks, np.column_stack([corner, corner + 40])))
    assert len(found.tracks) == len(small_tracks)


def test_identities_that_lost_digits_and_times_of_no_frame_are_refused(read, read_mot, small_rows, small_tracks):
    assert "line 2: track is a number in scientific notation" in said(read, f"{HEADER}\nbow,1,2.19E+08,1,1,2,3\n")
    assert read(f"{HEADER}\nbow,1,2.0E+00,1,1,2,3\n").tracks.track.tolist() == [2]
    texts = {name: re.sub(",[0-9]+,", ",2.19E+08,", text) for name, text in mot_texts(small_rows, small_tracks).items()}
    assert "identity is a number in scientific notation" in said(read_mot, texts)
    header = HEADER.replace("step", "time_s")
    time_s = small_rows.scene.times_s(0, 8)[2]
    assert read(f"{header}\nbow,{time_s + 0.0004},1,1,2,3,4\n").tracks.step.tolist() == [2]
    message = said(read, f"{header}\nbow,{time_s + 0.0006},1,1,2,3,4\n")
    assert f"line 2: camera 'bow' takes no frame at time_s 0.4006; the nearest is {time_s:g}" in message
    both = HEADER.replace("step", "step,time_s")
    assert read(f"{both}\nbow,1,0.2,1,1,2,3,4\n").tracks.step.tolist() == [1]
    assert "time_s 0.2 is that of step 1, but step is 2" in said(read, f"{both}\nbow,2,0.2,1,1,2,3,4\n")


def test_a_wrong_mot_line_is_named(read_mot):
    for line, what in (
        ("0,1,10,20,30,40,1", "frame is 0: frames count from 1"),
        ("9,1,10,20,30,40,1", "there is no frame 9: camera 'bow' has frames 1 to 8"),
        ("1,-1,10,20,30,40,1", "identity is -1, as in a file of detections"),
        ("1,1,10,20,-3,40,1", "the box has width -3 and height 40"),
        ("1,1,10,20,3,x,1", "height must be a number (got 'x')"),
        ("1,1,10,20,3,4,7", "confidence must be from 0 to 1 (got 7)"),
        ("1,1,10,20,3,4", "has 6 cells, must have 7"),
    ):
        message = said(read_mot, {"bow.txt": f"1,7,10,20,30,40,-1\n{line}\n", "quay.txt": ""})
        assert "bow.txt" in message.partition("\n")[0] and f"line 2: {what}" in message, (line, message)


def test_wrong_mot_files_and_a_path_that_is_no_tracks_are_named(small_run, small_rows, tmp_path):
    for number, (texts, what) in enumerate(
        [
            ({"bow.txt": ""}, "quay.txt is missing: a tracker that found nothing leaves an empty file"),
            ({"bow.txt": "", "quay.txt": "", "key.txt": ""}, "key.txt is of no camera of the run"),
            ({"bow-ship.txt": ""}, "bow-ship.txt is of one class"),
            ({}, "holds no tracks: neither tracks.json nor bow.txt, quay.txt"),
            ({"bow.txt": "1 2 3 4 5 6\n", "quay.txt": ""}, "at least 6 numbers with commas between them"),
        ]
    ):
        assert what in said(read_tracks, write_mot(tmp_path / str(number), texts), small_run, small_rows)
    (tmp_path / "bow.txt").write_text("")
    (tmp_path / "tracks.xml").write_text("")
    for name, what in {
        "bow.txt": "the run has 2 cameras: give the folder with bow.txt, quay.txt",
        "tracks.xml": "is none of what tracks may be",
        "none.parquet": "no such file or folder",
        "none.csv": "no such file or folder",
        "x" * 300: "File name too long",
        "a\0b": "a path cannot hold the character NUL",
    }.items():
        with pytest.raises(ModsimError, match=what):
            read_tracks(tmp_path / name, small_run, small_rows)


def half_a_box_off(boxes_px, by):
    return boxes_px + by * np.tile(boxes_px[:, 2:] - boxes_px[:, :2], 2)


def exchanged(boxes_px):
    return boxes_px[:, [1, 0, 3, 2]]


def from_below(boxes_px):
    x_min, y_min, x_max, y_max = boxes_px.T
    return np.column_stack([x_min, IMAGE_PX[1] - y_max, x_max, IMAGE_PX[1] - y_min])


def shares(boxes_px):
    return boxes_px / np.tile(IMAGE_PX, 2)


def test_boxes_in_another_form_are_recognised(read, read_mot, small_rows, small_tracks):
    for names, numbers, what in (
        (None, centred, "are read as the corners x_min, y_min, x_max, y_max, but are centre x"),
        (None, top_left, "but are the corner x, y and width, height"),
        (CENTRES, lambda boxes: boxes, "are read as centre x, centre y, width, height, but are the corners"),
        (CENTRES, top_left, "but are the corner x, y and width, height"),
        (None, shares, "the boxes are shares of the image (the corners"),
        (CENTRES, lambda boxes: shares(centred(boxes)), "the boxes are shares of the image (centre x"),
        (None, lambda boxes: boxes / 1.5, "are those of an image of 1280 x 720 px"),
        (None, lambda boxes: boxes * 2, "are those of an image of 3840 x 2160 px"),
        (None, lambda boxes: shares(boxes) * 640, "are those of an image of 640 x 640 px"),
        (None, lambda boxes: half_a_box_off(boxes, 0.5), "half a box too far right and down"),
        (None, lambda boxes: half_a_box_off(boxes, -0.5), "half a box too far left and up"),
        (None, exchanged, "x and y of the boxes are exchanged"),
        (None, from_below, "y is counted from the lower edge of the image"),
        (CENTRES, lambda boxes: exchanged(centred(boxes)), "x and y of the boxes are exchanged"),
        (CENTRES, lambda boxes: centred(from_below(boxes)), "y is counted from the lower edge of the image"),
        ("MOT", lambda boxes: boxes, "are read as x, y, width, height with pixels from 1, but are the corners"),
        ("MOT", centred, "but are centre x"),
        ("MOT", lambda boxes: shares(top_left(boxes)), "the boxes are shares of the image (the corner x, y"),
        ("MOT", lambda boxes: top_left(boxes) / 4, "are those of an image of 480 x 270 px"),
        ("MOT", top_left, "pixels are counted from 0, must be counted from 1 (then half of them lie within 0.00 %"),
        ("MOT", lambda boxes: exchanged(top_left(boxes)), "x and y of the boxes are exchanged"),
        ("MOT", lambda boxes: top_left(from_below(boxes)), "y is counted from the lower edge of the image"),
    ):
        four = numbers(small_tracks.boxes_px)
        if names == "MOT":
            message = said(read_mot, mot_texts(small_rows, small_tracks, four))
        else:
            message = said(read, csv_text(small_rows, small_tracks, four, **{"names": names} if names else {}))
        assert what in message, (names, what, message)


def test_one_file_of_several_and_one_camera_of_a_csv_file_may_be_wrong(read, read_mot, small_rows, small_tracks):
    right = mot_texts(small_rows, small_tracks)
    wrong = mot_texts(small_rows, small_tracks, exchanged(top_left(small_tracks.boxes_px)))
    assert wrong["quay.txt"].count("\n") < wrong["bow.txt"].count("\n")
    message = said(read_mot, {"bow.txt": right["bow.txt"], "quay.txt": wrong["quay.txt"]})
    assert "quay.txt" in message.splitlines()[0] and "x and y of the boxes are exchanged" in message
    quay = (small_tracks.camera == 1)[:, None]
    boxes_px = np.where(quay, exchanged(small_tracks.boxes_px), small_tracks.boxes_px)
    assert quay.mean() < 0.5
    message = said(read, csv_text(small_rows, small_tracks, boxes_px))
    assert "camera 'quay': x and y of the boxes are exchanged" in message


def one_off(rows, steps):
    tracks = detected_tracks(rows)
    there = tracks.take(np.isin(tracks.step + steps, rows.frames))
    return replace(there, frame=there.frame + steps)


def test_frames_that_count_from_elsewhere_are_recognised(one_camera_run, tmp_path):
    """Also where no line has frame 0, as with trackers that report a track from its second detection on."""
    rows = RunRows.of(one_camera_run)
    tracks = detected_tracks(rows)
    late = tracks.take(tracks.step > 0)
    (frames,) = mot_texts(rows, late, first_frame=0).values()
    (shifted,) = mot_texts(rows, late, top_left(late.boxes_px), first_frame=0).values()
    zero = "frames count from 0, must count from 1"
    for name, text, what in (
        ("frames.txt", frames, zero),
        ("both.txt", shifted, f"{zero}, and pixels are counted from 0, must be counted from 1"),
        ("steps.csv", csv_text(rows, one_off(rows, -1)), "frames are one too low"),
    ):
        (tmp_path / name).write_text(text)
        assert what in said(read_tracks, tmp_path / name, one_camera_run, rows)
    # The file of a tracker with a latency of one frame is that of frames which are one too high: it is not refused.
    assert_read(one_camera_run, rows, one_off(rows, 1), tmp_path)


@pytest.fixture(scope="module")
def biased_run(tmp_path_factory):
    """A detector whose boxes are nearly exact, but lie a pixel too far left and up."""
    folder = tmp_path_factory.mktemp("biased")
    detector = yaml.safe_load((data_folder("scenes") / "detectors" / "coastal.yaml").read_text())
    for state in detector["states"].values():
        state["box_error"] = {"unit": "px", "mean": [-1, -1, 0, 0], "covariance": (np.eye(4) * 1e-4).tolist()}
    (folder / "biased.yaml").write_text(yaml.safe_dump(detector))
    return scene_run(folder / "run", "strait", seed=3, detector=folder / "biased.yaml")


def assert_read(run, rows, tracks, folder):
    (folder / "any.csv").write_text(csv_text(rows, tracks))
    assert len(read_tracks(folder / "any.csv", run, rows).tracks) == len(tracks)


def test_exact_truth_and_a_tracker_that_corrects_the_bias_of_its_detector_are_read(biased_run, tmp_path):
    rows = RunRows.of(biased_run)
    true = TrueTracks.of(rows)
    true = true.take(true.scored)
    assert len(true) > 60
    assert_read(biased_run, rows, Tracks.of(2, true.frame, true.vessel, true.boxes_px), tmp_path)
    tracks = detected_tracks(rows)
    assert_read(biased_run, rows, replace(tracks, boxes_px=tracks.boxes_px + 1), tmp_path)


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """Runs of 60 steps of the shipped scenes, and their tracks of the reference tracker; each is made once."""
    folder = tmp_path_factory.mktemp("long")

    @functools.cache
    def made(scene):
        run = finished(load_scene(scene, steps=60, seed=3), folder / scene)
        return run, RunRows.of(run), track_run(run, folder / f"{scene} tracks").tracks

    return made


@pytest.mark.parametrize("scene", ["strait", "fairway", "simulation_1"])
def test_no_tracker_s_own_tracks_are_taken_for_a_misreading(scene, long_run, tmp_path):
    """As corners and as MOT, with all digits and in whole pixels, as many trackers round."""
    run, rows, reference = long_run(scene)
    for tracker in ("reference", "sort", "bytetrack", "ocsort"):
        tracks = reference
        if tracker != "reference":
            tracks = track_run(run, tmp_path / tracker, tracker=tracker).tracks
        whole = replace(tracks, boxes_px=np.round(tracks.boxes_px))
        whole = whole.take((whole.boxes_px[:, 2:] > whole.boxes_px[:, :2]).all(axis=1))
        assert len(whole) > 100
        for k, each in enumerate((tracks, whole)):
            assert_read(run, rows, each, tmp_path)
            folder = write_mot(tmp_path / f"{tracker}_{k}", mot_texts(rows, each))
            assert len(read_tracks(folder, run, rows).tracks) == len(each)


def test_pixels_from_zero_of_a_smoother_and_from_one_are_recognised_in_clear_truth(long_run, tmp_path):
    """Boxes of a smoother are no detections, but four of five would lie nearer one pixel further; among 54 boxes whose
    errors are as large as a pixel pixels from one are not clear."""
    run, rows, tracks = long_run("fairway")
    folder = write_mot(tmp_path / "mot", mot_texts(rows, tracks, top_left(tracks.boxes_px)))
    assert "pixels are counted from 0" in said(read_tracks, folder, run, rows)
    run, rows, _ = long_run("strait")
    tracks = detected_tracks(rows)
    (tmp_path / "any.csv").write_text(csv_text(rows, tracks, tracks.boxes_px + 1))
    what = "pixels are counted from 1, must be counted from 0 (then half of"
    assert what in said(read_tracks, tmp_path / "any.csv", run, rows)
