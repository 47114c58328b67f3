"""The cases of the campaign that counts how often intervals hold what was asked for."""

from dataclasses import replace

import yaml

from benchmarks.campaigns.learn_coverage import CASES, learned_again, of_another_model, summary, text
from modsim3d.detector.file.reading import load_detector
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
        "false_discovery_rate", "false_positives_per_image",
    }  # fmt: skip


def test_slopes_of_confidence_come_back() -> None:
    case = replace(BY_NAME["slopes"], steps=120)
    run = learned_again(case, 1)["confidence"]
    assert run["not_learned"] == [] and "confidence.size_slope" in run["0.95"]
    assert all(inside == of for inside, of in run["all together"].values())
    page = text({"slopes": {"confidence": summary(case, [run])}})
    assert "| confidence.size_reference_px | 1.000 | 1.000 |" in page and "Large box errors" not in page


def test_numbers_of_another_model_are_not_compared() -> None:
    asked = yaml.safe_load(BY_NAME["edges"].path.read_text())
    again = yaml.safe_load(BY_NAME["edges"].path.read_text())
    assert of_another_model(asked, again) == ()
    again["states"]["clear"]["box_error"]["unit"] = "px"
    again["states"]["haze"]["confidence"]["size_slope"] = 0.1
    assert of_another_model(asked, again) == ("states.clear.box_error_", "states.haze.confidence.")
