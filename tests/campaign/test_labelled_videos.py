"""Campaigns over labelled videos: each traffic seed shows another one, and a video alone has the same scores."""

import json
from pathlib import Path

import pytest
import yaml

import modsim3d
from modsim3d.core.errors import ModsimError
from tests.formats.labelled_video.videos import coco, write

FILMS = {"left": 20, "right": 25, "ahead": 30}


def campaign(folder: Path, **keys: object) -> Path:
    write(folder / "many.json", coco(FILMS))
    labels = {"truth": "many.json", "detector": "coastal", "labels": ["boat"], "frame_rate_hz": 5, "horizon": 150}
    content = {"scenes": [labels], "seeds": {"traffic": 3}, "trackers": ["sort"], "set": {"state": "haze"}, **keys}
    (folder / "videos.yaml").write_text(yaml.safe_dump(content))
    return folder / "videos.yaml"


def test_each_traffic_seed_shows_another_video_and_its_run_is_made_again(tmp_path: Path) -> None:
    found = modsim3d.run_campaign(campaign(tmp_path), tmp_path / "out", workers=1)
    rows = found.table.to_pylist()
    assert sorted(row["frames"] for row in rows) == sorted(FILMS.values())
    for row in rows:
        seeds = {"seed": row["traffic_seed"], "detector_seed": row["detector_seed"]}
        scene = modsim3d.load_scene(tmp_path / "videos_scenes" / "many" / "many.json", state="haze", **seeds)
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
    whole = modsim3d.run_campaign(
        campaign(tmp_path, scenes=["run"], seeds={"detector": 2}), tmp_path / "out", workers=1
    )
    assert [row["frames"] for row in whole.table.to_pylist()] == [sum(FILMS.values())] * 2
    assert json.loads((run / "run.json").read_text())["cameras"] == sorted(FILMS)
    for labels, said in (
        ({"truth": "none.json", "detector": "coastal"}, "scenes: none.json.*no such file"),
        ({"truth": "many.json", "fps": 5}, "unknown key"),
        ({"truth": "many.json", "detector": "coastal", "labels": ["boat"]}, "no time.*: give frame_rate_hz,"),
        ({"truth": "many.json", "detector": "coastal", "frame_rate_hz": 5}, r"labels: give labels: \[A, B, ...\] with"),
        ({"truth": "wrong.json", "detector": "coastal"}, "wrong.json.*skip_bad: true leaves all such entries out"),
    ):
        with pytest.raises(ModsimError, match=f"(?s){said}") as error:
            modsim3d.run_campaign(campaign(tmp_path, scenes=[labels]), tmp_path / "bad", workers=1)
        assert "--" not in str(error.value)
    assert path.is_file()
