"""A small sample of `script/campaign platforms`: an older processor gives the same detections."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.campaigns.platforms import Platform, campaign, markdown, platforms

OLDEST = "all of a processor without AVX"


OTHER_SEED = Platform("another seed", options=("--detector-seed", "8"))


@pytest.fixture(scope="module")
def oldest() -> Platform:
    return next(platform for platform in platforms([]) if platform.name == OLDEST)


@pytest.fixture(scope="module")
def rows(oldest: Platform, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What differs from this machine on the oldest processor, and with another seed."""
    folder = tmp_path_factory.mktemp("platforms")
    return campaign([Platform("here"), oldest, OTHER_SEED], ["simulation_1", "strait"], 12, folder)


def test_an_older_processor_gives_the_same_files(oldest: Platform, rows: list[dict[str, Any]]) -> None:
    found, _ = rows
    assert (found["platform"], found["variables"]) == (OLDEST, oldest.variables)
    assert "simulation_1" not in found["differs"]
    assert "simulation_1" not in markdown({"platforms": [found], "scenes": [], "steps": 1, "reference": "", "files": 1})


def test_waves_on_an_older_processor_leave_the_detections_the_same(rows: list[dict[str, Any]]) -> None:
    found, _ = rows
    assert not [name for name in found["differs"].get("strait", {}) if name.startswith(("detections", "frames"))]


def test_another_seed_is_noticed(rows: list[dict[str, Any]]) -> None:
    _, found = rows
    differs = found["differs"]["simulation_1"]
    assert set(differs) >= {"detections.parquet", "detections_C0.json"}
    assert "detections.parquet" in markdown(
        {"platforms": [found], "scenes": [], "steps": 1, "reference": "", "files": 1}
    )
