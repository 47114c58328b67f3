"""A scene to spoil, the command line in this process, and a check that a scene is refused."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from tests import command_line
from tests.cli.bad_input.builders import GOOD, Call, Inputs, Refused


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return Inputs(tmp_path / "in", copy.deepcopy(GOOD))


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """A function that runs the command line in this process and returns its exit status and output."""

    def run(*arguments: object) -> tuple[int, str]:
        status, said = command_line.call(monkeypatch, *arguments), capsys.readouterr()
        return status, said.out + said.err

    return run


@pytest.fixture
def refused(call: Call, tmp_path: Path) -> Refused:
    """A function that asserts that `check` and `run` refuse a scene, that their message has some parts, and that
    nothing is left behind.
    """

    def look(scene: object, *parts: str, options: tuple[object, ...] = ()) -> str:
        out = tmp_path / "out" / "run"
        commands = [("run", scene, "--out", out, "--no-sheet", *options)]
        if not options:
            commands.append(("check", "scene", scene))
        for command in commands:
            status, said = call(*command)
            assert status == 2, said
            assert "Traceback" not in said
            for part in parts:
                assert part in said, f"{part!r} not in:\n{said}"
        assert not out.parent.exists()
        return said

    return look
