"""Rows of a campaign: those of ordinary commands, whose layers are made once; and what truth they cover."""

import re
import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import modsim3d
from modsim3d import RunRows, Scene
from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.report.coverage import coverage_sections, empty_draws, numbers_in_words, trace_sections
from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.coverage import KINDS, OCCLUSIONS, RANGES, SIZES, Bins, coverage_of
from modsim3d.campaign.work.layers import Blocks, RunLayers, StoredLayers
from modsim3d.campaign.work.row import SCORES, column_type, row_of
from modsim3d.core.errors import OutputError
from modsim3d.runs.files.block_files import detected_tables
from modsim3d.runs.pipeline import truth_block
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.record import Truth
from tests.campaign.campaigns import count_calls, html_of_blocks, run_campaign_file
from tests.run_folders import run_files
from tests.scenes import camera_keys, crossing, write_scene

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
FACTORS: dict[str, Any] = {
    "scene": "harbour", "steps": STEPS, "seed": 3, "seeds": {"traffic": 2, "detector": 2},
    "vary": [{"grid": {"waves": WAVES}}, {"grid": {RATE: [0.02, 0.3]}}],
    "trackers": ["reference", {"tracker": "reference", "name": "patient", "set": {"lost_s": 9}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def rows_made(tmp_path_factory: pytest.TempPathFactory) -> RowsMade:
    """The rows of a campaign, and how often each layer was made for them."""
    with pytest.MonkeyPatch.context() as patch:
        counts = count_calls(patch, layers, LAYERS)
        return run_campaign_file(tmp_path_factory.mktemp("rows"), **FACTORS).table.to_pylist(), counts


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
    table = run_campaign_file(tmp_path, **{**FACTORS, "steps": 3, "vary": []}).table
    assert [len(table[name].unique()) for name in ("traffic_seed", "truth_key", "detections_key")] == [2, 1, 4]


OWN_SHIP = {"annotation": {"mode": 2, "source": "analytic"}}
OWN_SHIP |= {"cameras": {"bow": camera_keys(mount={"vessel": "own", "position_m": [4, 0, 6]})}}
BOAT = [10, 4, 3]


def rows_in_memory(scene: Scene, blocks: Blocks) -> RunRows:
    return RunRows.of_tables(scene, scene.steps, detected_tables(scene, blocks))


def rows_of(path: Path, steps: int | None = None, **settings: Any) -> RunRows:
    scene = modsim3d.load_scene(path, steps=steps, settings=settings)
    return rows_in_memory(scene, [(truth_block(scene, 0, scene.steps, None), 0, scene.steps)])


@pytest.fixture(scope="module")
def own_ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Own ship runs along w1 at 5 m/s for 100 s; one vessel meets her in each way, and one stays far away."""
    legs = {"own": ([0, 0], [500, 0]), "ahead": ([800, 30], [300, 30]), "starboard": ([330, -260], [330, 240])}
    legs |= {"port": ([300, 250], [300, -250]), "slow": ([150, 60], [250, 60]), "fast": ([-200, -60], [800, -60])}
    legs |= {"far": ([260, 2200], [240, 2200]), "leaving": ([-20, -90], [-400, -90])}
    boats = {name: (BOAT, [[0, *first], [100, *last]]) for name, (first, last) in legs.items()}
    return write_scene(tmp_path_factory.mktemp("own_ship"), boats, 101, **OWN_SHIP)


def test_each_encounter_is_counted_once_and_ranges_and_sizes_are_those_of_a_loop_over_the_visible_rows(own_ship):
    rows = rows_of(own_ship)
    found, visible = coverage_of(rows), rows.numbers("visible_px") > 0
    assert {name: found[name] for name in KINDS.values()} == dict.fromkeys(KINDS.values(), 1)
    assert found["met.seen"] == 4  # the one that overtakes comes up behind the camera
    assert found["covered.closest_approach_m"] == pytest.approx(30.0)
    for name, value in found.items():  # counts are whole numbers, and measures are not
        assert column_type(name) == (pa.int64() if isinstance(value, int) else pa.float64()), name
    short = coverage_of(rows_of(own_ship, 20))
    assert sum(short[name] for name in KINDS.values()) == 0  # the run does not reach them
    boxes, poses = rows.annotated_boxes_px, rows.scene.poses.poses(0, rows.steps)
    ranges_m, sizes_px = [], []
    for row in np.flatnonzero(visible).tolist():
        step, vessel = int(rows.truth_frame[row]), int(rows.truth_vessel[row])
        camera_m = poses.positions_m[step, 0, :2] + np.array([4.0, 0.0])
        ranges_m.append(float(np.hypot(*(poses.positions_m[step, vessel, :2] - camera_m))))
        sizes_px.append(float(np.sqrt(np.prod(boxes[row, 2:] - boxes[row, :2]))))
    assert len(ranges_m) > 100
    for bins, values, name in ((RANGES, ranges_m, "range_m"), (SIZES, sizes_px, "size_px")):
        assert [found[each] for each in bins.names] == np.histogram(values, [0, *bins.edges, np.inf])[0].tolist()
        ends = found[f"covered.least_{name}"], found[f"covered.most_{name}"]
        assert ends == pytest.approx((min(values), max(values)))
    assert found["covered.vessels_at_once"] == max(np.bincount(rows.truth_frame[visible]))
    assert found["covered.vessels.Vessel"] == len(set(rows.truth_vessel[visible].tolist()))


def test_drawn_traffic_meets_own_ship_as_it_was_asked_to() -> None:
    # The reference is independent of this module: `asked` of the craft whose closest approach lies in the run.
    scene = modsim3d.load_scene("fairway", seed=5, settings={"annotation.source": "analytic"})
    of_asked = {"overtaking": "met.own_overtaken", "overtaken": "met.own_overtakes"}
    asked = {of_asked.get(c.asked.kind, f"met.{c.asked.kind}") for c in scene.poses.craft if c.asked is not None}
    nothing = rows_in_memory(scene, [(truth_block(scene, 0, 1, None), 0, 1)])
    found = coverage_of(RunRows(**{**vars(nothing), "steps": scene.steps}))
    assert len(asked) >= 4 and all(found[name] >= 1 for name in asked)


def test_occlusions_are_those_of_the_scores_and_hidden_time_is_that_of_the_hidden_rows(tmp_path: Path) -> None:
    keys = CampaignKeys.model_validate({"scene": str(crossing(tmp_path)), "trackers": ["sort"]})
    with closing(RunLayers(keys, tmp_path, tmp_path / "cache")) as layers:
        made = layers.layers_of(Plan.of(keys).run(0))
    row = row_of(0, made, keys.score)
    assert sum(row[name] for name in OCCLUSIONS.names) == row["occlusions"] >= 2
    shown, in_view = made.rows.numbers("visible_px") > 0, made.rows.numbers("silhouette_px") > 0
    assert sum(row[name] for name in RANGES.names) == np.count_nonzero(shown) < len(shown)
    assert row["covered.hidden_s"] == np.count_nonzero(in_view & ~shown) > 0  # a frame a second
    found = coverage_of(made.rows)  # a camera ashore meets nobody, and says so by no column
    assert not [name for name in found if name.startswith("met.") or name == "covered.closest_approach_m"]
    assert found["covered.wave_height_m"] == found["covered.camera_roll_rad"] == 0


def test_waves_have_their_significant_height_and_roll_the_camera(own_ship: Path) -> None:
    sea = {"spectrum": "jonswap", "significant_height_m": 1.3, "peak_period_s": 6.0, "direction_rad": 1.6}
    rows = rows_of(own_ship, waves=sea)
    found = coverage_of(rows)
    assert found["covered.wave_height_m"] == pytest.approx(1.3)
    roll_rad = np.abs(rows.scene.motion.at(np.arange(rows.steps)).angles_rad[:, 0, 0]).max()
    assert found["covered.camera_roll_rad"] == pytest.approx(roll_rad, abs=1e-3)  # of a camera that looks ahead
    assert roll_rad > 0.01
    assert "covered.wave_height_m" not in coverage_of(rows_of(own_ship, waves={"level": "large"}))


def test_a_value_at_an_edge_belongs_to_the_bin_above() -> None:
    bins = Bins("x.", "m", (10, 20))
    counts = bins.counts(np.array([0.0, 9.9, 10.0, 20.0, 1e9, np.nan]))
    assert counts == {"x.0_10_m": 2, "x.10_20_m": 1, "x.over_20_m": 2}
    assert bins.labels == ("0 to 10 m", "10 to 20 m", "20 m and more")


KEYS: dict[str, Any] = {
    "scene": "harbour", "steps": 20, "seeds": {"traffic": 3}, "vary": [{"uniform": {RATE: [0.02, 0.3]}}],
    "trackers": ["sort", {"tracker": "sort", "name": "patient", "set": {"lost_s": 9}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    return run_campaign_file(tmp_path_factory.mktemp("coverage"), **KEYS)


def lines_of(page: str) -> dict[str, list[str]]:
    """The cells of each row of tables, by the first one."""
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(<td.*?)</tr>", page)]
    return {each[0]: each[1:] for each in cells}


def test_a_truth_is_counted_once_however_many_runs_are_over_it_and_what_is_empty_is_not_covered(result):
    table, page = result.table, html_of_blocks(coverage_sections(result.folder, result.table))
    assert len(set(table["truth_key"].to_pylist())) == 1  # the traffic of the harbour is not drawn
    assert len(set(table["detections_key"].to_pylist())) == 3
    names = [name for name in table.column_names if name.startswith("covered.")]
    assert len({tuple(row.values()) for row in table.select(names).to_pylist()}) == 1  # over a truth it is the same
    lines = lines_of(page)
    assert "6 of 6 runs are done, over 1 different truth and 1 traffic seed." in page
    assert "The traffic of harbour is not drawn: it is the same for every seed, and counts as one." in page
    assert (frames := table["covered.frames.range_200_500_m"][0].as_py()) > 0
    assert lines["200 to 500 m"] == [f"{frames:,}", "6", "1"]
    assert lines["Vessel"] == [f"{table['covered.vessels.Vessel'][0].as_py()}", "6", "1"]
    assert lines["excellent"] == [f"{3 * 20}", "6", "3"]  # the states are drawn by each of three detector seeds
    assert lines["5,000 m and more"] == ["–", "–", "–"] and re.search(r"<li>Range: [^<]*5,000 m and more</li>", page)
    assert re.search(r"<li>Sea: [^<]*moderate \(1.25 to 2.5 m\)", page)
    assert re.search(rf"<li>{RATE}: no draw from ", page)
    assert "there is no own ship that could meet another" in page and "no claim is made about it" in page
    assert "lost_s 9" in lines["patient"][2] and "lost_s 9" not in lines["sort"][2] and lines["sort"][-1] == "all"


def test_runs_that_crashed_cover_nothing(result: CampaignResult) -> None:
    def page(*status: str) -> str:
        table = result.table.set_column(result.table.column_names.index("status"), "status", pa.array(status))
        return html_of_blocks(coverage_sections(result.folder, table))

    one = page("crashed", *["done"] * 5)
    assert "5 of 6 runs are done" in one and "1 more crashed" in one and lines_of(one)["200 to 500 m"][1] == "5"
    assert "0 of 6 runs are done" in page(*["crashed"] * 6)


def test_a_verdict_is_traced_to_its_runs_seeds_checksums_and_commands(result: CampaignResult) -> None:
    verdict = Verdict(0, "hota < 1 & more", "patient", 0, "met", "", 0.95, 0.5, 0.4, 0.6, 3)
    page = re.sub("<wbr>|</?span[^>]*>", "", html_of_blocks(trace_sections(result.folder, result.table, [verdict])))
    facts, (condition,) = result.folder.facts, result.folder.facts["conditions"]
    (line,) = (cells for name, cells in lines_of(page).items() if name.startswith("1. "))
    assert line == ["patient", "0", "met", "1, 3, 5 (3 of them)", "1000000–1000002 (3 of them)", "3"]
    assert "1. HOTA &lt; 1 &amp; more" in page and facts["sha256"] in page
    assert condition["truth_sha256"][:16] in page and condition["detector_sha256"][:16] in page
    versions = {**facts["versions"], **condition["trackers"]["sort"]["versions"]}
    assert "trackers" in versions and all(lines_of(page)[name] == [version] for name, version in versions.items())
    assert f"modsim3d campaign reproduce {result.folder.path} 0 --out run_0" in page
    assert f"modsim3d campaign run {result.folder.path}/campaign.yaml --out campaign_again" in page
    assert f"{RATE} differ from seed to seed" in page


def test_a_trace_shows_the_first_of_very_many_verdicts_and_may_have_none(result: CampaignResult) -> None:
    verdicts = [Verdict(place, "hota", "sort", 0, "met", "", 0.95, 0.5, 0.4, 0.6, 3) for place in range(300)]
    page = html_of_blocks(trace_sections(result.folder, result.table, verdicts))
    assert "200. HOTA" in page and "201. hota" not in page and "100 more are in verdicts.json." in page
    nothing = result.table.slice(0, 0)
    page = html_of_blocks(trace_sections(result.folder, nothing, []))
    assert "no requirements" in page and "campaign reproduce" in page
    assert "none" in html_of_blocks(trace_sections(result.folder, nothing, verdicts[:1]))


def test_numbers_are_said_in_few_words() -> None:
    for numbers, said in (
        ([], "none"), ([7], "7"), ([0, 1, 2, 3], "0–3 (4 of them)"),
        ([0, 4, 8, 12, 16], "0, 4, … 16 (5 of them, 4 apart)"),
        ([0, 1, 4, 5, 9], "0–1, 4–5, 9 (5 of them)"),
        ([*range(0, 6), *range(9, 40, 3)], "0–5, 9, 12, 15, 18, 21 and 6 ranges more (17 of them)"),
    ):  # fmt: skip
        assert numbers_in_words(np.array(numbers, dtype=np.int64)) == said


def draws(ranges: dict[str, Any], columns: dict[str, list[Any]]) -> list[str]:
    keys = CampaignKeys.model_validate({"scene": "harbour", "trackers": ["sort"], "vary": [{"uniform": ranges}]})
    return empty_draws(keys, pa.table({"status": ["done"] * len(next(iter(columns.values()))), **columns}))


def test_parts_of_ranges_that_no_draw_came_near_and_choices_that_were_never_drawn_are_said() -> None:
    tenths = (np.arange(10) / 10 + 0.05).tolist()
    log = {"low": 1, "high": 100, "scale": "log"}
    for key, drawn, said in (
        ([0, 1], [0.05, 0.15, *tenths[4:]], ["x: no draw from 0.2 to 0.4"]),
        ([0, 1], tenths, []),
        (log, (10 ** (np.arange(9) / 5 + 0.1)).tolist(), ["x: no draw from 63.1 to 100"]),
        ({"choices": [1, 2, 3]}, [1.0, 3.0], ["x: 2: never drawn"]),
        ({"choices": [1, 2]}, [2.0, 1.0], []),
        ({"choices": ["a", 2, True]}, ["a", "2"], ["x: true: never drawn"]),
        ({"choices": ["a", "b"]}, ["b"], ["x: a: never drawn"]),
    ):
        assert draws({"x": key}, {"x": drawn}) == said, key
    along = (np.arange(40) / 40 + 0.01).tolist()
    (said,) = draws({"x": [0, 1], "y": [0, 1]}, {"x": along, "y": along})
    assert said == "x with y: no draw in 12 of 16 squares of quarters of both ranges"
