"""Detections in files whose boxes are meant otherwise than they are read, and those that match nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import modsim3d
from modsim3d.cli.main import app
from modsim3d.core.errors import ModsimError
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair

WIDTH, HEIGHT = 1920, 1080


def write_sets(folder, box, seed=0, shift_px=0.0, images=60, noise_px=2.0, stray=4):
    """COCO: two vessels in each image, detected, with as many less confident false detections as asked for."""
    rng = np.random.default_rng(seed)
    centre = np.array([[600, 400], [1200, 500]]) + np.cumsum(rng.normal(0, 6, (images, 2, 2)), axis=0)
    true = np.concatenate([centre - [30, 12], np.broadcast_to([60.0, 24.0], centre.shape)], axis=2)
    detected = true + rng.normal(0, noise_px, true.shape) + [shift_px, shift_px, 0, 0]
    false = np.concatenate([rng.uniform(0, 900, (images, stray, 2)), rng.uniform(10, 90, (images, stray, 2))], axis=2)
    entry = {"category_id": 1, "iscrowd": 0}
    truth = {
        "images": [{"id": k, "width": WIDTH, "height": HEIGHT, "file_name": f"{k}.jpg"} for k in range(images)],
        "categories": [{"id": 1, "name": "boat"}],
        "annotations": [
            {"id": 2 * k + j, "image_id": k, "bbox": true[k, j].tolist(), **entry}
            for k in range(images)
            for j in range(2)
        ],
    }
    results = [
        {"image_id": k, "category_id": 1, "bbox": [float(n) for n in box(*each)], "score": score}
        for k in range(images)
        for each, score in [*((b, 0.9) for b in detected[k]), *((b, 0.3) for b in false[k])]
    ]
    folder.mkdir(exist_ok=True)
    (folder / "gt.json").write_text(json.dumps(truth))
    (folder / "dt.json").write_text(json.dumps(results))
    return folder / "gt.json", folder / "dt.json"


def as_it_should_be(x, y, w, h):
    return x, y, w, h


WRONG = {
    "corners": (lambda x, y, w, h: (x, y, x + w, y + h), "but are the corners x_min, y_min, x_max, y_max"),
    "centres": (lambda x, y, w, h: (x + w / 2, y + h / 2, w, h), "but are centre x, centre y, width, height"),
    "shares": (lambda x, y, w, h: (x / WIDTH, y / HEIGHT, w / WIDTH, h / HEIGHT), "the boxes are shares of the image"),
    "scaled": (lambda x, y, w, h: (x / 3, y / 3, w / 3, h / 3), "are those of an image of 640 x 360 px"),
    "exchanged": (lambda x, y, w, h: (y, x, h, w), "x and y of the boxes are exchanged"),
    "from below": (lambda x, y, w, h: (x, HEIGHT - y - h, w, h), "y is counted from the lower edge of the image"),
}


@pytest.mark.parametrize(("box", "what"), WRONG.values(), ids=WRONG)
def test_boxes_in_another_form_are_named_and_nothing_is_written(tmp_path, box, what):
    truth, detections = write_sets(tmp_path, box)
    out = tmp_path / "detector.yaml"
    arguments = ["learn", "--truth", str(truth), "--detections", str(detections), "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code != 0 and not out.exists()
    with pytest.raises(ModsimError) as error:
        modsim3d.learn_detector(truth=truth, detections=detections)
    assert f"detections {detections}:" in str(error.value) and what in str(error.value)


def test_right_boxes_are_read_as_they_are_and_a_pixel_off_is_remarked_where_that_is_clear(tmp_path):
    """A real detector may have such a bias, which is learned."""

    def notes(**keys):
        return read_pair("day", *write_sets(tmp_path, as_it_should_be, **keys)).notes

    assert [notes(seed=seed) for seed in range(3)] == [()] * 3
    (note,) = notes(shift_px=1.0, noise_px=0.3)
    assert "pixels are counted from 1, must be counted from 0" in note and "such a bias" in note
    assert notes(shift_px=1.0, noise_px=5.0) == ()


def test_mot_pixels_from_zero_and_yolo_corners_are_named(tmp_path):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 8, (60, 2)), axis=0) + 300
    options = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))

    def lines(first_px, first_frame, tail):
        rows = (f"{k + first_frame},%d,{x + first_px},{y + first_px},60,24,{tail}" for k, (x, y) in enumerate(corner))
        return "".join(f"{row}\n" for row in rows)

    (tmp_path / "gt.txt").write_text(lines(1, 1, "1,1,1") % ((7,) * 60))
    (tmp_path / "det.txt").write_text(lines(0, 1, "0.9,-1,-1,-1") % ((-1,) * 60))
    notes = read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options).notes
    assert any("pixels are counted from 0, must be counted from 1" in note for note in notes)
    (tmp_path / "det.txt").write_text(lines(1, 2, "0.9,-1,-1,-1") % ((-1,) * 60))
    with pytest.raises(ModsimError, match="frames are one too high"):
        read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options)

    for name in ("set/labels", "found"):
        (tmp_path / name).mkdir(parents=True)
    for k, (x, y) in enumerate(corner):
        box = np.array([x / WIDTH, y / HEIGHT, (x + 60) / WIDTH, (y + 24) / HEIGHT])
        true = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, 60 / WIDTH, 24 / HEIGHT]
        (tmp_path / f"set/labels/{k}.txt").write_text(f"0 {' '.join(map(str, true))}\n")
        (tmp_path / f"found/{k}.txt").write_text(f"0 {' '.join(map(str, box))} 0.9\n")
    with pytest.raises(ModsimError, match="are read as centre x, centre y, width, height, but are the corners"):
        read_pair("day", tmp_path / "set", tmp_path / "found", options)


@pytest.mark.parametrize(("shift", "what"), [(1, "frames are one too high"), (-1, "frames are one too low")])
def test_frames_of_noisy_detections_one_off_are_named(tmp_path, shift, what):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 12, (60, 2)), axis=0) + 400
    found = corner + rng.normal(0, 2.5, corner.shape)
    options = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))
    (tmp_path / "gt.txt").write_text("".join(f"{k + 2},7,{x},{y},60,24,1,1,1\n" for k, (x, y) in enumerate(corner)))
    lines = (f"{k + 2 + shift},-1,{x},{y},60,24,0.9,-1,-1,-1\n" for k, (x, y) in enumerate(found))
    (tmp_path / "det.txt").write_text("".join(lines))
    with pytest.raises(ModsimError, match=what if shift > 0 else "frames count from 0"):
        read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options)


def test_detections_of_which_none_matches_are_refused(tmp_path):
    rng = np.random.default_rng(4)
    away = write_sets(tmp_path, lambda x, y, w, h: (*rng.uniform(0, 300, 2), 9, 9), stray=0)
    with pytest.raises(ModsimError, match="none of 120 detections matches any of 120 annotations"):
        modsim3d.learn_detector(truth=away[0], detections=away[1], replicates=20)
    with pytest.raises(ModsimError, match=r"none of 360 detections .* 0 of them have a confidence of at least 0.95"):
        files = write_sets(tmp_path, as_it_should_be)
        modsim3d.learn_detector(truth=files[0], detections=files[1], confidence=0.95, replicates=20)
