"""Rows of a campaign are those that the ordinary commands give; their layers are made once, also on the disk."""

import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

import modsim3d
from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.layers import StoredLayers
from modsim3d.campaign.work.row import SCORES
from modsim3d.core.errors import OutputError
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.record import Truth
from tests.campaign.campaigns import count_calls, run_campaign_file
from tests.run_folders import run_files

LAYERS = {"truth_block": "truth", "detected_tables": "detections", "run_tracker": "tracks"}


def run(folder: Path, name: str, trackers: str, keep: str = "", cache: Path | None = None) -> CampaignResult:
    keys = {"scene": "harbour", "steps": 15, "seeds": {"traffic": 1, "detector": 2}}
    return run_campaign_file(folder, f"{name}.yaml", cache, **keys, trackers=trackers.split(), keep=keep.split())


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
    return count_calls(monkeypatch, layers, LAYERS)


def test_a_second_campaign_makes_tracks_only(kept, cache, made, tmp_path):
    with_cache = run(tmp_path, "with", "ocsort sort", cache=cache)
    assert made == {"tracks": 2}  # those of ocsort
    without = run(tmp_path, "without", "ocsort sort")
    assert made["truth"] == 1 and made["detections"] == 2
    assert with_cache.table.equals(without.table)
    results = [run_files(each.folder.results, "_files.json") for each in (with_cache, without)]
    assert results[0] == results[1] != {}
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


RowsMade = tuple[list[dict[str, Any]], Counter[str]]
STEPS = 12
RATE = "detector.states.excellent.false_discovery_rate"
WAVES = [{"level": "small", "apply_to": "all"}, {"level": "large", "apply_to": "all"}]
KEYS: dict[str, Any] = {
    "scene": "harbour", "steps": STEPS, "seed": 3, "seeds": {"traffic": 2, "detector": 2},
    "vary": [{"grid": {"waves": WAVES}}, {"grid": {RATE: [0.02, 0.3]}}],
    "trackers": ["reference", {"tracker": "reference", "name": "patient", "set": {"lost_s": 9}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def rows_made(tmp_path_factory: pytest.TempPathFactory) -> RowsMade:
    """The rows of a campaign, and how often each layer was made for them."""
    with pytest.MonkeyPatch.context() as patch:
        counts = count_calls(patch, layers, LAYERS)
        return run_campaign_file(tmp_path_factory.mktemp("rows"), **KEYS).table.to_pylist(), counts


@pytest.mark.parametrize("number", [0, 31])
def test_a_row_has_the_scores_of_an_ordinary_run(number: int, rows_made, tmp_path: Path) -> None:
    row = rows_made[0][number]
    settings = {"waves": WAVES[row["condition"] // 2], RATE: row[RATE]}
    seeds = {"seed": row["traffic_seed"], "detector_seed": row["detector_seed"]}
    modsim3d.run_scene(modsim3d.load_scene("harbour", steps=STEPS, settings=settings, **seeds), tmp_path / "run")
    settings = {"lost_s": 9} if row["tracker"] == "patient" else {}
    modsim3d.track_run(tmp_path / "run", tmp_path / "tracks", settings=settings)
    scores = modsim3d.score_run(tmp_path / "run", tmp_path / "tracks").trackers[0].scores.flat()
    assert {key: row[key] for key in SCORES} == {key: scores[key] for key in SCORES}


def test_every_run_has_a_row_and_layers_are_made_once_for_the_runs_that_share_them(rows_made: RowsMade) -> None:
    rows, counts = rows_made
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
