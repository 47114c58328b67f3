"""Requirements against tables written by hand: what is met, failed or undecided, and why."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pytest

from modsim3d.campaign.done_rows import needed_seeds
from modsim3d.campaign.verdicts.bounds import clean_seeds, perfect_seeds, skewed_bounds
from modsim3d.campaign.verdicts.seed_values import Runs, paired
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.verdicts.wording import levels_of, rounded, seeds_needed, warnings_of
from tests.campaign.hand_made_tables import plan_of, table_of_runs, table_of_scores, verdict_of

CLEAN = {"score": "id_switches", "at_most": 0, "in": 0.99}
HOTA = {"score": "hota", "at_least": 0.6}


@dataclass(frozen=True)
class Case:
    """A requirement on a score, its value in each run, and what the verdict has to be and to say."""

    requirement: dict
    values: list
    outcome: str
    expected: dict = field(default_factory=dict)
    why: tuple = ()
    crashed: Sequence = ()
    seeds: int | None = None
    keys: dict = field(default_factory=dict)


def around(mean, spread=0.02):
    """Values of a hundred seeds."""
    return mean + spread * np.tile([-1, 1], 50)


GOSPA, LEAST = {"score": "gospa", "at_most": 50}, {**HOTA, "at_least": 0.0001}
NEEDED = int(seeds_needed("hota", "low", 0.95))
ENOUGH = np.tile([0.7, 0.71, 0.72], NEEDED)[:NEEDED]
TOO_FEW, SEQUENTIAL, TWO_LOOKS = "ask for a share of seeds with `in`", {"stop": "sequential"}, {"detector": 2}
VERDICTS = {
    "299 clean seeds": Case(CLEAN, [0] * 299, "met", {"seeds": 299}),
    "298 clean seeds": Case(CLEAN, [0] * 298, "undecided"),
    "299 with a failure": Case(CLEAN, [1, *[0] * 298], "undecided", {"seeds": 299}, (
        "It would have taken 473 seeds with no more than 1 wrong.",
        "half the error each (`confidence: 0.975`), or use `stop: sequential`")),
    "473 with a failure": Case(CLEAN, [1, *[0] * 472], "met"),
    "299 with 20 failures": Case(CLEAN, [1] * 20 + [0] * 279, "failed"),
    "680 clean seeds in sequence": Case(CLEAN, [0] * 680, "met", seeds=1000, keys=SEQUENTIAL),
    "679 clean seeds in sequence": Case(CLEAN, [0] * 679, "undecided", seeds=1000, keys=SEQUENTIAL),
    "a campaign that is looked at once decides nothing before its end": Case(
        CLEAN, [0] * 299, "undecided", {"low": None, "high": None},
        ("299 traffic seeds of 300 are done, 100 % right so far",), seeds=300),
    "a seed is right if the runs with all its detector seeds are": Case(
        {**CLEAN, "in": 0.5}, [[0, 0], [0, 1], [1, 0]], "undecided", {"estimate": 1 / 3}, keys=TWO_LOOKS),
    "a mean is one over seeds of means over their runs": Case(
        HOTA, [[0.7, 0.9], [0.6, np.nan], [0.5, 0.5]], "undecided",
        {"estimate": 1.9 / 3, "low": max(0.0, float(skewed_bounds(np.array([0.8, 0.6, 0.5]), 0.05, 1.0)))},
        keys=TWO_LOOKS),
    "equal values prove nothing of a mean": Case(HOTA, [0.7] * 50, "undecided", why=("`in`",)),
    "a crashed run counts as wrong and never drops out": Case(
        CLEAN, [0] * 299, "undecided", {"seeds": 299, "crashed": 1, "estimate": 298 / 299}, crashed={7}),
    "a mean holds with the worst value for a crashed run": Case(
        HOTA, around(0.7), "met", why=("1 run crashed: the bounds take the worst and the best possible score in",),
        crashed=range(1)),
    "a mean does not hold with the worst value for 30": Case(HOTA, around(0.7), "undecided", crashed=range(30)),
    "a mean fails with the best value for crashed runs": Case(HOTA, around(0.5), "failed", crashed=range(2)),
    "a mean does not fail with the best value for 30": Case(HOTA, around(0.5), "undecided", crashed=range(30)),
    **{f"every run of {seeds} crashed: {requirement}": Case(
        requirement, [np.nan] * seeds, "failed", {"estimate": None}, (f"no run has {requirement['score'].upper()}",),
        range(seeds)) for requirement in (HOTA, GOSPA, LEAST) for seeds in (1, 12)},
    "every run with something to score crashed": Case(HOTA, [np.nan, np.nan], "failed", {"undefined": 1}, crashed=[0]),
    **{f"an infinite value makes a mean infinite and is not dropped: {side}": Case(
        {"score": "gospa", **side}, [1.1, np.inf, 1.2, np.inf, 1.0, 1.3], outcome,
        {"estimate": np.inf, "seeds": 6, "high": None}, ("the mean is ∞",))
       for side, outcome in (({"at_most": 3}, "failed"), ({"at_least": 0.5}, "undecided"))},
    "an infinite value is wrong where it may be no more than something": Case(
        {"score": "gospa", "at_most": 3, "in": 0.5}, [1, np.inf, 1, np.inf, 1, 1], "undecided", {"estimate": 4 / 6}),
    # Seeds of two detector seeds: right, wrong, right by one run, and without a value.
    "a run without a value is no right one and is named if it is left out": Case(
        {**HOTA, "in": 0.5}, [[0.7, 0.7], [0.7, 0.1], [np.nan, 0.7], [np.nan, np.nan]], "undecided",
        {"estimate": 2 / 3, "seeds": 3, "undefined": 1},
        ("1 run of other traffic seeds without HOTA left out: 1000002.",), keys=TWO_LOOKS),
    "a crashed run leaves a mean without worst value undecided": Case(
        GOSPA, np.arange(10.0), "undecided", {"high": None}, crashed={3}),
    "seeds without a value are counted apart and named": Case(
        HOTA, [0.7, np.nan, 0.72, 0.71, np.nan], "met", {"seeds": 3, "undefined": 2}, ("1000001, 1000004",)),
    "as many seeds as a mean needs": Case(HOTA, ENOUGH, "met"),
    "two seeds are too few for any mean": Case(
        {"score": "id_switches", "at_most": 90}, [70, 71], "undecided", {"low": None, "high": None},
        ("traffic seeds with a value, and has 2",)),
    "seeds without a value count neither for those that a mean needs": Case(
        HOTA, [np.nan, *ENOUGH[1:]], "undecided", why=(f"and has {NEEDED - 1}",)),
    "a mean whose bound was never measured to hold": Case(
        {**HOTA, "confidence": 0.9999}, around(0.7), "undecided", why=(TOO_FEW,)),
    "a threshold is told as it was given and a mean without exponent": Case(
        {"score": "gospa", "at_most": 1_234_567.5}, [23_456.0, 23_457.0, 23_461.0], "undecided",
        {"text": "gospa at most 1234567.5"}, ("the mean is 23458;",)),
}  # fmt: skip


@pytest.mark.parametrize("case", VERDICTS.values(), ids=VERDICTS)
def test_a_requirement_is_judged_by_all_runs(case):
    plan = plan_of(case.seeds or len(case.values), [case.requirement], **case.keys)
    verdict = verdict_of(plan, case.requirement["score"], case.values, case.crashed)
    assert verdict.outcome == case.outcome
    for name, value in case.expected.items():
        assert getattr(verdict, name) == (pytest.approx(value) if isinstance(value, float) else value), name
    assert all(words in verdict.why for words in case.why), verdict.why


@pytest.mark.parametrize("stop", ["once", "sequential"])
@pytest.mark.parametrize(("mean", "least", "most"), [
    (0.7, "met", "failed"), (0.5, "failed", "met"), (0.6, "undecided", "undecided")
])  # fmt: skip
def test_a_mean_is_judged_on_the_side_that_the_requirement_names(mean, least, most, stop):
    plan = plan_of(100, [HOTA, {"score": "hota", "at_most": 0.6}], stop=stop)
    assert [each.outcome for each in judge(plan, table_of_scores(plan, "hota", around(mean, 0.05)))] == [least, most]


SAID = {
    "a mean with two bounds": (
        {**SEQUENTIAL}, HOTA, np.tile([0.7, 0.8], 200), (),
        "Over 400 traffic seeds the mean is 0.75; the true mean is at least 0.7408 and at most 0.7569, each with 95 % "
        "confidence."),
    "a share with crashed runs": (
        {}, {**HOTA, "in": 0.5}, [0.7, 0.7, 0.7, 0.1, 0.7, 0.7], (0, 1),
        "3 of 6 traffic seeds are right; the true share is at least 0.1531 and at most 0.8469, each with 95 % "
        "confidence. 2 runs crashed: these count as wrong."),
    "one bound": (
        {}, {**HOTA, "in": 0.5}, [0.7] * 6, (),
        "6 of 6 traffic seeds are right; the true share is at least 0.6069 and at most 1, each with 95 % confidence."),
    "one seed": (
        {}, HOTA, [0.7], (),
        "Over 1 traffic seed the mean is 0.7; one seed says nothing of how much seeds differ. This plan can never meet "
        f"it: the lower bound of a mean of HOTA needs {NEEDED} traffic seeds with a value, and has 1: with fewer it "
        "errs too often; a share of seeds with `in` is exact."),
}  # fmt: skip


@pytest.mark.parametrize(("keys", "requirement", "values", "crashed", "said"), SAID.values(), ids=SAID)
def test_a_verdict_says_what_it_rests_on_in_sentences(keys, requirement, values, crashed, said):
    assert verdict_of(plan_of(len(values), [requirement], **keys), "hota", values, crashed).why == said


def test_runs_that_are_lost_are_counted_by_their_kind_in_one_sentence():
    both = ({"tracker": "sort", "name": "old"}, {"tracker": "bytetrack", "name": "new"})
    difference = {"score": "hota", "of": "new", "minus": "old", "at_least": 0.1, "in": 0.5}
    (verdict,) = judge(plan := plan_of(4, [difference], both), table_of_scores(plan, "hota", [0.5, 0.9] * 4, (0,)))
    assert verdict.why.endswith(" 1 run crashed, of either tracker: this counts as wrong.")
    resting = {"score": "assa", "at_least": 0.1, "in": 0.5, "resting_on": 0.5}
    for more, words in ((resting, " or too little"), ({**resting, "resting_on": None}, "")):
        rows = ({"appearances": 2, "assa": None if run == 1 else 0.7} for run in range(4))
        (verdict,) = judge(plan_of(4, [more]), table_of_runs(rows, (0,)))
        assert f"1 run crashed and in 1 run the tracker gave nothing{words} to score" in verdict.why, verdict.why


def test_levels_are_told_of_one_verdict_of_two_and_of_a_family():
    def said(count, **keys):
        return levels_of(plan_of(9, [{**HOTA, "in": 0.5}, {**CLEAN, "in": 0.5}][:count], **keys)).sentences()

    assert said(0) == []
    (alone,) = said(1)
    assert alone.endswith("called failed with at most 5 %, if the campaign is looked at once.")
    assert said(1, **SEQUENTIAL)[0].endswith(", however often the campaign is looked at.")
    _, all_met, any_wrong = said(2)
    assert "all 2 verdicts are met" in all_met and any_wrong.endswith("are wrong is at most 10 %.")
    _, family = said(2, level="family")
    assert "one or more of the 2 verdicts are met wrongly is at most 5 %" in family and family.endswith("by Holm.")
    assert len(said(1, level="family")) == 1
    of_mean = levels_of(plan_of(9, [HOTA])).sentences()
    assert of_mean[0].endswith("looked at once, of means as far as it was measured.") and "is no proof" in of_mean[1]


def test_what_a_plan_can_never_meet_is_said_before_it_starts_and_of_the_side_that_is_asked():
    def warned(seeds, requirement, **keys):
        (said,) = warnings_of(plan_of(seeds, [{"score": "hota", **requirement}], **keys)) or [""]
        return said

    assert "299 traffic seeds that are all right, or 473 if one is not, and has 298" in warned(298, CLEAN)
    assert "680" in warned(679, CLEAN, stop="sequential")
    assert warned(299, CLEAN) == warned(680, CLEAN, stop="sequential") == ""
    assert warned(50, {"at_least": 1.2}) and warned(1, HOTA)
    assert TOO_FEW in warned(50, {"score": "id_switches", "at_most": 0})
    assert "over all detectors that the labelled set allows" in warned(50, HOTA, uncertainty="learned")
    assert warned(50, {**HOTA, "in": 0.9}, uncertainty="learned") == ""
    for side, best, end, bound in (("at_least", 1.0, "greatest", "lower"), ("at_most", 0.0, "least", "upper")):
        assert f"no number of runs shows that a mean is the {end} possible value" in warned(20, {side: best})
        assert f"the {bound} bound of a mean of HOTA needs" in warned(1, {side: 0.5})
    for requirement, share in (({"at_least": 0.9}, 0.9), ({"at_most": 0.1}, 0.9), ({"at_most": 0.6}, 0.4)):
        needed = int(perfect_seeds(share, 0.95))
        said = f"it needs {needed} traffic seeds even if every score is perfect, and has {needed - 1}"
        assert said in warned(needed - 1, requirement, **SEQUENTIAL)
        assert warned(needed, requirement, **SEQUENTIAL) == ""


def test_numbers_have_four_digits_and_bounds_are_rounded_away_from_what_they_bound():
    for value, down, near, up in (
        (23456.7, "23456", "23457", "23457"),
        (120.0, "120", "120", "120"),
        (1.23456, "1.234", "1.235", "1.235"),
        (-1.23456, "-1.235", "-1.235", "-1.234"),
        (1.2340000001, "1.234", "1.234", "1.235"),  # more than rounding above
        (0.0123456, "0.01234", "0.01235", "0.01235"),
        (0.999951234, "0.99995123", "0.99995123", "0.99995124"),  # of what it lacks to 1
        (0.3 - 0.1, "0.2", "0.2", "0.2"),  # a hair below
        (0.0, "0", "0", "0"),
        (np.inf, "∞", "∞", "∞"),
    ):
        assert (rounded(value, math.floor), rounded(value), rounded(value, math.ceil)) == (down, near, up)


def test_seeds_in_which_nothing_went_wrong_fail_nothing_and_one_with_a_run_of_nothing_is_wrong():
    plan = plan_of(4, [{"score": "mean_track_break_s", "at_most": 3, "resting_on": 0.5}])
    (verdict,) = judge(plan, table_of_runs({"appearances": 2, "established": 2 * (run > 0)} for run in range(4)))
    assert (verdict.outcome, verdict.nothing, verdict.undefined) == ("undecided", 1, 3)
    assert "nothing of that kind went wrong" in verdict.why
    plan = plan_of(2, [{"score": "detpr", "at_least": 0.6, "in": 0.5}], detector=2)
    (verdict,) = judge(plan, table_of_runs({"appearances": 3, "detpr": detpr} for detpr in (0.9, None, 0.9, 0.9)))
    assert (verdict.estimate, verdict.nothing, verdict.undefined, verdict.left_out) == (0.5, 1, 0, 0)


@pytest.mark.parametrize(("requirement", "said"), [
    ({"score": "id_switches", "at_most": 0, "in": 0.5}, True), ({"score": "false_track_s", "at_most": 3}, True),
    ({"score": "mota", "at_least": -1}, True), ({"score": "mota", "at_least": 0.5}, False),
    ({"score": "gospa", "at_most": 50}, True), ({"score": "gospa", "at_most": 49}, False),
    ({"score": "misses", "at_most": 10}, True), ({"score": "misses", "at_most": 9}, False),
    ({"score": "assa", "at_least": 0.1}, False),
    ({"score": "id_switches", "at_most": 0, "in": 0.5, "resting_on": 0.5}, False),
])  # fmt: skip
def test_a_requirement_that_no_tracks_at_all_would_meet_says_so(requirement, said):
    """In each run there are 10 vessel-frames in 10 frames: without tracks GOSPA is half of its cutoff, 100 px."""
    row = {"frames": 10, "true_positives": 8, "misses": 2, "appearances": 2, "id_switches": 0, "false_track_s": 1.0}
    table = table_of_runs({**row, "gospa": 9.0 + run, "mota": 0.7 + run / 100} for run in range(6))
    for seeds in (1, 6):
        (verdict,) = judge(plan_of(seeds, [requirement]), table.slice(0, seeds))
        assert verdict.met_without_tracks == said == ("No tracks at all would meet it too" in verdict.why)


def test_each_tracker_and_each_condition_has_a_verdict_and_drawn_values_split_nothing():
    vary = [{"grid": {"detector.miss_rate": [0.1, 0.2]}}, {"uniform": {"waves.level": [0, 3]}}]
    one_case = {**HOTA, "where": {"tracker": "sort", "detector.miss_rate": 0.2}}
    plan = plan_of(4, [HOTA, one_case], ("bytetrack", "sort"), vary=vary)
    values = np.add.outer([0.01, 0.02, 0.03, 0.04], [0.1, 0.2, 0.3, 0.4])  # by seed, condition and tracker
    verdicts = judge(plan, table_of_scores(plan, "hota", values))
    found = [(each.requirement, each.tracker, each.values["detector.miss_rate"]) for each in verdicts]
    of_all = [(0, "bytetrack", 0.1), (0, "bytetrack", 0.2), (0, "sort", 0.1), (0, "sort", 0.2)]
    assert found == [*of_all, (1, "sort", 0.2)]
    assert [each.estimate for each in verdicts] == pytest.approx([0.125, 0.325, 0.225, 0.425, 0.425])
    assert levels_of(plan).any_wrong == pytest.approx(0.25) and levels_of(plan).all_met == pytest.approx(0.05)


def test_levels_leave_out_a_bound_that_says_nothing_and_are_never_a_probability_of_a_hundred_percent():
    said = {count: levels_of(plan_of(5, [HOTA] * count)).sentences() for count in (12, 19, 20, 21)}
    for count, percent in ((12, 60), (19, 95)):
        words = f"The probability that one or more of the {count} verdicts are wrong is at most {percent} %."
        assert words in said[count]
    assert any("Of the 21 verdicts up to 1.05 are wrong on average" in each for each in said[21])
    assert not [each for count in (20, 21) for each in said[count] if "100 %" in each or "one or more" in each]
    first, *_, last = said[20]
    assert "as far as it was measured" in first and last.endswith("`in` is exact there too.")


def test_rows_behind_a_missing_one_do_not_count_and_a_crashed_run_rests_on_nothing():
    plan = plan_of(1000, [{**CLEAN, "in": 0.5}], stop="sequential")
    table = table_of_scores(plan, "id_switches", [0] * 20)
    assert judge(plan, pa.concat_tables([table.slice(0, 5), table.slice(6)]))[0].seeds == 5
    values, share = np.array([[1.0], [np.nan], [2.0]]), np.array([[0.8], [np.nan], [0.4]])
    assert Runs(values, np.isnan(values), np.zeros((3, 1), dtype=bool), share).rests_on == pytest.approx(0.4)


@pytest.mark.parametrize("stop", ["once", "sequential"])
@pytest.mark.parametrize("requirement", [
    {"score": "hota", "at_least": 1}, {"score": "hota", "at_most": 0}, {"score": "hota", "at_least": 1.2, "in": 0.5},
])  # fmt: skip
def test_a_mean_at_the_end_of_its_score_and_a_value_beyond_it_can_never_be_met(requirement, stop):
    assert warnings_of(plan_of(5_000, [requirement], stop=stop))
    best = 1.0 if "at_least" in requirement else 0.0
    assert verdict_of(plan_of(50, [requirement], stop=stop), "hota", [best] * 50).outcome != "met"


def test_the_seeds_between_two_measured_confidences_are_those_that_both_need(monkeypatch):
    seeds = {"hota": {"low": [3, 20, 10, 30], "high": [3, None, 3, 3]}}
    offers = {"confidences": [0.9, 0.95, 0.99, 0.999], "seeds": seeds}
    monkeypatch.setattr("modsim3d.campaign.verdicts.wording.measured_offers", lambda: offers)
    found = [seeds_needed("hota", "low", each) for each in (0.89, 0.9, 0.92, 0.95, 0.97, 0.99, 0.995, 0.9995)]
    assert found == [np.inf, 3, 20, 20, 20, 10, 30, np.inf]
    assert seeds_needed("hota", "high", 0.92) == seeds_needed("loca", "low", 0.95) == np.inf


def test_seeds_that_never_reach_a_state_are_left_out_and_the_state_is_named():
    plan = plan_of(6, [{**HOTA, "in": 0.5, "where": {"state": "haze"}}])
    rows = ({"hota": 0.1, "state.haze.hota": hota} for hota in (0.7, None, 0.72, 0.71, 0.7, 0.7))
    (verdict,) = judge(plan, table_of_runs(rows))
    assert (verdict.outcome, verdict.seeds, verdict.undefined) == ("met", 5, 1)
    assert "1 traffic seed without HOTA in state haze left out: 1000001. The truth has nothing to score" in verdict.why


def paired_scores(values, score="hota", crashed=(), seeds=None, **keys):
    """The difference of two trackers' scores, a row for each traffic seed."""
    plan = plan_of(seeds or len(values), [], ("bytetrack", "sort"), **keys)
    (found,) = paired(plan, table_of_scores(plan, score, values, crashed), score)
    return found


def test_pairing_takes_off_what_both_trackers_share():
    rng = np.random.default_rng(4)
    traffic, own = rng.normal(0.6, 0.05, (40, 1)), rng.normal(0, 0.01, (40, 2))
    values = traffic + own + [0.03, 0.0]
    found = paired_scores(values)
    difference = values[:, 0] - values[:, 1]
    assert (found.first, found.second, found.seeds) == ("bytetrack", "sort", 40)
    assert found.mean == pytest.approx(difference.mean())
    assert found.high - found.mean == pytest.approx(2.0227 * difference.std(ddof=1) / 40**0.5, rel=1e-4)
    assert found.variance_ratio == pytest.approx(values.var(axis=0, ddof=1).sum() / difference.var(ddof=1))
    assert found.variance_ratio > 10


def test_a_sequential_difference_has_an_interval_only_if_the_score_has_bounds_and_differences_are_not_the_same():
    values = np.tile([[0.9, 0.3], [0.8, 0.4]], (100, 1))
    found, unbounded = (paired_scores(values, score, **SEQUENTIAL) for score in ("hota", "gospa"))
    assert found.low < 0.5 < found.high and found.low > 0.3
    assert unbounded.low is unbounded.high is None and unbounded.mean == pytest.approx(0.5)
    nothing = paired_scores(values[:0], seeds=400, **SEQUENTIAL)
    assert (nothing.mean, nothing.low, nothing.high) == (None, None, None)
    alike = paired_scores(np.array([[0.9, 0.8], [0.7, 0.6], [0.4, 0.3]]))
    assert alike.mean == pytest.approx(0.1) and alike.low is alike.high is alike.variance_ratio is None


def test_a_run_that_crashed_or_has_nothing_to_score_widens_a_paired_difference_and_does_not_drop_out():
    values = np.tile([[0.7, 0.5], [0.68, 0.5]], (50, 1))
    whole, lost = paired_scores(values), paired_scores(values, crashed=(6,))
    assert (lost.crashed, lost.seeds) == (1, 99) and lost.low < whole.low and lost.high > whole.high
    assa = (None if run == 7 else 0.7 + run % 4 / 100 for run in range(100))
    table = table_of_runs({"appearances": 2, "assa": each} for each in assa)
    (found,) = paired(plan_of(50, [], ("bytetrack", "sort")), table, "assa")
    assert (found.crashed, found.undefined, found.seeds) == (1, 0, 49)


MOSTLY_CLEAN = {"score": "id_switches", "at_most": 0, "in": 0.9}
SCORES = ("id_switches", "hota", "mota", "idf1")


def verdicts_of(wrong, seeds, confidence=0.95, stop="once", level="family"):
    """Verdicts on shares of four scores, of which so many seeds are wrong."""
    require = [{"score": each, "at_least": 0.5, "in": 0.9, "confidence": confidence} for each in SCORES[1 : len(wrong)]]
    plan = plan_of(seeds, [{**MOSTLY_CLEAN, "confidence": confidence}, *require], level=level, stop=stop)
    others = list(zip(SCORES[1:], wrong[1:], strict=False))
    rows = ({name: 0.1 if run < bad else 0.9 for name, bad in others} for run in range(seeds))
    return judge(plan, table_of_runs({"id_switches": int(run < wrong[0]), **row} for run, row in enumerate(rows)))


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
            verdicts = judge(plan_of(60, require, level=level, stop=stop), table)
            wrong[level] += any(each.outcome == "met" for each in verdicts)
    assert wrong["family"] <= 0.1 * 60 + 6 and wrong["family"] < wrong["each"]


def test_a_mean_beyond_the_confidences_that_were_measured_is_undecided_and_says_so():
    require = [{"score": "hota", "at_least": 0.5}] * 6
    plan = plan_of(60, require, level="family")
    (why,) = {each.why for each in judge(plan, table_of_scores(plan, "hota", 0.8 + 0.02 * np.tile([-1, 1], 30)))}
    assert "99.16666667 % confidence" in why and "was not measured to hold" in why
    assert len(warnings_of(plan)) == 6 and warnings_of(plan_of(60, require[:5], level="family")) == []


def test_a_plan_is_warned_of_at_the_levels_that_the_family_can_reach_and_levels_say_whose_they_are():
    seeds = clean_seeds(0.9, 0.975)
    assert warnings_of(plan_of(seeds, [MOSTLY_CLEAN] * 2, level="family")) == []
    assert len(warnings_of(plan_of(seeds - 1, [MOSTLY_CLEAN] * 2, level="family"))) == 2
    assert clean_seeds(0.92, 0.95) == seeds < clean_seeds(0.92, 0.975)  # if the other is met first
    assert warnings_of(plan_of(seeds, [MOSTLY_CLEAN, {**MOSTLY_CLEAN, "in": 0.92}], level="family")) == []
    (first, _) = needed_seeds(plan_of(5, [MOSTLY_CLEAN] * 2, level="family"), {}, None)
    assert first.seeds == seeds
    levels = levels_of(plan_of(5, [MOSTLY_CLEAN] * 4, level="family"))
    assert (levels.met, levels.any_wrong) == (pytest.approx(0.05), pytest.approx(0.1))
    said = " ".join(levels.sentences())
    assert "that one or more of the 4 verdicts are met wrongly is at most 5 %" in said and "by Holm" in said
