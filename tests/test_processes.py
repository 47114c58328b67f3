"""Work in this process and work shared between several give the same results, in order."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from modsim3d.errors import ModsimError
from modsim3d.processes import open_workers


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


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_in_setting_up_a_worker_is_told(count: int) -> None:
    with (
        pytest.raises(ModsimError, match="a factor is positive"),
        open_workers(count, "try again", open_factor, -1) as workers,
    ):
        list(workers.map(times, [1]))


def test_a_worker_process_that_dies_is_told() -> None:
    with (
        pytest.raises(ModsimError, match=r"a worker process died \(killed, or out of memory\); try again"),
        open_workers(2, "try again", open_factor, 3) as workers,
    ):
        list(workers.map(kill_this_process, [1]))
