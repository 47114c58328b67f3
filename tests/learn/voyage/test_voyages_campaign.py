"""The campaign of simulated voyages: one is made again, and the committed page says what its numbers say."""

import json
from typing import Any

import numpy as np
import pytest

from benchmarks.campaigns.voyages import OUT
from benchmarks.voyages.cases import BY_NAME, CASES, FIRST_SEED
from benchmarks.voyages.causes import NUMBERS, Truth
from benchmarks.voyages.page import text
from benchmarks.voyages.pixels import comparisons
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.scores import below, fewest, scores
from benchmarks.voyages.trials import holds, trial
from benchmarks.voyages.wrong_camera import WRONG, drawn_traffic, drawn_wrong

FALL_SHORT = {
    "detector": ["states.voyage.box_error_std[e_w] (px)"],
    "detector_all": ["persistence.box_s"],
    "strait_ais": ["states.voyage.box_error_std[e_y] (px)"],
}
"""Numbers whose intervals hold too seldom: where vessels pass each other closely, each matches the other's boxes."""


@pytest.fixture(scope="module")
def committed() -> dict[str, dict[str, Any]]:
    content: dict[str, dict[str, Any]] = json.loads((OUT / "voyages.json").read_text(encoding="utf-8"))
    return content


def test_scores_count_what_holds_and_two_truths_are_compared_by_their_intervals() -> None:
    numbers = [
        {"asked": asked, "value": asked + off, "low": asked + off - 1, "high": asked + off + 1}
        for asked, off in ((1.0, -0.5), (-3.0, 0.0), (2.0, 2.0))
    ]
    numbers.append({"asked": 1.0, "value": 5.0, "low": 4.0, "high": 6.0, "bound": 1.0})
    assert [holds(number) for number in numbers] == [True, True, False, True]
    trials = [{"cpu_s": 1.0, "detector": {"rate": number}} for number in numbers]
    found = scores([*trials, {"cpu_s": 1, "refused": "no"}])
    assert (found["voyages"], found["refused"]) == (5, {"no": 1})
    rate = found["detector"]["rate"]
    assert (rate["held"], rate["of"], rate["bounds"], rate["bias"]) == (3, 4, 1, 1.375)
    assert (rate["asked"], rate["greatest_asked"]) == (-3.0, 2.0)
    assert (fewest(50), fewest(1), fewest(0)) == (43, 0, 0)
    unknown = scores([{"cpu_s": 1.0, "detector": {"rate": number | {"unknown": 1.0}}} for number in numbers])
    assert [unknown["detector"]["rate"][key] for key in ("held", "of", "unknown")] == [0, 0, 4]
    film = {"value": 1.0, "low": 0.0, "high": 2.0, "ais_value": 3.0, "ais_low": 1.5, "ais_high": 4.0}
    (found,) = comparisons([{"rate": film}, {"rate": film | {"ais_low": 2.5, "ais_bound": 1.0}}]).values()
    assert (found["films"], found["overlap"], found["inside"], found["ais"], found["bounds"]) == (2, 1, 0, 3.0, 1)


def test_a_voyage_comes_out_as_committed_and_the_page_says_what_its_numbers_say(committed):
    first, again = committed["detector_ais"]["first"], trial("detector_ais", FIRST_SEED)
    numbers = again["registration"] | again["detector"]
    assert first.keys() == numbers.keys()
    for name, number in numbers.items():
        assert number["value"] == pytest.approx(first[name], abs=0.1 * (number["high"] - number["low"]) + 1e-6), name
    assert (OUT / "voyages.md").read_text(encoding="utf-8") == text(committed)
    assert [name for name in committed if name != "pixels"] == [case.name for case in CASES]
    for case in CASES:
        if "registration" in committed[case.name]:
            assert len(below(committed[case.name]["registration"])) <= 1, case.name
    learned = {name: found["detector"] for name, found in committed.items() if "detector" in found}
    short = {name: below(numbers) for name, numbers in learned.items() if name != "unregistered"}
    assert {name: numbers for name, numbers in short.items() if numbers} == FALL_SHORT
    assert "registration" not in committed["unregistered"] and len(below(committed["unregistered"]["detector"])) > 10
    for film, causes in committed["pixels"]["causes"].items():
        truths = Truth.SAME_VESSELS, Truth.ALL_DETECTIONS
        own, with_others = (causes["some"][each.name][NUMBERS[0]] for each in truths)
        assert (with_others > 1.5 * own) == (causes["of_others"] > 0.05 * causes["matches"]), film
    clocks = [film["clock"] for films in committed["pixels"]["registered"].values() for film in films.values()]
    assert all(clock["low"] <= WRONG["clock_s"] <= clock["high"] for clock in clocks)


def test_errors_of_positions_are_as_large_and_last_as_long_as_asked_and_no_two_voyages_have_the_same_traffic() -> None:
    one, other = (drawn_traffic(BY_NAME["strait_true"].true_scene(), seed) for seed in (1, 2))
    moved = (one.poses.poses(0, 60).positions_m - other.poses.poses(0, 60).positions_m)[..., :2]
    apart = np.linalg.norm(moved, axis=-1).max(axis=0)
    assert (apart[list(one.own_ships)] == 0).all() and np.median(apart) > 10 and drawn_wrong(1) != drawn_wrong(2)
    scene = BY_NAME["detector"].true_scene()
    true = scene.poses.poses(0, scene.steps).positions_m
    errors = AisErrors(position_m=2.0, position_s=30.0, reports_s=1.0, absent=0.2)
    off, absent = [], set()
    for seed in range(20):
        known, _ = as_reported(scene, seed, errors)
        poses = known.poses.poses(0, scene.steps)
        off.append((poses.positions_m - true)[..., :2])
        absent.add(tuple(np.flatnonzero(~poses.present.any(axis=0)).tolist()))
    moved = np.stack(off)
    assert moved.std() == pytest.approx(2.0, rel=0.1)
    assert (moved[:, 30:] * moved[:, :-30]).mean() / moved.var() == pytest.approx(np.exp(-1), abs=0.1)
    assert all(len(each) == 3 for each in absent) and len(absent) > 10
