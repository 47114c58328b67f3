"""Confidences as files have them: from 0 to 1, on another scale, or not given."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import Problems, is_number
from modsim3d.inputs.validation import shown

NOT_GIVEN = -1
"""What stands for a confidence that is not given, as MOT has it."""
Scale = tuple[float, float]
_PERCENT, _MANY = 100, 8


@dataclass(frozen=True)
class Confidences:
    """How the confidences of one file are read.

    Attributes:
        name: What the file calls a confidence.
        low: What becomes 0.
        high: What becomes 1.
        given: Whether the file gives confidences.
        example: Place and value of one that is given; of use where others are not.
        ones: Their number if all are 1, and many; else 0.
    """

    name: str
    low: float
    high: float
    given: bool
    example: str
    ones: int = 0

    @classmethod
    def of(
        cls, values: Iterable[tuple[str, Any]], scale: Scale | None, problems: Problems, name: str = "confidence"
    ) -> Confidences:
        """How to read these values, each with its place in the file; a hint if they are on another scale.

        Raises:
            InputError: None is given, and they are to be scaled.
        """
        low, high = scale or (0.0, 1.0)
        rows = [(where, float(value)) for where, value in values if is_number(value)]
        known = [(where, value) for where, value in rows if value != NOT_GIVEN]
        if rows and not known and scale:
            raise InputError(problems.source, [f"--confidence-scale: every {name} is -1, which means not given"])
        if known and not all(low <= value <= high for _, value in known):
            found = [value for _, value in rows]
            problems.hint = problems.hint or _hint(min(found), max(found), name)
            if all(value == int(value) for value in found):
                problems.hint = f"whole numbers may be tracks or classes, not {name}s; if not so, {problems.hint}"
        inside = next((f"{where} has {value:g}" for where, value in known if low <= value <= high), "")
        whole = all(low <= value <= high for _, value in known)
        ones = len(known) if all(value == 1 for _, value in known) and len(known) >= _MANY and scale is None else 0
        return cls(name, low, high, bool(known) or not rows, inside if whole else "", ones)

    @property
    def notes(self) -> list[str]:
        """A remark if they are scaled, or may be something else."""
        if self.ones:
            return [f"all {self.ones:,} {self.name}s are 1: if that is the number of a track, {self.name}s are missing"]
        if (self.low, self.high) == (0, 1):
            return []
        return [f"{self.name}s from {self.low:g} to {self.high:g} were mapped onto 0 to 1 (--confidence-scale)"]

    def read(self, value: Any, where: str, problems: Problems) -> float | None:
        """A confidence from 0 to 1, NaN where the file gives none; None with a problem if it is wrong."""
        if value == NOT_GIVEN and not self.given:
            return math.nan
        if is_number(value, self.low, self.high):
            return (value - self.low) / (self.high - self.low)
        if value == NOT_GIVEN and self.example:
            problems.add(f"{where}: has no {self.name} (-1), but {self.example}: give one everywhere, or nowhere")
        else:
            got = f"{value:g}" if is_number(value) else shown(value)
            problems.add(f"{where}: {self.name} must be from {self.low:g} to {self.high:g} (got {got})")
        return None


def _hint(least: float, most: float, name: str) -> str:
    """What to do about values from least to most that are not from 0 to 1."""
    low, high = math.floor(least * 100) / 100, math.ceil(most * 100) / 100
    if least >= 0 and 10 < most <= _PERCENT:
        low, high = 0, _PERCENT
    return (
        f"{name}s are from {least:g} to {most:g} here: --confidence-scale LOW,HIGH maps LOW to 0 and HIGH to 1, as in "
        f"--confidence-scale {low:.10g},{high:.10g}"
    )
