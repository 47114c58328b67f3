"""Places, sizes and lifetimes of false positives: honest ones obey, others are told apart."""

from typing import Any

import pytest

from modsim3d import DetectorModel, ManyDetections
from modsim3d.detector.file.reading import parse_detector
from modsim3d.verify.false_positive_checks import false_positive_checks
from tests.detector_variants import thesis_data

PERSISTENCE = {"lifetime_s": 2.0, "share": 0.5}


def model(**keys: Any) -> DetectorModel:
    usual = {"model": "per_image", "rate": 2.0, "persistence": PERSISTENCE}
    return parse_detector(thesis_data() | {"false_positives": usual | keys})


def p_values(many: ManyDetections, made_with: DetectorModel, asked: DetectorModel, seed: int) -> dict[str, float]:
    found = false_positive_checks(asked, many.detect(made_with, seed))
    wanted = ("false_positives.placement", "false_positives.size", "false_positives.persistence.lifetime_s")
    return {p.name: p.measure.p_value() for p in found if p.measure is not None and p.name.startswith(wanted)}


@pytest.mark.parametrize("keys", [{}, {"size": {"model": "fixed", "px": [40, 20]}, "far_half_px": 90.0}])
def test_honest_false_positives_obey(many: ManyDetections, keys: dict[str, Any]) -> None:
    found = p_values(many, model(**keys), model(**keys), 3)
    assert len(found) == 5 and min(found.values()) > 1e-4


@pytest.mark.parametrize(
    "keys, name",
    [
        ({"placement": "horizon_band", "band_px": 300.0}, "false_positives.placement[below the horizon]"),
        ({"placement": "density", "density": [[1, 2]]}, "false_positives.placement[along the horizon]"),
        ({"size": {"model": "fixed", "px": [40, 20]}}, "false_positives.size[width]"),
        ({"persistence": {"lifetime_s": 0.4, "share": 0.5}}, "false_positives.persistence.lifetime_s"),
    ],
)
def test_others_are_told_apart(many: ManyDetections, keys: dict[str, Any], name: str) -> None:
    assert p_values(many, model(**keys), model(), 3)[name] < 1e-5
