"""Reason why a text is not what it is read as: other separators, shortened identities, times in another unit."""

import re
from collections.abc import Iterable

import numpy as np

from modsim3d.core.arrays import Array

SCIENTIFIC = r"^\s*([0-9]+(?:[.,][0-9]*)?)[eE]\+?([0-9]+)\s*$"
LOST = "is a number in scientific notation that has lost digits: write identities as text, or as whole numbers"
ROUNDED = "are all numbers that single precision can hold: digits were lost, write identities as whole numbers"
_FIRST_ROUNDED, _LAST_ROUNDED, _FEW_ROUNDED = 2**24, 2**53, 4
"""Smaller numbers are exact, larger ones are no MMSI; so many are all held by chance in one of 65,000 files of MMSI."""
_MAX_DIGITS = 15  # no identity has more; readers refuse larger numbers
_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_MIN_COVERED, _SLACK = 0.1, 1.05  # shares of the span that the last time reaches in the right unit


def no_commas(first_line: str) -> str:
    """Reason why the first line of a table has no commas in it, to be added to a message; empty if it has."""
    if first_line.strip().lower().startswith("sep="):
        return ": line 1 is for spreadsheets alone, leave it out"
    marks = {";": "semicolons", "\t": "tabs", "|": "bars"}
    words = [word for mark, word in marks.items() if first_line.count(mark) > first_line.count(",")]
    points = ", and points in numbers" * bool(re.search("[0-9],[0-9]", first_line))
    return f": its cells have {words[0]} between them, must have commas{points}" if words else ""


def has_lost_digits(identity: str) -> bool:
    """Whether an identity is a number with fewer digits than it stands for, such as 2.19E+08 of a spreadsheet."""
    match = re.match(SCIENTIFIC, identity)
    return match is not None and sum(map(str.isdigit, match[1])) <= float(match[2]) <= _MAX_DIGITS


def are_rounded(identities: Iterable[object]) -> bool:
    """Whether the whole numbers among identities went through single precision. MMSI that end in 000 tell nothing."""
    whole = (number for number in identities if isinstance(number, int) and number % 1000)
    large = {number for number in whole if _FIRST_ROUNDED <= number < _LAST_ROUNDED}
    return len(large) >= _FEW_ROUNDED and all(int(np.float32(number)) == number for number in large)


def other_unit(times_s: Array, length_s: float) -> str:
    """Addition to a message on times, shape (n,), that leave a span from 0 to a length; empty if no unit fits."""
    last = float(np.max(times_s, initial=0.0))
    for name, count in _UNITS.items():
        if last > _SLACK * length_s and _MIN_COVERED * length_s <= last / count <= _SLACK * length_s:
            return f": they seem to be {name}, must be seconds"
    return ""
