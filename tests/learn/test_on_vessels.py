"""False positives on vessels: what was asked for is learned again, from what a run says and from how boxes look."""

import numpy as np
import pytest

from modsim3d.formats.matching import Rule
from tests.learn.one_state import detected, detector_file, drawn_models, learned_from, moored

LAW = {"share": 0.1, "lifetime_s": 1.5, "mean": [0.1, -0.2, 0.5, 0.4], "std": [0.3, 0.15, 0.2, 0.25]}


def detector(**false_positives) -> dict:
    content = detector_file(false_positives_per_image=0.3)
    content["states"]["usual"].pop("false_discovery_rate")
    size = {"model": "lognormal", "px": [40, 30], "log_std": 0.3}
    return content | {"false_positives": {"model": "per_image", "size": size} | false_positives}


@pytest.fixture(scope="module")
def boats():
    return moored(3000, 6, 3, (900.0, 800.0))


@pytest.fixture(scope="module")
def learned(boats):
    return learned_from(detected(boats, detector(on_vessels=LAW), 4))


@pytest.mark.parametrize("rule", ["provenance", "confidence"])
def test_what_was_asked_for_is_learned_again(boats, learned, rule: str) -> None:
    if rule == "confidence":
        learned = learned_from(detected(boats, detector(on_vessels=LAW), 4), Rule(rule, least_iou=0.6))
    intervals = {each.key.path.removeprefix("false_positives.on_vessels."): each for each in learned.intervals(0.999)}
    stray = 0.06 if rule == "confidence" else 0.0  # others lie on vessels by chance, and some of these beside them
    for key, asked in LAW.items():
        slack = stray * (10 if key == "lifetime_s" else 1)
        ends = intervals[key].low, intervals[key].high
        assert bool(np.isnan(ends).any()) == (rule == "confidence" and key != "share")  # said not to be known
        low, high = (np.where(np.isnan(end), intervals[key].estimate, end) for end in ends)
        low, high = low - slack, high + slack
        assert np.all((low <= np.array(asked)) & (np.array(asked) <= high)), (key, intervals[key])
    section = learned.detector()["false_positives"]
    assert section["model"] == "per_image" and "duplicates" not in section
    rate = learned.detector()["states"]["usual"]["false_positives_per_image"]
    assert rate == pytest.approx(0.3, abs=0.03 if rule == "provenance" else 0.12)


def test_a_campaign_draws_them(learned, tmp_path) -> None:
    laws = [model.false_positives.on_vessels for model in drawn_models(learned, tmp_path, 3)]
    assert len({law.share for law in laws}) == len({law.std for law in laws}) == 3
    assert all(law.lifetime_s > 0 for law in laws)


def test_second_boxes_that_fit_as_well_as_first_ones_stay_second_boxes(boats) -> None:
    learned = learned_from(detected(boats, detector(duplicates=0.1), 4), Rule("confidence", least_iou=0.5))
    section = learned.detector()["false_positives"]
    assert section["duplicates"] == pytest.approx(0.1, abs=0.02) and "on_vessels" not in section


def test_false_positives_that_lie_anywhere_are_not_on_vessels(boats) -> None:
    learned = learned_from(detected(boats, detector(), 4), Rule("confidence", least_iou=0.5))
    assert "on_vessels" not in learned.detector()["false_positives"]
    (note,) = (note for note in learned.notes if note.startswith("false_positives.on_vessels: none; "))
    assert "standard errors from 0" in note or "by chance" in note
