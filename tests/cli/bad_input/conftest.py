"""A scene to spoil, and a check that a scene is refused."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from tests.cli.bad_input.builders import GOOD, Call, Inputs, Refused


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return Inputs(tmp_path / "in", copy.deepcopy(GOOD))


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
