"""Rows of a campaign are those that the ordinary commands give, and each layer is made once."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import modsim3d
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.row import SCORES
from tests.campaign.campaigns import count_calls, run_campaign_file

Made = tuple[list[dict[str, Any]], Counter[str]]
STEPS = 12
RATE = "detector.states.excellent.false_discovery_rate"
WAVES = [{"level": "small", "apply_to": "all"}, {"level": "large", "apply_to": "all"}]
KEYS: dict[str, Any] = {
    "scene": "harbour", "steps": STEPS, "seed": 3, "seeds": {"traffic": 2, "detector": 2},
    "vary": [{"grid": {"waves": WAVES}}, {"grid": {RATE: [0.02, 0.3]}}],
    "trackers": ["reference", {"tracker": "reference", "name": "patient", "set": {"lost_s": 9}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The rows of a campaign, and how often each layer was made for them."""
    with pytest.MonkeyPatch.context() as patch:
        counts = count_calls(
            patch, layers, {"truth_block": "truth", "detected_tables": "detections", "run_tracker": "tracks"}
        )
        return run_campaign_file(tmp_path_factory.mktemp("rows"), **KEYS).table.to_pylist(), counts


@pytest.mark.parametrize("number", [0, 31])
def test_a_row_has_the_scores_of_an_ordinary_run(number: int, made: Made, tmp_path: Path) -> None:
    row = made[0][number]
    settings = {"waves": WAVES[row["condition"] // 2], RATE: row[RATE]}
    seeds = {"seed": row["traffic_seed"], "detector_seed": row["detector_seed"]}
    modsim3d.run_scene(modsim3d.load_scene("harbour", steps=STEPS, settings=settings, **seeds), tmp_path / "run")
    settings = {"lost_s": 9} if row["tracker"] == "patient" else {}
    modsim3d.track_run(tmp_path / "run", tmp_path / "tracks", settings=settings)
    scores = modsim3d.score_run(tmp_path / "run", tmp_path / "tracks").trackers[0].scores.flat()
    assert {key: row[key] for key in SCORES} == {key: scores[key] for key in SCORES}


def test_every_run_has_a_row_and_layers_are_made_once_for_the_runs_that_have_them_in_common(made: Made) -> None:
    rows, counts = made
    assert counts == {"truth": 2 * 2, "detections": 2 * 2 * 2 * 2, "tracks": 32}
    assert [row["run"] for row in rows] == list(range(2 * 2 * 2 * 2 * 2))
    assert {(row["status"], row["tracker"]) for row in rows} == {("done", "reference"), ("done", "patient")}
    for key, count, part in (
        ("truth_key", 4, lambda row: (row["traffic_seed"], row["condition"] // 2)),
        ("detections_key", 16, lambda row: (row["detector_seed"], row["condition"])),
        ("tracks_key", 32, lambda row: row["run"]),
    ):
        pairs = {(part(row), row[key]) for row in rows}  # each part has one layer, and each layer one part
        assert len(pairs) == len({one for one, _ in pairs}) == len({layer for _, layer in pairs}) == count


def test_one_truth_serves_all_seeds_where_it_does_not_depend_on_them(tmp_path: Path) -> None:
    table = run_campaign_file(tmp_path, **{**KEYS, "steps": 3, "vary": []}).table
    assert [len(table[name].unique()) for name in ("traffic_seed", "truth_key", "detections_key")] == [2, 1, 4]
