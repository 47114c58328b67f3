"""Files of a campaign: relative to its own, known by checksums, refused where they changed; those of plug-ins too."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import open_campaign
from modsim3d.campaign.campaign import check_files
from modsim3d.campaign.folder import LIST, opened_campaign, planned
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.serving import check_worker
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.io.input_files import data_folder
from modsim3d.io.plugins import TRACKERS, changed_plugins, load_plugin, own_files
from tests.campaign.campaigns import campaign_file, checked_campaign, problems_of, run_campaign_file
from tests.campaign.one_process import ThisProcess
from tests.campaign.small_campaign import small_campaign
from tests.cli.conftest import Modsim3d

KEYS: dict[str, Any] = {
    "scene": "scenes/quay.yaml", "steps": 3, "seeds": {"traffic": 2}, "trackers": ["reference"],
    "vary": [{"grid": {"detector": ["mine.yaml", "experiment_1"]}}],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene and two detectors, which is not the working directory."""
    (tmp_path / "work/scenes/detectors").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    scenes = data_folder("scenes")
    shutil.copy(scenes / "harbour.yaml", tmp_path / "work/scenes/quay.yaml")
    shutil.copy(scenes / "detectors/thesis.yaml", tmp_path / "work/scenes/detectors")
    shutil.copy(scenes / "detectors/experiment_1.yaml", tmp_path / "work/mine.yaml")
    return tmp_path / "work"


def test_paths_are_relative_to_the_campaign_file(folder: Path) -> None:
    campaign = checked_campaign(folder, **KEYS)
    assert list(campaign.content["files"]) == ["mine.yaml", "scenes/quay.yaml"]
    assert [facts.states for facts in campaign.facts] == [("real_world",), ("real_world",)]
    own = checked_campaign(folder, **{**KEYS, "vary": []})
    assert list(own.content["files"]) == ["scenes/detectors/thesis.yaml", "scenes/quay.yaml"]


@pytest.mark.parametrize(("keys", "said"), [
    ({"scene": "scenes/pier.yaml"}, "scenes/pier.yaml"),
    ({"vary": [{"grid": {"detector": ["yours.yaml"]}}]}, "yours.yaml"),
    ({"vary": [{"grid": {"detector": [3]}}]}, "the name of a shipped one is text (got 3)"),
    ({"vary": [{"grid": {"state": ["fog"]}}]}, "fog"),
    ({"vary": [{"list": [{"state": "fog", "from": "nowhere"}]}]}, "nowhere"),
    ({"vary": [{"grid": {"detector.miss_rate": [0.1, 1.5]}}]}, "detector.miss_rate 1.5: a miss rate is a number"),
])  # fmt: skip
def test_what_is_missing_or_wrong_is_named_before_the_first_run(folder: Path, keys: dict[str, Any], said: str) -> None:
    assert said in "\n".join(problems_of(folder, **{**KEYS, **keys}))


@pytest.mark.parametrize("name", ["mine.yaml", "scenes/quay.yaml"])
def test_a_changed_file_is_named_when_a_campaign_goes_on_and_when_a_run_is_made_again(folder: Path, name: str) -> None:
    done = run_campaign_file(folder, **KEYS)
    assert set(done.table["status"].to_pylist()) == {"done"}
    check_files(opened_campaign(done.folder.path))
    content = yaml.safe_load((folder / name).read_text())
    changed = content["states"]["real_world"] if name == "mine.yaml" else content["vessels"]["ferry1"]
    changed |= {"false_discovery_rate": 0.2} if name == "mine.yaml" else {"length_m": 99.0}
    (folder / name).write_text(yaml.safe_dump(content, sort_keys=False))
    with pytest.raises(OutputError, match=f"holds a campaign with another plan: {name} changed"):
        run_campaign_file(folder, **KEYS)
    with pytest.raises(InputError, match=f"{name} has changed since the campaign was planned"):
        check_files(opened_campaign(done.folder.path))
    (folder / name).unlink()
    with pytest.raises(InputError, match=f"{name} cannot be read any more: No such file"):
        check_files(opened_campaign(done.folder.path))


def test_no_row_is_kept_of_a_file_that_changes_while_the_campaign_runs(folder: Path) -> None:
    campaign, before = checked_campaign(folder, **KEYS), (folder / "mine.yaml").read_bytes()
    (folder / "mine.yaml").write_bytes(before + b"# edited\n")
    with pytest.raises(ModsimError, match=r"mine\.yaml has changed since the campaign was planned: put it back"):
        run_plan(campaign, folder / "out", ThisProcess)
    assert not list((folder / "out").glob("done/*"))
    (folder / "mine.yaml").write_bytes(before)
    result = run_plan(checked_campaign(folder, **KEYS), folder / "out", ThisProcess)
    assert result is not None and set(result.table["status"].to_pylist()) == {"done"}


ENDED = {"scene": "harbour", "steps": 3, "trackers": ["reference"], "require": [{"score": "hota", "at_least": 0.9}]}


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a campaign; what a test changes in it is put back."""
    return run_campaign_file(tmp_path_factory.mktemp("ended"), **ENDED).folder.path


def replaced(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))


def other_scores(path: Path) -> None:
    table = pq.read_table(path, partitioning=None)
    pq.write_table(table.set_column(table.column_names.index("hota"), "hota", [[0.99] * len(table)]), path)


CHANGES: dict[str, Callable[[Path], object]] = {
    "plan.json": lambda path: replaced(path, '"at_least": 0.9', '"at_least": 0.1'),
    "results/scene=harbour/part-00000.parquet": other_scores,
    "results/scene=harbour/part-00001.parquet": lambda path: shutil.copy(path.parent / "part-00000.parquet", path),
    "verdicts.json": lambda path: replaced(path, "undecided", "met"),
    "campaign.yaml": lambda path: replaced(path, "0.9", "0.1"),
    f"results/{LIST}": lambda path: path.unlink(),
}


@contextmanager
def changed(path: Path, change: Callable[[Path], object]) -> Iterator[None]:
    before = path.read_bytes() if path.exists() else None
    change(path)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        if before is not None:
            path.write_bytes(before)


@pytest.mark.parametrize("name", CHANGES)
def test_a_file_that_was_changed_after_the_end_is_refused_by_its_name(ended: Path, name: str) -> None:
    open_campaign(ended)
    with changed(ended / name, CHANGES[name]):
        for attempt in (lambda: open_campaign(ended), lambda: run_campaign_file(ended.parent, **ENDED)):
            with pytest.raises(ModsimError, match=f"^{ended / name} (was changed|cannot be read)"):
                attempt()
    assert open_campaign(ended).finished


@pytest.mark.parametrize("files", ['{"../x": 5}', '{"x": {"bytes": 5}}', '{"x": ["bytes", "sha256"]}', '["x"]', "5"])
def test_a_list_of_another_form_is_refused_as_a_damaged_one(ended: Path, files: str) -> None:
    path = ended / "results" / LIST
    damaged = pytest.raises(ModsimError, match=f"^{path} cannot be read, or a file that it lists: .*; remove")
    with changed(path, lambda path: path.write_text(f'{{"files": {files}}}')), damaged:
        open_campaign(ended)


def test_the_list_has_every_file_but_the_log(ended: Path) -> None:
    files = {path.relative_to(ended).as_posix(): path for path in ended.rglob("*") if path.is_file()}
    listed = json.loads((ended / "results" / LIST).read_text())["files"]
    assert {*listed} == {*files} - {"campaign.log", f"results/{LIST}"}
    assert all(each["bytes"] == files[name].stat().st_size for name, each in listed.items())
    assert pq.read_table(ended / "results")["hota"].to_pylist() == open_campaign(ended).table["hota"].to_pylist()


def test_a_plan_that_was_changed_before_the_end_is_refused(tmp_path: Path) -> None:
    campaign = checked_campaign(tmp_path, **ENDED)
    here = planned(campaign, tmp_path / "planned")
    CHANGES["plan.json"](here.path / "plan.json")
    for attempt in (lambda: open_campaign(here.path), lambda: run_plan(campaign, here.path, ThisProcess)):
        with pytest.raises(ModsimError, match=r"planned/plan\.json was changed after it was written"):
            attempt()


def test_every_command_refuses_altered_results(modsim3d: Modsim3d, tmp_path: Path) -> None:
    folder = small_campaign(tmp_path)
    other_scores(folder / "results/scene=harbour/part-00000.parquet")
    for command, *options in (["status"], ["table"], ["report"], ["reproduce", "0", "--out", "again"]):
        said = modsim3d("campaign", command, folder, *options)
        assert said.status == 2 and "part-00000.parquet was changed after the campaign ended" in said.err, command


TRACKER = """
import numpy as np
from modsim3d import TrackedFrame, Tracker

class Shifting(Tracker):
    def follow(self, frames, camera):
        for frame in frames:
            yield TrackedFrame(np.arange(len(frame.boxes_px)), frame.boxes_px + SHIFT_PX, frame.label, frame.confidence)
"""
SHIFTING = {"scene": "harbour", "steps": 20, "trackers": ["shifting"], "keep": ["detections", "tracks"]}
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
    file, first = campaign_file(tmp_path, **SHIFTING), tmp_path / "first.py"
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
    made = checked_campaign(tmp_path, **SHIFTING)
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
    checked_campaign(tmp_path, **SHIFTING)
    site.shift(400)
    with pytest.raises(InputError, match=r"numbers\.py of .* has changed since Python loaded it: start it again"):
        checked_campaign(tmp_path, **SHIFTING)
    (point,) = entry_points(group=TRACKERS, name="shifting")
    planned_elsewhere = {f"{TRACKERS}:shifting": own_files(point)}
    (problem,) = changed_plugins(planned_elsewhere, "the campaign was planned")
    assert problem.endswith("this process has loaded it before it was changed: start it again")
    forget()
    assert changed_plugins(planned_elsewhere, "the campaign was planned") == []


def test_a_campaign_that_was_interrupted_does_not_go_on_with_an_edited_plugin(site: Site, tmp_path: Path) -> None:
    run_plan(checked_campaign(tmp_path, **SHIFTING), tmp_path / "out", ThisProcess, shard=(1, 1))
    forget()
    (site.folder / "shifting" / "more.py").write_text("")
    changed = r"another plan: shifting/more\.py of the plug-in modsim3d\.trackers:shifting"
    with pytest.raises(OutputError, match=changed):
        run_plan(checked_campaign(tmp_path, **SHIFTING), tmp_path / "out", ThisProcess)


def test_files_of_an_installed_package_are_those_of_its_record_and_all_in_its_folder(site: Site) -> None:
    recorded = ["shifting/__init__.py", "shifting/tracker.py", "shifting/data.bin", "../share/weights.bin"]
    made = ["shifting/__pycache__/tracker.cpython-311.pyc", "../bin/shifting", "shifting-1.0.dist-info/INSTALLER"]
    not_recorded = {"shifting/numbers.py", "shifting/downloaded.bin"}
    for name in (*recorded[2:], *made[1:], "shifting/downloaded.bin"):
        (site.folder / name).parent.mkdir(exist_ok=True)
        (site.folder / name).write_text(name)
    (site.info / "RECORD").write_text("".join(f"{name},,\n" for name in [*recorded, *made]))
    _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
    assert {*plugin.files} == {*recorded, *not_recorded, "entry_points.txt"}


def test_without_a_record_files_of_a_plugin_are_its_module_or_its_own_package_in_a_namespace(site: Site) -> None:
    def files_of(module: str) -> set[str]:
        (site.info / "entry_points.txt").write_text(f"[modsim3d.trackers]\nshifting = {module}:Shifting\n")
        _, plugin = load_plugin(TRACKERS, "shifting", "--tracker")
        forget(module.partition(".")[0])
        return {*plugin.files}

    (site.folder / "single.py").write_text(TRACKER)
    assert files_of("single") == {"single.py", "entry_points.txt"}
    (site.folder / "space" / "other").mkdir(parents=True)
    (site.folder / "space" / "other" / "__init__.py").write_text("")
    (site.folder / "shifting").rename(site.folder / "space" / "shifting")
    (site.folder / "space" / "shifting" / "tracker.py").write_text("SHIFT_PX = 0\n" + TRACKER)
    assert files_of("space.shifting.tracker") == {"entry_points.txt", *(f"space/{name}" for name in OWN)}


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
