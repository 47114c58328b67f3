"""A search: what it proposes, its trials, crashes and refusals, and going on after an interruption."""

import shutil
from pathlib import Path
from statistics import mean
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.keys import SearchKeys
from modsim3d.campaign.reproduce import remade
from modsim3d.campaign.running import DIED, Progress
from modsim3d.campaign.search import NO_RATE, SearchResult, run_search
from modsim3d.campaign.search_folder import Point, TriedPoint, proposed, search_table, trial_run
from modsim3d.campaign.work import task as tasks
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.row import row_of
from modsim3d.core.errors import InputError, ModsimError
from tests.campaign.campaigns import Losing, Shuffled, checked_campaign, interrupt, no_engine
from tests.campaign.one_process import ThisProcess

pytest.importorskip("optuna")
RATE = "detector.states.good.false_discovery_rate"
HEIGHT = "cameras.quay.pose.position_m[2]"
DOUBLES = "detector.false_positives.duplicates"
SEARCH: dict[str, Any] = {
    "minimise": "hota",
    "over": {
        RATE: [0.01, 0.12], DOUBLES: [0, 0.06],  # more than a low rate leaves room for: the detector refuses it
        HEIGHT: {"low": 5, "high": 9, "whole": True}, "state": {"choices": ["good", "terrible"]},
    },
    "budget": 12, "batch": 4, "seeds": 3,
}  # fmt: skip
FILE: dict[str, Any] = {"scenes": ["harbour"], "steps": 12, "trackers": ["sort"], "search": SEARCH}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> CheckedCampaign:
    return checked_campaign(tmp_path_factory.mktemp("campaign"), **FILE)


@pytest.fixture(scope="module")
def told() -> list[Progress]:
    return []


@pytest.fixture(scope="module")
def result(campaign: CheckedCampaign, told: list[Progress]) -> SearchResult:
    return run_search(campaign, campaign.file.base / "found", ThisProcess, progress=told.append)


def test_every_trial_is_within_the_limits_and_counted_and_refused_values_are_no_failures(result, told):
    rows = result.table.to_pylist()
    assert [row["run"] for row in rows] == list(range(12))
    for row in rows:
        assert 0.01 <= row[RATE] <= 0.12 and 0 <= row[DOUBLES] <= 0.06
        assert row[HEIGHT] in (5, 6, 7, 8, 9) and row["state"] in ("good", "terrible")
        assert row["traffic_seed"] in (1_000_000, 1_000_001, 1_000_002)
        assert (row["hota"] is None) == (row["error"] is not None) == (row["status"] == "refused")
        assert row["error"] is None or "leaves room for" in row["error"]
    assert {row["status"] for row in rows} == {"done", "refused"}
    assert [(each.done, each.total, each.crashed) for each in told] == [(done, 12, 0) for done in range(1, 13)]
    assert told[-1].left_s == 0
    files = {path.name for path in result.folder.path.iterdir() if not path.name.startswith(".")}
    assert files == {"campaign.yaml", "plan.json", "campaign.log", "search"}


def test_a_search_that_ended_is_not_made_again_leaves_no_task_and_tells_of_a_damaged_score(campaign, result, tmp_path):
    (result.folder.done / "left").mkdir(parents=True)  # as if it was killed at its very end
    assert run_search(campaign, result.folder.path, no_engine).table.equals(result.table)
    assert not result.folder.done.exists()
    file = shutil.copytree(result.folder.path, tmp_path / "damaged") / "search" / "part-00000.parquet"
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 255
    file.write_bytes(content)
    with pytest.raises(ModsimError, match=r"part-00000\.parquet was changed after the campaign ended"):
        search_table(opened_campaign(tmp_path / "damaged"))


def test_the_worst_comes_first_with_the_command_that_makes_it_again_from_the_folder(result: SearchResult) -> None:
    worst, folder = result.findings[0], result.folder
    assert [each.value for each in result.findings] == sorted(result.table["hota"].drop_null().to_pylist())[:5]
    assert worst.again.startswith(f"modsim3d campaign reproduce {folder.path} {worst.number} --out ")
    assert f"lowest HOTA {worst.value:.3f} in trial {worst.number}" in str(result) and str(result).endswith(NO_RATE)
    run = trial_run(folder.path, worst.number)
    row = row_of(run.number, remade(folder, run.number), folder.keys.score)
    assert (row["hota"], run.condition.values) == (worst.value, worst.values)
    with pytest.raises(ModsimError, match=r"has no trial 12 \(there: 0 to 11\)"):
        trial_run(folder.path, 12)


def test_an_interrupted_search_ends_with_the_same_bytes_whichever_engine(campaign, result, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_search(campaign, tmp_path, ThisProcess, progress=lambda now: interrupt() if now.done == 6 else None)
    so_far = search_table(opened_campaign(tmp_path))
    assert so_far.equals(result.table.slice(0, 6).select(so_far.column_names))
    assert trial_run(tmp_path, 7) == trial_run(result.folder.path, 7)
    run_search(campaign, tmp_path, lambda: Shuffled(2))
    parts = [folder / "search" / "part-00000.parquet" for folder in (tmp_path, result.folder.path)]
    assert parts[0].read_bytes() == parts[1].read_bytes()


def test_crashes_come_first_and_end_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, keys = tasks.row_of, {**SEARCH, "budget": 4, "over": {RATE: [0.2, 0.3]}, "seeds": 1}

    def crashing(number: int, *rest: Any) -> dict[str, Any]:
        if number == 2:
            raise ZeroDivisionError("no boxes")
        return made(number, *rest)

    monkeypatch.setattr(tasks, "row_of", crashing)
    campaign = checked_campaign(tmp_path, **{**FILE, "search": keys})
    found = run_search(campaign, tmp_path / "out", lambda: Losing(lambda task: task.runs[0].number == 3))
    assert [(each.number, each.error) for each in found.findings[:2]] == [(2, "ZeroDivisionError: no boxes"), (3, DIED)]
    assert all(each.error is None for each in found.findings[2:]) and "2 crashed" in str(found)


@pytest.mark.parametrize(("keys", "problem"), [
    ({"search": {**SEARCH, "minimise": "hotta"}}, r"search.minimise: there is no score 'hotta' \(did you mean"),
    ({"trackers": ["sort", "oracle"]}, "search: needs one tracker, and there are 2"),
    ({"scenes": ["harbour", "strait"]}, "search: needs one scene and one condition, and there are 2"),
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
])  # fmt: skip
def test_a_wrong_search_is_refused_before_it_starts(keys: dict[str, Any], problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        checked_campaign(tmp_path, **{**FILE, **keys})


def search_of(**keys: object) -> SearchKeys:
    return SearchKeys.model_validate({"minimise": "hota", "over": {"x": [0, 1]}, "budget": 60, **keys})


def tried_of(points: list[Point], score: object, crashed: bool = False) -> list[TriedPoint]:
    return [TriedPoint(point, None if crashed else score(point), crashed) for point in points]  # type: ignore[operator]


def searched(search: SearchKeys, seed: int, score: object) -> list[TriedPoint]:
    """All trials of a search for the least score."""
    found: list[TriedPoint] = []
    for batch in range(-(-search.budget // search.batch)):
        found += tried_of(proposed(search, seed, batch, found), score)
    return found


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-9, 1e6, allow_subnormal=False), st.floats(1e-12, 10), st.booleans(), st.integers(1, 9000))
def test_no_point_is_outside_of_its_range(low: float, width: float, log: bool, seed: int) -> None:
    """Also where the ends have more digits than the points."""
    high, scale = low * (1 + width), "log" if log else "linear"
    if not low < high:
        return
    over = {"x": {"low": low, "high": high, "scale": scale}, "c": {"choices": [None, "a", [1, 2]]}}
    over |= {"n": {"low": 2, "high": 4, "whole": True, "scale": scale}}
    search = search_of(over=over, budget=24, batch=12, seeds=3)
    first = proposed(search, seed, 0, [])
    for point in first + proposed(search, seed, 1, tried_of(first, lambda point: -point.places["x"])):
        values = point.values(search.over)
        assert low <= values["x"] <= high and values["n"] in (2, 3, 4) and isinstance(values["n"], int)
        assert values["c"] in (None, "a", [1, 2]) and point.seed_index in (0, 1, 2)


def test_a_batch_follows_from_the_seed_its_number_and_the_scores_before_it_of_which_crashes_are_none() -> None:
    search = search_of(over={"x": [0, 1], "y": [0, 1]})
    known = tried_of(proposed(search, 1, 0, []), lambda point: point.places["x"])
    other = tried_of(proposed(search, 1, 0, []), lambda point: point.places["y"])
    assert proposed(search, 1, 1, known) == proposed(search, 1, 1, known)
    assert proposed(search, 1, 1, known) != proposed(search, 1, 1, other)
    assert proposed(search, 1, 0, []) != proposed(search, 2, 0, [])
    assert len({point.places["x"] for batch in (0, 1) for point in proposed(search, 1, batch, [])}) == 20
    crashes = tried_of(proposed(search, 2, 0, []), None, crashed=True)
    assert proposed(search, 1, 2, [*known, *crashes]) == proposed(search, 1, 2, known)
    sizes = [len(proposed(search_of(budget=25), 1, batch, [])) for batch in range(3)]
    assert sizes == [10, 10, 5]  # the last one is what is left of the budget


@pytest.mark.parametrize("goal", ["minimise", "maximise"])
def test_a_search_comes_closer_to_the_worst_point(goal: str) -> None:
    sign = 1 if goal == "minimise" else -1
    keys = {"over": {"x": [0, 1], "y": [0, 1]}, "minimise": None, goal: "hota"}
    found = searched(search_of(**keys), 1, lambda point: sign * abs(point.places["x"] - 0.2))
    distances = [abs(each.point.places["x"] - 0.2) for each in found]
    assert mean(distances[-20:]) < 0.4 * mean(distances[:20])


def test_a_seed_that_is_bad_is_tried_more_often_and_points_that_the_scene_refuses_are_avoided() -> None:
    found = searched(search_of(seeds=4), 1, lambda point: float(point.seed_index != 2) + point.places["x"])
    assert sum(each.point.seed_index == 2 for each in found[-40:]) > 15  # 10 by chance
    found = searched(search_of(), 1, lambda point: None if point.places["x"] > 0.5 else point.places["x"])
    assert sum(each.value is None for each in found[-20:]) < sum(each.value is None for each in found[:20]) / 2
