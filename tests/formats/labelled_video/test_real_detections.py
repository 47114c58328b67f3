"""Real detections of a labelled video: tracked and scored as those of a run, with regions that are to be ignored."""

import json
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import ModsimError
from tests.formats.labelled_video.videos import TRACKS, coco, mot, rows, write


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
    asked = sorted(
        [row["step"], *(round(row[side], 2) for side in sides)] for row in rows(tmp_path / "sim/detections.parquet")
    )
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
        extra = [
            {"id": 999 + k, "image_id": image["id"], "category_id": 4, "bbox": box, "iscrowd": 1}
            for k, image in enumerate(labelled["images"])
        ]
        content = {**labelled, "annotations": labelled["annotations"] + (extra if box else [])}
        files[name] = write(folder / f"{name}.json", content)
    return files, folder / "dt.json"


def test_a_track_or_a_detection_in_a_region_to_be_ignored_is_not_false(tmp_path: Path) -> None:
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


def test_another_detector_works_on_the_labels_and_nothing_else_changes_what_was_found(tmp_path: Path) -> None:
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
