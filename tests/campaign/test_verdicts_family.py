"""`level: family`: the confidence is that of all verdicts together, by Holm's step-down."""

import numpy as np
import pytest

from modsim3d.campaign.done_rows import needed_seeds
from modsim3d.campaign.verdicts.bounds import clean_seeds
from modsim3d.campaign.verdicts.verdict import judged
from modsim3d.campaign.verdicts.wording import levels_of, warnings_of
from tests.campaign.hand_made_tables import plan_of, table_of_runs, table_of_scores

CLEAN = {"score": "id_switches", "at_most": 0, "in": 0.9}
SCORES = ("id_switches", "hota", "mota", "idf1")


def verdicts_of(wrong, seeds, confidence=0.95, stop="once", level="family"):
    """Verdicts on shares of four scores, of which so many seeds are wrong."""
    require = [{"score": each, "at_least": 0.5, "in": 0.9, "confidence": confidence} for each in SCORES[1 : len(wrong)]]
    plan = plan_of(seeds, [{**CLEAN, "confidence": confidence}, *require], level=level, stop=stop)
    others = list(zip(SCORES[1:], wrong[1:], strict=False))
    rows = ({name: 0.1 if run < bad else 0.9 for name, bad in others} for run in range(seeds))
    return judged(plan, table_of_runs({"id_switches": int(run < wrong[0]), **row} for run, row in enumerate(rows)))


def test_a_verdict_alone_is_judged_at_its_own_level_and_two_at_half_of_it():
    assert [each.outcome for each in verdicts_of([0], 29)] == ["met"]
    both = clean_seeds(0.9, 0.975)
    for fewer, level, outcome in ((1, "family", "undecided"), (0, "family", "met"), (1, "each", "met")):
        assert [each.outcome for each in verdicts_of([0, 0], both - fewer, level=level)] == [outcome] * 2


def test_what_is_met_leaves_the_rest_of_the_level_to_the_others():
    """With 46 seeds, one wrong of them is shown with 95 % and not with 97.5 %; none wrong with both."""
    assert clean_seeds(0.9, 0.95, 1) == 46 < clean_seeds(0.9, 0.975, 1)
    first, second = verdicts_of([0, 1], 46)
    assert (first.outcome, first.confidence) == ("met", 0.975)
    assert (second.outcome, second.confidence) == ("met", pytest.approx(0.95))
    assert "97.5 % confidence" in first.why and "Judged at 95 %, by Holm" in second.why
    assert [each.outcome for each in verdicts_of([1, 1], 46)] == ["undecided"] * 2
    # Met and failed step down by themselves.
    outcomes = [(each.outcome, round(each.confidence, 6)) for each in verdicts_of([0, 40, 4], 46)]
    assert outcomes == [("met", 0.983333), ("failed", 0.983333), ("undecided", 0.975)]
    # What is open could still be met or fail: its level is the stricter one.
    outcomes = [(each.outcome, each.confidence) for each in verdicts_of([0, 4], 46)]
    assert outcomes == [("met", 0.975), ("undecided", 0.975)]


@pytest.mark.parametrize("stop", ["once", "sequential"])
def test_the_family_errs_no_more_than_one_of_its_verdicts_may(stop):
    """Eight shares at their threshold: each verdict alone is wrong more often in all than its level."""
    rng, wrong = np.random.default_rng(3), {"family": 0, "each": 0}
    names = ("hota", "deta", "idf1", "idr", "mota", "assa", "detre", "detpr")
    require = [{"score": name, "at_least": 0.5, "in": 0.8, "confidence": 0.9} for name in names]
    for _ in range(60):
        right = (rng.random((60, 8)) < 0.8).astype(float)
        table = table_of_runs(dict(zip(names, each, strict=True)) for each in right)
        for level in wrong:
            verdicts = judged(plan_of(60, require, level=level, stop=stop), table)
            wrong[level] += any(each.outcome == "met" for each in verdicts)
    assert wrong["family"] <= 0.1 * 60 + 6 and wrong["family"] < wrong["each"]


def test_a_mean_beyond_the_confidences_that_were_measured_is_undecided_and_says_so():
    require = [{"score": "hota", "at_least": 0.5}] * 6
    plan = plan_of(60, require, level="family")
    (why,) = {each.why for each in judged(plan, table_of_scores(plan, "hota", 0.8 + 0.02 * np.tile([-1, 1], 30)))}
    assert "99.16666667 % confidence" in why and "was not measured to hold" in why
    assert len(warnings_of(plan)) == 6 and warnings_of(plan_of(60, require[:5], level="family")) == []


def test_a_plan_is_warned_of_at_the_levels_that_the_family_can_reach_and_levels_say_whose_they_are():
    seeds = clean_seeds(0.9, 0.975)
    assert warnings_of(plan_of(seeds, [CLEAN] * 2, level="family")) == []
    assert len(warnings_of(plan_of(seeds - 1, [CLEAN] * 2, level="family"))) == 2
    assert clean_seeds(0.92, 0.95) == seeds < clean_seeds(0.92, 0.975)  # if the other is met first
    assert warnings_of(plan_of(seeds, [CLEAN, {**CLEAN, "in": 0.92}], level="family")) == []
    (first, _) = needed_seeds(plan_of(5, [CLEAN] * 2, level="family"), {}, None)
    assert first.seeds == seeds
    levels = levels_of(plan_of(5, [CLEAN] * 4, level="family"))
    assert (levels.met, levels.any_wrong) == (pytest.approx(0.05), pytest.approx(0.1))
    said = " ".join(levels.sentences())
    assert "that one or more of the 4 verdicts are met wrongly is at most 5 %" in said and "by Holm" in said
