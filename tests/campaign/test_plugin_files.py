"""A plug-in whose files change while its version stays: its old scores are served nowhere."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from modsim3d.campaign.campaign import check_files
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.serving import check_worker
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.io.plugins import TRACKERS, changed_plugins, load_plugin, own_files
from tests.campaign.campaigns import campaign_file, checked_campaign
from tests.campaign.one_process import ThisProcess

TRACKER = """
import numpy as np
from modsim3d import TrackedFrame, Tracker

class Shifting(Tracker):
    def follow(self, frames, camera):
        for frame in frames:
            yield TrackedFrame(np.arange(len(frame.boxes_px)), frame.boxes_px + SHIFT_PX, frame.label, frame.confidence)
"""
KEYS = {"scene": "harbour", "steps": 20, "trackers": ["shifting"], "keep": ["detections", "tracks"]}
OWN = ("shifting/__init__.py", "shifting/numbers.py", "shifting/tracker.py")


class Site:
    """A folder on the path with a package that has a tracker, and no record of its files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.info = folder / "shifting-1.0.dist-info"
        self.info.mkdir(parents=True)
        (self.info / "METADATA").write_text("Metadata-Version: 2.1\nName: shifting\nVersion: 1.0\n")
        (self.info / "entry_points.txt").write_text("[modsim3d.trackers]\nshifting = shifting.tracker:Shifting\n")
        package = folder / "shifting"
        package.mkdir()
        (package / "__init__.py").write_text("")
        (package / "tracker.py").write_text("from shifting.numbers import SHIFT_PX\n" + TRACKER)
        self.shift(0)

    def shift(self, pixels: int) -> None:
        (self.folder / "shifting" / "numbers.py").write_text(f"SHIFT_PX = {pixels}\n")


def forget(package: str = "shifting") -> None:
    """As a new process does, load the package anew."""
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        del sys.modules[name]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    made = Site(tmp_path / "site")
    monkeypatch.syspath_prepend(made.folder)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # two edits within a second have one time
    yield made
    forget()


def test_an_edited_tracker_is_refused_by_the_same_command_and_scored_by_another(site, prepared, tmp_path: Path):
    file, first = campaign_file(tmp_path, **KEYS), tmp_path / "first.py"
    first.write_text(f"import sys\nsys.dont_write_bytecode = True\nsys.path[:0] = ['{site.folder}']\n")

    def campaign(name: str) -> tuple[int, str]:
        """The command in a process of its own: its status, and what it says of errors."""
        options = "--workers", "1", "--out", tmp_path / name, "--cache", tmp_path / "cache"
        line = [prepared, "campaign", "run", file, *options]
        environment = {**os.environ, "FIRST": str(first)}
        done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=300)
        return done.returncode, done.stderr

    assert campaign("old")[0] == 0
    site.shift(400)
    status, said = campaign("old")
    assert status == 2
    assert "shifting/numbers.py of the plug-in modsim3d.trackers:shifting changed. Choose another folder" in said
    assert campaign("new")[0] == 0
    old, new = (pq.read_table(tmp_path / name / "results") for name in ("old", "new"))
    assert old["hota"][0].as_py() > 0.1 and new["hota"].to_pylist() == [0]
    assert old["detections_key"] == new["detections_key"] and old["tracks_key"] != new["tracks_key"]
    plan = json.loads((tmp_path / "new" / "plan.json").read_text())
    assert {*plan["plugins"]["modsim3d.trackers:shifting"]} == {"entry_points.txt", *OWN}


def test_no_row_is_kept_of_a_plugin_that_changes_while_the_campaign_runs(site: Site, tmp_path: Path) -> None:
    made = checked_campaign(tmp_path, **KEYS)
    site.shift(400)
    changed = r"shifting/numbers\.py of the plug-in 'shifting' of shifting 1\.0 has changed"
    with pytest.raises(ModsimError, match=changed):
        run_plan(made, tmp_path / "out", ThisProcess)
    assert not [*(tmp_path / "out" / "done").iterdir()]
    site.shift(0)
    assert run_plan(made, tmp_path / "out", ThisProcess) is not None
    opened = opened_campaign(tmp_path / "out")
    check_files(opened)
    check_worker(opened.work)
    site.shift(400)
    with pytest.raises(InputError, match=r"numbers\.py of the plug-in .* has changed since the campaign was planned"):
        check_files(opened)
    with pytest.raises(ModsimError, match=r"the worker on .* has other plug-ins than the plan: shifting/numbers\.py"):
        check_worker(opened.work)


def test_a_process_that_has_loaded_an_older_plugin_is_refused(site: Site, tmp_path: Path) -> None:
    checked_campaign(tmp_path, **KEYS)
    site.shift(400)
    with pytest.raises(InputError, match=r"numbers\.py of .* has changed since Python loaded it: start it again"):
        checked_campaign(tmp_path, **KEYS)
    (point,) = entry_points(group=TRACKERS, name="shifting")
    planned_elsewhere = {f"{TRACKERS}:shifting": own_files(point)}
    (problem,) = changed_plugins(planned_elsewhere, "the campaign was planned")
    assert problem.endswith("this process has loaded it before it was changed: start it again")
    forget()
    assert changed_plugins(planned_elsewhere, "the campaign was planned") == []


def test_a_campaign_that_was_interrupted_does_not_go_on_with_an_edited_plugin(site: Site, tmp_path: Path) -> None:
    run_plan(checked_campaign(tmp_path, **KEYS), tmp_path / "out", ThisProcess, shard=(1, 1))
    forget()
    (site.folder / "shifting" / "more.py").write_text("")
    changed = r"another plan: shifting/more\.py of the plug-in modsim3d\.trackers:shifting"
    with pytest.raises(OutputError, match=changed):
        run_plan(checked_campaign(tmp_path, **KEYS), tmp_path / "out", ThisProcess)


def test_files_of_an_installed_package_are_those_of_its_record_and_all_in_its_folder(site: Site) -> None:
    """What Python and installers make does not count."""
    recorded = ["shifting/__init__.py", "shifting/tracker.py", "shifting/data.bin", "../share/weights.bin"]
    made = ["shifting/__pycache__/tracker.cpython-311.pyc", "../bin/shifting", "shifting-1.0.dist-info/INSTALLER"]
    not_recorded = {"shifting/numbers.py", "shifting/downloaded.bin"}
    for name in (*recorded[2:], *made[1:], "shifting/downloaded.bin"):
        (site.folder / name).parent.mkdir(exist_ok=True)
        (site.folder / name).write_text(name)
    (site.info / "RECORD").write_text("".join(f"{name},,\n" for name in [*recorded, *made]))
    _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
    assert {*plugin.files} == {*recorded, *not_recorded, "entry_points.txt"}


def test_of_a_single_module_without_a_record_its_file_counts_and_none_beside_it(site: Site) -> None:
    (site.folder / "single.py").write_text(TRACKER)
    (site.info / "entry_points.txt").write_text("[modsim3d.trackers]\nshifting = single:Shifting\n")
    _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
    forget("single")
    assert {*plugin.files} == {"single.py", "entry_points.txt"}


def test_other_packages_of_a_namespace_are_not_of_a_plugin(site: Site) -> None:
    (site.folder / "space" / "other").mkdir(parents=True)
    (site.folder / "space" / "other" / "__init__.py").write_text("")
    (site.folder / "shifting").rename(site.folder / "space" / "shifting")
    (site.folder / "space" / "shifting" / "tracker.py").write_text("SHIFT_PX = 0\n" + TRACKER)
    (site.info / "entry_points.txt").write_text("[modsim3d.trackers]\nshifting = space.shifting.tracker:Shifting\n")
    _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
    forget("space")
    assert {*plugin.files} == {"entry_points.txt", *(f"space/{name}" for name in OWN)}


def test_an_editable_package_is_all_that_its_folder_holds(site: Site, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (site.folder / "shifting").rename(source / "shifting")
    (site.folder / "_editable_impl_shifting.pth").write_text(f"{source}\n")
    (site.info / "RECORD").write_text("_editable_impl_shifting.pth,,\nshifting-1.0.dist-info/entry_points.txt,,\n")
    for name in ("weights.bin", ".weights.bin.swp", "tracker.py~"):
        (source / "shifting" / name).write_bytes(b"")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(source)
        _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
    assert {*plugin.files} == {"entry_points.txt", *OWN, "shifting/weights.bin"}
    assert replace(plugin, files={}).sha256 != plugin.sha256
