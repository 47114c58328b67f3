"""Workers that were killed from outside: lines of `campaign.log`, on which no row and no verdict depends."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence

from modsim3d.campaign.engines.death import Death
from modsim3d.campaign.results.folder import LOG, CampaignFolder
from modsim3d.display import counted, listed

_LINE = re.compile(r"killed \S+ how=(.*) host=.* runs=([0-9,]+)")
_MOST = 8
"""Numbers of runs in a sentence."""


def note_kill(folder: CampaignFolder, death: Death, runs: Sequence[int]) -> None:
    """Write into the log that the worker of a task was killed; at once, since the campaign may be interrupted."""
    under_way = ",".join(map(str, runs if death.run is None else [death.run]))
    line = f"killed {time.strftime('%Y-%m-%dT%H:%M:%S%z')} how={death.how} host={death.host} runs={under_way}\n"
    with (folder.path / LOG).open("a", encoding="utf-8") as log:
        log.write(line)


def killed_sentence(folder: CampaignFolder) -> str | None:
    """A sentence on the workers killed so far: number, signals and runs; None if there were none."""
    path = folder.path / LOG
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    found = [match.groups() for line in lines if (match := _LINE.fullmatch(line))]
    if not found:
        return None
    hows = listed([f"{how} {count}×" for how, count in Counter(how for how, _ in found).items()])
    runs = listed(sorted({run for _, runs in found for run in runs.split(",")}, key=int), _MOST)
    return (
        f"Killed from outside, and their work tried again: {counted(len(found), 'worker')} ({hows}); runs under way: "
        f"{runs} ({LOG})."
    )
