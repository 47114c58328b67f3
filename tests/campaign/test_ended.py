"""A campaign that has ended checks its files when it is opened."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from modsim3d import ModsimError, open_campaign
from modsim3d.campaign.folder import LIST, planned
from modsim3d.campaign.running import run_plan
from tests.campaign.campaigns import checked_campaign, run_campaign_file
from tests.campaign.one_process import ThisProcess
from tests.campaign.small_campaign import small_campaign
from tests.cli.conftest import Modsim3d

KEYS = {"scene": "harbour", "steps": 3, "trackers": ["reference"], "require": [{"score": "hota", "at_least": 0.9}]}


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a campaign; what a test changes in it is put back."""
    return run_campaign_file(tmp_path_factory.mktemp("ended"), **KEYS).folder.path


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
        for attempt in (lambda: open_campaign(ended), lambda: run_campaign_file(ended.parent, **KEYS)):
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
    campaign = checked_campaign(tmp_path, **KEYS)
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
