"""Philox4x64-10 for many keys and counters at once, and the keys: what NumPy's generators and seeds give one by one.

Salmon et al. (2011), "Parallel random numbers: as easy as 1, 2, 3", section 3.3. A pair of rows holds what the paper
has in two variables: words 0 and 2 of the counter are multiplied, words 1 and 3 are not.

NumPy makes keys with a hash of 32-bit words (O'Neill (2015), "Developing a seed_seq alternative"): the first words go
into a pool, whose words are mixed with each other and with every word that follows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array

Words = NDArray[np.uint64]
HalfWords = NDArray[np.uint32]
NUMBERS_PER_BLOCK = 4
"""One value of the counter gives four 64-bit numbers."""
_ROUNDS = 10
_FACTORS = np.array([[0xD2E7470EE14C6C93], [0xCA5A826395121157]], dtype=np.uint64)
_KEY_STEPS = np.array([[0x9E3779B97F4A7C15], [0xBB67AE8584CAA73B]], dtype=np.uint64)
_HALF, _LOW = np.uint64(32), np.uint64(0xFFFF_FFFF)
_HIGH_FACTORS, _LOW_FACTORS = _FACTORS >> _HALF, _FACTORS & _LOW
_POOL = 4
_HASH, _HASH_FACTOR = 0x43B0D7E5, 0x931E8875
_KEY_HASH, _KEY_HASH_FACTOR = 0x8B51F9DD, 0x58F38DED
_MIX_FACTOR, _MIX_OTHER_FACTOR = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_MIX_SHIFT = np.uint32(16)
_BITS_BELOW_A_DOUBLE, _DOUBLE_STEP = np.uint64(11), np.float64(2**-53)


def philox(keys: Words, counters: Words) -> Words:
    """The four words of each of n blocks, in the generator's order.

    Args:
        keys: Shape (2, n).
        counters: Words 0 to 3, the least first, shape (4, n). NumPy's generator counts up before its first block.

    Returns:
        Shape (4, n).
    """
    multiplied, others = counters[::2], counters[1::2]
    for _ in range(_ROUNDS):
        # The high word of a product of 64-bit words, from products of their halves.
        high, low = multiplied >> _HALF, multiplied & _LOW
        middle = high * _LOW_FACTORS + ((low * _LOW_FACTORS) >> _HALF)
        carried = (low * _HIGH_FACTORS + (middle & _LOW)) >> _HALF
        high_words = high * _HIGH_FACTORS + (middle >> _HALF) + carried
        multiplied, others = high_words[::-1] ^ others ^ keys, (multiplied * _FACTORS)[::-1]
        keys = keys + _KEY_STEPS
    return np.stack([multiplied, others], axis=1).reshape(4, -1)


def uniforms(keys: Words, low: Words, high: Words, first: int, count: int) -> Array:
    """Uniform numbers in [0, 1) that `np.random.Generator(np.random.Philox(...)).random` gives, shape (n, count).

    Args:
        keys: Key of each of n generators, shape (n, 2).
        low: Word 0 of the counter at which each starts; it must not overflow, shape (n,).
        high: Word 3, shape (n,); words 1 and 2 are 0.
        first: How many numbers of each are left out.
        count: How many numbers of each are given.
    """
    skipped, stop = first // NUMBERS_PER_BLOCK, -(-(first + count) // NUMBERS_PER_BLOCK)
    blocks = stop - skipped
    counters = np.zeros((4, len(keys) * blocks), dtype=np.uint64)
    counters[0] = (low[:, None] + np.arange(skipped + 1, stop + 1, dtype=np.uint64)).ravel()
    counters[3] = np.repeat(high, blocks)
    words = philox(np.repeat(keys.T, blocks, axis=1), counters).T.reshape(len(keys), blocks * NUMBERS_PER_BLOCK)
    start = first - skipped * NUMBERS_PER_BLOCK
    result: Array = (words[:, start : start + count] >> _BITS_BELOW_A_DOUBLE) * _DOUBLE_STEP
    return result


def seeded_keys(seed: int, spawn_keys: HalfWords) -> Words:
    """Keys that `np.random.SeedSequence(seed, spawn_key=...).generate_state(2, np.uint64)` gives, shape (n, 2).

    Args:
        seed: Not negative.
        spawn_keys: The w words of each of n spawn keys, shape (w, n).
    """
    count = max(_POOL, -(-seed.bit_length() // 32))
    of_seed = np.array([seed >> 32 * place & 0xFFFF_FFFF for place in range(count)], dtype=np.uint32)[:, None]
    constants = _hash_constants(_HASH, _HASH_FACTOR, _POOL * (count + len(spawn_keys)))
    pool, used = _hashed(of_seed[:_POOL], constants[: _POOL + 1]), _POOL
    for source in range(_POOL):
        others = np.arange(_POOL) != source
        pool[others] = _mixed(pool[others], _hashed(pool[source], constants[used : used + _POOL]))
        used += _POOL - 1
    for word in (*of_seed[_POOL:], *spawn_keys):
        pool = _mixed(pool, _hashed(word, constants[used : used + _POOL + 1]))
        used += _POOL
    halves = _hashed(pool, _hash_constants(_KEY_HASH, _KEY_HASH_FACTOR, _POOL)).astype(np.uint64)
    return (halves[::2] | halves[1::2] << _HALF).T.copy()


def _hash_constants(first: int, factor: int, count: int) -> HalfWords:
    """A geometric series of 32-bit words, shape (count + 1, 1)."""
    constants = [first]
    for _ in range(count):
        constants.append(constants[-1] * factor & 0xFFFF_FFFF)
    return np.array(constants, dtype=np.uint32)[:, None]


def _hashed(words: HalfWords, constants: HalfWords) -> HalfWords:
    """Words of shape (n,) or (k, n), hashed with each pair of neighbours of k + 1 constants, shape (k, n)."""
    hashed: HalfWords = (words ^ constants[:-1]) * constants[1:]
    return hashed ^ hashed >> _MIX_SHIFT


def _mixed(words: HalfWords, others: HalfWords) -> HalfWords:
    """Two words made one, same shapes."""
    mixed: HalfWords = words * _MIX_FACTOR - others * _MIX_OTHER_FACTOR
    return mixed ^ mixed >> _MIX_SHIFT
