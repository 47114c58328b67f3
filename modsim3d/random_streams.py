"""Random numbers that belong to a purpose, names and a step, not to the order they are asked for in."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array

_NUMBERS_PER_BLOCK = 4  # one value of Philox4x64's counter gives four 64-bit numbers
_UNIFORMS, _GENERATOR = 0, 1  # apart in the key: the two ways of counting steps would run into each other


def _words(text: str) -> tuple[int, int]:
    """Two 32-bit words that are the same for this text in every process, unlike `hash`."""
    digest = hashlib.blake2b(text.encode("utf-8"), digest_size=8).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:], "little")


class Streams:
    """All random numbers of a run, made from one seed.

    A stream is keyed by a purpose and by names (a camera, a vessel); within it a step has its own range of
    the counter of Philox (Salmon et al. (2011), "Parallel random numbers: as easy as 1, 2, 3"). So the noise
    of a vessel at a step does not depend on which others are seen, on how the steps are split, or on who
    asks first. Not to be shared between threads.

    Attributes:
        seed: What everything follows from.
    """

    def __init__(self, seed: int) -> None:
        """Start from a seed.

        Raises:
            ValueError: The seed is negative.
        """
        self.seed = seed
        self._root = np.random.SeedSequence(seed)
        self._keys: dict[tuple[int, str, tuple[str, ...]], NDArray[np.uint64]] = {}
        self._scratch = np.random.Philox(self._root)
        self._scratch_generator = np.random.Generator(self._scratch)

    def uniforms(self, purpose: str, *names: str, first: int, count: int, width: int = 1) -> Array:
        """Uniform numbers for consecutive steps; ask for one width only under one purpose.

        Args:
            purpose: What they are for.
            *names: Whose they are.
            first: First step.
            count: Number of steps.
            width: Numbers a step.

        Returns:
            Numbers in [0, 1), shape (count, width); row k is for step `first + k` however steps are split.
        """
        blocks = -(-width // _NUMBERS_PER_BLOCK)
        self._scratch.state = self._state(_UNIFORMS, purpose, names, counter=first * blocks)
        return self._scratch_generator.random((count, blocks * _NUMBERS_PER_BLOCK))[:, :width]

    def generator(self, purpose: str, *names: str, step: int) -> np.random.Generator:
        """A generator of its own for one step, for draws whose number is not known beforehand."""
        bits = np.random.Philox(self._root)
        bits.state = self._state(_GENERATOR, purpose, names, counter=step << 192)
        return np.random.Generator(bits)

    def _state(self, kind: int, purpose: str, names: tuple[str, ...], counter: int) -> Any:
        """Philox at a counter. `Philox(key=..., counter=...)` does the same, but gathers entropy first."""
        words = [(counter >> shift) & 0xFFFF_FFFF_FFFF_FFFF for shift in (0, 64, 128, 192)]
        return {
            "bit_generator": "Philox",
            "state": {"counter": np.array(words, dtype=np.uint64), "key": self._key(kind, purpose, names)},
            "buffer": np.zeros(_NUMBERS_PER_BLOCK, dtype=np.uint64),
            "buffer_pos": _NUMBERS_PER_BLOCK,
            "has_uint32": 0,
            "uinteger": 0,
        }

    def _key(self, kind: int, purpose: str, names: tuple[str, ...]) -> NDArray[np.uint64]:
        stream = (kind, purpose, names)
        if stream not in self._keys:
            spawn_key = (kind, *_words(purpose), *(word for name in names for word in _words(name)))
            sequence = np.random.SeedSequence(self.seed, spawn_key=spawn_key)
            self._keys[stream] = sequence.generate_state(2, np.uint64).astype(np.uint64)
        return self._keys[stream]
