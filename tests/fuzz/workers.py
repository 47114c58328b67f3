"""Cases in forked processes, so that one that crashes, hangs or takes too much is one result and not the end."""

import gc
import importlib
import mmap
import multiprocessing
import os
import resource
import shutil
import struct
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from tests.fuzz.cases import files_of
from tests.fuzz.corpora import write_files
from tests.fuzz.outcomes import FAILED, Outcome, outcome_of, place_of
from tests.fuzz.readers import READERS

MAX_CPU_S = 2.0
MAX_BYTES = 10**9
"""Most processor time and most memory above the warm process that a case may take."""
KILLED_CPU_S, KILLED_WALL_S = 10.0, 300.0
"""A case that takes more is a hang: its process is ended."""
_BATCH = 100
_CLOCK = struct.Struct("<qdd")
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Result:
    """What became of a case, and what it took."""

    number: int
    outcome: Outcome
    cpu_s: float = 0.0
    memory_bytes: int = 0


def within_limits(result: Result) -> Outcome:
    """The outcome, or a failure if the case took too much."""
    if result.outcome.verdict == FAILED:
        return result.outcome
    if result.cpu_s > MAX_CPU_S:
        return Outcome(FAILED, f"{result.cpu_s:.1f} s of processor time; {result.outcome.said}", "time")
    if result.memory_bytes > MAX_BYTES:
        return Outcome(FAILED, f"{result.memory_bytes / 1e6:.0f} MB; {result.outcome.said}", "memory")
    return result.outcome


def measured(reader: str, number: int, folder: Path, warm_bytes: int = 0) -> Result:
    """Make a case's files in an empty folder, read them, and measure what that takes."""
    try:
        write_files(files_of(reader, number), folder)
    except Exception as error:  # an error of this campaign, which is not to end it
        return Result(number, Outcome(FAILED, f"the case cannot be made: {error!r}", f"no case {place_of(error)}"))
    Path("/proc/self/clear_refs").write_text("5")  # the peak of the memory is counted from here
    started = time.process_time()
    outcome = outcome_of(READERS[reader].read, folder, READERS[reader].also_names)
    cpu_s = time.process_time() - started
    return Result(number, outcome, cpu_s, memory_bytes("VmHWM") - warm_bytes)


def memory_bytes(kind: str) -> int:
    """A size of this process: its peak `VmHWM`, `VmRSS` or `VmSize`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(kind):
            return int(line.split()[1]) * 1024
    raise OSError(f"/proc/self/status has no {kind}")


@dataclass
class _Slice:
    """Cases of a reader that one process works on, and the process."""

    reader: str
    numbers: Sequence[int]
    clock: mmap.mmap = field(default_factory=lambda: mmap.mmap(-1, _CLOCK.size))
    done: int = 0
    process: BaseProcess | None = None
    results: Connection | None = None

    def start(self) -> None:
        """Fork a process that takes the rest of the cases."""
        context = multiprocessing.get_context("fork")
        self.results, sender = context.Pipe(duplex=False)
        self.clock[:] = _CLOCK.pack(-1, 0.0, time.monotonic())
        self.process = context.Process(target=_work, args=(self.reader, self.numbers[self.done :], self.clock, sender))
        self.process.start()
        sender.close()

    def current(self) -> tuple[int, float, float]:
        """Number of the case in work, −1 before the first; processor time and time at its start."""
        return _CLOCK.unpack(self.clock[:])

    def hangs(self) -> bool:
        """Whether the case in work takes too long."""
        assert self.process is not None
        number, cpu_s, since = self.current()
        if number < 0:
            return False
        used = _cpu_s(self.process.pid or 0)
        return used - cpu_s > KILLED_CPU_S or time.monotonic() - since > KILLED_WALL_S


def _cpu_s(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _work(reader: str, numbers: Sequence[int], clock: mmap.mmap, results: Connection) -> None:
    """In a forked process: warm up on the good files, then take the cases."""
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(null, stream)
    with tempfile.TemporaryDirectory(prefix="modsim3d_fuzz_", dir=_fast_folder()) as name:
        folder = Path(name)
        warm_up(reader, folder)
        limit = memory_bytes("VmSize") + 2 * MAX_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        warm, batch = memory_bytes("VmRSS"), list[Result]()
        for number in numbers:
            clock[:] = _CLOCK.pack(number, time.process_time(), time.monotonic())
            batch.append(measured(reader, number, folder / str(number), warm))
            shutil.rmtree(folder / str(number), ignore_errors=True)
            if len(batch) == _BATCH:
                results.send(batch)
                batch = []
        clock[:] = _CLOCK.pack(-1, 0.0, 0.0)
        results.send(batch)
    results.close()


def warm_up(reader: str, folder: Path) -> None:
    """Read the good files; raise a `RuntimeError` if one is not accepted."""
    for number, files in enumerate(READERS[reader].bases()):
        write_files(files, folder / f"good_{number}")
        outcome = outcome_of(READERS[reader].read, folder / f"good_{number}", READERS[reader].also_names)
        if outcome.verdict != "accepted":
            raise RuntimeError(f"good file {number} of {reader} is not accepted: {outcome}")


def preload() -> None:
    """Import what readers import when they need it, once for all forked processes."""
    ours = ("PIL.Image", "pyais", "zipfile")
    for module in (*ours, "scipy.optimize", "scipy.spatial", "trimesh", "trimesh.exchange.load"):
        importlib.import_module(module)
    gc.freeze()


def _fast_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def tried(reader: str, numbers: Sequence[int], processes: int, slice_cases: int = 1000) -> Iterator[Result]:
    """The results of cases, as they come, not in order; raises RuntimeError if a process ends before its first case."""
    slices = [_Slice(reader, numbers[first : first + slice_cases]) for first in range(0, len(numbers), slice_cases)]
    waiting, running = slices[::-1], list[_Slice]()
    while waiting or running:
        while waiting and len(running) < processes:
            running.append(waiting.pop())
            running[-1].start()
        ready = wait([piece.results for piece in running if piece.results is not None], timeout=0.5)
        for piece in list(running):
            if piece.results in ready:
                yield from _received(piece)
            elif piece.hangs():
                yield from _ended(piece, "hang", f"ended after {KILLED_CPU_S:g} s of processor time")
            if piece.done == len(piece.numbers):
                _close(piece)
                running.remove(piece)


def _received(piece: _Slice) -> Iterator[Result]:
    assert piece.results is not None and piece.process is not None
    try:
        batch: list[Result] = piece.results.recv()
    except EOFError:
        piece.process.join()
        yield from _ended(piece, "crash", f"the process ended with status {piece.process.exitcode}")
        return
    piece.done += len(batch)
    yield from batch


def _ended(piece: _Slice, place: str, said: str) -> Iterator[Result]:
    """The failure of the case in work; the cases after it, and those whose results are lost, are taken again."""
    assert piece.process is not None
    number = piece.current()[0]
    piece.process.kill()
    _close(piece)
    if number < 0:
        raise RuntimeError(f"the process for {piece.reader} ended before its first case: {said}")
    left = [other for other in piece.numbers[piece.done :] if other != number]
    piece.numbers, piece.done = [*piece.numbers[: piece.done], number, *left], piece.done + 1
    yield Result(number, Outcome(FAILED, said, place))
    if left:
        piece.start()


def _close(piece: _Slice) -> None:
    if piece.process is not None and piece.results is not None:
        piece.process.join()
        piece.results.close()
