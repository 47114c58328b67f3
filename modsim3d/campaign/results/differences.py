"""What differs between two plans, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from modsim3d.inputs.validation import join_path, shown

MOST = 5
PARTS = ("campaign", "versions")
"""Of a plan, what its user knows: the keys of the file, and the versions of packages."""


def differences(there: Any, now: Mapping[str, Any]) -> list[str]:
    """The first few keys whose values differ, each with both.

    Args:
        there: The content of a plan that is stored.
        now: That of another.
    """
    there = there if isinstance(there, dict) else {}
    found = [line for part in PARTS for line in _between(there.get(part), now.get(part), (part,))]
    lines = [line.removeprefix("campaign.") for line in found[:MOST]]
    if len(found) > MOST:
        lines.append(f"{len(found) - MOST} more keys")
    return lines or ["a scene, a detector or a tracker that it names was changed"]


def _between(there: Any, now: Any, path: tuple[int | str, ...]) -> Iterator[str]:
    if isinstance(there, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*there, *now]):
            yield from _between(there.get(key), now.get(key), (*path, key))
    elif isinstance(there, list) and isinstance(now, list) and len(there) == len(now):
        for place, (one, other) in enumerate(zip(there, now, strict=True)):
            yield from _between(one, other, (*path, place))
    elif there != now:
        yield f"{join_path(*path)} is {shown(there)} there and {shown(now)} now"
