"""Labelled videos as other data sets have them, and real detections: tracked and scored as those of a run."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair, read_truth
from tests.formats import labelled_files
from tests.formats.labelled_files import HEIGHT, WIDTH, Video
from tests.formats.labelled_video.videos import TRACKS, coco, mot, rows, write

SIZED: dict[str, Any] = {"image_size_px": (WIDTH, HEIGHT), "frame_rate_hz": 5}
NO_INFO = ReadOptions(**SIZED)


def shifted(path: Path, by: int = -1) -> None:
    lines = (line.split(",") for line in path.read_text().splitlines())
    new = ([int(frame) + by, track, float(x) + by, float(y) + by, *rest] for frame, track, x, y, *rest in lines)
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in new))


def test_frames_and_pixels_from_0_are_those_from_1_and_results_are_written_so(tmp_path: Path) -> None:
    files = labelled_files.mot(tmp_path, Video.of())
    usual, lines = read_pair("day", *files), files[1].read_text().splitlines(keepends=True)

    def told(rows: slice = slice(None), first_frame: int | None = None) -> str:
        labelled = read_pair("day", *files, ReadOptions(first_frame=first_frame))
        boxes, asked = labelled.annotations, usual.annotations.take(np.arange(len(usual.annotations))[rows])
        np.testing.assert_allclose(boxes.boxes_px, asked.boxes_px, atol=1e-9)
        assert labelled.ids is not None and labelled.ids.images[:2] == (0, 1)
        return " ".join(labelled.notes)

    for path in files:
        shifted(path)
    assert "a frame 0 in gt.txt and det.txt" in told()
    with pytest.raises(InputError, match=r"frame must be a whole number from 1 to \d+ \(got 0\)"):
        read_pair("day", *files, ReadOptions(first_frame=1))
    files[1].write_text("".join(lines[6:]))
    shifted(files[1])
    assert "a frame 0 in gt.txt (" in told()
    files[1].write_text("".join(lines))
    with pytest.raises(InputError, match="frames are one too high, and pixels"):
        read_pair("day", *files)
    shifted(files[1])
    for path in files:
        path.write_text("".join(path.read_text().splitlines(keepends=True)[6:]))
    assert "a frame 0" not in told(slice(6, None), first_frame=0)
    truth, runs = mot(tmp_path / "bay"), []
    for name in ("from_1", "from_0"):
        run = modsim3d.detect_truth(truth, tmp_path / name, detector="thesis").folder
        runs.append(sorted(read_pair("day", truth, run / "det/det.txt").results.boxes_px.round(2).tolist()))
        assert modsim3d.score_run(run, truth).trackers[0].scores.flat()["loca"] == pytest.approx(1)
        shifted(truth)
    assert np.allclose(runs[0], runs[1], atol=0.02) and len(runs[0]) > 50


CAR, WORLD = "0 0 Car 0 0 -1.7 100 150 200 250 1.5 1.6 3.9 -4 1.8 13.4 -2.1", "1.5 1.6 3.9 -4 1.8 {} -2.1"
FAR = "-1000 -1000 -1000 -10 -1000 -1000 -1000"
KITTI = (
    f"0 -1 DontCare -1 -1 -10 600 100 700 180 {FAR}\n0 -1 DontCare -1 -1 -10 900 100 950 180 {FAR}\n"
    f"{CAR}\n0 1 Car 1 2 -1.7 300 150 400 250 {WORLD.format(9)}\n"
    f"1 0 Car 0 1 -1.7 101 150 201 250 {WORLD.format(13)}\n2 1 Car -1 3 -1.7 301 150 401 250 {WORLD.format(-1000)}\n"
    f"2 2 Van 0 0 -1.7 500 150 590 250 {WORLD.format(20)}\n2 3 Pedestrian 0 0 0 800 150 830 250 {WORLD.format(20)}\n"
)
BOXES = "0 {} 102 150 202 250", "0 {} 650 120 750 170", "2 {} 500 150 590 250"
FOUND = "".join(f"{box.format('-1 Car -1 -1 -10')} {FAR} 0.9\n" for box in BOXES)


def kitti(folder: Path, name: str = "0000", truth: str = KITTI, found: str = FOUND) -> list[Path]:
    for part, text in (("labels", truth), ("results", found)):
        (folder / part).mkdir(exist_ok=True)
        (folder / part / f"{name}.txt").write_text(text)
    return [folder / part / f"{name}.txt" for part in ("labels", "results")]


def test_occlusion_of_visdrone_is_a_visible_fraction_and_labels_of_kitti_are_read_or_refused(tmp_path: Path) -> None:
    files = tmp_path / "gt.txt", tmp_path / "det.txt"
    files[1].write_text("1,-1,10,20,30,40,0.9,4,-1,-1\n")

    def read(*ends: str) -> Any:
        tracks = [7 if end.startswith("0,0") else k for k, end in enumerate(ends)]
        files[0].write_text("".join(f"1,{tracks[k]},{10 + 50 * k},20,30,40,{end}\n" for k, end in enumerate(ends)))
        return read_pair("day", *files, NO_INFO)

    boxes = read("1,4,0,0", "0,0,0,0", "0,0,0,0", "1,5,1,1", "0,11,0,2").annotations
    assert sorted(boxes.label[boxes.crowd].tolist()) == [0, 0, 1, 1, 2, 2]  # of each of three labels
    assert boxes.visible_fraction[~boxes.crowd].tolist() == [1, 0.75, 0.25]
    assert boxes.in_frame_fraction[~boxes.crowd].tolist() == [1, 0.75, 1]
    assert boxes.ignored[~boxes.crowd].tolist() == [False, False, True] and (boxes.identity[boxes.crowd] == -1).all()
    for ends in (("1,4,0,0", "1,12,0,1"), ("1,4,0,0", "1,4,1,0"), ("1,1,1,1", "1,1,1,1")):
        labelled = read(*ends)
        assert np.isnan(labelled.annotations.visible_fraction).all()
    assert any("nine and ten are 1 in every line" in note for note in labelled.notes)
    labelled = read_pair("day", *kitti(tmp_path), NO_INFO)
    boxes, ids, cars = labelled.annotations, labelled.ids, ~labelled.annotations.ignored
    assert labelled.labels == ("Car",) and ids is not None and ids.images == ids.identities == (0, 1, 2)
    assert boxes.boxes_px[cars][0].tolist() == [100, 150, 200, 250] and boxes.identity[cars].tolist() == [0, 1, 0, 1]
    np.testing.assert_array_equal(boxes.visible_fraction[cars], [1, 0.25, 0.75, np.nan])
    np.testing.assert_array_equal(boxes.depth_m[cars], [13.4, 9, 13, np.nan])
    np.testing.assert_array_equal(boxes.in_frame_fraction[cars], [1, 0.75, 1, np.nan])
    assert re.findall(r"(\d) of 7 .*?\((\w+)", str(labelled.notes)) == [("2", "DontCare"), ("1", "types")]
    assert match(labelled, Rule()).counts.tolist() == [True, False, False]  # half in a region; the van
    both = read_pair("day", *kitti(tmp_path), replace(NO_INFO, labels=("Pedestrian", "Car"))).annotations
    assert (both.label[~both.ignored].tolist(), both.label[both.crowd].tolist()) == ([1, 1, 1, 1, 0], [0, 1, 0, 1])
    alone, kind = read_truth(tmp_path / "labels" / "0000.txt", NO_INFO)
    assert kind == "KITTI" and alone.labels[:2] == ("Car", "Van") and alone.annotations.ignored.sum() == 2
    text = KITTI.replace("Car 0 0", "Car 0.999 0").replace("Car 1 2", "Car 1.0 2")
    cut = read_pair("day", *kitti(tmp_path, truth=text, found=""), NO_INFO)
    assert cut.annotations.in_frame_fraction[:2].round(6).tolist() == [0.001, 0] and not len(cut.results)
    for text, told in WRONG.items():
        files = kitti(tmp_path, truth=f"5{CAR[1:]}\n{text}\n")
        with pytest.raises(InputError, match=re.escape(told)):
            read_pair("day", *files, NO_INFO)
        assert "left out" in read_pair("day", *files, replace(NO_INFO, skip_bad=True)).notes[0]
    with pytest.raises(InputError, match=r"'car' is no type in the files \(did you mean 'Car'"):
        read_pair("day", *files, replace(NO_INFO, labels=("car",)))


WRONG = {
    CAR[:-5]: "line 2: has 16 columns, must have 17 ",
    CAR.replace("13.4", "near"): "must be finite numbers but for the third column, a type",
    CAR.replace(" 0 0 -1.7", " 0 7 -1.7"): "occlusion must be 0, 1, 2 or 3, or -1 where it is not known (got 7)",
    CAR.replace("Car 0 0", "Car 3 0"): "truncation must be a class 0, 1 or 2, a share up to 1, or -1 where it is ",
    CAR.replace("200 250", "90 250"): "bbox has no area: width -10, height 100",
    f"{CAR.replace('0 0 Car 0', '7 0 Car .3')}\n{CAR.replace('Car 0', 'Car 2')}": "line 3: truncation must be a share",
    f"{CAR}\n{CAR}": "line 3: identity 0 is in frame 0 already",
}


def test_a_folder_of_files_is_a_sequence_each_and_their_tracks_are_different_things(tmp_path: Path) -> None:
    kitti(tmp_path), kitti(tmp_path, "0001", KITTI.replace("Van", "Tram"), FOUND.replace("102 150 202", "100 150 200"))
    given = tmp_path / "labels", tmp_path / "results"
    result = modsim3d.detect_truth(given[0], tmp_path / "out", detections=given[1], **SIZED)
    assert sum(note.startswith("KITTI: types other than Car are left out") for note in result.notes) == 1
    assert {name: counts.detected for name, counts in result.sequence_counts.items()} == {"0000": 1, "0001": 1}
    scores = modsim3d.score_run(tmp_path / "out", modsim3d.track_run(tmp_path / "out", tmp_path / "tracks").folder)
    edge = next(group for group in scores.trackers[0].scores.breakdown if group.name == "edge")
    assert [(each.bin, each.vessel_frames) for each in edge.rows] == [("whole in the image", 4), ("cut by the edge", 2)]
    boxes = rows(tmp_path / "out" / "truth.parquet")
    assert {row["camera"] + row["vessel"] for row in boxes} == {f"{s}{s}/{k}" for s in ("0000", "0001") for k in (0, 1)}
    (given[1] / "0001.txt").unlink()
    with pytest.raises(InputError, match=r"0001.txt: no such file, and .*labels has it"):
        read_pair("day", *given, NO_INFO)
    gt = mot(tmp_path / "bay", frames=5).read_text()
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "a.txt").write_text(gt), (tmp_path / "gt" / "b.txt").write_text(gt)
    shifted(tmp_path / "gt" / "a.txt")
    whole = read_truth(tmp_path / "gt", NO_INFO)[0]
    assert len(whole.images) == 5 + 6 and whole.ids is not None and whole.ids.sequences == ("a", "b")
    assert len(set(whole.annotations.identity.tolist())) == len(whole.ids.identities) == 6


@pytest.mark.parametrize("name", ["{}", "river_{:04}", "river_{}"])
def test_a_folder_of_yolo_with_tracks_is_the_video_of_its_mot_file(tmp_path: Path, name: str) -> None:
    truth, folder = mot(tmp_path / "bay", visible="", frames=20), tmp_path / "labels"
    truth.write_text("".join(line for line in truth.read_text().splitlines(keepends=True) if line[:2] != "7,"))
    folder.mkdir()
    for k, line in enumerate(truth.read_text().splitlines()):
        frame, track, x, y, w, h = map(float, line.split(",")[:6])
        box = (x - 1 + w / 2) / 640, (y - 1 + h / 2) / 480, w / 640, h / 480
        with (folder / f"{name.format(int(frame) * 10)}.txt").open("a") as file:
            file.write(f"0 {' '.join(map(repr, box))}{' 0.9' * (k % 2)} {track:.0f}\n")
    options, tables = ReadOptions(image_size_px=(640, 480), frame_rate_hz=10), []
    for given in (truth, folder):
        labelled = read_truth(given, options)[0]
        boxes, tracks = labelled.annotations, np.array(labelled.ids.identities if labelled.ids else ())
        columns = labelled.images.time_s[boxes.image], tracks[boxes.identity], *boxes.boxes_px.T
        tables.append(sorted(zip(*(column.round(4).tolist() for column in columns), strict=True)))
    assert tables[0] == tables[1] and len(tables[0]) == 57 and tables[0][-1][0] == 1.9
    options = {"detector": "thesis", "labels": ("Vessel",), **SIZED}
    assert modsim3d.detect_truth(folder, tmp_path / "out", **options).counts.annotated == 57
    for line, told in (("0 .5 .5 .1 .1 0.87\n", "must have 5: class"), ("0 .5 .5 .1 .1 3\n" * 2, "track 3 is in the ")):
        next(folder.iterdir()).write_text(line)
        with pytest.raises(InputError, match=told):
            read_truth(folder, NO_INFO)


def best_iou(box: list[float], others: list[list[float]]) -> float:
    def overlap(a: list[float], b: list[float]) -> float:
        sides = [min(a[k + 2], b[k + 2]) - max(a[k], b[k]) for k in (0, 1)]
        both = max(sides[0], 0) * max(sides[1], 0)
        return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)

    return max((overlap(box, other) for other in others), default=0.0)


def test_detections_keep_their_boxes_and_detect_what_they_overlap(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay")
    modsim3d.detect_truth(truth, tmp_path / "sim", detector="coastal", labels=("boat",), horizon=150)
    result = modsim3d.detect_truth(truth, tmp_path / "real", detections=tmp_path / "sim" / "det" / "det.txt")
    found, of_truth = (rows(tmp_path / "real" / f"{name}.parquet") for name in ("detections", "truth"))
    sides = [f"{side}_px" for side in ("x_min", "y_min", "x_max", "y_max")]
    by_step: dict[int, list[list[float]]] = {}
    for row in of_truth:
        by_step.setdefault(row["step"], []).append([row[f"full_{side}"] for side in sides])
    found = rows(tmp_path / "sim/detections.parquet")
    asked = sorted([row["step"], *(round(row[side], 2) for side in sides)] for row in found)
    got = sorted([row["step"], *(round(row[side], 2) for side in sides)] for row in found)
    assert len(got) > 50 and np.allclose(got, asked, atol=0.02)
    for row in found:
        overlap = best_iou([row[side] for side in sides], by_step.get(row["step"], []))
        assert (row["kind"] == "true") <= (overlap >= 0.5) and (overlap < 0.5) <= (row["vessel"] is None)
    assert result.counts.detected == sum(row["detected"] for row in of_truth) > 40
    with pytest.raises(ModsimError, match="are those of a real detector"):
        modsim3d.detect_truth(truth, tmp_path / "no", detections=tmp_path / "sim/det/det.txt", detector="thesis")


def regions(folder: Path) -> tuple[dict[str, Path], Path]:
    """Truth with a crowd region, with one of which less than half of a box lies inside, and with none; detections of
    all vessels and of something in the region."""
    labelled = coco({"left": 20})
    found = [{**entry, "score": 0.9} for entry in labelled["annotations"]]
    found += [{**found[0], "image_id": image["id"], "bbox": [420, 20, 60, 60]} for image in labelled["images"]]
    write(folder / "dt.json", found)
    files = {}
    for name, box in {"none": None, "half": [400, 0, 200, 200], "less": [460, 0, 200, 200]}.items():
        image_ids = enumerate(image["id"] for image in labelled["images"])
        extra = [{"id": 999 + k, "image_id": i, "category_id": 4, "bbox": box, "iscrowd": 1} for k, i in image_ids]
        content = {**labelled, "annotations": labelled["annotations"] + (extra if box else [])}
        files[name] = write(folder / f"{name}.json", content)
    return files, folder / "dt.json"


def test_a_track_in_an_ignored_region_is_not_false_and_another_detector_works_on_the_labels(tmp_path: Path) -> None:
    files, found = regions(tmp_path)
    tracks = tmp_path / "tracks.txt"
    boxes = [f"{frame},9,421,21,60,60,1,-1,-1,-1" for frame in range(1, 21)]
    boxes += [f"{frame},{k},{31 + 90 * k + (frame - 1) * (1 - k)},{201 + 40 * k},120,60,1,-1,-1,-1"
              for frame in range(1, 21) for k in range(3)]  # fmt: skip
    tracks.write_text("\n".join(boxes))
    false = {}
    for name, file in files.items():
        alone = modsim3d.detect_truth(file, tmp_path / name, truth_alone=True, frame_rate_hz=5)
        keys = modsim3d.score_run(alone.folder, tracks).trackers[0].scores.flat()
        real = modsim3d.detect_truth(file, tmp_path / f"{name}_real", detections=found, frame_rate_hz=5)
        false[name] = keys["false_positives"], real.counts.false_positives
        assert any("20 of 80 detections are left out" in note for note in real.notes) == (name == "half")
    assert false == {"none": (20, 20), "half": (0, 0), "less": (20, 20)}
    files, found = regions(tmp_path)
    real = modsim3d.detect_truth(files["none"], tmp_path / "real", detections=found, frame_rate_hz=5).folder
    simulated = modsim3d.detect_truth(files["none"], tmp_path / "asked", detector="thesis", seed=3, frame_rate_hz=5)
    modsim3d.detect_run(real, tmp_path / "again", detector="thesis", seed=3)
    tables = [modsim3d.open_run(run).table("detections") for run in (simulated.folder, tmp_path / "again")]
    assert tables[0].equals(tables[1]) and len(tables[0]) > 30
    tracks = modsim3d.track_run(real, tmp_path / "tracks", tracker="sort").folder
    for call in (
        lambda: modsim3d.detect_run(real, tmp_path / "x", seed=4),
        lambda: modsim3d.score_run(real, tracks, seeds=3),
        lambda: modsim3d.verify_run(real),
        lambda: modsim3d.open_run(real).scene.at(0),
    ):
        with pytest.raises(ModsimError, match=r"real detector|real one|places in the world"):
            call()
    classes = coco({"left": 20}, categories=("ship", "buoy"))
    for entry in classes["annotations"][::3]:
        entry["category_id"] = 5
    write(tmp_path / "two.json", classes)
    write(tmp_path / "all.json", [{**entry, "score": 0.5} for entry in classes["annotations"]])
    options = {"detections": tmp_path / "all.json", "frame_rate_hz": 5, "labels": ("ship", "-")}
    result = modsim3d.detect_truth(tmp_path / "two.json", tmp_path / "ships", **options)
    assert (result.counts.annotated, result.counts.detected, result.counts.false_positives) == (40, 40, 0)
    assert modsim3d.open_run(result.folder).scene.detector.labels == ("ship",)


def test_labels_that_were_changed_are_refused(tmp_path: Path) -> None:
    modsim3d.detect_truth(mot(tmp_path / "bay"), tmp_path / "run", detector="thesis")
    path = tmp_path / "run" / "scene" / "poses.json"
    content = json.loads(path.read_text())
    for change, said in (
        ({"format": 2}, "format: must be 1"),
        ({"boxes": {**content["boxes"], "vessel": [7] * 120}}, "a vessel that the file does not have"),
        ({"boxes": {**content["boxes"], "step": [99] * 120}}, "a row where a camera has no image"),
        ({"boxes": {**content["boxes"], "step": [0]}}, "columns of different lengths"),
        ({"vessels": dict.fromkeys(map(str, TRACKS), "ufo")}, "'ufo' is not one of the detector's labels"),
        ({"sequences": []}, "there are none"),
    ):
        path.write_text(json.dumps({**content, **change}))
        with pytest.raises(ModsimError, match=said):
            modsim3d.load_scene(path.with_name("bay.json"))
    path.write_text(json.dumps(content))
    for setting in ({"sea": "curved"}, {"annotation.mode": 2}):
        with pytest.raises(ModsimError, match=r"a scene of labels|in a scene of labels"):
            modsim3d.load_scene(path.with_name("bay.json"), settings=setting)
