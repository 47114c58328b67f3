"""Tables of results written by hand: a plan whose runs all have given scores."""

from __future__ import annotations

import numpy as np

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.work.row import crashed_row, table_of


def plan_of(seeds, require, trackers=("bytetrack",), detector=1, **keys):
    return Plan.of(
        CampaignKeys.model_validate(
            {
                "scenes": ["harbour"],
                "seeds": {"traffic": seeds, "detector": detector},
                "trackers": list(trackers),
                "require": require,
                **keys,
            }
        )
    )


def table_of_scores(plan, score, values, crashed=()):
    """The rows of the first runs, whose values of one score are given; those of some numbers crashed."""
    values = np.asarray(values, dtype=float).ravel()
    return table_of(
        crashed_row(number, "lost")
        if number in crashed
        else {"run": number, "status": "done", score: None if np.isnan(value) else _typed(score, value)}
        for number, value in enumerate(values)
    )


def _typed(score, value):
    return int(value) if score == "id_switches" else float(value)
