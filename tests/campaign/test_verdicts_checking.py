"""Requirements that cannot be judged are refused before the first run."""

import pytest

from tests.campaign.campaigns import checked_campaign, problems_of

KEYS = {"scene": "harbour", "steps": 20, "trackers": ["bytetrack"]}
GOSPA = {"score": "gospa", "at_most": 50}
HOTA = {"score": "hota", "at_least": 0.5}
DETECTORS = {"vary": [{"grid": {"detector": ["thesis", "conditions/foggy_clear"]}}]}
GRID = {"vary": [{"grid": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
PAIRS = {"vary": [{"pairs": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
DRAWN = {"vary": [{"uniform": {"state": {"choices": ["good", "bad"]}}}]}


@pytest.mark.parametrize(("keys", "requirement", "said"), [
    ({"stop": "sequential"}, GOSPA, "require[0]: with stop: sequential a mean needs"),
    ({}, {**GOSPA, "where": {"state": "bad"}}, "require[0].score: gospa is not known by state (known: hota, "),
    (DETECTORS, {**HOTA, "where": {"state": "bad"}}, "the detector of condition 1 has no state 'bad'"),
    (GRID, {**HOTA, "where": {"state": "baad"}}, "where.state: there is no 'baad' (did you mean 'bad'?)"),
    (GRID, {**HOTA, "where": {"waves.level": ["small", "huge"]}}, "where.waves.level: there is no 'huge'"),
    (GRID, {**HOTA, "where": {"waves.level": []}}, "require[0].where.waves.level: names no value"),
    (GRID, {**HOTA, "where": {"tracker": "sort"}}, "require[0].where.tracker: there is no 'sort'"),
    (PAIRS, {**HOTA, "where": {"state": "bad", "waves.level": "small"}}, "no condition has these values together"),
    (DRAWN, {**HOTA, "where": {"state": "bad"}}, "require[0].where.state: is drawn for each traffic seed"),
    ({}, {**HOTA, "in": 99}, "require[0].in: needs a share between 0 and 1, as in 0.99 (got 99)"),
    ({}, {**HOTA, "in": 1}, "no number of runs shows that every seed is right"),
    ({}, {**HOTA, "confidence": 95}, "require[0].confidence: needs a probability of 0.5 or more and below 1"),
])  # fmt: skip
def test_a_requirement_that_cannot_be_judged_is_refused(keys, requirement, said, tmp_path):
    found = problems_of(tmp_path, **KEYS, **keys, require=[requirement])
    assert any(said in problem for problem in found), found


def test_a_share_of_a_score_without_bounds_can_be_judged_sequentially(tmp_path):
    campaign = checked_campaign(tmp_path, **KEYS, require=[{**GOSPA, "in": 0.9}], stop="sequential")
    assert campaign.plan.keys.require[0].share == 0.9


def test_a_state_that_no_detector_has_is_one_problem_and_not_one_for_each_condition(tmp_path):
    (problem,) = problems_of(tmp_path, **KEYS, require=[{**HOTA, "where": {"state": "foggy"}}])
    assert problem.startswith("require[0].where.state: there is no 'foggy' (known: ")
