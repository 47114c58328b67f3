"""A small finished run, and the command line with its two streams apart."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from modsim3d.cli import main
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
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
        monkeypatch.setattr(sys, "argv", ["modsim3d", *map(str, arguments)])
        with pytest.raises(SystemExit) as stopped:
            main.main()
        return Said(int(stopped.value.code or 0), *capsys.readouterr())

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
