"""A kept block that is damaged is made anew, and the run says so."""

from pathlib import Path

import pytest

from modsim3d.cli.run_summary import print_summary
from modsim3d.runs import pipeline
from modsim3d.runs.files.block_files import finished_truth
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene

BLOCK, STEPS = 100, 240  # three blocks


@pytest.fixture(scope="module", autouse=True)
def short_blocks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "MAX_BLOCK_STEPS", BLOCK)
        yield


@pytest.fixture(scope="module")
def scene():
    return load_scene("simulation_1", source="analytic", steps=STEPS)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole") / "run"
    run_scene(scene, folder)
    return content(folder)


@pytest.fixture
def cut(scene, tmp_path) -> Path:
    """A run that was interrupted after two blocks."""
    done = []

    def stop(steps: int) -> None:
        done.append(steps)
        if len(done) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, tmp_path / "run", progress=stop)
    return tmp_path / "run"


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != "run.log"}


def flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[:5000],
    "without its last byte": lambda data: data[:-1],
    "one bit": flipped,
    "zeros": lambda data: bytes(len(data)),
    "another file": lambda data: b"PK\x03\x04" + data[:-4],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_block_is_made_anew_and_told(scene, whole, cut, capsys, damage):
    block = sorted((cut / "unfinished").glob("truth_*.npz"))[0]
    block.write_bytes(damage(block.read_bytes()))
    result = run_scene(scene, cut, resume=True)
    assert (result.damaged_blocks, result.resumed_steps) == (1, BLOCK)
    assert content(cut) == whole
    assert "1 damaged blocks of it made anew" in (cut / "run.log").read_text()
    print_summary(scene, result, sheet=False)
    assert "blocks of the interrupted run, made anew" in capsys.readouterr().out


def test_blocks_that_are_whole_are_taken_and_nothing_is_told(scene, whole, cut):
    result = run_scene(scene, cut, resume=True)
    assert (result.damaged_blocks, result.resumed_steps) == (0, 2 * BLOCK)
    assert content(cut) == whole
    assert "damaged" not in (cut / "run.log").read_text()


def test_an_interrupted_run_shows_the_steps_before_a_damaged_block(cut):
    _, second = sorted((cut / "unfinished").glob("truth_*.npz"))
    second.write_bytes(flipped(second.read_bytes()))
    run = open_run(cut)
    assert finished_truth(cut / "unfinished", run.scene, BLOCK, 2 * BLOCK) is None
    assert run.steps == BLOCK
    assert len(list(run.frames())) == BLOCK
