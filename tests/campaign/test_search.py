"""A search from its file to its folder: trials, crashes, refusals, and going on after an interruption."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import DIED, Progress
from modsim3d.campaign.search import NO_RATE, SearchResult, run_search
from modsim3d.campaign.search_folder import search_table, trial_run
from modsim3d.campaign.work import task as tasks
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.work.layers import RunLayers
from modsim3d.campaign.work.row import row_of, rules_of
from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.campaign.workers import LOST, Death, Engine, ThisProcess
from modsim3d.core.errors import InputError, ModsimError

pytest.importorskip("optuna")
RATE = "detector.states.good.false_discovery_rate"
HEIGHT = "cameras.quay.pose.position_m[2]"
DOUBLES = "detector.false_positives.duplicates"
SEARCH: dict[str, Any] = {
    "minimise": "hota",
    "over": {
        RATE: [0.01, 0.12],
        DOUBLES: [0, 0.06],  # more than a low rate leaves room for: the detector refuses it
        HEIGHT: {"low": 5, "high": 9, "whole": True},
        "state": {"choices": ["good", "terrible"]},
    },
    "budget": 12,
    "batch": 4,
    "seeds": 3,
}
FILE = {"scene": "harbour", "steps": 12, "trackers": ["sort"], "search": SEARCH}


def written(folder: Path, **keys: Any) -> Path:
    content = {**FILE, **keys}
    if isinstance(content["scene"], list):
        content["scenes"] = content.pop("scene")
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


class Backwards(ThisProcess):
    """Does the latest task first, and wants many at once."""

    width = 2

    def next(self) -> tuple[Task, TaskReport | Death]:
        self._waiting.reverse()
        found = super().next()
        self._waiting.reverse()
        return found


class Interrupted(ThisProcess):
    """Is interrupted after six tasks."""

    done = 0

    def next(self) -> tuple[Task, TaskReport | Death]:
        if self.done == 6:
            raise KeyboardInterrupt
        self.done += 1
        return super().next()


class Deadly(ThisProcess):
    """Loses its worker over one trial."""

    def next(self) -> tuple[Task, TaskReport | Death]:
        if self._waiting[0].runs[0].number == 3:
            return self._waiting.pop(0), LOST
        return super().next()


def no_engine() -> Engine:
    raise AssertionError("there is nothing to do")


def search(campaign: Path, folder: Path, engine: Callable[[], Engine], **keys: Any) -> SearchResult:
    return run_search(checked(read_campaign(campaign)), folder, engine, **keys)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("campaign"))


@pytest.fixture(scope="module")
def told() -> list[Progress]:
    return []


@pytest.fixture(scope="module")
def result(campaign: Path, told: list[Progress]) -> SearchResult:
    return search(campaign, campaign.parent / "found", ThisProcess, progress=told.append)


def part(result: SearchResult) -> bytes:
    return (result.folder.path / "search" / "part-00000.parquet").read_bytes()


def columns(table: pa.Table, *names: str) -> list[dict[str, Any]]:
    return list(table.select(list(names)).to_pylist())


def test_every_trial_is_within_the_limits_and_refused_values_are_no_failures(result: SearchResult) -> None:
    rows = columns(result.table, "run", "status", "error", "hota", "traffic_seed", RATE, DOUBLES, HEIGHT, "state")
    assert [row["run"] for row in rows] == list(range(12))
    for row in rows:
        assert 0.01 <= row[RATE] <= 0.12 and 0 <= row[DOUBLES] <= 0.06
        assert row[HEIGHT] in (5, 6, 7, 8, 9) and row["state"] in ("good", "terrible")
        assert row["traffic_seed"] in (1_000_000, 1_000_001, 1_000_002)
        assert (row["hota"] is None) == (row["error"] is not None) == (row["status"] == "refused")
        assert row["error"] is None or "leaves room for" in row["error"]
    assert {row["status"] for row in rows} == {"done", "refused"}


def test_progress_counts_every_trial_and_nothing_of_a_search_is_among_the_results(
    result: SearchResult, told: list[Progress]
) -> None:
    assert [(each.done, each.total, each.crashed) for each in told] == [(done, 12, 0) for done in range(1, 13)]
    assert told[-1].left_s == 0
    files = {path.name for path in result.folder.path.iterdir() if not path.name.startswith(".")}
    assert files == {"campaign.yaml", "plan.json", "campaign.log", "search"}


def test_a_search_that_ended_is_not_made_again_and_nothing_is_left_of_its_tasks(
    campaign: Path, result: SearchResult
) -> None:
    (result.folder.done / "left").mkdir(parents=True)  # as if it was killed at its very end
    assert search(campaign, result.folder.path, no_engine).table.equals(result.table)
    assert not result.folder.done.exists()


def test_the_worst_comes_first_with_the_command_that_makes_it_again(result: SearchResult) -> None:
    worst = result.findings[0]
    known = [row["hota"] for row in columns(result.table, "hota") if row["hota"] is not None]
    assert [each.value for each in result.findings] == sorted(known)[:5]
    assert worst.again.startswith(f"modsim3d campaign reproduce {result.folder.path} {worst.number} --out ")
    assert f"lowest hota {worst.value:.4g} in trial {worst.number}" in str(result)
    assert str(result).endswith(NO_RATE)


def test_a_trial_is_made_again_from_the_folder(result: SearchResult) -> None:
    worst = result.findings[0]
    run = trial_run(result.folder.path, worst.number)
    layers = RunLayers(result.folder.keys, Path(result.folder.facts["base"]), result.folder.path / "cache")
    try:
        row = row_of(run.number, layers.made(run), rules_of(result.folder.keys.score))
    finally:
        layers.close()
    assert row["hota"] == worst.value
    assert run.condition.values == worst.values
    with pytest.raises(ModsimError, match=r"has no trial 12 \(there: 0 to 11\)"):
        trial_run(result.folder.path, 12)


def test_a_score_that_was_damaged_on_the_disk_is_told(campaign: Path, result: SearchResult) -> None:
    folder = campaign.parent / "damaged"
    shutil.copytree(result.folder.path, folder)
    file = folder / "search" / "part-00000.parquet"
    group = pq.ParquetFile(file).metadata.row_group(0)
    columns = [group.column(place) for place in range(group.num_columns)]
    hota = next(column for column in columns if column.path_in_schema == "hota")
    content = bytearray(file.read_bytes())
    content[hota.data_page_offset - 20] ^= 255  # of the values themselves, which lie before the page that names them
    file.write_bytes(content)
    with pytest.raises(ModsimError, match=r"part-00000\.parquet was changed after the campaign ended"):
        search_table(opened_campaign(folder))


def test_an_interrupted_search_ends_with_the_same_bytes_whichever_engine(campaign: Path, result: SearchResult) -> None:
    folder = campaign.parent / "interrupted"
    with pytest.raises(KeyboardInterrupt):
        search(campaign, folder, Interrupted)
    so_far = search_table(opened_campaign(folder))
    assert so_far.equals(result.table.slice(0, 6).select(so_far.column_names))
    assert trial_run(folder, 7) == trial_run(result.folder.path, 7)
    assert part(search(campaign, folder, Backwards)) == part(result)


def test_crashes_come_first_and_end_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, keys = tasks.row_of, {**SEARCH, "budget": 4, "over": {RATE: [0.2, 0.3]}, "seeds": 1}

    def crashing(number: int, *rest: Any) -> dict[str, Any]:
        if number == 2:
            raise ZeroDivisionError("no boxes")
        return made(number, *rest)

    monkeypatch.setattr(tasks, "row_of", crashing)
    found = search(written(tmp_path, search=keys), tmp_path / "out", Deadly)
    crashes = {each.number: each.error for each in found.findings if each.error is not None}
    assert crashes == {2: "ZeroDivisionError: no boxes", 3: DIED}
    assert [each.number for each in found.findings[:2]] == [2, 3]
    assert "2 crashed" in str(found)


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"search": {**SEARCH, "minimise": "hotta"}}, r"search.minimise: there is no score 'hotta' \(did you mean"),
        ({"trackers": ["sort", "oracle"]}, "search: needs one tracker, and there are 2"),
        ({"scene": ["harbour", "strait"]}, "search: needs one scene and one condition, and there are 2"),
        ({"vary": [{"grid": {"state": ["good"]}}]}, "search.over: 'state' is in vary too"),
        ({"vary": [{"uniform": {"time_step_s": [0.4, 0.6]}}]}, "vary: 'time_step_s' is drawn"),
        ({"seeds": {"traffic": 3}}, "seeds: does not go with search.*search.seeds is the number"),
        ({"require": [{"score": "hota", "at_least": 0.5}]}, "require: does not go with search"),
        ({"uncertainty": "learned"}, "uncertainty: does not go with search"),
        ({"batch": 4}, "batch: does not go with search: search.batch is the number of trials"),
        ({"search": {**SEARCH, "over": {"seed": [1, 2]}}}, "search.over: 'seed' cannot be searched"),
        ({"search": {**SEARCH, "over": {"wave.level": [1, 2]}}}, r"search\.over.*wave\.level.*unknown key wave"),
        ({"search": {**SEARCH, "over": {"tracker.lost": [1, 2]}}}, r"search\.over.*lost"),
        ({"search": {**SEARCH, "seeds": 2000}}, "search.seeds: at most 1,000"),
    ],
)
def test_a_wrong_search_is_refused_before_it_starts(keys: dict[str, Any], problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        checked(read_campaign(written(tmp_path, **keys)))
