"""A plug-in tracker that waits or ends its process when it is told to, and campaigns with it."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.campaign.engines.campaigns import Campaigns
from tests.campaign.one_process import ThisProcess
from tests.plugin_site import Site

TRACKER = """
import ctypes, os, signal, sys, time
from pathlib import Path
import numpy as np
from modsim3d import TrackedFrame, Tracker

class Fragile(Tracker):
    fatal: bool = False

    def follow(self, frames, camera):
        hold = Path(os.environ.get("FRAGILE_HOLD", "/nowhere"))
        if hold.is_dir():
            (hold / str(os.getpid())).touch()
            while hold.is_dir():
                time.sleep(0.01)
        if self.fatal:
            os._exit(9)
        for frame in frames:
            yield TrackedFrame(np.arange(len(frame.boxes_px)), frame.boxes_px, frame.label, frame.confidence)

class Mortal(Tracker):
    how: str
    always: bool = False

    def follow(self, frames, camera):
        mark = Path(os.environ["FRAGILE_HOLD"]).with_name("marks") / self.how
        if self.always or not mark.exists():
            mark.touch()
            DEATHS[self.how]()
        yield from Fragile().follow(frames, camera)

def interrupt():
    raise KeyboardInterrupt

DEATHS = {
    "exit": lambda: os._exit(3),
    "nothing": lambda: os._exit(0),
    "system_exit": lambda: sys.exit(5),
    "segfault": lambda: ctypes.string_at(0),
    "deaf": lambda: (os.closerange(3, 256), time.sleep(60)),
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "term": lambda: os.kill(os.getpid(), signal.SIGTERM),
    "interrupt": interrupt,
}
"""


@pytest.fixture(scope="session")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Campaigns]:
    folder = tmp_path_factory.mktemp("engines")
    site, points = folder / "site", {"fragile": "fragile:Fragile", "mortal": "fragile:Mortal"}
    site.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        Site(site, patch).add("fragile", "1.0", "fragile", TRACKER, {"modsim3d.trackers": points})
        patch.setenv("PYTHONPATH", os.pathsep.join([str(site), str(Path(__file__).resolve().parents[3])]))
        patch.setenv("FRAGILE_HOLD", str(folder / "hold"))
        made = Campaigns(folder)
        made.run("plain", ThisProcess, "reference")
        yield made


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """The folder of a campaign, not there yet."""
    return tmp_path / "out"


@pytest.fixture
def doomed(campaigns: Campaigns) -> Path:
    """A folder of marks: each death comes once, so a run that is tried again does not die."""
    folder = campaigns.folder / "marks"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder
