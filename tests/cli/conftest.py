"""A small finished run, the command line with its two streams apart, and a scene to spoil."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import GOOD, Call, Inputs, Refused, refusal
from tests.cli.bad_input.writers import TRACKS
from tests.command_line import call
from tests.scenes import crossing


class Said(NamedTuple):
    """How a command ended, and what it wrote."""

    status: int
    out: str
    err: str


Modsim3d = Callable[..., Said]


@pytest.fixture
def modsim3d(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Modsim3d:
    """A function that runs the command line in this process."""

    def run(*arguments: object) -> Said:
        capsys.readouterr()
        return Said(call(monkeypatch, *arguments), *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of 40 steps."""
    return crossing(tmp_path_factory.mktemp("scene"), 40)


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory, scene: Path) -> Path:
    """A finished run; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("commands") / "run"
    run_scene(load_scene(scene, source="analytic"), folder)
    return folder


WITHOUT_OVERWRITE = ("scenes", "check repeat")


@pytest.fixture
def lines(scene: Path, run: Path, tmp_path: Path) -> dict[str, tuple[object, ...]]:
    """A command line for each of many commands."""
    (tmp_path / "tracks.csv").write_text(TRACKS)
    return {
        "run": ("run", scene, "--source", "analytic", "--out", tmp_path / "run"),
        "detect": ("detect", run, "--detector-seed", 3, "--out", tmp_path / "detect"),
        "check scene": ("check", "scene", scene),
        "scenes": ("scenes",),
        "check run": ("check", "run", run, "--out", tmp_path / "verify"),
        "check repeat": ("check", "repeat", run),
        "check truth": ("check", "truth", scene, "--steps", 2, "--out", tmp_path / "compare"),
        "track": ("track", run, "--out", tmp_path / "tracks"),
        "score": ("score", run, tmp_path / "tracks.csv"),
        "export": ("export", run, "--format", "coco", "--out", tmp_path / "coco"),
        "report": ("report", run, "--out", tmp_path / "page.html"),
        "view frame": ("view", "frame", run, 3, "--width", 160, "--out", tmp_path / "picture.png"),
        "learn": ("learn", run, "--replicates", 20, "--no-check", "--out", tmp_path / "learned.yaml"),
    }


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return Inputs(tmp_path / "in", copy.deepcopy(GOOD))


@pytest.fixture
def refused(call: Call, tmp_path: Path) -> Refused:
    """Function that asserts that `check` and `run` refuse a scene with some parts in their message, leaving nothing."""

    def look(scene: object, *parts: str, options: tuple[object, ...] = ()) -> str:
        out = tmp_path / "out" / "run"
        commands = [("run", scene, "--out", out, "--no-sheet", *options)]
        if not options:
            commands.append(("check", "scene", scene))
        said = [refusal(call, command, *parts) for command in commands]
        assert not out.parent.exists()
        return said[-1]

    return look
