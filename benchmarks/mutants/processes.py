"""Processes for mutants: forked from one that has imported every library, with a limit on processor time."""

from __future__ import annotations

import functools
import gc
import importlib
import math
import os
import resource
import select
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

SURVIVED, KILLED, TIMED_OUT = "survived", "killed", "timed out"
LIBRARIES = ("hypothesis.extra.numpy", "pyarrow.parquet", "pydantic", "scipy.optimize", "scipy.spatial", "scipy.stats")
LIBRARIES += ("shapely", "trimesh", "yaml")
MAX_BYTES = 8 << 30
WALL_S = 300.0
"""Only for a process that waits for ever: what counts against a mutant is its processor time."""


def preload() -> None:
    """Import what forked processes need, without threads, but nothing of the package, of which a module may change."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    for name in LIBRARIES:
        importlib.import_module(name)


def in_a_process(work: Callable[[], bool], cpu_s: float | None = None) -> str:
    """Do some work in a forked process and say how it ended: its result is whether it survived."""
    pid = os.fork()
    if pid == 0:
        _child(work, cpu_s)
    watch = os.pidfd_open(pid)
    ended = select.select([watch], [], [], None if cpu_s is None else WALL_S)[0]
    os.close(watch)
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # it, if it waits for ever, and the workers that it may have left
    _, status = os.waitpid(pid, 0)
    if not ended or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return TIMED_OUT
    return SURVIVED if status == 0 else KILLED


def _child(work: Callable[[], bool], cpu_s: float | None) -> None:
    os.setsid()
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    if cpu_s is not None:
        os.dup2(nothing, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu_s), math.ceil(cpu_s) + 5))
        resource.setrlimit(resource.RLIMIT_DATA, (MAX_BYTES, MAX_BYTES))
    code = 1
    try:
        code = int(not work())
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def caches_of_all() -> list[functools._lru_cache_wrapper[Any]]:
    """The cached functions of the package and of the tests."""
    gc.unfreeze()  # what the tests hide from Python's collector is not listed
    found = [each for each in gc.get_objects() if isinstance(each, functools._lru_cache_wrapper)]
    return [each for each in found if each.__module__.startswith(("modsim3d", "tests"))]


def clear(caches: Sequence[functools._lru_cache_wrapper[Any]]) -> None:
    """Forget what cached functions have computed."""
    for each in caches:
        each.cache_clear()
