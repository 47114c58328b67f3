"""A detector from the figures of a test report: simulated in a scene it has them, whichever way they were printed."""

import re
from typing import Any

import numpy as np
import pytest

import modsim3d
from benchmarks.voyages.cases import SHOEBOXES
from modsim3d.core.errors import InputError
from tests.command_line import call

COUNTS = [[80, 5, 10], [4, 90, 6], [16, 5, 0]]  # ultralytics: predicted down, true across, background last
TWO = {"labels": ["boat", "ship"]}
RECALL = {"boat": 0.8, "ship": 0.9}
KNOWN = {**TWO, "mean_iou": 0.8, "confidence": 0.3}
PLAIN = {"labels": ["boat"], "precision": 0.9, "recall": 0.8}


def test_in_a_scene_of_its_own_it_has_precision_recall_and_mean_iou_of_the_report() -> None:
    asked = {"precision": 0.85, "recall": 0.75, "mean_iou": 0.72}
    made = modsim3d.learn_from_figures({"labels": ["boat", "sailboat", "ship"], **asked})
    assert made.contradictions == ()
    scene = modsim3d.load_scene("strait", source="analytic", steps=60, settings=SHOEBOXES)
    right, found, there, overlaps = 0, 0, 0, []
    truth = modsim3d.ManyDetections.of_scene(scene)
    for seed in range(24):
        seen = truth.detect(made.detector, seed)
        detected, boats = seen.true_detections, seen.instances
        for box, row in zip(detected.boxes_px, detected.instance, strict=True):
            own = boats.boxes_px[row]
            x, y = (min(box[i + 2], own[i + 2]) - max(box[i], own[i]) for i in (0, 1))
            common = max(x, 0) * max(y, 0)
            both = [(each[2] - each[0]) * (each[3] - each[1]) for each in (box, own)]
            overlaps.append(common / (sum(both) - common))
            right += overlaps[-1] >= 0.5
        found += len(detected.instance) + len(seen.false_positives.frame_row)
        there += len(boats.label)
    measured = {"precision": right / found, "recall": right / there, "mean_iou": float(np.mean(overlaps))}
    assert len(overlaps) > 10_000 and measured == pytest.approx(asked, abs=0.01)


@pytest.mark.parametrize("report", [
    {"confusion_matrix": COUNTS, "matrix_rows": "predicted"},
    {"confusion_matrix": np.transpose(COUNTS).tolist(), "matrix_rows": "true"},
    {"confusion_matrix": [[*row[:2], None] if row[2] == 0 else row for row in COUNTS], "matrix_rows": "predicted"},
    # Shares of each column with two decimals, as ultralytics prints them; one column sums to 1.01.
    {"confusion_matrix": [[0.8, 0.05, 0.63], [0.05, 0.9, 0.38], [0.16, 0.05, None]], "precision": 170 / 195},
    {"confusion_matrix": [[0.8, 0.04, 0.16], [0.05, 0.9, 0.05], [0.63, 0.38, 0]], "precision": 170 / 195},
    # Scikit-learn, of what was detected alone, whose rows are true labels.
    {"confusion_matrix": [[0.95, 0.05], [0.05, 0.95]], "recall": RECALL, "precision": 170 / 195},
], ids=["counts", "transposed", "empty cell", "shares", "shares transposed", "no background"])  # fmt: skip
def test_a_matrix_means_the_same_whichever_way_it_is_printed(report: dict[str, Any]) -> None:
    found = modsim3d.learn_from_figures({**KNOWN, **report}).content["states"]["reported"]
    np.testing.assert_allclose(found["confusion"], np.array(COUNTS)[:, :2] / 100, atol=0.012)
    assert found["false_discovery_rate"] == pytest.approx(16 / 195, abs=0.012)
    if len(report["confusion_matrix"]) == 3:
        assert found["false_positive_labels"] == pytest.approx([0.625, 0.375], abs=0.01)


def test_annotations_tell_rows_from_columns_and_images_make_false_positives_on_an_empty_sea() -> None:
    told = {"annotations": {"boat": 100, "ship": 100}, "images": 50}
    for matrix, rows in ((COUNTS, "predicted"), (np.transpose(COUNTS).tolist(), "true")):
        made = modsim3d.learn_from_figures({**KNOWN, **told, "confusion_matrix": matrix})
        assert f"The rows of the confusion matrix are {rows} labels." in made.assumed
        assert made.content["false_positives"] == {"model": "per_image", "rate": pytest.approx(16 / 50, abs=0.001)}


@pytest.mark.parametrize("wanted", [0.6, 0.92])
def test_mean_iou_and_the_ratio_of_average_precisions_are_solved_for(wanted: float) -> None:
    made = modsim3d.learn_from_figures({**PLAIN, "mean_iou": wanted})
    assert made.figures["mean_iou"] == (wanted, pytest.approx(wanted, abs=0.002))
    simulated = {name: value for name, (_, value) in made.figures.items()}
    again = modsim3d.learn_from_figures({**PLAIN, "map50": simulated["map50"], "map50_95": simulated["map50_95"]})
    assert again.figures["mean_iou"] == (None, pytest.approx(wanted, abs=0.01))
    assert again.figures["map50"][1] == pytest.approx(simulated["map50"], abs=0.01)
    exchanged = modsim3d.learn_from_figures({**PLAIN, "map50": simulated["map50_95"], "map50_95": simulated["map50"]})
    assert "map50_95 is higher than map50" in exchanged.contradictions[0]


def test_average_precision_by_size_makes_small_vessels_missed_more_often() -> None:
    made = modsim3d.learn_from_figures({**PLAIN, "ap_small": 0.2, "ap_medium": 0.5, "ap_large": 0.6})
    assert made.content["dropout"]["size_px"]["per_doubling"] < -0.5
    small, large = (made.figures[name][1] for name in ("ap_small", "ap_large"))
    assert small / large == pytest.approx(1 / 3, abs=0.2) and made.figures["recall"][1] == pytest.approx(0.8, abs=0.01)
    as_coco = {**PLAIN, "ap_small": -1, "ap_medium": 0.5, "ap_large": 0.6}
    unknown = modsim3d.learn_from_figures(as_coco)
    assert unknown.figures["ap_small"][0] is None and unknown.figures["ap_large"][0] == 0.6


@pytest.mark.parametrize(("changes", "message"), [
    ({"recall": None}, "give precision and recall, or a confusion_matrix"),
    ({"recall": 84}, r"recall: must be a share above 0 and up to 1, or one for each label \(got 84\)"),
    ({"precision": 0}, "precision: must be a share above 0"),
    ({"precision": {"boat": 0.9, "shp": 0.8}}, r"precision: must have a number for each of boat, ship \(got boat"),
    ({"recal": 0.8}, r"recal: unknown key \(did you mean 'recall'\?\)"),
    ({"confusion_matrix": [[9, 1]]}, r"must have 2 or, with background, 3 rows and columns \(got 1 rows of 2\)"),
    ({"confusion_matrix": COUNTS}, "are its rows true or predicted labels"),
    ({"confusion_matrix": [[0.8, 0.04], [0.1, 0.9], [0.14, 0.06]]}, "'boat' sum to 1.04, must sum to 1 "),
    ({"confusion_matrix": COUNTS, "matrix_rows": "true", "annotations": {"boat": 100, "ship": 100}}, "would fit"),
    ({"confusion_matrix": [[0, 4], [0, 5]], "matrix_rows": "predicted"}, "'boat' sum to 0, must to more than 0"),
    ({"confusion_matrix": [[1.5, 4], [0, 5]]}, r"shares from 0 to 1, and not both \(1.5 is no count"),
    ({"confusion_matrix": [[9, 1], [2, 8]], "matrix_rows": "true", "recall": None}, "recall: missing: the matrix"),
])  # fmt: skip
def test_a_wrong_report_is_refused_with_key_and_remedy(changes: dict[str, Any], message: str) -> None:
    given = {**TWO, "precision": 0.9, "recall": 0.8, **changes}
    with pytest.raises(InputError, match=message):
        modsim3d.learn_from_figures({key: value for key, value in given.items() if value is not None})


def test_the_command_writes_a_file_with_what_was_assumed_and_warns_of_contradictions(monkeypatch, capsys, tmp_path):
    report, out = tmp_path / "report.yaml", tmp_path / "detector.yaml"
    matrix = "confusion_matrix: [[80, 10], [20, 0]]\nmatrix_rows: predicted\n"
    report.write_text(f"labels: [boat]\nrecall: 0.9\n{matrix}", encoding="utf-8")
    assert call(monkeypatch, "learn", "--from-figures", report, "--out", out) == 0
    said = capsys.readouterr()
    assert "warning: recall is 0.9, and 0.8 by the matrix, which counts" in said.err
    assert "Mean IoU is 0.8; mean_iou, or map50 and map50_95, would say." in said.out
    assert re.search(r"recall +0\.800 +0\.\d{3}", said.out)
    head = " ".join(line.removeprefix("# ") for line in out.read_text().splitlines() if line.startswith("#"))
    assert all(word in head for word in ("Assumed: Mean IoU is 0.8", "Contradiction: recall", "mean_iou 0.800"))
    assert call(monkeypatch, "learn", "--from-figures", report, "--truth", report, "--out", out) == 2
    assert "--from-figures is in place of runs, files" in capsys.readouterr().err
