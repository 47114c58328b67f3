"""The scenes that are timed are what they are said to be, and the bench runs."""

import importlib
import sys

import numpy as np
import pytest
from shapely import intersects

from benchmarks import bench, child, pyrender_pass, scenes
from benchmarks.growth import COUNTS
from benchmarks.measured import Bench, significant
from benchmarks.whole_commands import differing_files
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.scene.reading import load_scene
from tests.scenes import footprints

HERE = scenes.HERE
FILES = {"small": scenes.small, "dense": scenes.dense}


def looked_at(name: str, text: str, tmp_path) -> dict[str, float]:
    return child.shares(Bench(quick=True, folder=tmp_path, bytes_per_s=1.0).scene(name, text))


@pytest.mark.parametrize("name", sorted(path.stem for path in HERE.glob("*.py")))
def test_every_benchmark_finds_what_it_measures(name):
    importlib.import_module(f"benchmarks.{name}")


@pytest.mark.parametrize(("name", "least_m", "most_m"), [("small", 4, 14), ("dense", 5, 300)])
def test_scene_is_what_the_script_writes_with_50_vessels_as_promised_and_waterlines_in_the_image(name, least_m, most_m):
    """In the image are all centres; and of the boats, which no image edge cuts, every corner."""
    assert (HERE / f"{name}.yaml").read_bytes() == FILES[name]().encode()
    scene = load_scene(HERE / f"{name}.yaml")
    lengths = np.array([vessel.length_m for vessel in scene.vessels])
    assert len(lengths) == 50 and lengths.min() >= least_m
    assert lengths.max() <= most_m and lengths.max() / lengths.min() > 0.5 * most_m / least_m
    poses, camera = scene.poses.poses(0, scene.steps), scene.cameras[0]
    distances = np.hypot(poses.positions_m[..., 0], poses.positions_m[..., 1])
    assert poses.present.all() and distances.min() >= 299.9 and distances.max() <= 2500.1
    assert camera.intrinsics.image_size_px == (3600, 2400)
    camera_poses = scene.sight(camera, np.arange(scene.steps)).camera_poses
    size = np.array([(v.length_m, v.beam_m, 0) for v in scene.vessels]) / 2
    signs = [(0, 0, 0)] if name == "dense" else [(a, b, 0) for a in (-1, 1) for b in (-1, 1)]
    turn = world_R_vehicle(poses.headings_rad)
    for sign in signs:
        corners = poses.positions_m + (turn @ (size * sign)[..., None])[..., 0]
        pixels = camera.intrinsics.project(camera_poses.to_camera(corners[:, :, None, :]))
        assert (pixels > 0).all() and (pixels < camera.intrinsics.image_size_px).all()


def test_vessels_never_touch():
    """Their rectangles, at every tenth step."""
    scene = load_scene(HERE / "dense.yaml")
    hulls = footprints(scene, np.arange(0, scene.steps, 10))
    assert not any(intersects(hull, row[:index]).any() for row in hulls for index, hull in enumerate(row))


def test_boats_overlap_as_often_when_they_become_more_and_most_of_the_dense_scene_are_hidden(renderer, tmp_path):
    for count in COUNTS:
        shares = looked_at(f"small{count}", scenes.small(count), tmp_path)
        assert shares["in_image"] == count and 0.10 < shares["overlapping"] < 0.15 and 0.04 < shares["hidden"] < 0.08
    shares = looked_at("dense", scenes.dense(), tmp_path)
    assert shares["in_image"] == 50 and shares["overlapping"] > 0.8 and shares["hidden"] > 0.65
    assert (shares["hidden"] - shares["wholly_hidden"]) / (1 - shares["wholly_hidden"]) > 0.5  # of those seen


def test_boxes_in_an_id_image_are_half_open_and_none_where_an_id_is_not():
    ids = np.zeros((6, 8), dtype=np.uint8)
    ids[2:4, 1:3] = 1
    ids[3:5, 5] = 3
    assert pyrender_pass.boxes_in(ids, 4) == [[1, 2, 3, 4], None, [5, 3, 6, 5], None]
    assert pyrender_pass.boxes_in(np.zeros((6, 8), dtype=np.uint8), 2) == [None, None]


def test_files_that_differ_or_are_missing_are_found(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name / "inner").mkdir(parents=True)
        (tmp_path / name / "same").write_text("x")
        (tmp_path / name / "run.log").write_text(name)
        (tmp_path / name / "inner" / "other").write_text(name)
    (tmp_path / "a" / "alone").write_text("x")
    assert differing_files(tmp_path / "a", tmp_path / "b") == {"alone", "inner/other"}


def test_numbers_have_three_digits_also_those_of_a_time_over_that_of_filling_what_was_drawn(tmp_path):
    values = [significant(value) for value in (0, 0.0123456, 1.5, 68.04, 123.4, 12345)]
    assert values == ["0", "0.0123", "1.50", "68.0", "123", "12,300"]
    trial = Bench(quick=True, folder=tmp_path, bytes_per_s=1e9)
    assert trial.times_limit(3.0, 2e9) == "1.50" and trial.times_limit(3.0, 0) == "nothing is drawn"


def test_a_quick_trial_prints_a_row_and_writes_nothing(monkeypatch, capsys):
    before = bench.RESULTS.read_bytes() if bench.RESULTS.exists() else None
    monkeypatch.chdir(bench.ROOT)
    monkeypatch.setattr(sys, "argv", ["bench", "--quick", "--only", "live_step"])  # which starts the fewest processes
    bench.main()
    said = capsys.readouterr().out
    (row,) = (line.split(" | ") for line in said.splitlines() if "≤ 1.5 ms; ≤ 3 ms" in line)
    assert row[2].endswith(" steps") and "A quick trial" in said
    assert (bench.RESULTS.read_bytes() if bench.RESULTS.exists() else None) == before
