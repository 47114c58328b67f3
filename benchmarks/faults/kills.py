"""Commands that are killed at random moments, and resumed."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

from benchmarks.faults.commands import Ended, Running, start
from benchmarks.faults.jobs import Job, Outcome, Tried, after
from benchmarks.faults.tracing import Tracer

LAST_CALLS = 40
"""Half of the kills at a call hit one of the last, which put the files in place."""


def killed(job: Job, chance: random.Random) -> Ended:
    """Run a command until it is killed, at a random time or with a random call that changes a file."""
    if chance.random() < 0.5:
        running = start(job.arguments)
        wait_until(running, chance.uniform(0, job.seconds))
        running.send(signal.SIGKILL)
        return running.wait()
    call = chance.choice(job.calls[-LAST_CALLS:] if chance.random() < 0.5 else job.calls)
    running = start(job.arguments, held=True)
    tracer = Tracer(running, inject=call.signalled("SIGKILL"))
    ended = running.wait()
    tracer.calls()
    return ended


def wait_until(running: Running, seconds: float) -> None:
    """Wait for a time, or for the end of the command."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and not running.ended():
        time.sleep(0.001)


def with_workers(job: Job, workers: int) -> Job:
    """The same command with another number of workers."""
    arguments = list(job.arguments)
    arguments[arguments.index("--workers") + 1] = workers
    return replace(job, arguments=tuple(arguments))


def chains(job: Job, kills: int, seed: int) -> Iterator[Tried]:
    """Runs that are killed, resumed, killed again and so on, one to four times, and then resumed to the end.

    Args:
        job: `modsim3d run`, with its calls.
        kills: How many must hit; what hits none does not count.
        seed: Of times, calls and numbers of workers.
    """
    chance = random.Random(f"{seed} {job.name}")
    while kills > 0:
        job.reset()
        moments, wrong = _chain(job, chance, min(kills, chance.randint(1, 4)))
        kills -= len(moments)
        case = f"{job.name}: {', '.join(moments) or 'not hit'}"
        tried = Tried("", case, Outcome.FAILED, wrong) if wrong else after(job, "", case)
        fault = "SIGKILL" if len(moments) <= 1 else f"SIGKILL, {len(moments)} in a row"
        if moments or tried.outcome is Outcome.FAILED:
            yield replace(tried, fault=fault)


def _chain(job: Job, chance: random.Random, kills: int) -> tuple[list[str], str]:
    moments: list[str] = []
    for _ in range(kills):
        workers = chance.choice((1, 2))
        attempt = with_workers(job, workers)
        if moments:
            attempt = replace(attempt, arguments=(*attempt.arguments, "--resume"))
        ended = killed(attempt, chance)
        if ended.status == 0:
            break
        if ended.status != -signal.SIGKILL and not ended.refused():  # a killed worker ends the command with one error
            return moments, f"exit status {ended.status}: {ended.message()}"
        if ended.left_behind:
            return moments, f"{ended.left_behind} workers did not end"
        moments.append(f"after {ended.seconds:.2f} s with {workers} worker{'s' * (workers > 1)}")
    return moments, ""


def killed_workers(job: Job, kills: int, seed: int) -> Iterator[Tried]:
    """One worker process of two is killed; the command must say so, and `--resume` goes on."""
    chance = random.Random(f"{seed} worker {job.name}")
    done = 0
    while done < kills:
        job.reset()
        running = start(with_workers(job, 2).arguments)
        wait_until(running, chance.uniform(0.1, 1) * job.seconds)
        workers = running.children()
        if workers:
            os.kill(chance.choice(workers), signal.SIGKILL)
        ended = running.wait()
        if workers:
            done += 1
            yield after(job, "SIGKILL of one worker process", f"{job.name}: after {ended.seconds:.2f} s", ended)


def ended_by(number: signal.Signals, expected: Sequence[int], job: Job, count: int) -> Iterator[Tried]:
    """SIGTERM or SIGINT at random times.

    Args:
        number: SIGINT goes to all processes of the command, as from a terminal.
        expected: What the exit status may be.
        job: The command.
        count: How many must hit.
    """
    chance = random.Random(f"{number} {job.name}")
    done = 0
    while done < count:
        job.reset()
        attempt = with_workers(job, chance.choice((1, 2))) if "--workers" in job.arguments else job
        running = start(attempt.arguments)
        wait_until(running, chance.uniform(0.05, 1) * job.seconds)
        running.send(number, group=number == signal.SIGINT)
        ended = running.wait()
        if ended.status == 0:
            continue
        done += 1
        case = f"{job.name}: after {ended.seconds:.2f} s"
        if ended.status not in expected or "Traceback" in ended.said or ended.left_behind:
            said = f"exit status {ended.status}, {ended.left_behind} left behind: {ended.message()}"
            yield Tried(number.name, case, Outcome.FAILED, said)
        else:
            yield after(job, number.name, case)


def killed_outputs(job: Job, kills: int, seed: int) -> Iterator[Tried]:
    """Another command than `run` that is killed; its old output is whole, or the new is."""
    chance = random.Random(f"{seed} {job.name}")
    done = 0
    while done < kills:
        job.reset()
        ended = killed(job, chance)
        if ended.status == 0:
            continue
        done += 1
        yield after(job, f"SIGKILL of {job.name}", f"{job.name}: after {ended.seconds:.2f} s")
