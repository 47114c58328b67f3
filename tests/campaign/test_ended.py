"""A campaign that has ended checks its files when it is opened."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from modsim3d.campaign.campaign import open_campaign
from modsim3d.campaign.folder import LIST, planned
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.workers import ThisProcess
from modsim3d.core.errors import ModsimError
from tests.campaign.campaigns import checked_campaign
from tests.campaign.small_campaign import small_campaign
from tests.cli.conftest import Modsim3d

KEYS = {"scene": "harbour", "steps": 3, "trackers": ["reference"], "require": [{"score": "hota", "at_least": 0.9}]}
COMMANDS = (["status"], ["table"], ["report"], ["reproduce", "0", "--out", "again"])


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a campaign; what a test changes in it is put back."""
    folder = tmp_path_factory.mktemp("ended")
    run_plan(checked_campaign(folder, **KEYS), folder / "out", ThisProcess)
    return folder / "out"


def plan_with_another_threshold(path: Path) -> None:
    path.write_text(path.read_text().replace('"at_least": 0.9', '"at_least": 0.1'))


def other_scores(path: Path) -> None:
    table = pq.read_table(path, partitioning=None)
    place = table.column_names.index("hota")
    pq.write_table(table.set_column(place, "hota", [[0.99] * len(table)]), path)


def other_outcome(path: Path) -> None:
    path.write_text(path.read_text().replace("undecided", "met"))


CHANGES: dict[str, Callable[[Path], object]] = {
    "plan.json": plan_with_another_threshold,
    "results/scene=harbour/part-00000.parquet": other_scores,
    "results/scene=harbour/part-00001.parquet": lambda path: path.write_bytes(
        (path.parent / "part-00000.parquet").read_bytes()
    ),
    "verdicts.json": other_outcome,
    "campaign.yaml": lambda path: path.write_text(path.read_text().replace("0.9", "0.1")),
    f"results/{LIST}": lambda path: path.unlink(),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_file_that_was_changed_after_the_end_is_refused_by_its_name(ended: Path, name: str) -> None:
    path = ended / name
    before = path.read_bytes() if path.exists() else None
    open_campaign(ended)
    CHANGES[name](path)
    try:
        with pytest.raises(ModsimError, match=f"^{path} (was changed|cannot be read)"):
            open_campaign(ended)
        with pytest.raises(ModsimError, match=f"^{path} (was changed|cannot be read)"):
            run_plan(checked_campaign(ended.parent, **KEYS), ended, ThisProcess)
    finally:
        path.unlink(missing_ok=True)
        if before is not None:
            path.write_bytes(before)
    assert open_campaign(ended).finished


@pytest.mark.parametrize("files", ['{"../x": 5}', '{"x": {"bytes": 5}}', '{"x": ["bytes", "sha256"]}', '["x"]', "5"])
def test_a_list_of_another_form_is_refused_as_a_damaged_one(ended: Path, files: str) -> None:
    path = ended / "results" / LIST
    before = path.read_bytes()
    path.write_text(f'{{"files": {files}}}')
    try:
        with pytest.raises(ModsimError, match=f"^{path} cannot be read, or a file that it lists: .*; remove"):
            open_campaign(ended)
    finally:
        path.write_bytes(before)


def test_the_list_has_every_file_but_the_log(ended: Path) -> None:
    files = {path.relative_to(ended).as_posix(): path for path in ended.rglob("*") if path.is_file()}
    listed = json.loads((ended / "results" / LIST).read_text())["files"]
    assert {*listed} == {*files} - {"campaign.log", f"results/{LIST}"}
    assert {name: each["bytes"] for name, each in listed.items()} == {
        name: files[name].stat().st_size for name in listed
    }
    assert pq.read_table(ended / "results")["hota"].to_pylist() == open_campaign(ended).table["hota"].to_pylist()


def test_a_plan_that_was_changed_before_the_end_is_refused(tmp_path: Path) -> None:
    campaign = checked_campaign(tmp_path, **KEYS)
    here = planned(campaign, tmp_path / "planned")
    plan_with_another_threshold(here.path / "plan.json")
    for attempt in (lambda: open_campaign(here.path), lambda: run_plan(campaign, here.path, ThisProcess)):
        with pytest.raises(ModsimError, match=r"planned/plan\.json was changed after it was written"):
            attempt()


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_every_command_refuses_altered_results(modsim3d: Modsim3d, tmp_path: Path, command: list[str]) -> None:
    folder = small_campaign(tmp_path)
    other_scores(folder / "results/scene=harbour/part-00000.parquet")
    said = modsim3d("campaign", command[0], folder, *command[1:])
    assert said.status == 2
    assert "part-00000.parquet was changed after the campaign ended" in said.err
