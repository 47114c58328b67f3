"""Times in logs: seconds, or UTC as text or as Unix time."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime

LEAST_UNIX_S = 1e8
"""A number of seconds from here on, March 1973, is Unix time: no scene lasts three years."""
MOST_S = 1e11
MIXED = "some times are UTC and others are not (from 1e8 on, seconds are Unix time; are these nanoseconds?)"
TIME_FORM = "2024-01-04T10:00:00.250Z"
"""A time as messages show it."""
_EXIF_DAY = re.compile(r"(\d{4}):(\d\d):(\d\d)(?= )")
"""As cameras write a date into their images: 2024:01:04 10:00:00."""


def utc_s(text: str) -> float:
    """Unix time from a date and time of ISO 8601 or EXIF, NaN if it is none; without a zone it is UTC."""
    try:
        when = datetime.fromisoformat(_EXIF_DAY.sub(r"\1-\2-\3", text.strip().replace("/", "-"), count=1))
        return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return math.nan


def seconds(text: str) -> float:
    """A finite number of seconds, NaN if the text is none."""
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if abs(number) <= MOST_S else math.nan


def time_of(value: object) -> tuple[float, bool]:
    """The time that a number or a text stands for, NaN if none, and whether it is UTC, as Unix time."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan, False
    number = seconds(str(value))
    if math.isnan(number):
        return (utc_s(value), True) if isinstance(value, str) else (math.nan, False)
    return number, number >= LEAST_UNIX_S


def all_utc(utc: Sequence[bool]) -> bool | None:
    """Whether all times are UTC; None if some are and others are not."""
    return None if any(utc) and not all(utc) else any(utc)
