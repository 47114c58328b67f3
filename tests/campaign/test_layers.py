"""Layers on the disk: the same rows with less work, and nothing that is damaged."""

import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.layers import StoredLayers
from modsim3d.core.errors import OutputError
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.record import Truth
from tests.campaign.campaigns import count_calls, run_campaign_file


def run(folder: Path, name: str, trackers: str, keep: str = "", cache: Path | None = None) -> CampaignResult:
    keys = {"scene": "harbour", "steps": 15, "seeds": {"traffic": 1, "detector": 2}}
    return run_campaign_file(folder, f"{name}.yaml", cache, **keys, trackers=trackers.split(), keep=keep.split())


def bytes_of(result: CampaignResult) -> list[bytes]:
    return [path.read_bytes() for path in sorted(result.folder.results.rglob("*.parquet"))]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    """A campaign that has kept all layers."""
    return run(tmp_path_factory.mktemp("layers"), "kept", "reference sort", "truth detections tracks")


@pytest.fixture
def cache(kept: CampaignResult, tmp_path: Path) -> Path:
    """Its layers, to be used up."""
    return shutil.copytree(kept.folder.path / "cache", tmp_path / "cache")


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each layer is made."""
    return count_calls(
        monkeypatch, layers, {"truth_block": "truth", "detected_tables": "detections", "run_tracker": "tracks"}
    )


def test_a_second_campaign_makes_tracks_only(kept, cache, made, tmp_path):
    with_cache = run(tmp_path, "with", "ocsort sort", cache=cache)
    assert made == {"tracks": 2}  # those of ocsort
    without = run(tmp_path, "without", "ocsort sort")
    assert made["truth"] == 1 and made["detections"] == 2
    assert with_cache.table.equals(without.table) and bytes_of(with_cache) == bytes_of(without)
    tables = (each.table.select(["tracker", "hota"]).to_pylist() for each in (kept, without))
    sort, again = ([row["hota"] for row in table if row["tracker"] == "sort"] for table in tables)
    assert sort == again


def test_what_is_kept_changes_no_row_and_only_named_layers_are_written(kept: CampaignResult, tmp_path: Path) -> None:
    some = run(tmp_path, "some", "reference sort", "detections")
    assert some.table.equals(kept.table)
    assert some.folder.facts["sha256"] == kept.folder.facts["sha256"]  # so a campaign may go on with other layers kept
    assert [path.name for path in (some.folder.path / "cache").iterdir()] == ["detections"]


def test_a_layer_that_cannot_be_kept_ends_the_campaign_and_crashes_no_run(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(OutputError, match="cannot be written"):
        run(tmp_path, "full", "sort", "truth", tmp_path / "cache")


@pytest.mark.parametrize("layer", ["truth", "detections", "tracks"])
def test_a_damaged_layer_is_remade(kept, cache, made, tmp_path, layer):
    first, second, *_ = sorted((cache / layer).rglob("*.parquet")) * 2
    content = bytearray(first.read_bytes())
    content[len(content) // 3] ^= 0xFF  # in a page: the file still opens
    first.write_bytes(content)
    second.write_bytes(second.read_bytes()[:40])
    assert run(tmp_path, "again", "reference sort", layer, cache).table.equals(kept.table) and set(made) == {layer}
    made.clear()
    assert run(tmp_path, "repaired", "reference sort", cache=cache).table.equals(kept.table) and not made


def test_a_layer_of_another_run_is_not_taken(cache, made, kept, tmp_path):
    one, other, *_ = sorted(path.parent for path in (cache / "tracks").rglob("tracks.parquet"))
    shutil.copy(one / "tracks.parquet", other / "tracks.parquet")
    assert run(tmp_path, "again", "reference sort", cache=cache).table.equals(kept.table) and made == {"tracks": 1}


def test_many_may_write_the_same_layer_at_once(tmp_path: Path) -> None:
    table = pa.table({"step": pa.array(range(5_000), pa.int64())})
    stored, key = StoredLayers(tmp_path, ["truth"]), "ab" * 32

    def write_and_read(_: int) -> bool:
        stored.write("truth", key, {"truth": table})
        return stored.read("truth", key, {"truth": table.schema}) in (None, {"truth": table})

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(write_and_read, range(300)))
    assert stored.read("truth", key, {"truth": table.schema}) == {"truth": table}
    assert [path.name for path in stored.path("truth", key).parent.iterdir()] == [key]  # nothing is left over


def test_a_truth_that_is_not_what_is_drawn_crashes_its_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Occlusion.truth

    def wide(self: Occlusion, *arguments: Any) -> Truth:
        truth = original(self, *arguments)
        return replace(truth, full_boxes_px=truth.full_boxes_px + 1.0)

    monkeypatch.setattr(Occlusion, "truth", wide)
    table = run(tmp_path, "wrong", "reference").table
    assert table["status"].to_pylist() == ["crashed", "crashed"]
    assert all(error.startswith("TruthCheckError: cross-check: ") for error in table["error"].to_pylist())
