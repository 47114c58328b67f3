"""Every score with trackers that give nothing, little or everything: whose fault it is that one is undefined."""

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from modsim3d.campaign.keys import ScoreKeys
from modsim3d.campaign.plan import Case
from modsim3d.campaign.verdicts.seed_values import SeedRows
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.work.row import SCORES, SHARES, WORLD_SCORES, facts_of, score_bounds, without_tracks
from modsim3d.tracking.score_text import keys_of
from modsim3d.tracking.scores.scoring import scores_of
from tests.campaign.hand_made_tables import plan_of, table_of_runs
from tests.tracking.hand_made import Seen, Tracked, box, hand_made

KEYS, CASE, STEPS = ScoreKeys(), Case(0, 0), 8
MANAGED = [name for name in SCORES if facts_of(name).managed]

NEAR, HARD = [box(10 + k, 10, 40, 40) for k in range(STEPS)], [box(200 + k, 100) for k in range(STEPS)]

TRUTH = [(k, 0, NEAR[k]) for k in range(STEPS)]
TRUTH += [Seen(k, 1, HARD[k], {3: 0.2, 4: 0.0}.get(k, 1.0)) for k in range(STEPS)]  # which is hidden for two steps
SURE = ((4.0, 0.0), (0.0, 4.0))


def track(number, boxes, frames=range(STEPS)):
    return [Tracked(k, number, boxes[k], -1, SURE) for k in frames]


EASIEST, PERFECT = track(7, NEAR), [*track(7, NEAR), *track(8, HARD)]


def runs_of(truth, tracks, score, resting_on=None):
    rows = scored(tuple(truth), tuple(tracks))
    return rows.runs_of(CASE, score, resting_on), rows.columns(CASE)


@cache
def scored(truth, tracks):
    row = {"frames": STEPS, **keys_of(scores_of(hand_made(truth, tracks, STEPS)))}
    return SeedRows(plan_of(1, []), table_of_runs([row]))


@pytest.mark.parametrize("score", SCORES)
def test_without_tracks_a_score_has_its_value_or_it_is_the_trackers_fault(score):
    runs, column = runs_of(TRUTH, [], score)
    value, known = float(runs.values[0, 0]), without_tracks(score, KEYS, column)
    assert bool(runs.nothing.all()) == math.isnan(value) == facts_of(score).managed
    if facts_of(score).without_tracks is not None:
        assert value == facts_of(score).without_tracks
    if known is not None:
        assert value == pytest.approx(float(known[0, 0]))
    (requirement,) = plan_of(1, [{"score": score, "at_most": 1e9}]).keys.require
    assert runs.right(requirement)[0] == (not facts_of(score).managed)


@pytest.mark.parametrize("tracks", [[], track(9, HARD)], ids=["nothing", "a false track"])
@pytest.mark.parametrize("score", SCORES)
def test_without_vessels_no_score_is_the_trackers_fault(score, tracks):
    runs, _ = runs_of([], tracks, score)
    assert not runs.nothing.any() and runs.undefined.all() == np.isnan(runs.values).all()


@pytest.mark.parametrize("score", SCORES)
def test_a_perfect_tracker_is_never_at_fault_and_rests_on_everything(score):
    runs, _ = runs_of(TRUTH, PERFECT, score, resting_on=1)
    least, greatest = score_bounds(score, KEYS)
    assert not runs.nothing.any() and runs.rests_on == 1
    assert bool(runs.undefined.all()) == facts_of(score).of_faults  # nothing went wrong
    assert runs.undefined.all() or least <= runs.values[0, 0] <= greatest
    best = score in SHARES and not runs.undefined.all()
    assert not best or runs.values[0, 0] == pytest.approx(0.0 if facts_of(score).low_is_good else 1.0)


@pytest.mark.parametrize("hidden", [[0, 1], [6, 7]], ids=["when it appears", "when it is seen last"])
def test_an_occlusion_that_no_tracker_could_survive_is_nobodys_fault(hidden):
    truth = [Seen(k, 1, HARD[k], 0.2 if k in hidden else 1.0) for k in range(STEPS)]
    runs, column = runs_of(truth, track(8, HARD), "occlusions_survived")
    assert (column("occlusions")[0, 0], column("occlusions_to_survive")[0, 0]) == (1, 0)
    assert runs.undefined.all() and not runs.nothing.any()


@pytest.mark.parametrize("tracks", [track(7, NEAR, [2]), EASIEST], ids=["one frame", "easiest vessel"])
@pytest.mark.parametrize("score", SCORES)
def test_a_tracker_that_gives_up_rests_on_a_share_and_is_at_fault_where_more_is_asked_for(score, tracks):
    runs, _ = runs_of(TRUTH, tracks, score)
    assert runs.rests_on is not None and runs.rests_on <= 0.6
    assert runs_of(TRUTH, tracks, score, resting_on=0.7)[0].nothing.all()
    assert bool(runs.nothing.any()) == (score == "occlusions_survived")  # the other vessel has the one occlusion


@pytest.mark.parametrize("score", MANAGED)
def test_giving_up_on_the_hard_vessel_never_makes_a_managed_score_worse(score):
    """The hard one is off, late, followed by two tracks, lost for a while, and there is a false track."""
    off = [box(206 + k, 104) for k in range(STEPS)]
    hard = [*track(8, off, [1, 2]), *track(9, off, [6, 7]), *track(5, [box(500, 300)] * STEPS)]
    tried, given_up = (runs_of(TRUTH, [*EASIEST, *each], score)[0] for each in (hard, []))
    values = [float(each.values[0, 0]) for each in (tried, given_up)]
    assert math.isnan(values[1]) or (max if high_is_good(score) else min)(values) == values[1]


def high_is_good(score):
    return facts_of(score).greatest == 1 and score != "siap_spuriousness"


def good_of(score):
    """A good value, and a requirement that it meets."""
    return (0.95, {"at_least": 0.8}) if high_is_good(score) else (0.05, {"at_most": 0.3})


def rows_with(score, values, **columns):
    """Rows of a score, None where the tracker gave nothing; each truth has three vessels and an occlusion."""
    whole = {"appearances": 3, "occlusions_to_survive": 1, "frames": 9}
    typed = [value if value is None or SCORES[score] == "double" else int(value) for value in values]
    return table_of_runs({**whole, "established": 3 * (each is not None), **columns, score: each} for each in typed)


@pytest.mark.parametrize("score", MANAGED)
@pytest.mark.parametrize("share", [{}, {"in": 0.5}, {"resting_on": 0.1}, {"resting_on": 0.1, "in": 0.8}])
def test_a_tracker_that_gives_nothing_in_4_of_12_seeds_meets_nothing(score, share):
    good, side = good_of(score)
    values = [None if run % 3 == 0 else good + 0.001 * run for run in range(12)]
    (verdict,) = judge(plan_of(12, [{"score": score, **side, **share}]), rows_with(score, values))
    assert verdict.outcome != "met" and (verdict.seeds, verdict.nothing, verdict.undefined) == (12, 4, 0)
    assert "In 4 runs the tracker gave nothing" in verdict.why
    if "in" in share:
        assert verdict.estimate == pytest.approx(8 / 12)
    elif not math.isfinite(facts_of(score).greatest):
        assert f"the mean of the 8 with a value is {np.mean([v for v in values if v]):.4g}" in verdict.why
        assert "it cannot be met" in verdict.why


@pytest.mark.parametrize("score", MANAGED)
def test_what_the_tracker_manages_is_met_only_with_the_share_that_it_must_rest_on(score):
    good, side = good_of(score)
    values = [good + 0.001 * run for run in range(12)]
    parts = {"true_positives": 90, "misses": 10, "nees_pairs": 90, "established_share": 0.9, "occlusions_judged": 9}
    table = rows_with(score, values, **parts, occlusions_to_survive=10)
    required = [{"score": score, **side, "in": 0.5, "resting_on": share} for share in (None, 0.85, 0.95)]
    without, some, more = judge(plan_of(12, required), table)
    assert (without.outcome, some.outcome, more.outcome) == ("undecided", "met", "failed")
    assert "`resting_on`, as in `resting_on: 0.8`" in without.why
    assert "It rests on 90 % of" in some.why and some.rests_on == pytest.approx(0.9)


PAGE = Path(__file__).resolve().parents[2] / "docs" / "requirements.md"


def rows_of_the_page():
    """What the page's table of scores has to say, a row for each score, from the code."""
    special = {"gospa": "its `gospa_missed`", "ospa": "`--gospa` in each frame with a vessel"}
    special |= {"gospa_missed": "all missed", "misses": "all vessel-frames", "mostly_lost": "all appearances"}
    for score in SCORES:
        facts, (least, greatest) = facts_of(score), score_bounds(score, KEYS)
        bounds = f"{least:g} to {greatest:g}".replace("inf", "∞").replace("-", "−")
        empty = special.get(score, "the truth's")
        if facts.managed:
            empty = "**nothing to score**"
        elif facts.without_tracks is not None:
            empty = f"{facts.without_tracks:g}"
        dead = [f"{each:g}" if math.isfinite(each) else "never met" for each in (least, greatest)]
        left_out = "nothing" if not facts.managed and SCORES[score] == "int64" else f"no {LEFT_OUT[facts.expected]}"
        if score.startswith("hidden_") and score != "hidden_vessel_frames":
            left_out = "nothing hidden"
        if score.startswith(("gospa", "ospa", "false_", "track_break_s", "lost_s")):
            left_out = "nothing"
        left_out += ", or none of these" * facts.of_faults
        rests = BASES[facts.basis.part] if facts.managed else ""
        yield f"| `{score}` | {bounds} | {empty} | {dead[0]} | {dead[1]} | {left_out} | {rests} |"


LEFT_OUT = {"appearances": "vessel", "occlusions_to_survive": "occlusion to survive"}
BASES = {"true_positives": "vessel-frames followed", "nees_pairs": "vessel-frames with a covariance"}
BASES |= {"established_share": "`established_share`"}
BASES |= {"occlusions_judged": "`occlusions_judged` / `occlusions_to_survive`"}


def test_the_page_has_what_trackers_without_tracks_do_to_each_score():
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    told = [line for line in lines if line.startswith("| `") and line.split("`")[1] in SCORES]
    assert told == list(rows_of_the_page())


def test_the_page_has_every_score_in_the_world_by_what_trackers_without_tracks_do_to_it():
    section = PAGE.read_text(encoding="utf-8").split("## Scores in the world")[1]
    told = {}
    for line in (line for line in section.splitlines() if line.startswith("| `")):
        names, empty, _, rests, _ = (cell.strip() for cell in [*line.strip("|").split("|"), ""])
        names = re.findall("`(.*?)`", names)
        more = [f"{name}_{end}" for name in names[:2] for end in ("lower", "upper")] if "_lower" in names else []
        told |= dict.fromkeys([name for name in names if not name.startswith("_")] + more, (empty, bool(rests)))
    assert set(told) == set(WORLD_SCORES)
    for name, (empty, rests) in told.items():
        facts = facts_of(name)
        assert facts.managed == rests == (empty == "**nothing to score**"), name
        assert facts.worst_undefined == empty.startswith("**never"), name
        assert (facts.without_tracks == 0) == (empty == "0"), name
