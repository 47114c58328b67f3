"""A small sample of `script/campaign platforms`: an older processor gives the same detections."""

from typing import Any

from benchmarks.campaigns.platforms import Platform, campaign, markdown, platforms

OLDEST = next(platform for platform in platforms([]) if platform.name == "all of a processor without AVX")


def page(row: dict[str, Any]) -> str:
    return markdown({"platforms": [row], "scenes": [], "steps": 1, "reference": "", "files": 1})


def test_an_older_processor_gives_the_same_files_in_waves_the_same_detections_and_another_seed_is_noticed(tmp_path):
    compared = [Platform("here"), OLDEST, Platform("another seed", options=("--detector-seed", "8"))]
    older, other = campaign(compared, ["simulation_1", "strait"], 12, tmp_path)
    assert (older["platform"], older["variables"]) == (OLDEST.name, OLDEST.variables)
    assert "simulation_1" not in older["differs"] and "simulation_1" not in page(older)
    assert not [name for name in older["differs"].get("strait", {}) if name.startswith(("detections", "frames"))]
    assert set(other["differs"]["simulation_1"]) >= {"detections.parquet", "detections_C0.json"}
    assert "detections.parquet" in page(other)
