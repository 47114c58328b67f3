"""What a row says that its truth covers, held against hand-made scenes and against the scores."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import modsim3d
from modsim3d import RunRows, Scene
from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.work.coverage import KINDS, OCCLUSIONS, RANGES, SIZES, Bins, coverage_of
from modsim3d.campaign.work.layers import Blocks, RunLayers
from modsim3d.campaign.work.row import column_type, row_of
from modsim3d.runs.files.block_files import detected_tables
from modsim3d.runs.pipeline import truth_block
from tests.scenes import camera_keys, crossing, write_scene

KEYS = {"annotation": {"mode": 2, "source": "analytic"}}
KEYS |= {"cameras": {"bow": camera_keys(mount={"vessel": "own", "position_m": [4, 0, 6]})}}
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
    return write_scene(tmp_path_factory.mktemp("own_ship"), boats, 101, **KEYS)


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
        made = layers.made(Plan.of(keys).run(0))
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
