"""Fixtures that several tests share."""

import functools
import gc
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401 (it brings a library of its own for linear algebra, which is told below too)
import typer.testing
from hypothesis import settings
from threadpoolctl import threadpool_limits

from modsim3d.cli.main import COLLECT_AFTER
from modsim3d.learn import self_check
from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer
from tests import command_line
from tests.cli.bad_input.builders import Call

# A busy machine fails no test, and a run of the tests is the same as the one before.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")

# As the command line does for itself: matrices are small, and threads that wait for each other take half of the time of
# the processors from the other tests. Not by a variable, which programs that tests start would inherit.
threadpool_limits(1, user_api="blas")

# Typer prepares commands anew for each call, all of them for a tenth of a second; they do not change.
typer.main.get_command = typer.testing._get_command = functools.cache(typer.main.get_command)

os.fsync = lambda _: None  # no test cuts the power, and the disk would take milliseconds for each of ten thousand files

self_check.SEEDS = 2  # what is learned is compared with real results over fewer seeds than a user's

ROOT = Path(__file__).resolve().parents[1]
TERMINAL = (
    *("COLUMNS", "LINES", "TERM", "TERMINAL_WIDTH", "TTY_COMPATIBLE", "TTY_INTERACTIVE"),
    *("FORCE_COLOR", "NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE", "PY_COLORS", "PYTHON_COLORS", "GITHUB_ACTIONS"),
)
"""Variables that change width and colour of what programs print."""


def forget_who_started_the_tests() -> None:
    """Take from this process, and so from those that tests start, what its shell or its user gave it: a shell lets
    programs in the background ignore Ctrl-C, and nohup lets them ignore that their terminal is gone."""
    for name in TERMINAL:
        os.environ.pop(name, None)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


forget_who_started_the_tests()  # now, because some libraries look at the terminal when they are imported


def pytest_collection_finish() -> None:
    """Let Python look for garbage as seldom as in the command line, and never through the thousands of tests."""
    gc.set_threshold(COLLECT_AFTER)
    gc.freeze()


@pytest.fixture(scope="session")
def renderer() -> Iterator[IdRenderer]:
    with open_context() as context:
        yield IdRenderer(context)


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """A function that runs the command line in this process and returns its exit status and output."""

    def run(*arguments: object) -> tuple[int, str]:
        status, said = command_line.call(monkeypatch, *arguments), capsys.readouterr()
        return status, said.out + said.err

    return run


@pytest.fixture(scope="session")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A `modsim3d` that starts at once, for tests that need a process and nothing of how Python starts."""
    folder = tmp_path_factory.mktemp("prepared")
    line = [sys.executable, "-m", "tests.prepared_commands", str(folder)]
    with subprocess.Popen(line, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdin is not None and server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        yield folder / "modsim3d"
        server.stdin.close()
