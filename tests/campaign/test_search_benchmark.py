"""The committed comparison of the search with random trials, and a small sample of it."""

import json
from contextlib import closing
from pathlib import Path

import pytest

from benchmarks.campaigns import search as benchmark
from modsim3d.campaign.search import run_search
from modsim3d.campaign.work.layers import RunLayers
from tests.campaign.campaigns import checked_campaign
from tests.campaign.one_process import ThisProcess

pytest.importorskip("optuna")
CAMPAIGNS = Path(__file__).resolve().parents[2] / "docs" / "campaigns"


def test_the_committed_page_is_what_the_campaign_makes_of_its_figures() -> None:
    data = json.loads((CAMPAIGNS / "search.json").read_text(encoding="utf-8"))
    assert (CAMPAIGNS / "search.md").read_text(encoding="utf-8") == benchmark.page(data)


def test_the_benchmark_searches_as_the_command_does(tmp_path: Path) -> None:
    keys = benchmark.keys_of({**benchmark.PROBLEMS["seeds"], "steps": 6}, 3, 12)
    campaign = checked_campaign(tmp_path, **keys.model_dump(mode="json", by_alias=True, exclude_unset=True))
    found = run_search(campaign, tmp_path / "out", ThisProcess).table["hota"].to_pylist()
    with closing(RunLayers(keys, Path(), Path("cache"))) as layers:
        assert benchmark.searched(keys, layers) == found


def test_the_best_score_never_rises_and_the_verdict_follows_the_interval_of_the_differences() -> None:
    assert benchmark.best([0.5, None, 0.6, 0.4]) == [0.5, 0.5, 0.5, 0.4]
    for gain, said in ((-0.1, "found lower scores"), (0.1, "The random trials found lower")):
        found = [{"search": [0.5, 0.4 + gain + 0.001 * each], "random": [0.5, 0.4]} for each in range(5)]
        assert said in benchmark.verdict(found)
    mixed = [{"search": [0.4 + 0.1 * (-1) ** each], "random": [0.4]} for each in range(4)]
    assert "no advantage is shown" in benchmark.verdict(mixed)
