"""Work done in this process or shared between several, with the results in the order of the pieces."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.reduction import ForkingPickler
from numbers import Integral
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, Literal, NoReturn, Protocol, TypeVar

from modsim3d.core.errors import ModsimError
from modsim3d.io.operating_system import Connection, end_with_parent, forked, inherited, may_fork, passing, usable_cpus

IN_HAND = 2  # pieces that a worker process has at once: the one that it does, and the next
_END = b""  # the message after the last piece
# Processes share the cores; threads of each would only wait for each other.
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

Task = tuple[Future[Any], Callable[[Any, Any], Any], Any]  # where the result goes, the work and the piece


class DiedError(Exception):
    """A worker process died."""


class WorkerProcess:
    """A worker in a process of its own. Nobody else holds the other end of its pipe, which therefore ends when the
    process dies; in a queue of several processes, half a result would be waited for without end."""

    def __init__(self, fork: bool, set_up: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        """Start the process, a fork of this one or a new interpreter; `set_up` of `arguments` opens its worker."""
        # Made now: the caller may work with the same arguments as soon as it goes on, which changes what they keep.
        self._first = None if fork else ForkingPickler.dumps((set_up, arguments))
        self._pipe, other_end = multiprocessing.Pipe()
        self._sending = threading.Lock()
        with other_end:  # closed before the next process is forked, which would hold it too
            if fork:
                self._wait: Callable[[], Any] = forked(_serve, other_end, set_up, arguments).join
            else:
                # A script without `if __name__ == "__main__":` would start again in a process of multiprocessing.
                code = f"from modsim3d.io.processes import serve; serve({other_end.fileno()}, {os.getpid()})"
                self._wait = new_interpreter(other_end, "-c", code).wait

    def do_all(self, tasks: SimpleQueue[Task | None], enough: int) -> None:
        """Have tasks done until None comes, and wait for the end of the process. Where there are `enough` tasks for all
        workers, the process has its next one before it has done one, so that it need not wait for this process."""
        begun: deque[Future[Any]] = deque()
        more = True
        while True:
            with suppress(Empty):
                while more and (not begun or (len(begun) < IN_HAND and tasks.qsize() >= enough)):
                    task = tasks.get(block=not begun)
                    if task is None:
                        more = False
                    else:
                        begun.append(self._hand(*task))
            if not begun:
                break
            self._take_result(begun.popleft())
        self._wait()
        self._pipe.close()

    def stop(self) -> None:
        """Let the process end after what it does now."""
        with suppress(OSError), self._sending:
            self._pipe.send_bytes(_END)

    def _hand(self, future: Future[Any], work: Callable[[Any, Any], Any], piece: Any) -> Future[Any]:
        try:
            with self._sending:
                if self._first is not None:
                    self._pipe.send_bytes(self._first)  # not at once: an interpreter that starts does not read yet
                    self._first = None
                self._pipe.send((work, piece))
        except OSError:
            future.set_exception(DiedError())
        except Exception as error:
            future.set_exception(error)
        return future

    def _take_result(self, future: Future[Any]) -> None:
        """Wait for what a process has to say of a task, unless the task could not be handed to it."""
        if future.done():
            return
        try:
            result, error = self._pipe.recv()
        except (EOFError, OSError):
            result, error = None, DiedError()
        except Exception as unreadable:
            result, error = None, unreadable
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)


def new_interpreter(pipe: Connection, *arguments: str) -> subprocess.Popen[bytes]:
    """A new Python with the given options, which finds the modules that this one finds, and holds a pipe under the same
    number. It is in a group of its own, because Ctrl-C goes to all of a group, and the main process tells the user what
    was interrupted. What it prints goes to standard error, because standard output is the command's."""
    paths = [path or str(Path.cwd()) for path in sys.path]
    environment = {**_ONE_THREAD, **os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.Popen(
        [sys.executable, "-P", *arguments],  # -P: the working directory may hold files that are named like modules
        env=environment,
        **passing(pipe),
        stdin=subprocess.DEVNULL,
        stdout=2,
        process_group=0,
    )


def serve(pipe_number: int, parent: int) -> None:
    """Be a worker in a new interpreter; what its worker is comes through the pipe first."""
    end_with_parent(parent)
    pipe = inherited(pipe_number)
    try:
        message = pipe.recv_bytes()
        if message != _END:  # there may be no piece for this worker
            _serve(pipe, *_set_up_of(message))
    except (EOFError, OSError):  # the parent has gone
        os._exit(1)


def _set_up_of(message: bytes) -> tuple[Callable[..., AbstractContextManager[Any]], tuple[Any, ...]]:
    """Function that sets up a worker, and its arguments. Where a new interpreter cannot read them, as those of a class
    that it cannot import, setting up raises the error: so it is told as any other error of setting up."""
    try:
        set_up, arguments = ForkingPickler.loads(message)
    except Exception as error:
        return _raise, (error,)
    return set_up, arguments


def _raise(error: Exception) -> NoReturn:
    raise error


def _serve(pipe: Connection, set_up: Callable[..., AbstractContextManager[Any]], arguments: tuple[Any, ...]) -> None:
    """Set up the worker of this process, and do what comes through a pipe until its end is told."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process tells the user what was interrupted
    messages: SimpleQueue[bytes] = SimpleQueue()
    # A thread reads, or both sides might wait with a full pipe: one to hand a task, the other to give a result.
    threading.Thread(target=_read, args=(pipe, messages), daemon=True).start()
    with ExitStack() as opened:
        worker, problem = None, None
        try:
            worker = opened.enter_context(set_up(*arguments))
        except Exception as error:
            problem = error
        while message := messages.get():
            _answer(pipe, problem, worker, message)


def _read(pipe: Connection, messages: SimpleQueue[bytes]) -> None:
    """Take messages from a pipe until its end is told or the parent has gone."""
    message = None
    while message != _END:
        try:
            message = pipe.recv_bytes()
        except (EOFError, OSError):
            message = _END
        if message == _END:
            _empty(messages)  # nobody waits for the results
        messages.put(message)


def _empty(queue: SimpleQueue[Any]) -> None:
    with suppress(Empty):
        while True:
            queue.get_nowait()


def _answer(pipe: Connection, problem: Exception | None, worker: Any, message: bytes) -> None:
    """Send a result and no error, or an error with its traceback as a note."""
    try:
        if problem is not None:
            raise problem
        work, piece = ForkingPickler.loads(message)
        pipe.send((work(worker, piece), None))
    except BaseException as error:
        if not isinstance(error, ModsimError):
            error.add_note("".join(traceback.format_exception(error)))
        pipe.send((None, error))


MAX_WORKERS = 1024
AHEAD = 3  # pieces that may wait for each worker; it bounds the memory

T = TypeVar("T")
P = TypeVar("P")
W = TypeVar("W")
W_co = TypeVar("W_co", covariant=True)
WorkerCount = int | Literal["auto"]  # number of worker processes; `auto`: one for each CPU that this process may use


def worker_count(workers: WorkerCount, name: str = "workers") -> int:
    """The number of workers that is asked for. Raises ModsimError, which calls it `name`, if there is no such one."""
    if isinstance(workers, str) and workers == "auto":
        return min(usable_cpus(), MAX_WORKERS)
    if isinstance(workers, Integral) and not isinstance(workers, bool) and 1 <= workers <= MAX_WORKERS:
        return int(workers)
    shown = repr(workers)[:60]
    raise ModsimError(f"{name}: needs a number of processes from 1 to {MAX_WORKERS}, or 'auto' (got {shown})")


def parse_workers(text: str) -> WorkerCount:
    """The value of the option `--workers`. Raises ModsimError if it is neither a number of workers nor `auto`."""
    value: Any = int(text) if re.fullmatch("[0-9]{1,9}", text) else text
    worker_count(value, "--workers")
    return value  # type: ignore[no-any-return]


class Workers(Protocol[W_co]):
    """One or several workers of one type, each in a process of its own or the only one in this process."""

    def map(self, work: Callable[[W_co, P], T], pieces: Iterable[P]) -> Iterator[T]:
        """Do the work on each piece, with a worker, and give the results in the order of the pieces, of which a few are
        taken ahead. Other processes must be able to import `work`. Raises ModsimError if a worker process could not be
        set up, or died."""


def open_workers(
    workers: WorkerCount,
    if_killed: str,
    set_up: Callable[..., AbstractContextManager[W]],
    *arguments: Any,
    here_too: bool = False,
) -> AbstractContextManager[Workers[W]]:
    """One worker in this process, or several in processes of their own. `set_up` opens a worker: it is called once in
    each process with `arguments`, which must be picklable. `if_killed` is what a user should do if a worker process
    dies. With `here_too`, one of several workers is in this process and works while it waits for the others. Raises
    ModsimError if this is no number of workers."""
    return _opened(worker_count(workers), if_killed, set_up, arguments, here_too)


@contextmanager
def _opened(
    count: int,
    if_killed: str,
    set_up: Callable[..., AbstractContextManager[W]],
    arguments: tuple[Any, ...],
    here_too: bool,
) -> Iterator[Workers[W]]:
    if count == 1:
        with set_up(*arguments) as worker:
            yield _ThisProcess(worker)
        return
    fork = may_fork()
    started = [WorkerProcess(fork, set_up, arguments) for _ in range(count - here_too)]  # before the first thread
    processes: _Processes[W] = _Processes(started, count, if_killed)
    try:
        with ExitStack() as opened:
            if here_too:
                processes.do_here = partial(_do, opened.enter_context(set_up(*arguments)))
            yield processes
    finally:
        processes.close()


@dataclass(frozen=True)
class _ThisProcess(Generic[W]):
    worker: W

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        return (work(self.worker, piece) for piece in pieces)


class _Processes(Generic[W]):
    """Worker processes, each with a thread here that hands it pieces and waits for the results. `do_here` does a piece
    in this process too, with a worker of its own, while it waits for a result."""

    def __init__(self, processes: list[WorkerProcess], workers: int, if_killed: str) -> None:
        self._processes = processes
        self._if_killed = if_killed
        self._most_waiting = workers * AHEAD
        self.do_here: Callable[[Task | None], None] | None = None
        self._tasks: SimpleQueue[Task | None] = SimpleQueue()
        self._threads = [threading.Thread(target=process.do_all, args=(self._tasks, workers)) for process in processes]
        for thread in self._threads:
            thread.start()

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        waiting: deque[Future[T]] = deque()
        for piece in pieces:
            waiting.append(Future())
            self._tasks.put((waiting[-1], work, piece))
            if len(waiting) >= self._most_waiting:
                yield self._result(waiting.popleft())
        while waiting:
            yield self._result(waiting.popleft())

    def close(self) -> None:
        _empty(self._tasks)
        for process in self._processes:
            process.stop()
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def _result(self, future: Future[T]) -> T:
        with suppress(Empty):
            while self.do_here is not None and not future.done():
                self.do_here(self._tasks.get_nowait())
        try:
            return future.result()
        except DiedError:
            raise ModsimError(f"a worker process died (killed, or out of memory); {self._if_killed}") from None


def _do(worker: Any, task: Task | None) -> None:
    assert task is not None  # it comes only after all tasks
    future, work, piece = task
    try:
        future.set_result(work(worker, piece))
    except Exception as error:
        future.set_exception(error)
