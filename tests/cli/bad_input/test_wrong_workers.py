"""A wrong `--workers` is one line, before anything is read or written."""

from pathlib import Path

import pytest

from tests.cli.bad_input.builders import Call, Inputs, refusal


@pytest.mark.parametrize("command", ["run", "detect", "check repeat", "view film"])
@pytest.mark.parametrize("wrong", ["0", "-2", "1.5", "all", "Auto", "1_0", "٣", "9" * 5000, "", "1025"])
def test_a_wrong_number_of_workers_is_one_line(call: Call, tmp_path: Path, command: str, wrong: str) -> None:
    out = () if command == "check repeat" else ("--out", tmp_path / "out")
    said = refusal(call, (*command.split(), tmp_path / "any", f"--workers={wrong}", *out))
    assert said.startswith("modsim3d: --workers: needs a number of processes from 1 to 1024, or 'auto' (got ")
    assert wrong[:50] in said
    assert said.count("\n") == 1 and len(said) < 200
    assert not list(tmp_path.iterdir())


def test_auto_is_taken(inputs: Inputs, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one worker; what several write for `auto` is looked at in test_worker_count.py."""
    asked: list[int] = []
    monkeypatch.setattr("modsim3d.io.processes._usable_cpus", lambda: asked.append(1) or 1)
    status, said = call("run", inputs.write(), "--workers", "auto", "--no-sheet", "--out", tmp_path / "run")
    assert status == 0, said
    assert asked
    asked.clear()
    assert call("check", "repeat", tmp_path / "run", "--workers", "auto")[0] == 0 and asked
