"""Work in this process and work shared between several give the same results, in order; `auto` counts the CPUs."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from modsim3d import ModsimError, detect_run, load_scene, open_run, run_scene
from modsim3d.io.processes import MAX_WORKERS, _Processes, open_workers, parse_workers, worker_count
from tests.cli.bad_input.builders import refusal
from tests.run_folders import wait_for
from tests.scenes import crossing


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


@pytest.mark.parametrize(("count", "set_up", "argument", "work", "error", "said"), [
    (1, open_factor, -1, times, ModsimError, "a factor is positive"),
    (2, open_factor, -1, times, ModsimError, "a factor is positive"),
    (2, open, "missing", times, FileNotFoundError, "missing"),
    (2, open_factor, 3, kill_this_process, ModsimError, DIED),
])  # fmt: skip
def test_what_goes_wrong_in_a_worker_is_told(count, set_up, argument, work, error, said: str) -> None:
    with pytest.raises(error, match=said):
        work_with(count, set_up, argument, work)


def test_workers_say_what_they_cannot_import_closing_waits_for_none_and_arguments_are_copied_first(monkeypatch):
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)
    plugin = ModuleType("plugin_of_this_process")
    exec("class Choice: pass", plugin.__dict__)
    monkeypatch.setitem(sys.modules, plugin.__name__, plugin)
    with pytest.raises(ModuleNotFoundError, match="plugin_of_this_process"):
        work_with(2, open_argument, plugin.Choice())
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)
    argument = ToldByOthers()
    with open_workers(2, "try again", open_argument, argument, here_too=True) as workers:
        asked_by = list(argument.asked_by)
        assert list(workers.map(times, range(5))) == [0, 3, 6, 9, 12]
    assert asked_by == argument.asked_by == [threading.current_thread().name]
    processes: _Processes[int] = _Processes([], 2, "try again")
    processes._tasks = TakenByAnother()
    processes._tasks.put((Future(), times, 1))
    assert ends_within(5, processes.close)
    monkeypatch.setattr("modsim3d.io.processes.may_fork", lambda: False)

    def use_no_worker() -> None:
        with open_workers(2, "try again", open_factor, 3):
            pass

    assert ends_within(30, use_no_worker)


def ends_within(seconds: float, work: Callable[[], object]) -> bool:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    return not thread.is_alive()


class TakenByAnother(SimpleQueue[Any]):
    """A queue whose last entry another thread takes right after this one has seen that it is not empty."""

    def empty(self) -> bool:
        was_empty = super().empty()
        if not was_empty:
            self.get()
        return was_empty


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


def meet_another(folder: Path, piece: int) -> int:
    """Wait for another process that does a piece at the same time."""
    (folder / str(os.getpid())).touch()
    wait_for(lambda: len(list(folder.iterdir())) > 1)
    return os.getpid()


def test_one_of_several_workers_is_this_process_and_the_option_takes_auto(tmp_path, call, monkeypatch):
    with open_workers(2, "try again", nullcontext, tmp_path, here_too=True) as workers:
        done_by = set(workers.map(meet_another, range(2)))
    assert os.getpid() in done_by
    assert len(done_by) == len(list(tmp_path.iterdir())) == 2
    asked: list[int] = []
    monkeypatch.setattr("modsim3d.io.processes.usable_cpus", lambda: asked.append(1) or 1)
    options = ("--workers", "auto", "--no-sheet", "--out", tmp_path / "run")
    assert call("run", crossing(tmp_path, 4), *options)[0] == 0 and asked
    asked.clear()
    assert call("check", "repeat", tmp_path / "run", "--workers", "auto")[0] == 0 and asked


def die_while_the_result_is_sent(factor: int, piece: int) -> bytes:
    if piece:
        return bytes(factor)

    def send_half(self: Connection, content: bytes, write: object = None) -> None:
        os.write(self.fileno(), bytes(content)[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    Connection._send = send_half
    return bytes(100_000)


def test_workers_are_a_number_or_auto_and_one_that_dies_while_it_sends_its_result_is_told(monkeypatch):
    """In a process of its own, since it once waited for ever."""
    parts = "(2, test.open_factor, 100_000, test.die_while_the_result_is_sent, test.ModsimError, test.DIED)"
    code = f"import {__name__} as test; test.test_what_goes_wrong_in_a_worker_is_told{parts}"
    root = Path(__file__).resolve().parents[1]
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True, timeout=240)
    assert [worker_count(n) for n in (1, 7, np.int64(2))] == [1, 7, 2]  # type: ignore[list-item]
    assert [parse_workers(text) for text in ("1", "16", "auto")] == [1, 16, "auto"]
    wrong: tuple[Any, ...] = (0, -1, 2.0, True, None, "2", "AUTO", "", MAX_WORKERS + 1)
    for workers in wrong:
        with pytest.raises(ModsimError, match="needs a number of processes from 1 to 1024, or 'auto'"):
            worker_count(workers)
        with pytest.raises(ModsimError, match="workers: needs a number"):
            open_workers(workers, "", open)
    if hasattr(os, "process_cpu_count"):
        monkeypatch.setattr(os, "process_cpu_count", lambda: 3)
    else:
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 4, 5})
    assert worker_count("auto") == 3


@pytest.mark.parametrize("command", ["run", "detect", "check repeat", "view film"])
def test_a_wrong_option_is_one_line_before_anything_is_read_or_written(call, tmp_path: Path, command: str) -> None:
    out = () if command == "check repeat" else ("--out", tmp_path / "out")
    for wrong in ("0", "-2", "1.5", "all", "Auto", "1_0", "٣", "9" * 5000, "", "1025"):
        said = refusal(call, (*command.split(), tmp_path / "any", f"--workers={wrong}", *out), wrong[:50])
        assert said.startswith("modsim3d: --workers: needs a number of processes from 1 to 1024, or 'auto' (got ")
        assert said.count("\n") == 1 and len(said) < 200
    assert not list(tmp_path.iterdir())


def test_functions_take_auto_and_write_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.io.processes.usable_cpus", lambda: 2)
    scene, written = load_scene(crossing(tmp_path, 6), source="analytic"), []
    for workers in (1, "auto"):
        folders = [tmp_path / f"{workers}", tmp_path / f"{workers}_again"]
        run_scene(scene, folders[0], workers=workers)  # type: ignore[arg-type]
        detect_run(open_run(folders[0]), folders[1], seed=2, workers=workers)  # type: ignore[arg-type]
        tables = [folder / table for folder in folders for table in ("truth.parquet", "detections.parquet")]
        written.append([path.read_bytes() for path in tables])
    assert written[0] == written[1]
    with pytest.raises(ModsimError, match="workers: needs a number"):
        run_scene(scene, tmp_path / "none", workers=0)
    assert not (tmp_path / "none").exists()
