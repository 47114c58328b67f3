"""Benchmarks and campaigns: scenes that are timed, the bench, mutants, and faults of disks."""

import ast
import functools
import gc
import importlib
import random
import sys
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from shapely import intersects

from benchmarks import bench, child, pyrender_pass, scenes
from benchmarks.faults.disk import Disk, Lost
from benchmarks.faults.results import read_rows, table
from benchmarks.faults.tracing import parse
from benchmarks.faults.trees import differences, tree
from benchmarks.growth import COUNTS
from benchmarks.measured import Bench, significant
from benchmarks.mutants.mutations import mutants_of, mutated
from benchmarks.mutants.processes import KILLED, SURVIVED, TIMED_OUT, caches_of_all, in_a_process
from benchmarks.mutants.reach import Reach
from benchmarks.mutants.trials import functions_of
from benchmarks.whole_commands import differing_files
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.scene.reading import load_scene
from modsim3d.world.traffic.tracks import shipped_kinds
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


SOURCE = '''
"""A module."""
from x import y

LIMIT = 4


class Box:
    side: int = 2

    def wide(self, other, *, near=0.5) -> bool:
        """Whether it is wide."""
        if not self.side and other:
            raise ValueError(f"{self.side} is not above {0}")
        return self.side - other < LIMIT


def first(values):
    def lowest():
        return min(values, key=abs)

    values[0] = -lowest()
    return values[:LIMIT]
'''


def test_each_mutant_changes_the_code_once_and_says_where_and_leaves_messages_and_annotations_alone():
    found, original = mutants_of(SOURCE), ast.unparse(ast.parse(SOURCE)).splitlines()
    texts = [ast.unparse(mutated(SOURCE, mutant.index)) for mutant in found]
    for mutant, text in zip(found, texts, strict=True):
        assert sum(line != before for line, before in zip(text.splitlines(), original, strict=True)) == 1, mutant.change
    assert len(set(texts)) == len(texts)
    assert Counter(mutant.function for mutant in found) == {"": 3, "Box.wide": 7, "first": 8}
    changes = " ".join(mutant.change for mutant in found)
    # Neither docstring, annotation nor message; but that the error is raised at all is looked at.
    assert not any(text in changes for text in ("A module", "bool", "{1}"))
    assert "raise ValueError(f'{self.side} is not above {0}') → pass" in changes


def test_expressions_have_these_mutants():
    for code, changed in {
        "a < b": ["a <= b"],
        "a + b.T": ["a - b.T", "a + b"],
        "a and -b": ["a or -b", "a and b"],
        "np.floor(a)": ["np.ceil(a)"],
        "a[1:b]": ["a[2:b]", "a[1:]"],
        "f(a, axis=1)": ["f(a)", "f(a, axis=2)"],
        "0.25": ["0.5"],
    }.items():
        assert [mutant.change for mutant in mutants_of(f"assert {code}")] == [f"{code} → {each}" for each in changed]


def test_process_survives_is_killed_or_times_out():
    def loop() -> bool:
        while True:
            pass

    assert in_a_process(lambda: True, 10) == SURVIVED
    assert in_a_process(lambda: False, 10) == KILLED
    assert in_a_process(functools.partial(int, "no number"), 10) == KILLED
    assert in_a_process(loop, 1) == TIMED_OUT


def test_functions_and_caches_are_found_although_the_tests_hide_them_from_pythons_collector():
    def found() -> bool:
        gc.freeze()
        functions = functions_of({"modsim3d.world.traffic.tracks"})
        gc.freeze()
        return ("modsim3d.world.traffic.tracks", "draw_one") in functions and shipped_kinds in caches_of_all()

    assert in_a_process(found, 10) == SURVIVED


def test_quickest_tests_that_reach_a_line_come_first_within_the_budget(tmp_path: Path):
    reach = Reach({"slow": 5.0, "quick": 1.0, "other": 0.1}, {"a.py": {3: {"slow", "quick"}, 4: {"other"}}}, {})
    assert reach.of_lines("a.py", (2, 3)) == {"slow", "quick"}
    assert reach.quickest({"slow", "quick"}, 3.0) == ["quick"]
    assert reach.quickest({"slow", "quick"}, 6.0) == ["quick", "slow"]
    assert reach.quickest({"slow"}, 3.0) == ["slow"]
    assert reach.of_file("a.py") == {"slow", "quick", "other"}
    fixtures = {name: {"renderer": 1.0} for name in "abc"}  # which tests share, and pay for once
    reach = Reach({"a": 0.1, "b": 0.2, "c": 0.3}, {"a.py": {3: {"a"}}}, fixtures)
    assert reach.quickest(set("abc"), 1.35) == ["a", "b"]
    assert reach.quickest(set("abc"), 1.7) == ["a", "b", "c"] and reach.alone_s("c") == 1.3
    reach = Reach({"a": 0.1, "b": 0.2, "c": 0.3}, {}, {"a": {"campaign": 9.0}})  # which keeps out no other test
    assert reach.quickest(set("abc"), 1.0) == ["b", "c"] and reach.quickest(set("abc"), 0.1) == ["b"]
    reach.save(tmp_path / "reach.json")
    assert Reach.load(tmp_path / "reach.json") == reach


REPOSITORY = Path(__file__).resolve().parents[2]


def escaped(text: object) -> str:
    return "".join(f"\\x{byte:02x}" for byte in str(text).encode())


def trace(folder: Path, *, fsync_file: bool, fsync_folder: bool) -> str:
    """A file is written beside its place, and renamed."""
    root, partial, final = (escaped(path) for path in ("/", folder / "partial", folder / "final"))
    fd, folder_fd = f"3<{partial}>", f"4<{escaped(folder)}>"
    lines = [
        f'7 openat(AT_FDCWD<{root}>, "{partial}", O_WRONLY|O_CREAT|O_TRUNC, 0666) = {fd}',
        f'7 write({fd}, "{escaped("whole")}", 5) = 5',
        f"7 fsync({fd}) = 0" if fsync_file else "",
        f"7 close({fd}) = 0",
        f'7 rename("{partial}", "{final}" <unfinished ...>',
        "8 close(9) = 0",
        "7 <... rename resumed>) = 0",
        f'7 openat(AT_FDCWD<{root}>, "{escaped(folder)}", O_RDONLY|O_DIRECTORY) = {folder_fd}',
        f"7 fsync({folder_fd}) = 0" if fsync_folder else "",
    ]
    return "\n".join(filter(None, lines))


@pytest.mark.parametrize("fsync_file", [False, True])
@pytest.mark.parametrize("fsync_folder", [False, True])
def test_after_a_power_cut_only_what_was_fsynced_is_sure_to_be_there(tmp_path, fsync_file, fsync_folder):
    folder = tmp_path / "disk"
    folder.mkdir()
    (folder / "final").write_bytes(b"old")
    left, disk = set(), Disk(folder)
    for call in parse(trace(folder, fsync_file=fsync_file, fsync_folder=fsync_folder)):
        disk.replay(call)
    for seed, lost in product(range(40), Lost):
        target = tmp_path / f"{seed} {lost.name}"
        disk.crash(random.Random(seed), lost, target)
        left.add((target / "final").read_bytes())
    assert b"whole" in left and (b"old" in left) == (not fsync_folder)
    assert (b"" in left and bytes(5) in left) == (not fsync_file)
    assert left <= {b"whole", b"old"} or not fsync_file


def test_missing_surplus_and_different_files_are_named_of_two_trees_and_of_what_a_command_wrote(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name / "inner").mkdir(parents=True)
        (tmp_path / name / "inner" / "other").write_text(name)
        (tmp_path / name / name).write_text("same")
        (tmp_path / name / "alike").write_text("same")
        (tmp_path / name / "run.log").write_text(name)
    found = differences(tree(tmp_path / "one"), tree(tmp_path / "two"))
    assert found == "two is missing, one should not be there, inner/other differs"
    assert differing_files(tmp_path / "one", tmp_path / "two") == {"one", "two", "inner/other"}


def test_page_has_the_table_of_the_stored_result_and_no_fault_did_harm():
    rows = read_rows(REPOSITORY / "docs" / "campaigns" / "faults.json")
    assert sum(row["tried"] for of_class in rows.values() for row in of_class) > 1000
    assert not [failure for of_class in rows.values() for row in of_class for failure in row["failures"]]
    assert table(rows) in (REPOSITORY / "docs" / "reliability.md").read_text("utf-8")
