"""The cases of the campaign that counts how often intervals hold what was asked for."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from benchmarks.campaigns.learn_coverage import CASES, OUT, learned_again, of_another_model, summary, text
from benchmarks.elsewhere import STRAIT, OtherTruth
from benchmarks.invented import SHIPPED, invented, models_in
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.target_statistics import TargetStatistics
from tests.learn.round_trip import asked_of

BY_NAME = {case.name: case for case in CASES}


def test_every_kind_of_number_is_asked_for_by_some_case_whose_detector_can_be_read() -> None:
    for case in CASES:
        assert load_detector(str(case.path)).labels == ("sailboat", "motorboat", "ferry"), case.name
    asked = {path.removeprefix("states.").partition(".")[2] for case in CASES for path in asked_of(case.path)}
    assert asked >= {
        "visible_fraction.per_unit", "size_px.per_doubling", "class_s", "box_s", "confidence_s", "class_vessel_share",
        "box_vessel_share", "density", "band_px", "far_half_px", "persistence.lifetime_s", "persistence.drift_px_s",
        "persistence.share", "duplicates", "merges", "splits", "box_error_growth", "box_error_degrees_of_freedom",
        "confidence.true.mean", "confidence.visibility_slope", "confidence.size_slope", "confidence.size_reference_px",
        "false_discovery_rate", "false_positives_per_image", "score.vessel_share", "score.shares", "on_vessels.share",
        "on_vessels.lifetime_s", "on_vessels.mean", "on_vessels.std",
    }  # fmt: skip


def test_slopes_of_confidence_come_back() -> None:
    case = replace(BY_NAME["slopes"], steps=120)
    run = learned_again(case, 1)["confidence"]
    assert run["not_learned"] == [] and "confidence.size_slope" in run["0.95"]
    assert all(inside == of for inside, of in run["all together"].values())
    for misses in run["elsewhere"].values():
        assert misses["inside"] == [1] and 0 < misses["width"][0] < 0.3
    page = text({"slopes": {"confidence": summary(case, [run])}})
    assert "| misses in strait, 150 steps | true | IoU: learned | IoU: width of the range | IoU: true in" in page
    assert "| confidence.size_reference_px | 1.000 | 1.000 |" in page and "Large box errors" not in page
    held = {"seeds": 200, "0.95": dict.fromkeys(("a", "b", "c"), 0.95) | {"b": 0.9, "c": 1.0}, "0.99": {"b": 0.98}}
    page = text({"slopes": {"confidence": summary(case, [run]) | held}})
    assert all(row in page for row in ("| a | 0.950 | – |", "| b | 0.900 ▼ | 0.980 |", "| c | 1.000 ▲ | – |"))


def test_numbers_of_another_model_are_not_compared() -> None:
    asked = yaml.safe_load(BY_NAME["edges"].path.read_text())
    again = yaml.safe_load(BY_NAME["edges"].path.read_text())
    assert of_another_model(asked, again) == ()
    again["states"]["clear"]["box_error"]["unit"] = "px"
    again["states"]["haze"]["confidence"]["size_slope"] = 0.1
    assert of_another_model(asked, again) == ("states.clear.box_error_", "states.haze.confidence.")


def test_misses_in_another_scene_follow_what_vessels_look_like_there() -> None:
    content = yaml.safe_load(BY_NAME["state_effects"].path.read_text())
    content["dropout"]["anchor"] = "none"
    strait = OtherTruth.of(STRAIT, BY_NAME["state_effects"].path)
    rates = dict(zip(strait.bins, strait.miss_rates(parse_detector(content), TargetStatistics()).T, strict=True))
    assert np.all(rates["far"] > rates["near"] + 0.05) and rates["far"][1] > rates["near"][1] + 0.3  # steeper in haze
    counts = {name: chosen.mean() for name, chosen in strait.bins.items()}
    for one, other in (("near", "far"), ("small", "large"), ("hidden", "visible")):
        both = counts[one] * rates[one] + counts[other] * rates[other]
        assert both == pytest.approx(rates["all"]) and counts[one] > 0.1 < counts[other]


def test_models_that_a_detector_does_not_have_are_told_from_its_own() -> None:
    by_name = {case.detector: models_in(yaml.safe_load(case.path.read_text())) for case in SHIPPED}
    rich, coastal, thesis = (by_name[name] for name in ("rich", "coastal", "thesis"))
    assert thesis == set() and {"false_positives.persistence", "states.haze.confidence.visibility_slope"} <= coastal
    assert {"states.haze.box_error: mixed", "states.haze.confidence.true: quantiles", "dropout.distance_m"} <= rich
    content = yaml.safe_load(SHIPPED[0].path.read_text())
    content["states"]["good"]["box_error"] |= {"law": "student_t", "degrees_of_freedom": 4}
    assert models_in(content) == {"states.good.box_error: student_t"}
    (case,) = (replace(case, steps=60) for case in SHIPPED if case.detector == "coastal")
    for found in invented(case, 1).values():
        assert not any("box_error" in each or "persistence" in each for each in found["invented"])
        assert "persistence.box_s" not in found["missing"]


def test_no_lasting_false_positives_were_invented_in_runs_of_the_thesis() -> None:
    runs = json.loads((OUT / "learn_coverage.json").read_text(encoding="utf-8"))["shipped_thesis"]["runs"]
    assert f"[{len(runs)} runs](campaigns/learn_coverage.md)" in (OUT.parent / "learn.md").read_text(encoding="utf-8")
    assert not any("false_positives.persistence" in run["provenance"]["invented"] for run in runs)
