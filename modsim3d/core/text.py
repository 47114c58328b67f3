"""Texts: numbers in them, and how results show themselves, in a few words or a small table of HTML."""

import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from math import isfinite

MAX_NAMES = 6
UNKNOWN = "–"  # what stands for a number that is not known
_START = re.compile(r"[±+−-]? ?(?!\d+\.\d+\.\d|\d+\. )(\d|∞)")
"""How a number begins; a version with two points is none, and neither is an ordinal."""
_CHECKSUM = re.compile(r"[0-9a-f]{32,}")
_MAX_WORDS = 3


def number_in(text: object) -> float:
    """The finite number that a text is, NaN if it is none."""
    try:
        number = float(str(text))
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def column_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with named columns, or with a name before each row if there is no header, under a title."""
    head = f"<thead><tr>{''.join(_cell('th', name) for name in header)}</tr></thead>" if header else ""
    first = "td" if header else "th"
    body = "".join(
        f"<tr>{''.join(_cell('td' if place else first, cell) for place, cell in enumerate(row))}</tr>" for row in rows
    )
    if header:
        body = f"<tbody>{body}</tbody>"
    return f'<table><caption style="text-align:left"><b>{escape(title)}</b></caption>{head}{body}</table>'


def _cell(kind: str, text: str) -> str:
    return f'<{kind} style="text-align:left">{escape(text)}</{kind}>'


def listed(names: Sequence[str], most: int = MAX_NAMES) -> str:
    """Names with commas; of many only the first."""
    shown = ", ".join(names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown


def counted(number: int, one: str, many: str | None = None) -> str:
    """A number with its noun in the singular or plural, such as `1 camera`."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def is_number(cell: str) -> bool:
    """Whether a cell of a table is a number, with a unit, an interval or a few words."""
    if _START.match(cell) is None or _CHECKSUM.search(cell):
        return False
    return len(re.findall(r"[^\W\d_]{2,}", cell)) <= _MAX_WORDS


def with_minus(cell: str) -> str:
    """A cell of a table with the minus sign in place of the hyphen before its numbers."""
    return re.sub(r"(?<![\w.])-(?=\d)", "−", cell) if is_number(cell) else cell


def is_numeric(column: Sequence[str]) -> bool:
    """Whether at least half of the known cells of a column are numbers."""
    cells = [cell for cell in column if cell not in (UNKNOWN, "")]
    return bool(cells) and 2 * sum(map(is_number, cells)) >= len(cells)


def number(value: float | None, decimals: int = 3) -> str:
    """A number with its decimals; a dash where it is not known."""
    if value is None or value != value:
        return UNKNOWN
    return f"{value:,.{decimals}f}".replace("-", "−").replace("inf", "∞")


def significant(value: float, digits: int = 4) -> str:
    """A number with so many digits, a whole one as it is."""
    if not isfinite(value) or float(value).is_integer():
        return number(value, 0)
    return f"{value:#.{digits}g}".rstrip(".").replace("-", "−")


def with_interval(value: float | None, low: float | None, high: float | None, decimals: int = 3) -> str:
    """A number with its interval; the number alone where an end is not known."""
    ends = [number(end, decimals) for end in (low, high)]
    known = value is not None and not {UNKNOWN, "∞", "−∞"} & set(ends)
    return number(value, decimals) + (f" [{ends[0]}, {ends[1]}]" if known else "")


def in_percent(share: float, decimals: int = 0) -> str:
    """A share in percent."""
    return f"{100 * share:.{decimals}f} %"


def percent_of(part: float, whole: float) -> str:
    """A share in percent with one decimal; a dash of nothing."""
    return in_percent(part / whole, 1) if whole else UNKNOWN


def duration_text(seconds: float) -> str:
    """A time in seconds, minutes, hours or days."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    if seconds < 7200:
        return f"{seconds / 60:.1f} minutes"
    return f"{seconds / 3600:.1f} hours" if seconds < 48 * 3600 else f"{seconds / 86400:,.1f} days"


def three_digits(value: float | None) -> str:
    """A number with three digits or three decimals, a whole one as it is; a dash where it is not known."""
    if value is None or not isfinite(value) or float(value).is_integer():
        return number(value, 0)
    return _with_decimals(value, _decimals(value))


def three_digits_with_interval(value: float | None, low: float | None, high: float | None) -> str:
    """A number with its interval; the number alone where there is no interval."""
    if value is None or not isfinite(value):
        return three_digits(value)
    if low is None or high is None or not (isfinite(low) and isfinite(high)):
        return _with_decimals(value, _decimals(value))
    text, *ends = (_with_decimals(figure, _decimals(value)) for figure in (value, low, high))
    return f"{text} [{ends[0]}, {ends[1]}]"


def _decimals(value: float) -> int:
    return max(0, 3 - len(f"{abs(value):.0f}")) if abs(value) >= 1 else 3


def _with_decimals(value: float, decimals: int) -> str:
    text = number(value, decimals)
    return f"{value:.2g}".replace("-", "−") if value and not text.strip("−0.") else text
