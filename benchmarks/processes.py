"""The processes that a benchmark starts: parts of modsim3d, and the program as a user runs it."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 3600

Answer = dict[str, Any]


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def inherited() -> dict[str, str]:
    """What commands inherit: they keep Python's byte code, as those of an installed package have it."""
    left_out = ("PYOPENGL_PLATFORM", "PYTHONDONTWRITEBYTECODE")
    return {name: value for name, value in os.environ.items() if name not in left_out}


def environment() -> dict[str, str]:
    """That of the processes: as the command line sets it, and the same for the baselines."""
    kept = inherited()
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    settings = {
        "LP_NUM_THREADS": "0",
        "OPENBLAS_NUM_THREADS": "1",
        "JE_ARROW_MALLOC_CONF": "background_thread:false",
        "ARROW_DEFAULT_MEMORY_POOL": "system",
    }
    return {**kept, **settings, "PYTHONPATH": path}


def child(name: str, **given: Any) -> Answer:
    """What benchmarks/child.py answers, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.child", name, json.dumps(given)]
    done = subprocess.run(
        command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE_S
    )
    answer: Answer = json.loads(done.stdout.splitlines()[-1])
    return answer


@contextlib.contextmanager
def server(passes: str, scene: str) -> Iterator[Callable[[str, Sequence[int]], Answer]]:
    """A process that answers one request after another, so that two can be timed in turn."""
    command = [sys.executable, "-m", "benchmarks.child", "serve", json.dumps({"passes": passes, "scene": scene})]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment(), cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin and process.stdout

        def answer() -> Answer:
            line = process.stdout.readline()
            if not line:
                raise RuntimeError(f"the process of the pass '{passes}' died")
            found: Answer = json.loads(line)
            return found

        def ask(what: str, frames: Sequence[int]) -> Answer:
            process.stdin.write(json.dumps({"do": what, "frames": list(frames)}) + "\n")
            process.stdin.flush()
            return answer()

        try:
            answer()
            yield ask
        finally:
            process.stdin.close()


@dataclass(frozen=True)
class Finished:
    """A command that was run: seconds by the clock and of processors, and the most memory that it held."""

    seconds: float
    processor_s: float
    peak_bytes: int


def modsim3d(*arguments: str | Path, right: Container[int] = (0,)) -> Finished:
    """Run the program as a user does; another exit status than those that are right is an error."""
    return finished([Path(sys.executable).parent / "modsim3d", *arguments], right)


def finished(command: Sequence[str | Path], right: Container[int] = (0,)) -> Finished:
    """Run a command; another exit status than those that are right is an error."""
    kept = inherited()
    with tempfile.TemporaryFile() as said:
        started = time.perf_counter()
        process = subprocess.Popen(command, env=kept, cwd=ROOT, stdout=said, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in right:
            said.seek(0)
            raise RuntimeError(f"{' '.join(map(str, command))} failed:\n{said.read().decode()}")
    return Finished(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)
