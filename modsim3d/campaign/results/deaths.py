"""Workers that were killed from outside: lines of `campaign.log`, on which no row and no verdict depends."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from modsim3d.campaign.engines.death import Death
from modsim3d.campaign.results.folder import LOG, CampaignFolder
from modsim3d.display import counted, listed

_LINE = re.compile(r"killed \S+ how=(.*) host=(.*) runs=([0-9,]+)")
_MOST = 8
"""Numbers of runs in a sentence."""


@dataclass(frozen=True)
class Kill:
    """A worker that was killed from outside, or was lost.

    Attributes:
        how: The signal, or what is known.
        host: Name of its machine; empty if that is unknown.
        runs: The run that it had begun; all runs of its task if that is unknown.
    """

    how: str
    host: str
    runs: tuple[int, ...]


def note_kill(folder: CampaignFolder, death: Death, runs: Sequence[int]) -> None:
    """Write into the log that a worker was killed, at once: the campaign may be interrupted.

    Args:
        folder: The campaign.
        death: How it ended.
        runs: The runs of its task.
    """
    under_way = ",".join(map(str, runs if death.run is None else [death.run]))
    line = f"killed {time.strftime('%Y-%m-%dT%H:%M:%S%z')} how={death.how} host={death.host} runs={under_way}\n"
    with (folder.path / LOG).open("a", encoding="utf-8") as log:
        log.write(line)


def kills(folder: CampaignFolder) -> list[Kill]:
    """The workers that were killed so far, in their order."""
    try:
        lines = (folder.path / LOG).read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return []
    found = [match for line in lines if (match := _LINE.fullmatch(line))]
    return [Kill(how, host, tuple(map(int, runs.split(",")))) for how, host, runs in (each.groups() for each in found)]


def killed_sentence(folder: CampaignFolder) -> str | None:
    """How many workers were killed, how, and in which runs; None if there were none."""
    found = kills(folder)
    if not found:
        return None
    hows = listed([f"{how} {count}×" for how, count in Counter(kill.how for kill in found).items()])
    runs = listed([str(run) for run in sorted({run for kill in found for run in kill.runs})], _MOST)
    return (
        f"Killed from outside, and their work tried again: {counted(len(found), 'worker')} ({hows}); runs under way: "
        f"{runs} ({LOG})."
    )
