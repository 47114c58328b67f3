"""The plan: conditions, drawn values and seeds, before anything is run."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from modsim3d.campaign.keys import CampaignKeys, Range
from modsim3d.campaign.plan import Plan, value_at


def plan_of(**keys: Any) -> Plan:
    return Plan.of(CampaignKeys.model_validate({"scene": "harbour", "trackers": ["reference", "sort"], **keys}))


def test_conditions_are_all_combinations_the_last_factor_changing_first() -> None:
    grid, pairs = {"waves.level": ["small", "large"]}, {"detector.a": [1, 2], "state": ["clear", "haze"]}
    plan = plan_of(vary=[{"grid": grid}, {"pairs": pairs}, {"list": [{"tracker.lost_s": 2}, {"sea": "curved"}]}])
    values = [dict(condition.values) for condition in plan.conditions]
    assert len(values) == 2 * 2 * 2
    assert values[0] == {"waves.level": "small", "detector.a": 1, "state": "clear", "tracker.lost_s": 2}
    assert values[1] == {"waves.level": "small", "detector.a": 1, "state": "clear", "sea": "curved"}
    assert values[2]["state"] == "haze" and values[2]["detector.a"] == 2
    assert plan.parameters == ("waves.level", "detector.a", "state", "tracker.lost_s", "sea")


def test_each_key_belongs_to_the_first_layer_that_it_changes() -> None:
    keys = {"waves.level": "small", "detector.x": 1, "state": "haze", "from": "d", "tracker.lost_s": 3}
    (condition,) = plan_of(vary=[{"list": [keys]}]).conditions
    assert condition.of_truth() == {"waves.level": "small"}
    assert condition.of_detector() == {"detector.x": 1, "state": "haze", "from": "d"}
    assert condition.of_tracker() == {"lost_s": 3}


def test_runs_are_numbered_by_seed_condition_look_and_tracker() -> None:
    plan = plan_of(seeds={"traffic": 3, "detector": 2}, vary=[{"grid": {"state": ["clear", "haze"]}}])
    runs = plan.runs(range(len(plan)))
    assert len(runs) == 3 * 2 * 2 * 2
    order = [(r.seed_index, r.condition_index, r.detector_seed % 1000, r.tracker.label) for r in runs]
    assert order == sorted(order) and len(set(order)) == len(runs)


def test_everything_that_is_compared_meets_the_same_seeds_and_no_two_repetitions_do() -> None:
    plan = plan_of(seed=7, seeds={"traffic": 4, "detector": 3}, vary=[{"grid": {"state": ["clear", "haze"]}}])
    runs = plan.runs(range(len(plan)))
    by_place: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for run in runs:
        by_place.setdefault((run.condition_index, run.tracker.label), []).append((run.traffic_seed, run.detector_seed))
    assert len({tuple(seeds) for seeds in by_place.values()}) == 1
    assert len({run.traffic_seed for run in runs}) == 4
    assert len({run.detector_seed for run in runs}) == 12
    others = plan_of(seed=8, seeds={"traffic": 4}).runs(range(8))
    assert {run.traffic_seed for run in others}.isdisjoint(run.traffic_seed for run in runs)


def test_a_longer_campaign_begins_with_the_shorter_one_unless_a_hypercube_is_drawn() -> None:
    draw = [{"uniform": {"detector.x": [0, 1], "detector.y": {"choices": ["a", "b", "c"]}}}]
    short, long = (plan_of(seeds={"traffic": count}, vary=draw) for count in (3, 50))
    assert [long.run(number) for number in range(len(short))] == short.runs(range(len(short)))


def test_a_latin_hypercube_has_one_point_in_each_layer_of_each_key() -> None:
    count = 40
    ranges = {"detector.x": [2, 4], "detector.y": {"low": 1, "high": 100, "scale": "log"}}
    plan = plan_of(seeds={"traffic": count}, vary=[{"latin_hypercube": ranges}])
    assert plan.drawn == ("detector.x", "detector.y")
    points = [plan.run(number).condition.values for number in range(0, len(plan), 2)]
    x = (np.array([point["detector.x"] for point in points]) - 2) / 2
    y = np.log10([point["detector.y"] for point in points]) / 2
    for values in (x, y):
        assert sorted(np.floor(values * count).astype(int)) == list(range(count))
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.5


@given(share=st.floats(0, 1, exclude_max=True), low=st.integers(-5, 5), width=st.integers(1, 9))
def test_drawn_values_stay_in_their_range(share: float, low: int, width: int) -> None:
    whole = Range(low=float(low), high=float(low + width), whole=True)
    value = value_at(whole, share)
    assert isinstance(value, int) and low <= value <= low + width
    assert low <= value_at(Range(low=float(low), high=float(low + width)), share) <= low + width
    decade = Range(low=0.1, high=10.0, scale="log")
    assert 0.1 <= value_at(decade, share) <= 10
    assert value_at(Range(choices=["a", "b"]), share) == ("a" if share < 0.5 else "b")


def test_both_trackers_of_a_seed_get_the_same_draw_and_whole_numbers_are_equally_likely() -> None:
    plan = plan_of(seeds={"traffic": 5}, vary=[{"uniform": {"waves.x": [0, 1]}}])
    for number in range(0, len(plan), 2):
        assert plan.run(number).condition == plan.run(number + 1).condition
    assert len({plan.run(number).condition.values["waves.x"] for number in range(0, len(plan), 2)}) == 5
    values = [value_at(Range(low=1.0, high=3.0, whole=True), share) for share in np.arange(0, 1, 0.01)]
    assert [values.count(number) for number in (1, 2, 3)] == [34, 33, 33]


@pytest.mark.parametrize(("keys", "said"), [
    ({"vary": [{"pairs": {"a": [1, 2], "b": [1]}}]}, "as many values"),
    ({"vary": [{"uniform": {"a": [2, 1]}}]}, "below high"),
    ({"vary": [{"uniform": {"a": {"low": 0, "high": 1, "scale": "log"}}}]}, "above 0"),
    ({"vary": [{"uniform": {"a": [1, 2, 3]}}]}, "two numbers"),
    ({"seed": 0}, "greater than or equal to 1"),
])  # fmt: skip
def test_what_cannot_be_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        plan_of(**keys)
