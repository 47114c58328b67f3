"""Whether a worker may work on a campaign: it reaches its folder, and has the versions of its plan."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import orjson

from modsim3d.campaign.work.digests import versions
from modsim3d.campaign.work.task import PLAN, Work
from modsim3d.errors import ModsimError
from modsim3d.inputs.plugins import changed_plugins


def check_worker(work: Work) -> None:
    """Check that this process may work on a campaign.

    Raises:
        ModsimError: The folder of the campaign is not here or is that of another, or packages have other versions.
    """
    host, plan = platform.node(), Path(work.folder) / PLAN
    try:
        facts = orjson.loads(plan.read_bytes())
        sha256, wanted = facts["sha256"], {**facts["versions"], **_of_trackers(facts)}
    except OSError as error:
        raise ModsimError(
            f"the worker on {host} cannot read {plan} ({error.strerror or error}): every worker needs the folder of "
            "the campaign under the same path"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise ModsimError(f"{plan} is damaged: {error}") from None
    if sha256 != work.plan_sha256:
        raise ModsimError(
            f"the worker on {host} finds another campaign at {plan}: every worker needs the folder of the campaign "
            "under the same path"
        )
    if changed := changed_plugins(work.plugins, "the campaign was planned"):
        raise ModsimError(f"the worker on {host} has other plug-ins than the plan: {'; '.join(changed)}")
    found = versions() | {name: _version(name) for name in wanted if name not in versions()}
    if differing := [f"{name} {found[name]} instead of {each}" for name, each in wanted.items() if found[name] != each]:
        raise ModsimError(
            f"the worker on {host} has {', '.join(differing)}: a campaign needs the same versions everywhere"
        )


def _of_trackers(facts: dict[str, Any]) -> dict[str, str]:
    """The versions of the packages of all trackers, and of what they use."""
    found: dict[str, str] = {}
    for condition in facts["conditions"]:
        for tracker in condition["trackers"].values():
            package, _, number = tracker["package"].rpartition(" ")
            found |= tracker["versions"]
            if number[:1].isdigit():  # else a plug-in of no package
                found[package] = number
    return found


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
