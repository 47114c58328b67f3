"""The cross-check of a run: each planted error stops it, and nothing else does."""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import modsim3d
from modsim3d import Scene, detect_run, load_scene, run_scene, simulate_frames
from modsim3d.cli.run_summary import _check_rows
from modsim3d.runs import pipeline, truth_check
from modsim3d.runs.truth_check import TruthCheckError, frame_count
from modsim3d.scene import sight
from modsim3d.truth import buffer_drawing, outlines, rendered
from modsim3d.truth.crosscheck import comparison
from modsim3d.truth.crosscheck.comparison import CheckCounts
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.silhouettes import Spans
from tests.cli.bad_input.builders import Call, answer
from tests.run_folders import interrupt
from tests.scenes import CAMERA_HEIGHT_M, camera_keys, write_scene

POSE = {"pose": {"position_m": [0, 0, CAMERA_HEIGHT_M]}}
BOATS = {
    "far": ([10, 4, 3], [[0, 150, 5], [100, 151, 5]]),
    "near": ([10, 4, 3], [[0, 100, 3], [100, 101, 3]]),
    "ship": ([60, 10, 12], [[0, 190, 20], [100, 191, 19]]),  # its depths overlap those of the next, which it hides
    "beside": ([10, 4, 8], [[0, 214, 12], [100, 215, 12]]),
    "raft": ([12, 4, 3], [[0, 60, -12], [100, 61, -12]]),  # intersects the next: OpenGL draws both
    "rafted": ([10, 4, 4], [[0, 61, -9], [100, 62, -9]]),
    "close": ([10, 4, 3], [[0, 31, 6], [100, 32, 5]]),  # crosses the near plane
}


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return load_scene(write_boats(tmp_path))


def write_boats(folder: Path, steps: int = 4, camera: Any = None, cameras: int = 1, **annotation: Any) -> Path:
    """A scene of the boats; `camera` has further keys of its cameras."""
    keys = camera_keys(**POSE, near_clip_m=30, **camera or {})
    named = {f"C{i}": keys for i in range(cameras)}
    return write_scene(folder, BOATS, steps, annotation={"mode": 2, **annotation}, cameras=named)


def unchecked(scene: Scene) -> Scene:
    return replace(scene, annotation=replace(scene.annotation, check="off"))


def column(name: str, change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A change of an attribute of a record."""
    return lambda record: replace(record, **{name: change(getattr(record, name))})


def first_body(name: str, change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda bodies: [column(name, change)(bodies[0]), *bodies[1:]]


def with_longer_spans(found: tuple[Spans, Any]) -> tuple[Spans, Any]:
    stop = found[0].stop.copy()
    stop[len(stop) // 2 :: 97] += 1
    return replace(found[0], stop=stop), found[1]


def with_sides_exchanged(order: Any) -> Any:
    return replace(order, first_can_hide=order.second_can_hide, second_can_hide=order.first_can_hide)


def with_second_moved(vertices: Any) -> Any:
    return vertices + np.array([0.0, 0.2, 0.0]) * (np.arange(len(vertices)) == 1)[:, None, None]


PLANTED: dict[str, tuple[Any, str, Callable[[Any], Any]]] = {
    "rows lost": (Occlusion, "truth", lambda truth: truth.take(truth.vessel != 1)),
    "fraction wrong": (Occlusion, "truth", column("visible_fraction", lambda share: share * 0.99)),
    "occluder misnamed": (Occlusion, "truth", column("occluder", lambda index: np.where(index == 1, 3, index))),
    "box one pixel off": (Occlusion, "truth", column("full_boxes_px", lambda boxes: boxes + np.array([0.0, 0, 1, 0]))),
    "annotated wrong": (pipeline, "annotated_rows", lambda found: found & (np.arange(len(found)) % 3 > 0)),
    "wrong ranks": (rendered, "ranks_of", lambda found: (found[0].max() - found[0], found[1])),
    "wrong side of a plane": (rendered, "order_of_pairs", with_sides_exchanged),
    "near and far exchanged": (buffer_drawing, "triangles_of", column("inverse_depth", lambda each: each.min() / each)),
    "corners moved": (sight, "vessel_bodies", first_body("vertices_m", with_second_moved)),
    "vessel lost": (sight, "vessel_bodies", first_body("present", lambda there: there & (np.arange(len(BOATS)) != 1))),
    "span off by one": (rendered, "scan_convert", with_longer_spans),
}
"""Modules or classes, functions in them, and a change of what these return."""


def plant(monkeypatch: pytest.MonkeyPatch, error: str) -> None:
    owner, name, change = PLANTED[error]
    original = getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *args, **kwargs: change(original(*args, **kwargs)))


def ignore_near_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(vertices: Any, crosses: Any, lens: Any, *rest: Any, original: Any = outlines.cut_faces, **keys: Any) -> Any:
        return original(vertices, crosses, replace(lens, near_clip_m=28.0), *rest, **keys)

    for module in (buffer_drawing, outlines):
        monkeypatch.setattr(module, "cut_faces", cut)


@pytest.mark.parametrize("error", [*PLANTED, "near plane ignored"])
def test_a_planted_error_stops_a_run_that_is_checked(error, scene, tmp_path, monkeypatch):
    if error in PLANTED:
        plant(monkeypatch, error)
    else:
        ignore_near_plane(monkeypatch)
    with pytest.raises(TruthCheckError, match=r"vessel '\w+' in camera C0 at step \d"):
        run_scene(scene, tmp_path / "checked")
    assert not (tmp_path / "checked" / "run.json").exists()
    run_scene(unchecked(scene), tmp_path / "off")


@pytest.mark.parametrize(("steps", "changes", "frames"), [
    (60, {"camera": {"start_offset_s": 55}}, 3),  # none in the first parts
    (60, {"camera": {"start_offset_s": 58}}, 2),  # two frames in all
    (60, {"camera": {"frame_rate_hz": 0.05, "start_offset_s": 17}}, 3),  # three in all
    (1, {"cameras": 4}, 3), (1, {"cameras": 2}, 2),
])  # fmt: skip
@pytest.mark.parametrize("check", ["sample", "all"])
def test_frames_that_exist_are_checked_and_the_first_drawn_whole(steps, changes, frames, check, tmp_path):
    result = run_scene(load_scene(write_boats(tmp_path, steps, check=check, **changes)), tmp_path / "run")
    expected = frames if check == "sample" else result.counts.frames
    assert (result.checked.whole_frames, result.checked.frames) == (1, expected)


def test_streams_and_frames_in_memory_are_checked_and_the_row_says_what_was_drawn(tmp_path, scene, monkeypatch):
    slow = load_scene(write_boats(tmp_path, 2500, {"frame_rate_hz": 0.01, "start_offset_s": 5}))
    found = [frame for step in range(2500) for frame in set(truth_check._frames_of_stream(slow, step, step + 1))]
    taken = truth_check.frames_taken(slow)[0].tolist()
    assert [step for step, _ in found[:3]] == taken[:3] and len(found) >= 3 + 2
    assert set(found) == set(truth_check._frames_of_stream(slow, 0, 2500))
    assert all(step in taken for step, _ in found)
    plant(monkeypatch, "box one pixel off")
    with pytest.raises(TruthCheckError, match="step 0"):
        next(iter(simulate_frames(scene)))
    assert next(iter(simulate_frames(unchecked(scene)))).step == 0
    assert truth_check.STREAM_STEPS == 1000
    scene = load_scene("simulation_1")
    equal = "1 vessel: pixels equal, boxes within 0.00 px of corner projection"
    rows = [_check_rows(scene, CheckCounts(frames=frames, vessels=max(frames - 1, 0)))[0][1:] for frames in (0, 1, 2)]
    assert rows == [("nothing", "no camera took a frame"), ("1 frame", "no vessel in it"), ("2 frames", equal)]
    samples = [truth_check._sample(replace(scene, seed=seed), 0, scene.steps) for seed in (0, 0, 1)]
    assert samples[0] == samples[1] != samples[2] and len(samples[0]) == frame_count(scene) == 4
    assert frame_count(replace(scene, steps=5)) == 3 and frame_count(replace(scene, steps=150_000)) > 30


def test_a_run_without_an_error_says_so_and_a_lens_and_full_images_are_checked_too(scene, tmp_path):
    checked = run_scene(scene, tmp_path / "run").checked
    assert detect_run(tmp_path / "run", tmp_path / "second", seed=3).checked == checked
    for name in ("run", "second"):
        assert json.loads((tmp_path / name / "run.json").read_text())["crosscheck"] == asdict(checked)
    counts = checked.frames, checked.whole_frames, checked.empty_frames, checked.tie_pixels, checked.vessels
    assert counts == (3, 1, 0, 0, 3 * len(BOATS))
    assert checked.from_buffers == 4 * 3  # the raft, and what crosses the near plane
    assert checked.from_spans + checked.from_buffers == 4 * len(BOATS) and 0 < checked.largest_box_px < 1
    path = write_boats(tmp_path, camera={"distortion": {"k1": -0.1}}, supersample=2)
    bent = run_scene(load_scene(path), tmp_path / "bent").checked
    whole = run_scene(load_scene(write_boats(tmp_path, render="full")), tmp_path / "whole").checked
    assert [(each.from_spans, each.vessels) for each in (bent, whole)] == [(0, 3 * len(BOATS))] * 2


def test_all_checks_every_frame_and_off_none_and_truth_that_is_wrong_is_not_kept(scene, tmp_path):
    every = replace(scene, annotation=replace(scene.annotation, check="all"))
    found, none = run_scene(every, tmp_path / "all").checked, run_scene(unchecked(scene), tmp_path / "off").checked
    assert (found.frames, none.frames, none.from_spans + none.from_buffers) == (4, 0, 4 * len(BOATS))
    for name in ("truth", "detections", "frames"):
        one, other = ((tmp_path / run / f"{name}.parquet").read_bytes() for run in ("all", "off"))
        assert one == other
    with pytest.MonkeyPatch.context() as wrong:
        plant(wrong, "box one pixel off")
        with pytest.raises(TruthCheckError):
            run_scene(scene, tmp_path / "run")
    assert not list((tmp_path / "run" / "unfinished").glob("truth_*"))
    assert run_scene(scene, tmp_path / "run", resume=True).checked


def test_ties_are_looked_for_once_and_only_where_something_is_hidden(tmp_path: Path, monkeypatch: Any) -> None:
    places = [(60, 3.6, 5), (64, 0, 3), (60, 4, 3), (60, 3.6, 5), (68, 4, 5), (64, 3.6, 5)]
    rafted = {f"v{i}": ([12, 4, z], [[0, x, y], [100, x + 10, y]]) for i, (x, y, z) in enumerate(places)}
    cameras = {"C0": camera_keys(**POSE, distortion={"k1": -0.05})}
    path = write_scene(tmp_path, rafted, 3, annotation={"mode": 0}, cameras=cameras)
    looked_at: list[int] = []
    original = comparison.possible_ids

    def counted(drawing: Any, x: Any, y: Any) -> Any:
        if sys._getframe(1).f_code.co_name == "_possible_behind":  # others ask for what they differ in
            looked_at.append(len(x))
        return original(drawing, x, y)

    monkeypatch.setattr(comparison, "possible_ids", counted)
    checked = run_scene(load_scene(path), tmp_path / "run").checked
    assert len(looked_at) <= checked.vessels
    truth = modsim3d.open_run(tmp_path / "run").table("truth").to_pylist()
    hidden = sum(row["silhouette_px"] - row["visible_px"] for row in truth)
    assert 0 < sum(looked_at) <= 2 * hidden


@pytest.mark.parametrize("least", [0.0, 0.5])
def test_a_vessel_without_a_pixel_is_annotated_in_mode_0_unless_a_filter_is_set(least: float) -> None:
    scene = load_scene("harbour", steps=151)
    scene = replace(scene, annotation=replace(scene.annotation, mode=0, check="all", min_visible_fraction=least))
    with pipeline.open_renderer(scene) as renderer:
        truth = pipeline.truth_block(scene, 150, 151, renderer)
        assert truth.annotated[truth.silhouette_px == 0].tolist() == [least == 0]
        assert truth_check.check_block(scene, truth, 150, 151, renderer).frames == 1


def test_the_sample_depends_on_no_workers_or_blocks_and_statistics_see_no_truth_that_is_wrong(tmp_path, monkeypatch):
    scene = load_scene(write_boats(tmp_path, steps=9))
    plain = run_scene(scene, tmp_path / "plain")
    monkeypatch.setattr("modsim3d.runs.pipeline.MAX_BLOCK_STEPS", 2)
    assert run_scene(scene, tmp_path / "blocks").checked == plain.checked
    assert run_scene(scene, tmp_path / "workers", workers=2).checked == plain.checked
    resumed = run_scene(scene, interrupt(scene, tmp_path / "resumed"), resume=True)
    assert resumed.resumed_steps and resumed.checked == plain.checked
    monkeypatch.undo()
    scene = load_scene(write_boats(tmp_path))
    monkeypatch.setattr(type(scene.detector), "needs_target_statistics", property(lambda _: True))
    assert run_scene(scene, tmp_path / "good").checked.frames == 3
    plant(monkeypatch, "box one pixel off")
    with pytest.raises(TruthCheckError):
        run_scene(scene, tmp_path / "bad")


def test_the_command_names_vessel_and_draws_it_and_gives_a_command_if_the_scene_has_a_file(tmp_path, monkeypatch, call):
    plant(monkeypatch, "span off by one")
    (tmp_path / "my boats").mkdir()
    path = write_boats(tmp_path / "my boats", supersample=2)
    status, said = call("run", path, "--out", tmp_path / "run", "--no-sheet")
    parts = "silhouette pixels", f"run '{path}' --seed", "view frame unchecked", "cross_check.png"
    for part in (*parts, "--set annotation.supersample=2"):
        assert part in " ".join(said.split())
    assert status == 2 and (tmp_path / "run" / "unfinished" / "cross_check.png").is_file()
    monkeypatch.chdir(path.parent)
    with pytest.raises(TruthCheckError) as stopped:
        run_scene(Scene.from_dict(json.loads(path.read_text())), tmp_path / "no_file")
    assert "modsim3d run" not in str(stopped.value)


def test_nothing_is_drawn_for_other_sources_and_the_summary_says_what_was(call: Call, tmp_path: Path) -> None:
    path, nothing = write_boats(tmp_path), "nothing was drawn"
    for option, row in (
        ("check=sample", "pixels equal, boxes within"), ("source=analytic", nothing), ("source=rectangles", nothing)
    ):  # fmt: skip
        status, said = call("run", path, "--set", f"annotation.{option}", "--out", tmp_path / option, "--no-sheet")
        assert status == 0 and row in " ".join(said.split()), said
        checked = json.loads((tmp_path / option / "run.json").read_text())["crosscheck"]
        assert (checked == asdict(CheckCounts())) == (row == nothing), option


@pytest.mark.parametrize("supersample", [1, 2])
def test_counting_pixels_of_public_id_buffers_gives_the_numbers_of_the_truth(tmp_path: Path, supersample: int) -> None:
    run_scene(load_scene(write_boats(tmp_path, supersample=supersample)), tmp_path / "run")
    run = modsim3d.open_run(tmp_path / "run")
    frame = run.frame("C0", 2)
    image = frame.id_image()
    assert (image.ids.shape, image.ids.dtype) == ((600 * supersample, 800 * supersample), np.uint32)
    rows = [row for row in run.table("truth").to_pylist() if row["step"] == 2]
    assert len(rows) == len(BOATS)
    number = {name: each for each, name in image.names.items()}
    for row in rows:
        whole, seen = frame.silhouette(row["vessel"]), image.ids == number[row["vessel"]]
        assert whole.sum() / supersample**2 == row["silhouette_px"] and seen.sum() / supersample**2 == row["visible_px"]
        for mask, kind in ((whole, "full"), (seen, "visible")):
            y, x = np.nonzero(mask)
            said = [row[f"{kind}_{side}_px"] for side in ("x_min", "y_min", "x_max", "y_max")]
            edges = [x.min(), y.min(), x.max() + 1, y.max() + 1] if len(x) else []
            assert said == ([edge / supersample for edge in edges] or [None] * 4)
    np.testing.assert_array_equal(run.scene.at(2).render_ids("C0").ids, image.ids)
    with pytest.raises(modsim3d.ModsimError, match="no camera 'C9'"):
        run.scene.at(0).render_ids("C9")
    with pytest.raises(modsim3d.ModsimError, match="no vessel 'neer'"):
        frame.silhouette("neer")


def test_view_writes_an_id_buffer_as_png_or_npy(call: Call, scene: Scene, tmp_path: Path) -> None:
    run_scene(scene, tmp_path / "run")
    expected = scene.at(1).render_ids("C0").ids
    for options in ([], ["--out", tmp_path / "ids.npy"]):
        answer(call, ("view", "frame", tmp_path / "run", 1, "--kind", "id_buffer", *options), "near")
    np.testing.assert_array_equal(np.array(Image.open(tmp_path / "run" / "id_buffer_C0_000001.png")), expected)
    np.testing.assert_array_equal(np.load(tmp_path / "ids.npy"), expected)
    assert call("view", "frame", tmp_path / "run", "--kind", "id_buffer")[0] != 0
