"""Requirements that cannot be judged are refused before the first run."""

import pytest

from tests.campaign.campaigns import checked_campaign, problems_of

KEYS = {"scene": "harbour", "steps": 20, "trackers": ["bytetrack"]}
GOSPA = {"score": "gospa", "at_most": 50}
HOTA = {"score": "hota", "at_least": 0.5}
RECALL = {"score": "recall", "at_least": 0.8, "in": 0.5}
SURVIVED = {"score": "occlusions_survived", "at_least": 0.6, "in": 0.5}
NO_WORSE = {"score": "siap_completeness", "of": "new", "minus": "old", "at_least": -0.02}
DETECTORS = {"vary": [{"grid": {"detector": ["thesis", "conditions/foggy_clear"]}}]}
GRID = {"vary": [{"grid": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
PAIRS = {"vary": [{"pairs": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
DRAWN = {"vary": [{"uniform": {"state": {"choices": ["good", "bad"]}}}]}
TWO_CAMERAS = {"scene": "simulation_3", "trackers": ["reference"]}
OLD_AND_NEW = {"trackers": [{"tracker": "sort", "name": "old"}, {"tracker": "bytetrack", "name": "new"}]}


@pytest.mark.parametrize(("keys", "requirement", "said"), [
    ({"stop": "sequential"}, GOSPA, "require[0]: with stop: sequential a mean needs"),
    ({}, {**GOSPA, "where": {"state": "bad"}}, "require[0].score: gospa is not known by state (known: hota, "),
    ({}, {**HOTA, "where": {"state": "foggy"}}, "require[0].where.state: there is no 'foggy' (known: "),
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
    # Parts that no run has, and scores that are not known of a part.
    ({}, {**RECALL, "where": {"visible_fraction": "half"}},
     "visible_fraction: there is no 'half' (known: 1, 0.75 to 1, 0.5 to 0.75, 0.25 to 0.5, below 0.25)"),
    ({}, {**RECALL, "where": {"range": 7}}, "range: there is no 7 (known: 0 to 100, 100 to 200, 200 to 400, 400 to"),
    (TWO_CAMERAS, {**HOTA, "where": {"camera": "bow"}}, "camera: there is no 'bow' (known: "),
    ({}, {**HOTA, "where": {"camera": "quay"}}, "the scene of condition 0 has no other camera: leave it out"),
    ({}, {**RECALL, "where": {"range": "0 to 100", "size": "0 to 16"}},
     "where: range and size each divide the runs, and only one may: leave all but one out"),
    ({}, RECALL, "score: recall is known of parts of the runs only: `where` needs one of visible_fraction, occlusion"),
    ({}, {**SURVIVED, "where": {"size": "0 to 16"}}, "occlusions_survived is not known by size (known: recall)"),
    (TWO_CAMERAS, {**RECALL, "where": {"camera": "C1"}}, "recall is not known by camera (known: hota, deta, assa"),
    ({}, {**HOTA, "where": {"occlusion": "3 to 10"}}, "hota is not known by occlusion (known: recall, occlusions_surv"),
    # Differences that name no two trackers.
    (OLD_AND_NEW, {**NO_WORSE, "minus": None}, "require[0]: a difference needs both of and minus"),
    (OLD_AND_NEW, {**NO_WORSE, "of": "newest"}, "of: there is no tracker 'newest' (did you mean 'new'?)"),
    (OLD_AND_NEW, {**NO_WORSE, "minus": "ancient"}, "minus: there is no tracker 'ancient' (known: old, new)"),
    (OLD_AND_NEW, {**NO_WORSE, "minus": "new"}, "require[0]: of and minus are both 'new'"),
    (OLD_AND_NEW, {**NO_WORSE, "where": {"tracker": "new"}}, "require[0]: a difference names its trackers with of and"),
])  # fmt: skip
def test_a_requirement_that_cannot_be_judged_is_one_problem(keys, requirement, said, tmp_path):
    (problem,) = problems_of(tmp_path, **{**KEYS, **keys}, require=[requirement])
    assert said in problem


def test_a_family_has_one_confidence(tmp_path):
    (said,) = problems_of(tmp_path, **KEYS, level="family", require=[HOTA, {**HOTA, "confidence": 0.9}])
    assert said == "level: family has one confidence for all requirements, and these have 0.9 and 0.95"


def test_a_share_of_a_score_without_bounds_can_be_judged_sequentially_and_a_bin_may_be_called_by_a_number(tmp_path):
    whole = {**RECALL, "where": {"visible_fraction": 1}}  # the bin is called "1", and YAML reads a number
    campaign = checked_campaign(tmp_path, **KEYS, require=[{**GOSPA, "in": 0.9}, whole], stop="sequential")
    assert [each.share for each in campaign.plan.keys.require] == [0.9, 0.5]
