"""What a search proposes: inside its ranges, from the seed and what came of earlier batches, and better in time."""

from statistics import mean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.campaign.keys import SearchKeys
from modsim3d.campaign.search_folder import Point, Tried, proposed

pytest.importorskip("optuna")


def search_of(**keys: object) -> SearchKeys:
    return SearchKeys.model_validate({"minimise": "hota", "over": {"x": [0, 1]}, "budget": 60, **keys})


def tried_of(points: list[Point], score: object, crashed: bool = False) -> list[Tried]:
    return [Tried(point, None if crashed else score(point), crashed) for point in points]  # type: ignore[operator]


def run(search: SearchKeys, seed: int, score: object) -> list[Tried]:
    """All trials of a search for the least score."""
    found: list[Tried] = []
    for batch in range(-(-search.budget // search.batch)):
        found += tried_of(proposed(search, seed, batch, found), score)
    return found


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-9, 1e6, allow_subnormal=False), st.floats(1e-12, 10), st.booleans(), st.integers(1, 9000))
def test_no_point_is_outside_of_its_range(low: float, width: float, log: bool, seed: int) -> None:
    """Also where the ends have more digits than the points."""
    high, scale = low * (1 + width), "log" if log else "linear"
    if not low < high:
        return
    over = {"x": {"low": low, "high": high, "scale": scale}, "c": {"choices": [None, "a", [1, 2]]}}
    over |= {"n": {"low": 2, "high": 4, "whole": True, "scale": scale}}
    search = search_of(over=over, budget=24, batch=12, seeds=3)
    first = proposed(search, seed, 0, [])
    for point in first + proposed(search, seed, 1, tried_of(first, lambda point: -point.places["x"])):
        values = point.values(search.over)
        assert low <= values["x"] <= high and values["n"] in (2, 3, 4) and isinstance(values["n"], int)
        assert values["c"] in (None, "a", [1, 2]) and point.seed_index in (0, 1, 2)


def test_a_batch_follows_from_the_seed_its_number_and_the_scores_before_it_of_which_crashes_are_none() -> None:
    search = search_of(over={"x": [0, 1], "y": [0, 1]})
    known = tried_of(proposed(search, 1, 0, []), lambda point: point.places["x"])
    other = tried_of(proposed(search, 1, 0, []), lambda point: point.places["y"])
    assert proposed(search, 1, 1, known) == proposed(search, 1, 1, known)
    assert proposed(search, 1, 1, known) != proposed(search, 1, 1, other)
    assert proposed(search, 1, 0, []) != proposed(search, 2, 0, [])
    assert len({point.places["x"] for batch in (0, 1) for point in proposed(search, 1, batch, [])}) == 20
    crashes = tried_of(proposed(search, 2, 0, []), None, crashed=True)
    assert proposed(search, 1, 2, [*known, *crashes]) == proposed(search, 1, 2, known)
    sizes = [len(proposed(search_of(budget=25), 1, batch, [])) for batch in range(3)]
    assert sizes == [10, 10, 5]  # the last one is what is left of the budget


@pytest.mark.parametrize("goal", ["minimise", "maximise"])
def test_a_search_comes_closer_to_the_worst_point(goal: str) -> None:
    sign = 1 if goal == "minimise" else -1
    keys = {"over": {"x": [0, 1], "y": [0, 1]}, "minimise": None, goal: "hota"}
    found = run(search_of(**keys), 1, lambda point: sign * abs(point.places["x"] - 0.2))
    distances = [abs(each.point.places["x"] - 0.2) for each in found]
    assert mean(distances[-20:]) < 0.4 * mean(distances[:20])


def test_a_seed_that_is_bad_is_tried_more_often_and_points_that_the_scene_refuses_are_avoided() -> None:
    found = run(search_of(seeds=4), 1, lambda point: float(point.seed_index != 2) + point.places["x"])
    assert sum(each.point.seed_index == 2 for each in found[-40:]) > 15  # 10 by chance
    found = run(search_of(), 1, lambda point: None if point.places["x"] > 0.5 else point.places["x"])
    assert sum(each.value is None for each in found[-20:]) < sum(each.value is None for each in found[:20]) / 2
