"""What an export cannot do is told in a line, and nothing is written or lost."""

from pathlib import Path

import pytest

from modsim3d.io.overwrite_guard import locked_file
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import content
from tests.cli.conftest import Modsim3d
from tests.scenes import crossing


def export(modsim3d: Modsim3d, run: Path, out: Path, *more: object) -> str:
    """Assert that an export is refused, and that what is in the folder stays; what it says."""
    before = content(out)
    said = modsim3d("export", run, "--out", out, *more)
    assert said.status == 2 and not said.out
    assert len(said.err.splitlines()) == 1 and "Traceback" not in said.err
    assert content(out) == before
    return said.err


def test_masks_go_with_coco_alone_and_need_a_truth_in_pixels_of_the_image(modsim3d, run, tmp_path: Path) -> None:
    for name in ("mot", "yolo"):
        said = export(modsim3d, run, tmp_path, "--format", name, "--masks")
        assert f"--masks goes with --format coco, not with {name}" in said
    said = export(modsim3d, run, tmp_path, "--format", "coco", "--true-attitude")
    assert "--true-attitude goes with --format csv, not with coco" in said
    said = export(modsim3d, run, tmp_path, "--format", "coco", "--masks")
    assert "source is analytic: run the scene with --source rendered" in said
    run_scene(load_scene(crossing(tmp_path, 2), supersample=2), tmp_path / "run")
    said = export(modsim3d, tmp_path / "run", tmp_path / "out", "--format", "coco", "--masks")
    assert "supersample 2: run the scene with --set annotation.supersample=1" in said


def test_a_camera_that_is_not_there_and_a_folder_that_another_process_writes_are_told(modsim3d, run, tmp_path) -> None:
    for name in ("coco", "mot", "yolo"):
        assert "has no camera 'C7'; it has: C0" in export(modsim3d, run, tmp_path, "--format", name, "--camera", "C7")
    with locked_file(tmp_path / "predictions"):
        assert "predictions is being written by" in export(modsim3d, run, tmp_path, "--format", "yolo")


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("labels/a.txt", ("labels exists: use --overwrite", None)),
        ("labels/a.jpg", ("labels holds other files than *.txt (a.jpg)",) * 2),
        ("labels", ("labels is a file, and a folder is to be written there",) * 2),
        ("images/deep/a.png", ("images holds other files than *.png (deep)",) * 2),
    ],
)
def test_a_folder_that_is_there_is_replaced_only_if_it_holds_nothing_else(modsim3d, run, tmp_path, name, parts):
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    for part, more in zip(parts, ((), ("--overwrite",)), strict=True):
        if part is not None:
            assert part in export(modsim3d, run, tmp_path, "--format", "yolo", *more)
    if parts[1] is None:
        assert modsim3d("export", run, "--out", tmp_path, "--format", "yolo", "--overwrite").status == 0
        assert not (tmp_path / name).exists() and (tmp_path / "labels" / "C0_000000.txt").is_file()
        assert {path.name for path in tmp_path.iterdir()} == {"data.yaml", "images", "labels", "predictions"}


@pytest.mark.parametrize("set_", ["modsim3d-all", "modsim3d-class"])
def test_sequences_of_another_export_are_not_left_among_the_new_ones(modsim3d, run, tmp_path, set_):
    """A tracker or an evaluator that goes through the folders would take them for this run's."""
    assert modsim3d("export", run, "--out", tmp_path, "--format", "mot").status == 0
    old = tmp_path / set_ / "old" / "gt" / "gt.txt"
    old.parent.mkdir(parents=True)
    old.write_text("1,1,1,1,5,5,1,1,1\n")
    said = export(modsim3d, run, tmp_path, "--format", "mot", "--overwrite")
    assert f"{set_} holds another sequence (old): choose another folder" in said
