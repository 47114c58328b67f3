"""Checks the search of a campaign before its first trial."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

from modsim3d.campaign.file.keys import CampaignKeys, SearchKeys
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.work.row import SCORES
from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import nearest

MOST_CHOSEN_SEEDS = 1_000
"""Each seed is a category of the estimator, whose time grows with their number."""
NOT_SEARCHED = ("seed", "detector_seed", "steps", "scene", "tracker")


def search_problems(keys: CampaignKeys) -> Iterator[str]:
    """What is wrong with the search of a campaign, if it has one."""
    if keys.search is None:
        return
    search, plan = keys.search, Plan.of(keys)
    score = search.minimise or search.maximise or ""
    if score not in SCORES:
        name = "minimise" if search.minimise is not None else "maximise"
        yield f"search.{name}: there is no score '{score}' ({nearest(score, SCORES)})"
    if (count := len(plan.conditions)) > 1:
        yield f"search: needs one scene and one condition, and there are {count}: search each in a campaign of its own"
    if plan.drawn:
        yield f"vary: '{plan.drawn[0]}' is drawn, which does not go with search: put its range into search.over"
    if len(keys.trackers) > 1:
        yield f"search: needs one tracker, and there are {len(keys.trackers)}: search each in a campaign of its own"
    for key in ("require", "stop", "seeds", "uncertainty"):
        if key in keys.model_fields_set:
            hint = "; search.seeds is the number of seeds to choose from" if key == "seeds" else ""
            yield f"{key}: does not go with search, whose trials are chosen to be bad and make no rate{hint}"
    if "batch" in keys.model_fields_set:
        yield "batch: does not go with search: search.batch is the number of trials that are proposed at once"
    yield from _range_problems(plan, search)


def _range_problems(plan: Plan, search: SearchKeys) -> Iterator[str]:
    if search.seeds > MOST_CHOSEN_SEEDS:
        yield f"search.seeds: at most {MOST_CHOSEN_SEEDS:,} can be chosen from (got {search.seeds:,})"
    for key in search.over:
        if key in NOT_SEARCHED:
            yield f"search.over: '{key}' cannot be searched; search.seeds is the number of seeds to choose from"
        if key in plan.parameters:
            yield f"search.over: '{key}' is in vary too"


def search_versions(keys: CampaignKeys) -> dict[str, str]:
    """The version of Optuna, if the campaign has a search, whose trials depend on it.

    Raises:
        ModsimError: It is not installed.
    """
    if keys.search is None:
        return {}
    try:
        return {"optuna": version("optuna")}
    except PackageNotFoundError:
        raise ModsimError('a search needs Optuna: pip install "modsim3d[search]"') from None
