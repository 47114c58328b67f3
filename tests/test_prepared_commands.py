"""A command of the prepared process runs as one that a shell starts."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

TELL = """
import json, os, sys
told = {"arguments": sys.argv, "folder": os.getcwd(), "environment": dict(os.environ), "input": sys.stdin.read()}
print(json.dumps(told))
print("warned", file=sys.stderr)
sys.exit(5)
"""
WAIT = """
import time
print("here", flush=True)
time.sleep(60)
"""


@pytest.fixture
def first(tmp_path: Path) -> Path:
    """A file of Python that is run in place of the command."""
    return tmp_path / "first.py"


def test_it_has_the_arguments_folder_environment_and_files_of_its_client(prepared, first, tmp_path, monkeypatch):
    first.write_text(TELL, encoding="utf-8")
    environment = {**os.environ, "FIRST": str(first), "ADDED": "yes"}
    removed = next(name for name in ("HOME", "USER", "SHELL", "PWD", "PATH") if environment.pop(name, None))
    line = [prepared, "run", "a scene"]
    finished = subprocess.run(line, cwd=tmp_path, env=environment, input="poses", capture_output=True, text=True)
    assert (finished.returncode, finished.stderr) == (5, "warned\n")
    told = json.loads(finished.stdout)
    assert told["arguments"] == ["modsim3d", "run", "a scene"]
    assert (told["folder"], told["input"]) == (str(tmp_path), "poses")
    assert told["environment"]["ADDED"] == "yes" and removed not in told["environment"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it(prepared, first, number):
    first.write_text(WAIT, encoding="utf-8")
    line, environment = [prepared, "scenes"], {**os.environ, "FIRST": str(first)}
    with subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as client:
        assert client.stdout.readline() == "here\n"
        client.send_signal(number)
        client.communicate(timeout=50)
        assert client.returncode != 0
