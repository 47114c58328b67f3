"""A small sample of `script/campaign platforms`: an older processor gives the same detections."""

from typing import Any

import pytest

from benchmarks.campaigns.platforms import Platform, campaign, markdown, platforms

OLDEST = next(platform for platform in platforms([]) if platform.name == "all of a processor without AVX")
OTHER_SEED = Platform("another seed", options=("--detector-seed", "8"))


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What differs from this machine on the oldest processor, and with another seed."""
    folder = tmp_path_factory.mktemp("platforms")
    return campaign([Platform("here"), OLDEST, OTHER_SEED], ["simulation_1", "strait"], 12, folder)


def page(row: dict[str, Any]) -> str:
    return markdown({"platforms": [row], "scenes": [], "steps": 1, "reference": "", "files": 1})


def test_an_older_processor_gives_the_same_files_and_in_waves_the_same_detections(rows: list[dict[str, Any]]) -> None:
    found, _ = rows
    assert (found["platform"], found["variables"]) == (OLDEST.name, OLDEST.variables)
    assert "simulation_1" not in found["differs"] and "simulation_1" not in page(found)
    assert not [name for name in found["differs"].get("strait", {}) if name.startswith(("detections", "frames"))]


def test_another_seed_is_noticed(rows: list[dict[str, Any]]) -> None:
    _, found = rows
    assert set(found["differs"]["simulation_1"]) >= {"detections.parquet", "detections_C0.json"}
    assert "detections.parquet" in page(found)
