"""Tables of results written by hand: a plan whose runs all have given scores."""

import numpy as np

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.work.row import crashed_row, table_of


def verdict_of(plan, score, values, crashed=()):
    """The only verdict of a plan on runs with these values of a score."""
    (verdict,) = judge(plan, table_of_scores(plan, score, values, crashed))
    return verdict


def plan_of(seeds, require, trackers=("bytetrack",), detector=1, **keys):
    counts = {"traffic": seeds, "detector": detector}
    named = {"scenes": ["harbour"], "seeds": counts, "trackers": list(trackers), "require": require}
    return Plan.of(CampaignKeys.model_validate({**named, **keys}))


def table_of_runs(columns, crashed=()):
    """A row for each run, whose columns are given; those of some numbers crashed."""
    rows = ({"run": run, "status": "done", **each} for run, each in enumerate(columns))
    return table_of(crashed_row(row["run"], "lost") if row["run"] in crashed else row for row in rows)


def table_of_scores(plan, score, values, crashed=()):
    """The rows of the first runs, whose values of one score are given."""
    kind = int if score == "id_switches" else float
    values = np.asarray(values, dtype=float).ravel()
    return table_of_runs([{score: None if np.isnan(value) else kind(value)} for value in values], crashed)
