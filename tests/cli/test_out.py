"""`--out` names what a command makes: a folder, or a file, which in a folder that is there has its usual name."""

from pathlib import Path

import pytest

from tests.cli.conftest import Modsim3d

FILES = {
    "report.html": ("report",),
    "map_000039.png": ("view map", "--width", "160"),
    "detections_000003.png": ("view frame", "3", "--width", "160"),
    "ids.gif": ("view film", "--kind", "ids", "--end", "1", "--width", "160", "--format", "gif"),
    "detections.mp4": ("view film", "--end", "0.5", "--width", "160"),
}


@pytest.mark.parametrize(("name", "words"), FILES.items(), ids=FILES)
@pytest.mark.parametrize("folder", ["pages", "run.2"])
def test_a_file_is_put_into_a_folder_under_its_usual_name(modsim3d, run, tmp_path, name, words, folder):
    (tmp_path / folder).mkdir()
    command, *options = words
    line = (*command.split(), run, *options, "--out", tmp_path / folder)
    assert modsim3d(*line).status == 0
    assert [path.name for path in (tmp_path / folder).iterdir()] == [name]
    said = modsim3d(*line)
    assert said.status == 2 and f"{tmp_path / folder / name} exists: use --overwrite" in said.err


def test_a_learned_detector_and_an_export_are_put_into_a_folder(modsim3d: Modsim3d, run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    assert modsim3d("learn", run, "--replicates", 20, "--out", tmp_path).status == 0
    assert {path.name for path in tmp_path.iterdir()} == {"detector.yaml", "detector.html", "detector.uncertainty.json"}
    assert modsim3d("export", run, "--format", "coco", "--out", folder).status == 0
    assert {path.name for path in folder.iterdir()} == {"gt.json", "dt.json"}
    for arguments, part in (
        (("--format", "voc", "--out", tmp_path), "coco"),
        (("--out", tmp_path), "--format"),
        (("--format", "coco"), "--out"),
    ):
        said = modsim3d("export", run, *arguments)
        assert said.status == 2 and part in said.err
