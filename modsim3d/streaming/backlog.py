"""The lines of a stream that are kept for readers who are slow, late or back again."""

from __future__ import annotations

from collections import deque


class Backlog:
    """The latest chunks of a stream, counted from the stream's beginning; old ones make room for new ones.

    Attributes:
        first: Number of the oldest chunk that is kept.
    """

    def __init__(self, most_bytes: int) -> None:
        """Start empty. `most_bytes` is kept at most, or a single chunk that is larger."""
        self.first = 0
        self._chunks: deque[bytes] = deque()
        self._most, self._bytes = most_bytes, 0

    @property
    def stop(self) -> int:
        """The number that the next chunk gets."""
        return self.first + len(self._chunks)

    def drops(self, chunk: bytes) -> int:
        """How many of the oldest chunks must go before a chunk fits."""
        excess, count = self._bytes + len(chunk) - self._most, 0
        for kept in self._chunks:
            if excess <= 0:
                break
            excess, count = excess - len(kept), count + 1
        return count

    def append(self, chunk: bytes) -> None:
        """Keep a chunk, and drop the oldest ones that it leaves no room for."""
        for _ in range(self.drops(chunk)):
            self._bytes -= len(self._chunks.popleft())
            self.first += 1
        self._chunks.append(chunk)
        self._bytes += len(chunk)

    def from_number(self, number: int, least_bytes: int) -> tuple[bytes, int]:
        """Chunks from a number that is kept, joined, and the number after them; as many as reach `least_bytes`."""
        taken, size = [], 0
        while number < self.stop and size < least_bytes:
            taken.append(self._chunks[number - self.first])
            size += len(taken[-1])
            number += 1
        return b"".join(taken), number
