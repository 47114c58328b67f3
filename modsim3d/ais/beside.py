"""The time beside an AIS sentence, which carries none of its own.

Many numbers stand there: identities of ships (MMSI), of stations, and times in other forms. One of them is a Unix time
if it has ten digits before the point (13 in milliseconds, 16 in microseconds), does not begin with 0 and is not in the
future. Nine digits are those of identities, and of Unix times before September 2001, of which there are no logs of AIS.
Dates have the year first or, with points or hyphens, last; without a zone they are UTC. Days and months with slashes
are not read, because nobody can tell which is first, and neither are local times such as 3 PM or CET.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from datetime import UTC, datetime

_UNIX = r"[1-9](?:\d{15}|\d{12}|\d{9}(?:\.\d+)?)"
_ALONE = re.compile(rf"(?<![\w.:+-])({_UNIX})(?![\w.:])")
_NAMED = re.compile(rf"\b(?:toa|rxuxtime|timestamp|time)\"?\s*[:=]\s*\"?({_UNIX})(?![\w.:])", re.IGNORECASE)
_TAG = re.compile(r"(?:^|,)c:(\d+(?:\.\d+)?)(?:,|$)")
_CLOCK = r"(\d\d)(:?)(\d\d)\6(\d\d(?:\.\d+)?)\s?(Z|UTC|GMT|[+-]\d\d:?\d\d)?(?![\w.:]|\s?(?:[AaPp][Mm]|[A-Z]{1,3}T)\b)"
_YEAR_FIRST = re.compile(rf"(?<![\w.])(\d{{4}})([-/.]?)(\d\d)\2(\d\d)(?:[T _]|, ?)?{_CLOCK}")
_YEAR_LAST = re.compile(rf"(?<![\w.])(\d\d)([-.])(\d\d)\2(\d{{4}})(?:[T _]|, ?){_CLOCK}")
_FIRST_S, _LAST_S, _DAY_S = datetime(1990, 1, 1, tzinfo=UTC).timestamp(), 4_102_444_800.0, 86400.0
"""1990, and 2100."""


def time_beside(tag: str | None, before: str, after: str) -> float | None:
    """Unix time that a tag block or the text around a sentence has; None if neither has one.

    Of several Unix times the first before the sentence counts, or the last after it.
    """
    if tag and (found := _TAG.search(tag)):
        said_s = _unix_s(found[1])
        return said_s if _FIRST_S <= said_s < _LAST_S else None
    date_s = next(_dates(f"{before} {after}"), None)
    alone = [*reversed(_ALONE.findall(after)), *_ALONE.findall(before)] if date_s is None else []
    numbers = map(_unix_s, (*_NAMED.findall(f"{before} {after}"), *alone))
    return next((number for number in numbers if number < time.time() + _DAY_S), date_s)


def _unix_s(text: str) -> float:
    """Seconds of a Unix time, of which 13 digits are milliseconds, 16 microseconds and 19 nanoseconds."""
    digits = len(text.partition(".")[0])
    return float(text) / 10 ** (digits - 10) if digits in (13, 16, 19) else float(text)


def _dates(text: str) -> Iterator[float]:
    """The dates with times in a text, as Unix times."""
    for pattern, order in ((_YEAR_FIRST, (1, 3, 4)), (_YEAR_LAST, (4, 3, 1))):
        for found in pattern.finditer(text):
            zone = found[9] if found[9] and found[9][0] in "+-" else "Z"
            day = "-".join(found[place] for place in order)
            try:
                minute = datetime.fromisoformat(f"{day}T{found[5]}:{found[7]}{zone}")
            except ValueError:
                continue
            value = minute.timestamp() + float(found[8])
            if _FIRST_S <= value < _LAST_S:
                yield value
