"""The plan: conditions, drawn values and seeds, before anything is run."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.campaign.keys import CampaignKeys, Range
from modsim3d.campaign.plan import Plan, value_at


def plan_of(**keys: Any) -> Plan:
    return Plan.of(CampaignKeys.model_validate({"scene": "harbour", "trackers": ["reference", "sort"], **keys}))


def test_conditions_are_all_combinations_the_last_factor_changing_first() -> None:
    grid, pairs = {"waves.level": ["small", "large"]}, {"detector.a": [1, 2], "state": ["clear", "haze"]}
    plan = plan_of(vary=[{"grid": grid}, {"pairs": pairs}, {"list": [{"tracker.lost_s": 2}, {"sea": "curved"}]}])
    values = [dict(condition.values) for condition in plan.conditions]
    first = {"waves.level": "small", "detector.a": 1, "state": "clear"}
    assert values[:2] == [{**first, "tracker.lost_s": 2}, {**first, "sea": "curved"}] and len(values) == 2 * 2 * 2
    assert values[2]["state"] == "haze" and values[2]["detector.a"] == 2
    assert plan.parameters == ("waves.level", "detector.a", "state", "tracker.lost_s", "sea")

    # Each key belongs to the first layer that it changes.
    keys = {"waves.level": "small", "detector.x": 1, "state": "haze", "from": "d", "tracker.lost_s": 3}
    (condition,) = plan_of(vary=[{"list": [keys]}]).conditions
    assert (condition.of_truth(), condition.of_tracker()) == ({"waves.level": "small"}, {"lost_s": 3})
    assert condition.of_detector() == {"detector.x": 1, "state": "haze", "from": "d"}


def test_runs_are_in_order_and_all_that_is_compared_meets_the_same_seeds_and_no_two_repetitions_do() -> None:
    plan = plan_of(seed=7, seeds={"traffic": 4, "detector": 3}, vary=[{"grid": {"state": ["clear", "haze"]}}])
    runs = plan.runs(range(len(plan)))
    order = [(r.seed_index, r.condition_index, r.detector_seed % 1000, r.tracker.label) for r in runs]
    assert order == sorted(order) and len(set(order)) == len(runs) == 4 * 2 * 3 * 2
    by_place: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for run in runs:
        by_place.setdefault((run.condition_index, run.tracker.label), []).append((run.traffic_seed, run.detector_seed))
    assert len({tuple(seeds) for seeds in by_place.values()}) == 1
    assert len({run.traffic_seed for run in runs}) == 4 and len({run.detector_seed for run in runs}) == 12
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
    value = value_at(Range(low=float(low), high=float(low + width), whole=True), share)
    assert isinstance(value, int) and low <= value <= low + width
    assert low <= value_at(Range(low=float(low), high=float(low + width)), share) <= low + width
    assert 0.1 <= value_at(Range(low=0.1, high=10.0, scale="log"), share) <= 10
    assert value_at(Range(choices=["a", "b"]), share) == ("a" if share < 0.5 else "b")


def test_both_trackers_of_a_seed_get_the_same_draw_and_whole_numbers_are_equally_likely() -> None:
    plan = plan_of(seeds={"traffic": 5}, vary=[{"uniform": {"waves.x": [0, 1]}}])
    for number in range(0, len(plan), 2):
        assert plan.run(number).condition == plan.run(number + 1).condition
    assert len({plan.run(number).condition.values["waves.x"] for number in range(0, len(plan), 2)}) == 5
    values = [value_at(Range(low=1.0, high=3.0, whole=True), share) for share in np.arange(0, 1, 0.01)]
    assert [values.count(number) for number in (1, 2, 3)] == [34, 33, 33]
