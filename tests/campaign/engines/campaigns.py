"""Tiny campaigns, their results as bytes, and processes that are waited for."""

import os
import shutil
import subprocess
import sys
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
from tests.campaign.one_process import ThisProcess
from tests.run_folders import run_files, wait_for

MORTAL = ("exit", "nothing", "segfault", "kill", "term", "interrupt")  # ends of the process of the tracker `mortal`
_DEATHS = ", ".join(f"{{tracker: mortal, name: {how}, set: {{how: {how}}}}}" for how in MORTAL)
_SHORT = "scene: simulation_1\nsteps: 3\nset: {annotation.source: analytic}\n"  # quick, without OpenGL
_VARIED = _SHORT + "vary: [{grid: {waves.level: [small]}}]\n"
_PLAIN = _VARIED + "seeds: {traffic: 4}\ntrackers: [fragile, reference]\n"
FILES = {
    "plain": _PLAIN,
    "sequential": _PLAIN + "require: [{score: hota, at_least: 0.1}]\nstop: sequential\nbatch: 1\n",
    "fatal": _VARIED + "trackers: [reference, {tracker: fragile, name: fatal, set: {fatal: true}}]\n",
    "still": _SHORT + "seeds: {traffic: 8}\ntrackers: [reference]\n",
    "mortal": _SHORT + f"trackers: [reference, {_DEATHS}]\n",
    "killed": _SHORT + "trackers: [reference, {tracker: mortal, name: exit, set: {how: exit, always: true}}, "
    "{tracker: mortal, name: kill, set: {how: kill}}]\n",
    "deaf": _SHORT + "trackers: [{tracker: mortal, set: {how: deaf, always: true}}]\n",
    "leaving": _SHORT + "trackers: [{tracker: mortal, set: {how: system_exit, always: true}}]\n",
}
Content = dict[str, bytes]


@dataclass(frozen=True)
class Campaigns:
    folder: Path

    def checked(self, name: str = "plain") -> CheckedCampaign:
        path = self.folder / f"{name}.yaml"
        path.write_text(FILES[name], encoding="utf-8")
        return checked(read_campaign(path))

    def run(self, name: str, engine: Callable[[], Engine], out: str | Path) -> CampaignResult:
        result = run_plan(self.checked(name), self.folder / out, engine)
        assert result is not None
        return result

    def run_part(self, name: str, engine: Callable[[], Engine], out: Path, *shard: int) -> None:
        assert run_plan(self.checked(name), out, engine, shard=shard) is None  # type: ignore[arg-type]

    def planned(self, out: Path, name: str = "plain") -> tuple[CampaignFolder, list[Task]]:
        """A folder with a plan, and a task for each traffic seed."""
        here = planned(self.checked(name), out)
        size = here.plan.runs_by_seed
        numbers = (range(first, first + size) for first in range(0, len(here.plan), size))
        return here, [Task(here.work, tuple(here.plan.runs(each))) for each in numbers]

    @property
    def reference(self) -> Content:
        """What the campaign `plain` gives when nothing goes wrong."""
        return content(self.folder / "reference")

    def check_end(self, out: Path, engine: Callable[[], Engine] = ThisProcess) -> None:
        """Give the command of `plain` once more: it ends with the bytes of one with which nothing went wrong."""
        self.run("plain", engine, out)
        assert content(out) == self.reference

    @contextmanager
    def holding(self) -> Iterator[Callable[..., list[int]]]:
        """Let the tracker wait in this block; gives a function that waits for so many processes that do, by number."""
        hold = self.folder / "hold"  # in it the tracker leaves the number of its process
        hold.mkdir()

        def waiting(count: int = 1) -> list[int]:
            wait_for(lambda: len(list(hold.iterdir())) >= count)
            return [int(path.name) for path in hold.iterdir()]

        try:
            yield waiting
        finally:
            shutil.rmtree(hold, ignore_errors=True)

    def coordinator(self, engine: str, out: Path, name: str = "plain", threads: int = 1) -> subprocess.Popen[str]:
        """A campaign in a process of its own: a number of workers, which are forks where it has one thread, or the
        address of a scheduler."""
        path = self.checked(name).file.path
        line = [sys.executable, "-m", "tests.campaign.engines.coordinator", engine, path, out]
        alone = {"OPENBLAS_NUM_THREADS": str(threads), "JE_ARROW_MALLOC_CONF": "background_thread:false"}
        return subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env={**os.environ, **alone})


def content(folder: Path) -> Content:
    """All files of a campaign's folder by their paths; the log names times."""
    return run_files(folder, "campaign.log")


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"
