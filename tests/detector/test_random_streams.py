from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.random_streams import Streams


@given(
    borders=st.lists(st.integers(0, 60), max_size=6),
    width=st.integers(1, 9),
    first=st.integers(0, 2**40),
)
def test_a_step_has_the_same_numbers_however_steps_are_split(borders: list[int], width: int, first: int) -> None:
    whole = Streams(3).uniforms("noise", "C0", first=first, count=60, width=width)
    streams, edges = Streams(3), [0, *sorted(borders), 60]
    parts = [
        streams.uniforms("noise", "C0", first=first + a, count=b - a, width=width) for a, b in itertools.pairwise(edges)
    ]
    assert np.array_equal(np.concatenate(parts), whole)


def test_a_row_starts_at_its_steps_blocks_of_philox() -> None:
    streams = Streams(3)
    numbers = streams.uniforms("noise", "C0", first=7, count=2, width=5)
    key = streams._key(0, "noise", ("C0",))
    slow = [np.random.Generator(np.random.Philox(key=key, counter=2 * step)).random(5) for step in (7, 8)]
    assert np.array_equal(numbers, slow)


def test_numbers_do_not_depend_on_what_was_asked_for_before() -> None:
    streams = Streams(3)
    first = streams.uniforms("noise", "a", first=0, count=10)
    streams.uniforms("noise", "b", first=0, count=3)
    streams.generator("noise", "a", step=0).random(7)
    assert np.array_equal(streams.uniforms("noise", "a", first=0, count=10), first)


@pytest.mark.parametrize(
    ("seed", "purpose", "names"),
    [
        (4, "noise", ("a", "b")),
        (3, "other", ("a", "b")),
        (3, "noise", ("a",)),
        (3, "noise", ("b", "a")),
        (3, "noise", ("ab",)),
        (3, "noise", ("a", "b", "")),
        (3, "noisea", ("b",)),
    ],
)
def test_another_seed_purpose_or_name_gives_other_numbers(seed: int, purpose: str, names: tuple[str, ...]) -> None:
    ours = Streams(3).uniforms("noise", "a", "b", first=0, count=100)
    theirs = Streams(seed).uniforms(purpose, *names, first=0, count=100)
    assert not np.intersect1d(ours, theirs).size


def test_generators_of_steps_and_uniforms_do_not_run_into_each_other() -> None:
    streams = Streams(3)
    draws = [streams.generator("noise", "a", step=step).random(1000) for step in range(5)]
    draws.append(streams.uniforms("noise", "a", first=0, count=250, width=4).ravel())
    assert len(np.unique(np.concatenate(draws))) == 6000


def test_generators_are_repeatable_and_independent_of_each_other() -> None:
    streams = Streams(3)
    one, two = streams.generator("noise", "a", step=1), streams.generator("noise", "a", step=1)
    two.random(5)
    assert np.array_equal(one.random(3), Streams(3).generator("noise", "a", step=1).random(3))


def test_numbers_are_the_same_in_every_process() -> None:
    numbers = Streams(2023).uniforms("noise", "C0", "vessel1", first=12, count=1, width=2)
    assert numbers.tolist() == REFERENCE


REFERENCE = [[0.7582095607512185, 0.7847842115921855]]


def test_uniforms_lie_in_the_unit_interval_and_have_its_mean() -> None:
    numbers = Streams(1).uniforms("noise", first=0, count=50_000, width=2)
    assert numbers.shape == (50_000, 2)
    assert numbers.min() >= 0
    assert numbers.max() < 1
    assert abs(numbers.mean() - 0.5) < 4 / np.sqrt(12 * numbers.size)


def test_no_steps_give_no_numbers() -> None:
    assert Streams(1).uniforms("noise", first=5, count=0, width=3).shape == (0, 3)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        Streams(-1)
