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


def test_a_track_in_a_region_to_be_ignored_is_not_false(tmp_path: Path) -> None:
    labelled = coco({"left": 20})
    region = {"id": 999, "category_id": 4, "bbox": [400, 0, 200, 200], "iscrowd": 1}
    found = [
        {"image_id": image["id"], "category_id": 4, "bbox": [420, 20, 60, 60], "score": 0.9}
        for image in labelled["images"]
    ]
    found += [{**entry, "score": 0.9} for entry in labelled["annotations"]]
    write(tmp_path / "dt.json", found)
    counted = {}
    for name, box in {"none": None, "half": region["bbox"], "less": [460, 0, 200, 200]}.items():
        extra = [
            {**region, "id": 999 + k, "image_id": image["id"], "bbox": box}
            for k, image in enumerate(labelled["images"])
        ]
        content = {**labelled, "annotations": labelled["annotations"] + (extra if box else [])}
        write(tmp_path / f"{name}.json", content)
        options = {"detections": tmp_path / "dt.json", "frame_rate_hz": 5}
        run = modsim3d.detect_truth(tmp_path / f"{name}.json", tmp_path / name, **options).folder
        tracks = modsim3d.track_run(run, tmp_path / f"{name}_tracks", tracker="sort").folder
        keys = modsim3d.score_run(run, tracks).trackers[0].scores.flat()
        counted[name] = keys["false_positives"]
    assert counted["half"] == 0 < counted["none"] == counted["less"]


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
