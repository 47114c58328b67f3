"""Two commands that write to one place at once: the first is stopped in the middle while the second is started."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Iterator

from benchmarks.faults.commands import Ended, Running, run, start
from benchmarks.faults.jobs import Job, Outcome, Tried
from benchmarks.faults.tracing import Call, Tracer
from benchmarks.faults.trees import differences, tree

STOPPED_FOR = 20
"""Looks in a row that must find a process stopped; strace stops it for moments too."""
LOCK = ".lock"


def two_writers(job: Job, second: tuple[str, ...], times: int, seed: int) -> Iterator[Tried]:
    """Start a second command while the first has begun to write.

    Args:
        job: The first command.
        second: What the second adds to the first's command line.
        times: How often.
        seed: Of the moments.
    """
    chance = random.Random(f"{seed} {job.name} {second}")
    fault = f"two writers: {job.name.split()[0]}"
    for _ in range(times):
        job.reset()
        call = chance.choice(_while_writing(job.calls))
        running = start(job.arguments, held=True)
        tracer = Tracer(running, inject=call.signalled("SIGSTOP"))
        _wait_until_stopped(running)
        other = run(_without(job.arguments, second))
        running.send(signal.SIGCONT, group=True)
        ended = running.wait()
        tracer.calls()
        case = f"{job.name}, then {' '.join(second) or 'the same'}, at {call.name} {call.nth}"
        wrong = _wrong(job, running.pid, ended, other)
        yield Tried(fault, case, Outcome.FAILED if wrong else Outcome.REFUSED, wrong or other.message())


def _without(arguments: tuple[object, ...], second: tuple[str, ...]) -> list[object]:
    """The command line of the second; `--resume` and `--overwrite` do not go together."""
    kept = [argument for argument in arguments if argument not in ("--overwrite", "--resume")]
    return [*kept, *second]


def _while_writing(calls: tuple[Call, ...]) -> list[Call]:
    """The calls of the first process while the lock is held; all where there is none."""
    calls = tuple(call for call in calls if call.pid == calls[0].pid)
    locks = [i for i, call in enumerate(calls) if LOCK in call.arguments]
    taken = [i for i in locks if calls[i].name not in ("unlink", "close")]
    given_back = [i for i in locks if "unlink" in calls[i].name]
    first = taken[-1] + 1 if taken else 0
    last = given_back[-1] if given_back else len(calls)
    return list(calls[first:last]) or list(calls)


def _wait_until_stopped(running: Running, patience_s: float = 60) -> None:
    deadline, looks = time.monotonic() + patience_s, 0
    while looks < STOPPED_FOR and time.monotonic() < deadline and not running.ended():
        looks = looks + 1 if running.stopped() else 0
        time.sleep(0.002)


def _wrong(job: Job, pid: int, first: Ended, second: Ended) -> str:
    if first.status == 0 and second.status == 0:
        return "both wrote"
    if first.status != 0:
        return f"the first ended with exit status {first.status}: {first.message()}"
    if not second.refused():
        return f"the second ended with exit status {second.status}: {second.message()}"
    if str(pid) not in second.said:
        return f"the second does not name the first's process: {second.message()}"
    wrong = differences(tree(job.folder), job.expected)
    return f"afterwards {wrong}" if wrong else ""
