"""The latest things that were made, kept in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Latest(Generic[T]):
    """The last few things by their keys."""

    def __init__(self, most: int) -> None:
        """Keep so many."""
        self._most = most
        self._kept: dict[str, T] = {}

    def get(self, key: str, make: Callable[[], T]) -> T:
        """What the key stands for, made if it is not there."""
        found = self._kept.pop(key) if key in self._kept else make()
        self._kept[key] = found  # the last one from now on
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return found
