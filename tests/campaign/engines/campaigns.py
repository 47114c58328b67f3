"""Tiny campaigns, their results as bytes, and processes that are waited for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from modsim3d.campaign.folder import CampaignFolder, planned
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import CampaignResult, run_plan
from modsim3d.campaign.work.checking import CheckedCampaign, checked
from modsim3d.campaign.work.task import Task
from modsim3d.campaign.workers import Engine

PATIENCE_S = 60.0
PLAIN = """
scene: harbour
steps: 3
seeds: {traffic: 4}
vary:
  - grid: {waves.level: [small]}
trackers: [fragile, reference]
"""
FATAL = """
scene: harbour
steps: 3
seeds: {traffic: 1}
vary:
  - grid: {waves.level: [small]}
trackers: [reference, {tracker: fragile, name: fatal, set: {fatal: true}}]
"""
STILL = "{scene: harbour, steps: 3, seeds: {traffic: 8}, trackers: [reference]}"
SEQUENTIAL = PLAIN + "require: [{score: hota, at_least: 0.1}]\nstop: sequential\nbatch: 1\n"
MORTAL = ("exit", "nothing", "segfault", "kill", "term", "interrupt")
"""How the tracker `mortal` ends its process, once for each of these."""
_DEATHS = ", ".join(f"{{tracker: mortal, name: {how}, set: {{how: {how}}}}}" for how in MORTAL)
MORTALS = f"{{scene: harbour, steps: 3, trackers: [reference, {_DEATHS}]}}"
KILLED = """
scene: harbour
steps: 3
trackers: [reference, {tracker: mortal, name: exit, set: {how: exit, always: true}},
           {tracker: mortal, name: kill, set: {how: kill}}]
"""
DEAF = "{scene: harbour, steps: 3, trackers: [{tracker: mortal, set: {how: deaf, always: true}}]}"
LEAVING = "{scene: harbour, steps: 3, trackers: [{tracker: mortal, set: {how: system_exit, always: true}}]}"
FILES = {
    "leaving": LEAVING,
    "deaf": DEAF,
    "mortal": MORTALS,
    "killed": KILLED,
    "still": STILL,
    "plain": PLAIN,
    "fatal": FATAL,
    "sequential": SEQUENTIAL,
}


@dataclass(frozen=True)
class Campaigns:
    folder: Path

    @property
    def hold(self) -> Path:
        """While this folder is there, the tracker of the campaigns waits, and leaves its process's number in it."""
        return self.folder / "hold"

    def checked(self, name: str = "plain") -> CheckedCampaign:
        path = self.folder / f"{name}.yaml"
        path.write_text(FILES[name], encoding="utf-8")
        return checked(read_campaign(path))

    def run(
        self, name: str, engine: Callable[[], Engine], out: str | Path, shard: tuple[int, int] | None = None
    ) -> CampaignResult | None:
        return run_plan(self.checked(name), self.folder / out, engine, shard=shard)

    def planned(self, out: Path, name: str = "plain") -> tuple[CampaignFolder, list[Task]]:
        """A folder with a plan, and a task for each traffic seed."""
        campaign = self.checked(name)
        here = planned(campaign, out)
        size = campaign.plan.runs_by_seed
        firsts = range(0, len(campaign.plan), size)
        return here, [Task(here.work, tuple(here.plan.runs(range(first, first + size)))) for first in firsts]

    @property
    def reference(self) -> dict[str, bytes]:
        """What the campaign `plain` gives when nothing goes wrong."""
        return content(self.folder / "reference")

    @contextmanager
    def holding(self) -> Iterator[Path]:
        """Let the tracker wait in this block."""
        self.hold.mkdir()
        try:
            yield self.hold
        finally:
            shutil.rmtree(self.hold, ignore_errors=True)

    def fatal_task(self, out: Path) -> Task:
        """A task of one run, which ends its process."""
        here = planned(self.checked("fatal"), out)
        return Task(here.work, (here.plan.run(1),))

    def coordinator(self, engine: str, out: Path) -> subprocess.Popen[str]:
        """A campaign in a process of its own: a number of workers, or the address of a scheduler."""
        return subprocess.Popen(
            [sys.executable, "-m", "tests.campaign.engines.coordinator", engine, self.folder / "plain.yaml", out],
            stderr=subprocess.PIPE,
            text=True,
        )


def content(folder: Path) -> dict[str, bytes]:
    """All files of a campaign's folder by their paths; the log names times."""
    files = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in files.items() if name != "campaign.log"}


def waited_for(what: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def numbers_in(hold: Path) -> list[int]:
    """The processes that wait."""
    return [int(path.name) for path in hold.iterdir()]


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"
