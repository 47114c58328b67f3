"""Conditions of a campaign that gave the same detections in all runs: what differs between them changed nothing."""

from __future__ import annotations

import pyarrow as pa

from modsim3d.campaign.plan.conditions import Condition
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.work.digests import digest
from modsim3d.display import listed
from modsim3d.inputs.validation import shown


def same_detections(plan: Plan, table: pa.Table) -> list[str]:
    """A sentence for each group of conditions whose scenes or detectors differ and whose detections do not."""
    names, seen = ("condition", "traffic_seed", "detector_seed", "detections_sha256"), dict[int, set[tuple[str, ...]]]()
    if not {*names} <= {*table.column_names}:  # it was made by an older version, or has no rows
        return []
    for place, *found in zip(*(table[name].to_pylist() for name in names), strict=True):
        if None not in found:
            seen.setdefault(place, set()).add(tuple(map(str, found)))
    groups: dict[str, dict[str, Condition]] = {}
    for place in sorted(seen):
        condition = plan.conditions[place]
        asked = digest(condition.scene, condition.of_truth(), condition.of_detector())
        groups.setdefault(digest(sorted(seen[place])), {}).setdefault(asked, condition)
    return [
        f"the detections are the same in all runs with {_in_words([*each.values()])}: what differs there changes "
        "nothing that a tracker sees, and a verdict on one condition says nothing of the other"
        for each in groups.values()
        if len(each) > 1
    ]


def _in_words(conditions: list[Condition]) -> str:
    """The values of each condition that are not those of all of them."""
    values = [{"scene": each.scene, **each.of_truth(), **each.of_detector()} for each in conditions]
    keys = dict.fromkeys(key for each in values for key in each)
    differing = [key for key in keys if len({shown(each.get(key)) for each in values}) > 1]
    return listed([" and ".join(f"{key} {shown(each.get(key))}" for key in differing) for each in values])
