"""Every call that changes the files of a command, failing in turn."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace

from benchmarks.faults.jobs import Job, Outcome, Tried, after
from benchmarks.faults.tracing import FAILURES, Call, injected, traced


def failing_calls(job: Job, most: int, seed: int = 0, error: str | None = None) -> Iterator[Tried]:
    """Fail each call of a command in turn, or some of them.

    Args:
        job: With its calls.
        most: If there are more calls, this many at random.
        seed: Of the choice.
        error: In place of the usual one, of those calls that may run out of space.
    """
    calls = [call for call in job.calls if error is None or FAILURES[call.name] == "ENOSPC"]
    if len(calls) > most:
        chosen = random.Random(f"{seed} {job.name}").sample(range(len(calls)), most)
        calls = [calls[index] for index in sorted(chosen)]
    for call in calls:
        yield fail(job, call, error or FAILURES[call.name])


def fail(job: Job, call: Call, error: str) -> Tried:
    """Fail one call."""
    job.reset()
    ended, calls = traced(job.arguments, inject=call.failure(error))
    hit = injected(calls, job.folder)
    fault = f"{call.name} fails ({error})"
    if hit is None:
        return Tried(fault, f"{job.name}: call {call.nth}", Outcome.FAILED, "strace did not reach the call")
    case = f"{job.name}: {call.name} {call.nth}, {hit.arguments.replace(str(job.folder), '')[:100]}"
    tried = after(job, fault, case, ended)
    return replace(tried, said=tried.said.replace(str(job.folder), "DIR"))
