"""Work in this process and work shared between several give the same results, in order."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType
from typing import Any

import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.io.processes import _Processes, open_workers


@contextmanager
def open_factor(factor: int) -> Iterator[int]:
    if factor < 0:
        raise ModsimError("a factor is positive")
    yield factor


def times(factor: int, piece: int) -> int:
    return factor * piece


def kill_this_process(factor: int, piece: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("count", [1, 2])
def test_results_come_in_the_order_of_the_pieces(count: int) -> None:
    with open_workers(count, "try again", open_factor, 3) as workers:
        assert list(workers.map(times, range(20))) == list(range(0, 60, 3))
        assert list(workers.map(times, [])) == []


def work_with(count: int, set_up: Callable[..., Any], argument: Any, work: Callable[..., Any] = times) -> list[Any]:
    with open_workers(count, "try again", set_up, argument) as workers:
        return list(workers.map(work, range(9)))


DIED = r"a worker process died \(killed, or out of memory\); try again"


@pytest.mark.parametrize(
    ("count", "set_up", "argument", "work", "error", "said"),
    [
        (1, open_factor, -1, times, ModsimError, "a factor is positive"),
        (2, open_factor, -1, times, ModsimError, "a factor is positive"),
        (2, open, "missing", times, FileNotFoundError, "missing"),
        (2, open_factor, 3, kill_this_process, ModsimError, DIED),
    ],
)
def test_what_goes_wrong_in_a_worker_is_told(count, set_up, argument, work, error, said: str) -> None:
    with pytest.raises(error, match=said):
        work_with(count, set_up, argument, work)


def test_a_worker_whose_argument_a_new_interpreter_cannot_import_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)
    plugin = ModuleType("plugin_of_this_process")
    exec("class Choice: pass", plugin.__dict__)
    monkeypatch.setitem(sys.modules, plugin.__name__, plugin)
    with pytest.raises(ModuleNotFoundError, match="plugin_of_this_process"):
        work_with(2, open_argument, plugin.Choice())


def ends_within(seconds: float, work: Callable[[], object]) -> bool:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    return not thread.is_alive()


def test_new_interpreters_end_that_never_had_a_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)

    def use_no_worker() -> None:
        with open_workers(2, "try again", open_factor, 3):
            pass

    assert ends_within(30, use_no_worker)


class TakenByAnother(SimpleQueue[Any]):
    """A queue whose last entry another thread takes right after this one has seen that it is not empty."""

    def empty(self) -> bool:
        was_empty = super().empty()
        if not was_empty:
            self.get()
        return was_empty


def test_closing_does_not_wait_for_a_task_that_a_worker_takes_meanwhile() -> None:
    processes: _Processes[int] = _Processes([], 2, "try again")
    processes._tasks = TakenByAnother()
    processes._tasks.put((Future(), times, 1))
    assert ends_within(5, processes.close)


class ToldByOthers:
    """An argument that keeps who asked for its state, as is done for a copy of it."""

    def __init__(self) -> None:
        self.asked_by: list[str] = []

    def __getstate__(self) -> dict[str, Any]:
        self.asked_by.append(threading.current_thread().name)
        return {"asked_by": []}


@contextmanager
def open_argument(argument: ToldByOthers) -> Iterator[int]:
    yield 3


def test_arguments_are_copied_before_a_worker_of_this_process_may_change_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)
    argument = ToldByOthers()
    with open_workers(2, "try again", open_argument, argument, here_too=True) as workers:
        asked_by = list(argument.asked_by)
        assert list(workers.map(times, range(5))) == [0, 3, 6, 9, 12]
    assert asked_by == argument.asked_by == [threading.current_thread().name]


def meet_another(folder: Path, piece: int) -> int:
    """Wait for another process that does a piece at the same time."""
    (folder / str(os.getpid())).touch()
    deadline = time.monotonic() + 30
    while len(list(folder.iterdir())) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    return os.getpid()


def test_one_of_several_workers_is_this_process(tmp_path: Path) -> None:
    with open_workers(2, "try again", nullcontext, tmp_path, here_too=True) as workers:
        done_by = set(workers.map(meet_another, range(2)))
    assert os.getpid() in done_by
    assert len(done_by) == len(list(tmp_path.iterdir())) == 2


def die_while_the_result_is_sent(factor: int, piece: int) -> bytes:
    if piece:
        return bytes(factor)

    def send_half(self: Connection, content: bytes, write: object = None) -> None:
        os.write(self.fileno(), bytes(content)[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    Connection._send = send_half
    return bytes(100_000)


def test_a_worker_process_that_dies_while_it_sends_its_result_is_told() -> None:
    """In a process of its own, since it once waited for ever."""
    parts = "(2, test.open_factor, 100_000, test.die_while_the_result_is_sent, test.ModsimError, test.DIED)"
    code = f"import {__name__} as test; test.test_what_goes_wrong_in_a_worker_is_told{parts}"
    root = Path(__file__).resolve().parents[1]
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True, timeout=60)
