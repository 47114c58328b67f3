"""The time beside an AIS sentence, which carries none of its own.

Many numbers stand there: identities of ships (MMSI), of stations, and times in other forms. One of them is a Unix time
if it has ten digits before the point (13 in milliseconds, 16 in microseconds) and is from 2003, before which there are
no logs of AIS, to tomorrow. Nine digits are those of identities. Dates have the year first or, with points or hyphens,
last; without a zone they are UTC. Days and months with slashes are not read, because nobody can tell which is first,
and neither are local times such as 3 PM, CET or [Europe/Oslo]: a date has no word after it but a few of loggers.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from datetime import datetime

_UNIX = r"[1-9](?:\d{15}|\d{12}|\d{9}(?:\.\d+)?)"
_ALONE = re.compile(rf"(?<![\w.:+-])({_UNIX})(?![\w.:])")
_NAME = r"\b(?:toa|(?:rx)?(?:ux)?time(?:stamp)?)\"?\s*[:=]\s*\"?"
_NAMED = re.compile(rf"{_NAME}({_UNIX})(?![\w.:])", re.IGNORECASE)
_NAME_BEFORE = re.compile(rf"{_NAME}$", re.IGNORECASE)
_TAG = re.compile(r"(?:^|,)c:(\d+(?:\.\d+)?)(?:,|$)")
_ZONE = r"(?:\s?((?i:Z|UTC|GMT)|[+-]\d\d:?\d\d)|([+-]\d\d))?"
_NO_WORD = r"(?![\w.:]|\s?[+-]\d|\s?[\[(]?(?!(?:AIS|NMEA|UDP|TCP|DEBUG|INFO)\b)[A-Za-z])"
_CLOCK = rf"(\d\d)(:?)(\d\d)\6((?:[0-5]\d|60)(?:\.\d+)?){_ZONE}{_NO_WORD}"
_YEAR_FIRST = re.compile(rf"(?<![\w.])(\d{{4}})([-/.]?)(\d\d)\2(\d\d)(?:[T _]|, ?)?{_CLOCK}")
_YEAR_LAST = re.compile(rf"(?<![\w.])(\d\d)([-.])(\d\d)\2(\d{{4}})(?:[T _]|, ?){_CLOCK}")
_FIRST_S, _FIRST_LOG_S, _LAST_S, _DAY_S = 631_152_000.0, 1_041_379_200.0, 4_102_444_800.0, 86400.0
"""1990, 2003, and 2100."""


def time_beside(tag: str | None, before: str, after: str) -> float | None:
    """Unix time that a tag block or the text around a sentence has; None if neither has one.

    What has a name such as `toa` or `rxtime` comes first, then dates. Of several Unix times the first before the
    sentence counts, or the last after it; none where they are more than a day apart, for one is something else.
    """
    if tag and (found := _TAG.search(tag)) and _FIRST_S <= (said_s := _unix_s(found[1])) < _LAST_S:
        return said_s
    text = f"{before}|{after}"
    if said := [*_times(_NAMED.findall(text)), *(value for *_, value in sorted(_dates(text)))]:
        return said[0]
    alone = _times([*reversed(_ALONE.findall(after)), *_ALONE.findall(before)])
    return alone[0] if alone and max(alone) - min(alone) <= _DAY_S else None


def _times(numbers: list[str]) -> list[float]:
    """Unix times among some that a log of AIS can have."""
    return [value for value in map(_unix_s, numbers) if _FIRST_LOG_S <= value < time.time() + _DAY_S]


def _unix_s(text: str) -> float:
    """Seconds of a Unix time, of which 13 digits are milliseconds, 16 microseconds and 19 nanoseconds."""
    digits = len(text.partition(".")[0])
    return float(text) / 10 ** (digits - 10) if digits in (13, 16, 19) else float(text)


def _dates(text: str) -> Iterator[tuple[bool, int, float]]:
    """The dates with times in a text: whether they have no name, their place, and the Unix time."""
    for pattern, order in ((_YEAR_FIRST, (1, 3, 4)), (_YEAR_LAST, (4, 3, 1))):
        for found in pattern.finditer(text):
            zone = found[9] if found[9] and found[9][0] in "+-" else found[10] or "Z"
            try:
                minute = datetime.fromisoformat(f"{'-'.join(found[k] for k in order)}T{found[5]}:{found[7]}{zone}")
            except ValueError:
                continue
            value = minute.timestamp() + float(found[8])
            if _FIRST_S <= value < _LAST_S:
                yield _NAME_BEFORE.search(text, 0, found.start()) is None, found.start(), value
