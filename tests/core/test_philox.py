from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.core import random_streams

WORD, HALF_WORD = st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1)


def generator(key: tuple[int, int], low: int, high: int) -> np.random.Generator:
    """NumPy's own generator at a counter."""
    return np.random.Generator(np.random.Philox(key=np.array(key, dtype=np.uint64), counter=low + (high << 192)))


@given(st.lists(st.tuples(st.tuples(WORD, WORD), st.tuples(WORD, WORD, WORD, WORD)), min_size=1, max_size=9))
def test_blocks_are_those_of_numpy(drawn: list[tuple[tuple[int, int], tuple[int, int, int, int]]]) -> None:
    keys, counters = (np.array(part, dtype=np.uint64) for part in zip(*drawn, strict=True))
    blocks = random_streams.philox(keys.T, counters.T)
    for (key, words), block in zip(drawn, blocks.T, strict=True):
        before = (sum(word << (64 * place) for place, word in enumerate(words)) - 1) % 2**256
        numpys = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=before)
        assert block.tolist() == numpys.random_raw(4).tolist()


@given(
    st.lists(st.tuples(st.tuples(WORD, WORD), st.integers(0, 2**62), st.integers(0, 2**62)), min_size=1, max_size=5),
    st.integers(0, 30),
    st.integers(0, 30),
)
def test_numbers_are_those_of_numpy(drawn: list[tuple[tuple[int, int], int, int]], first: int, count: int) -> None:
    keys, low, high = (np.array(part, dtype=np.uint64) for part in zip(*drawn, strict=True))
    numpys = [generator(*each).random(first + count)[first:] for each in drawn]
    assert np.array_equal(random_streams.uniforms(keys, low, high, first, count), numpys)


@given(
    st.integers(0, 2**200),
    st.integers(1, 9).flatmap(lambda width: st.lists(st.tuples(*[HALF_WORD] * width), min_size=1, max_size=4)),
)
def test_seeded_keys_are_those_of_numpy(seed: int, spawn_keys: list[tuple[int, ...]]) -> None:
    ours = random_streams.seeded_keys(seed, np.array(spawn_keys, dtype=np.uint32).T)
    numpys = [np.random.SeedSequence(seed, spawn_key=key).generate_state(2, np.uint64) for key in spawn_keys]
    np.testing.assert_array_equal(ours, numpys)
