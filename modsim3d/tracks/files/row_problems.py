"""What is wrong with the rows of a file of tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.arrays import Indices
from modsim3d.errors import InputError

_MOST = 10
"""Rows that are named; the others are counted."""


@dataclass
class RowProblems:
    """The wrong rows of a file, collected over the checks of one stage.

    Attributes:
        source: The file.
        line: Number of each row in the file, shape (k,).
        word: What a row is called in messages.
    """

    source: str
    line: Indices
    word: str = "line"
    _found: dict[int, str] = field(default_factory=dict)
    _wrong: set[int] = field(default_factory=set)

    def refuse(self, bad: ArrayLike, say: Callable[[int], str]) -> None:
        """Record wrong rows, shape (k,); `say` has the message for a row. Only the first problem of a row is kept."""
        rows = np.flatnonzero(bad)
        self._wrong.update(rows.tolist())
        for row in rows[:_MOST].tolist():
            self._found.setdefault(row, say(row))

    def settle(self) -> None:
        """End a stage.

        Raises:
            InputError: There are wrong rows.
        """
        if not self._wrong:
            return
        told = sorted(self._found)[:_MOST]
        lines = [f"{self.word} {self.line[row]}: {self._found[row]}" for row in told]
        if len(self._wrong) > len(told):
            lines.append(f"… and {len(self._wrong) - len(told):,} more {self.word}s")
        raise InputError(self.source, lines)
