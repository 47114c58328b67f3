"""The times of a run's shown steps for its player: differences of whole numbers, however long the run is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from modsim3d.view.report.recording.packing import ROW_BEFORE, Coded, Columns

_DECIMAL = re.compile(r"(-?)(\d+)\.(\d+)")
LONGEST_DIFFERENCE = 2**31
MOST_DIGITS = 15
"""Whole numbers up to here are exact in the browser."""


def clock(timestamps: Sequence[str]) -> tuple[dict[str, Any], Columns]:
    """Facts and columns from which the player has the texts of the steps' times; see `said`.

    Texts that are not plain decimals in their shortest form are stored as they are.
    """
    decimals = max((len(text.partition(".")[2]) for text in timestamps), default=0)
    if all(map(_DECIMAL.fullmatch, timestamps)):
        units = [_in_units(text, decimals) for text in timestamps]
        differences = np.diff(units, prepend=units[0])
        exact = max(map(abs, units)) < 10**MOST_DIGITS and np.abs(differences).max(initial=0) < LONGEST_DIFFERENCE
        if exact and all(said(unit, decimals) == text for unit, text in zip(units, timestamps, strict=True)):
            facts = {"decimals": decimals, "first": units[0]}
            return facts, {"clock": Coded(differences.astype(np.int32), by=ROW_BEFORE)}
    return {}, {"clockTexts": np.frombuffer("\n".join(timestamps).encode("utf-8"), np.uint8)}


def _in_units(text: str, decimals: int) -> int:
    whole, _, part = text.partition(".")
    return int(whole + part.ljust(decimals, "0"))


def said(units: int, decimals: int) -> str:
    """A time in units of its last decimal as text, in its shortest form with at least one decimal."""
    digits = f"{abs(units):0{decimals + 1}d}"
    whole, part = digits[: len(digits) - decimals], digits[len(digits) - decimals :]
    return f"{'-' if units < 0 else ''}{whole}.{part.rstrip('0') or '0'}"
