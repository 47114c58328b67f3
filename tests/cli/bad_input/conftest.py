"""A scene to spoil, and a check that a scene is refused."""

import copy
from pathlib import Path

import pytest

from tests.cli.bad_input.builders import GOOD, Call, Inputs, Refused, refusal


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
