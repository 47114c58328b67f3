"""Over a run's own truth, the detector gives what the run has; over any truth, what its file says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import stats

from modsim3d.detector.records import KINDS
from modsim3d.formats.labelled_video.detect_truth import detect_truth
from modsim3d.runs.files.table_columns import BOX_SIDES, ERRORS
from modsim3d.runs.run import detect_run, run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from tests.detector_variants import thesis_data
from tests.formats.labelled_video.videos import rows
from tests.scenes import mistaken_strait

NUMBERS = (*BOX_SIDES, *ERRORS, "confidence")
ALPHA = 1e-6


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the strait's camera ashore, whose horizon stays, before a detector that makes every kind of mistake."""
    folder = tmp_path_factory.mktemp("as a run")
    path = mistaken_strait(folder, 60)
    scene = yaml.safe_load(path.read_text())
    scene["cameras"].pop("bow")
    for key in ("frame_rate_hz", "start_offset_s"):
        scene["cameras"]["quay"].pop(key)
    path.write_text(yaml.safe_dump(scene))
    run_scene(load_scene(path), folder / "run")
    return folder / "run"


def top_left_form(box: list[float]) -> list[float]:
    return [*box[:2], box[2] - box[0], box[3] - box[1]]


def as_coco(run: Path, folder: Path) -> Path:
    """The truth of a run under its own names, its rows in no order."""
    truth = [row for row in rows(run / "truth.parquet") if row["annotated"]]
    size = {"width": 1920, "height": 1080}
    labels = sorted({row["label"] for row in truth})
    content = {
        "categories": [{"id": 3 * k + 5, "name": name} for k, name in enumerate(labels)],
        "images": [
            {"id": 1000 - frame["step"], "time_s": float(frame["timestamp"]), "sequence": frame["camera"]} | size
            for frame in rows(run / "frames.parquet")
        ],
        "annotations": [
            {"image_id": 1000 - row["step"], "category_id": 3 * labels.index(row["label"]) + 5}
            | {"bbox": top_left_form([row[f"visible_{side}"] for side in BOX_SIDES])}
            | {"track_id": row["vessel"], "visible_fraction": row["visible_fraction"], "distance_m": row["depth_m"]}
            for row in truth[::-1]
        ],
    }
    (folder / "gt.json").write_text(json.dumps(content))
    return folder / "gt.json"


SETTINGS: dict[str, dict[str, object]] = {
    "every kind of mistake": {},
    "another": {
        "detector.false_positives.model": "per_image",
        "detector.false_positives.rate": 0.8,
        "detector.false_positives.size": None,
        "detector.gates.update_interval_s": 0.4,
        "detector.performance.schedule": [[3, "haze"]],
        "detector.persistence.class_s": 0,
    },
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)
def test_over_a_runs_truth_under_its_names_each_detection_is_that_of_the_run(run: Path, tmp_path: Path, settings):
    detect_run(run, tmp_path / "run", seed=8, settings=settings)
    scene = open_run(run).scene
    ((a, b, c),) = np.unique(scene.sea_half_planes(scene.cameras[0], np.arange(3)), axis=0)
    options = {"detector": run / "scene" / "detector.yaml", "seed": 8, "settings": settings}
    horizon = (0, -c / b, 1920, -(a * 1920 + c) / b)
    detect_truth(as_coco(run, tmp_path), tmp_path / "new", horizon=horizon, **options)
    asked, found = (rows(tmp_path / folder / "detections.parquet") for folder in ("run", "new"))
    assert len(asked) > 70
    for one, other in zip(asked, found, strict=True):
        for key in ("step", "label", "state", "kind", "vessel", "detection"):
            assert one[key] == other[key]
        for key in NUMBERS:
            assert one[key] == other[key] or abs(one[key] - other[key]) < 2e-3, key
    assert {row["kind"] for row in found} == set(KINDS)


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A long MOT sequence of many boxes, half of them half hidden, with what a detector of one state made of it."""
    folder, rng = tmp_path_factory.mktemp("busy"), np.random.default_rng(1)
    places = rng.uniform((900, 600), (4000, 3000), (300, 40, 2))
    lines = [
        f"{frame + 1},{track},{x:.2f},{y:.2f},900,500,1,1,{1 if track % 2 else 0.5}\n"
        for frame, of_frame in enumerate(places)
        for track, (x, y) in enumerate(of_frame)
    ]
    (folder / "gt.txt").write_text("".join(lines))
    data = thesis_data() | {
        "initial_state": "good",
        "transition_matrix": np.eye(4).tolist(),
        "dropout": {"model": "table", "visible_fraction": {"edges": [0.75], "odds": [4.0, 1.0]}},
    }
    (folder / "detector.yaml").write_text(yaml.safe_dump(data))
    options = {"image_size_px": (6000, 4000), "frame_rate_hz": 10}
    detect_truth(folder / "gt.txt", folder / "out", detector=folder / "detector.yaml", seed=3, **options)
    return rows(folder / "out" / "truth.parquet"), rows(folder / "out" / "detections.parquet")


def test_misses_box_errors_and_false_alarms_are_those_of_the_detector_file(busy) -> None:
    truth, detections = busy
    good = thesis_data()["states"]["good"]
    for visible, odds in ((1.0, 1.0), (0.5, 4.0)):
        seen = [row["detected"] for row in truth if row["visible_fraction"] == visible]
        rate = good["confusion"][-1][0]
        asked = odds * rate / (1 - rate) / (1 + odds * rate / (1 - rate))
        assert len(seen) == 6000
        assert stats.binomtest(len(seen) - sum(seen), len(seen), asked).pvalue > ALPHA
    errors = np.array([[row[key] for key in ERRORS] for row in detections if row["kind"] == "true"])
    mean, variance = np.array(good["box_error"]["mean"]), np.diag(good["box_error"]["covariance"])
    count = len(errors)
    assert np.all(np.abs(errors.mean(axis=0) - mean) < 6 * np.sqrt(variance / count))
    assert np.all(np.abs(np.var(errors, axis=0) / variance - 1) < 6 * np.sqrt(2 / count))
    false = sum(row["vessel"] is None for row in detections)
    rate, true = good["false_discovery_rate"], len(detections) - false
    expected = true * rate / (1 - rate)
    assert abs(false - expected) < 6 * np.sqrt(expected)


def test_a_run_exported_and_detected_again_has_the_same_rates(run: Path, tmp_path: Path) -> None:
    """Under other names its random numbers are others, and its shares the same but for chance."""
    truth = json.loads(as_coco(run, tmp_path).read_text())
    for image in truth["images"]:
        image["sequence"] = "elsewhere"
    (tmp_path / "gt.json").write_text(json.dumps(truth))
    detector = run / "scene" / "detector.yaml"
    detect_truth(tmp_path / "gt.json", tmp_path / "new", detector=detector, seed=7, horizon=500)
    asked, found = (rows(folder / "frames.parquet") for folder in (run, tmp_path / "new"))
    for key, of in (("n_detected", "n_annotated"), ("n_false", "n_detected")):
        table = [[sum(row[key] for row in each), sum(row[of] for row in each)] for each in (asked, found)]
        assert stats.chi2_contingency(table).pvalue > ALPHA
    assert rows(run / "detections.parquet") != rows(tmp_path / "new" / "detections.parquet")
