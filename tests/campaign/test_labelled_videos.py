"""Campaigns over labelled videos: each traffic seed shows another one, and a video alone has the same scores."""

import json
from pathlib import Path

import pytest
import yaml

import modsim3d
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.work.checking import checked
from modsim3d.core.errors import ModsimError
from tests.formats.labelled_video.videos import coco, write

FILMS = {"left": 20, "right": 25, "ahead": 30}


LABELS = {"truth": "many.json", "detector": "coastal", "labels": ["boat"], "frame_rate_hz": 5, "horizon": 150}


def campaign(folder: Path, **keys: object) -> Path:
    write(folder / "many.json", coco(FILMS))
    content = {"scenes": [LABELS], "seeds": {"traffic": 3}, "trackers": ["sort"], "set": {"state": "haze"}, **keys}
    (folder / "videos.yaml").write_text(yaml.safe_dump(content))
    return folder / "videos.yaml"


def test_each_traffic_seed_shows_another_video_and_its_run_is_made_again(tmp_path: Path) -> None:
    found = modsim3d.run_campaign(campaign(tmp_path), tmp_path / "out", workers=1)
    rows = found.table.to_pylist()
    assert sorted(row["frames"] for row in rows) == sorted(FILMS.values())
    for row in rows:
        seeds = {"seed": row["traffic_seed"], "detector_seed": row["detector_seed"]}
        (file,) = tmp_path.glob("videos_scenes/many-*/many.json")
        scene = modsim3d.load_scene(file, state="haze", **seeds)
        run = modsim3d.run_scene(scene, tmp_path / f"run_{row['run']}").folder
        assert FILMS[scene.cameras[0].name] == scene.steps == row["frames"]
        tracks = modsim3d.track_run(run, tmp_path / f"tracks_{row['run']}", tracker="sort").folder
        assert modsim3d.score_run(run, tracks).trackers[0].scores.flat()["hota"] == row["hota"] > 0.3
    with pytest.raises(ModsimError, match="has 3 videos, too few for 4 traffic seeds"):
        modsim3d.run_campaign(campaign(tmp_path, seeds={"traffic": 4}), tmp_path / "more", workers=1)


def test_a_run_of_labels_is_a_scene_of_a_campaign_and_wrong_labels_are_named(tmp_path: Path) -> None:
    path, wrong = campaign(tmp_path), coco(FILMS)
    for entry in wrong["annotations"][:100]:
        entry["bbox"][2] = -1
    write(tmp_path / "wrong.json", wrong)
    options = {"detector": "coastal", "labels": ("boat",), "frame_rate_hz": 5, "horizon": 150}
    run = modsim3d.detect_truth(tmp_path / "many.json", tmp_path / "run", **options).folder
    over_run = campaign(tmp_path, scenes=["run"], seeds={"detector": 2})
    whole = modsim3d.run_campaign(over_run, tmp_path / "out", workers=1)
    assert [row["frames"] for row in whole.table.to_pylist()] == [sum(FILMS.values())] * 2
    flat = {**LABELS, "detector": "rich", "labels": ["sailboat"], "horizon": None}
    assert json.loads((run / "run.json").read_text())["cameras"] == sorted(FILMS)
    for labels, said in (
        ({"truth": "none.json", "detector": "coastal"}, "scenes: none.json.*no such file"),
        ({"truth": "many.json", "fps": 5}, "unknown key"),
        ({"truth": "many.json", "detector": "coastal", "labels": ["boat"]}, "no time.*: give frame_rate_hz,"),
        ({"truth": "many.json", "detector": "coastal", "frame_rate_hz": 5}, r"labels: give labels: \[A, B, ...\] with"),
        ({"truth": "many.json"}, "give either detector, a simulated one, or detections"),
        ({"truth": "many.json", "detector": "coastal", "horizon": [1, 2]}, "horizon: a row, or x and y of two"),
        ({**LABELS, "confidence_scale": [1, 1]}, "confidence_scale: must be two numbers that rise"),
        ({"truth": "wrong.json", "detector": "coastal"}, "wrong.json.*skip_bad: true leaves all such entries out"),
        (flat, "give horizon: ROW, or .*with detector.false_positives.placement: uniform d"),
    ):
        with pytest.raises(ModsimError, match=f"(?s){said}") as error:
            modsim3d.run_campaign(campaign(tmp_path, scenes=[labels]), tmp_path / "bad", workers=1)
        assert "--" not in str(error.value)
    parts = ("false_positives.band_px", "false_positives.far_half_px", "gates.max_range_m", "dropout.distance_m")
    settings = {"detector.false_positives.placement": "uniform"} | dict.fromkeys(f"detector.{part}" for part in parts)
    planned = checked(read_campaign(campaign(tmp_path, scenes=[flat], set=settings)))
    assert any("anywhere in the image" in note for note in planned.notes) and path.is_file()


def test_a_campaign_keeps_the_scene_that_it_was_planned_with(tmp_path: Path) -> None:
    first = checked(read_campaign(campaign(tmp_path)))
    (scene,) = first.file.keys.scenes
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / scene).parent.iterdir()}
    (other,) = checked(read_campaign(campaign(tmp_path, scenes=[{**LABELS, "horizon": 160}]))).file.keys.scenes
    assert other != scene and checked(read_campaign(campaign(tmp_path))).sha256 == first.sha256
    assert before == {path: path.stat().st_mtime_ns for path in before} and len(before) == 3
    campaign(tmp_path).rename(tmp_path / "x.yaml")
    (tmp_path / "x_scenes").write_text("in the way")
    with pytest.raises(ModsimError, match=r"x_scenes/many-.*cannot be written .*copy the campaign file"):
        checked(read_campaign(tmp_path / "x.yaml"))
