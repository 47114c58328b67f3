"""A trial of a search as a planned run, and what its row says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from modsim3d.campaign.file.keys import SearchKeys
from modsim3d.campaign.plan.plan import Plan, PlannedRun
from modsim3d.campaign.plan.seeds import detector_seed, traffic_seed
from modsim3d.campaign.running import DIED
from modsim3d.campaign.search.proposing import Tried
from modsim3d.campaign.search.space import Point
from modsim3d.campaign.work.row import CRASHED, DONE
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.errors import ModsimError
from modsim3d.tracking.trackers.registry import named_tracker

REFUSED = "refused"
"""Status of a trial whose values the scene, the detector or the tracker does not take: no failure of the tracker."""


def score_of(search: SearchKeys) -> str:
    """The score that is searched by."""
    score = search.minimise or search.maximise
    assert score is not None
    return score


def planned_trial(plan: Plan, number: int, seed_index: int, values: Mapping[str, Any]) -> PlannedRun:
    """The run of a trial.

    Args:
        plan: The plan of the campaign: one condition and one tracker.
        number: Number of the trial, from 0.
        seed_index: Number of the traffic seed, from 0.
        values: The values of the keys that are searched.
    """
    traffic = traffic_seed(plan.keys.seed, seed_index)
    condition = plan.conditions[0].with_values(values)
    return PlannedRun(number, seed_index, 0, condition, traffic, detector_seed(traffic, 0), plan.keys.trackers[0])


def refusal(run: PlannedRun, scenes: Scenes) -> str | None:
    """Why a run cannot even begin; None if it can."""
    try:
        scene = scenes.of(run.condition, run.traffic_seed, run.detector_seed)
        named_tracker(run.tracker.tracker, {**run.tracker.settings, **run.condition.of_tracker()}, scene.name)
    except ModsimError as error:
        return str(error)
    except Exception:  # of a plug-in: a crash
        return None
    return None


def told_apart(row: Mapping[str, Any], run: PlannedRun, scenes: Scenes) -> dict[str, Any]:
    """The row of a trial, in which a refused one is told apart from a crash."""
    alive = row["error"] != DIED  # what ended a worker is not tried in this process
    if row["status"] == CRASHED and alive and (said := refusal(run, scenes)) is not None:
        return {**row, "status": REFUSED, "error": said}
    return dict(row)


def tried(point: Point, row: Mapping[str, Any], search: SearchKeys) -> Tried:
    """What came of a point."""
    value = row.get(score_of(search)) if row["status"] == DONE else None
    known = value is not None and math.isfinite(value)
    return Tried(point, value if known else None, row["status"] == CRASHED)
