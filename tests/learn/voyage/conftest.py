"""A voyage that is simulated: a short run of the strait, exported in every format."""

from pathlib import Path

import pytest

from modsim3d import Scene, load_scene, open_run, run_scene
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.export_formats import FORMATS, ExportRequest
from modsim3d.runs.stream_lines import header_line, step_lines

STEPS = 24


@pytest.fixture(scope="session")
def strait() -> Scene:
    return load_scene("strait", steps=STEPS)


@pytest.fixture(scope="session")
def voyage(strait: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the run, and its exports each in a folder of its own."""
    folder = tmp_path_factory.mktemp("voyage")
    run_scene(strait, folder / "run")
    for name in ("coco", "csv", "mot", "mcap"):
        (folder / name).mkdir()
        FORMATS[name].write(ExportRequest(open_run(folder / "run"), (0, 1)), folder / name)
    lines = [line for step in step_lines(strait, one_by_one=False) for line in step.lines]
    (folder / "stream.jsonl").write_bytes(header_line(strait) + b"".join(lines))
    return folder


@pytest.fixture(scope="session")
def labelled(voyage: Path) -> LabelledSet:
    """The run with its own truth."""
    return labelled_run(voyage / "run")[0]
