"""A small sample of `script/campaign platforms`: an older processor gives the same detections."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.campaigns.platforms import Platform, campaign, markdown, platforms

OLDEST = "all of a processor without AVX"


@pytest.fixture(scope="module")
def oldest() -> Platform:
    return next(platform for platform in platforms([]) if platform.name == OLDEST)


def test_an_older_processor_gives_the_same_files(oldest: Platform, tmp_path: Path) -> None:
    (found,) = campaign([Platform("here"), oldest], ["simulation_1"], 12, tmp_path)
    assert found == {"platform": OLDEST, "variables": oldest.variables, "differs": {}}
    assert "simulation_1" not in markdown({"platforms": [found], "scenes": [], "steps": 1, "reference": "", "files": 1})


def test_waves_on_an_older_processor_leave_the_detections_the_same(oldest: Platform, tmp_path: Path) -> None:
    (found,) = campaign([Platform("here"), oldest], ["strait"], 12, tmp_path)
    assert not [name for name in found["differs"].get("strait", {}) if name.startswith(("detections", "frames"))]


def test_another_seed_is_noticed(tmp_path: Path) -> None:
    other = Platform("another seed", options=("--detector-seed", "8"))
    (found,) = campaign([Platform("here"), other], ["simulation_1"], 12, tmp_path)
    differs = found["differs"]["simulation_1"]
    assert set(differs) >= {"detections.parquet", "detections_C0.json"}
    assert "detections.parquet" in markdown(
        {"platforms": [found], "scenes": [], "steps": 1, "reference": "", "files": 1}
    )
