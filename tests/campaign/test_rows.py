"""Rows of a campaign are those that the ordinary commands give, and each layer is made once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import modsim3d
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.row import SCORES
from tests.campaign.campaigns import run_campaign_file

STEPS = 12
WAVES = [{"level": "small", "apply_to": "all"}, {"level": "large", "apply_to": "all"}]
KEYS: dict[str, Any] = {
    "scene": "harbour",
    "steps": STEPS,
    "seed": 3,
    "seeds": {"traffic": 2, "detector": 2},
    "vary": [{"grid": {"waves": WAVES}}, {"grid": {"detector.states.excellent.false_discovery_rate": [0.02, 0.3]}}],
    "trackers": ["reference", {"tracker": "reference", "name": "patient", "set": {"lost_s": 9}}],
}


@pytest.fixture(scope="module")
def made() -> dict[str, int]:
    """How often each layer of the campaign was made."""
    return {"truth_block": 0, "Simulation": 0, "tracked": 0}


@pytest.fixture(scope="module")
def rows(made: dict[str, int], tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    def counted(name: str) -> Callable[..., Any]:
        function = getattr(layers, name)

        def call(*arguments: Any, **keywords: Any) -> Any:
            made[name] += 1
            return function(*arguments, **keywords)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in made:
            patch.setattr(layers, name, counted(name))
        table = run_campaign_file(tmp_path_factory.mktemp("rows"), **KEYS).table
    return list(table.to_pylist())


def test_every_run_of_the_plan_has_a_row_in_its_order(rows: list[dict[str, Any]]) -> None:
    assert [row["run"] for row in rows] == list(range(2 * 2 * 2 * 2 * 2))
    assert {row["status"] for row in rows} == {"done"}
    assert {row["tracker"] for row in rows} == {"reference", "patient"}


@pytest.mark.parametrize("number", [0, 21, 31])
def test_a_row_has_the_scores_of_an_ordinary_run(number: int, rows: list[dict[str, Any]], tmp_path: Path) -> None:
    row = rows[number]
    waves = WAVES[row["condition"] // 2]
    rate = row["detector.states.excellent.false_discovery_rate"]
    scene = modsim3d.load_scene(
        "harbour",
        steps=STEPS,
        seed=row["traffic_seed"],
        detector_seed=row["detector_seed"],
        settings={"waves": waves, "detector.states.excellent.false_discovery_rate": rate},
    )
    modsim3d.run_scene(scene, tmp_path / "run")
    settings = {"lost_s": 9} if row["tracker"] == "patient" else {}
    modsim3d.track_run(tmp_path / "run", tmp_path / "tracks", settings=settings)
    scores = modsim3d.score_run(tmp_path / "run", tmp_path / "tracks").trackers[0].scores.flat()
    assert {key: row[key] for key in SCORES} == {key: scores[key] for key in SCORES}


def test_layers_are_shared_by_the_runs_that_have_them_in_common(rows: list[dict[str, Any]]) -> None:
    def kinds(key: str, *by: Callable[[dict[str, Any]], object]) -> None:
        parts = {tuple(part(row) for part in by): set[str]() for row in rows}
        for row in rows:
            parts[tuple(part(row) for part in by)].add(row[key])
        assert all(len(found) == 1 for found in parts.values())
        assert len({value for found in parts.values() for value in found}) == len(parts)

    kinds("truth_key", lambda row: row["traffic_seed"], lambda row: row["condition"] // 2)
    kinds("detections_key", lambda row: row["detector_seed"], lambda row: row["condition"])
    kinds("tracks_key", lambda row: row["run"])


def test_truth_and_detections_are_made_once(rows: list[dict[str, Any]], made: dict[str, int]) -> None:
    assert len(rows) == 32
    assert made == {"truth_block": 2 * 2, "Simulation": 2 * 2 * 2 * 2, "tracked": 32}


def test_one_truth_serves_all_seeds_where_it_does_not_depend_on_them(tmp_path: Path) -> None:
    table = run_campaign_file(tmp_path, **{**KEYS, "steps": 3, "vary": []}).table
    assert len(set(table["traffic_seed"].to_pylist())) == 2
    assert len(set(table["truth_key"].to_pylist())) == 1
    assert len(set(table["detections_key"].to_pylist())) == 4
