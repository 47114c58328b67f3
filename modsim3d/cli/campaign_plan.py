"""Text of `modsim3d campaign --plan`: how many runs there will be, and how many seeds each requirement needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.cli.shared import print_line
from modsim3d.cli.terminal import open_console, print_prose, print_table
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.campaign.done_rows import NeededSeeds
    from modsim3d.campaign.plan import Plan
    from modsim3d.campaign.work.checking import CheckedCampaign


def told_plan(campaign: CheckedCampaign, expect: Sequence[str], like: Path | None) -> dict[str, Any]:
    """Print how many frames and seeds there will be and are needed; the same for JSON.

    Raises:
        ModsimError: What is expected says nothing, `like` is no campaign, or this is a search.
    """
    from modsim3d.campaign.done_rows import needed_seeds, parsed_expectation
    from modsim3d.campaign.folder import opened_campaign

    plan = campaign.plan
    if plan.keys.search is not None:
        raise ModsimError("--plan: a search has no requirements, and its budget says how many trials there will be")
    expected = dict(parsed_expectation(text, plan) for text in expect)
    earlier = None if like is None else opened_campaign(like)
    if earlier is not None and earlier.keys.search is not None:
        raise ModsimError(f"--like {like}: holds a search, whose trials were chosen to be bad, and has no mean")
    needed = needed_seeds(plan, expected, earlier)
    frames, console = frames_of(campaign), open_console()
    print_line(console, f"{len(plan):,} runs of {frames:,} frames together")
    if needed:
        print_table(
            console,
            "traffic seeds needed",
            [_row(plan, each) for each in needed],
            header=("requirement", "tracker", "condition", "seeds needed", "why"),
            right=(3,),
        )
        print_prose(
            console,
            "Seeds needed by a mean: so many that the bound of its verdict is beyond the threshold in 80 % of such "
            "campaigns, if the means of seeds are normal values with this mean and spread, and no run is lost.",
            "dim",
        )
    return {"frames": frames, "needed": [asdict(each) for each in needed]}


def frames_of(campaign: CheckedCampaign) -> int:
    """Number of frames of all cameras in all runs."""
    from modsim3d.campaign.work.scenes import Scenes

    keys, plan = campaign.file.keys, campaign.plan
    scenes = Scenes(keys.steps, campaign.file.base, learned=keys.uncertainty == "learned")
    first = (plan.run(place * plan.runs_by_seed // len(plan.conditions)) for place in range(len(plan.conditions)))
    made = (scenes.of(each.condition, each.traffic_seed, each.detector_seed) for each in first)
    return sum(scene.steps * len(scene.cameras) for scene in made) * len(plan) // len(plan.conditions)


def _row(plan: Plan, each: NeededSeeds) -> tuple[str, ...]:
    from modsim3d.campaign.plan import values_text
    from modsim3d.core.text import UNKNOWN

    values = "all" if each.condition is None else values_text(plan.conditions[each.condition].values)
    seeds = UNKNOWN if each.seeds is None else f"{each.seeds:,}"
    return (each.text, each.tracker or "all", values, seeds, each.why)
