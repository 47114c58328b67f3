"""Stretches of time in which a user knows that the sea is empty, as given to `--empty`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError
from modsim3d.inputs.validation import shown

_SECONDS = re.compile(r"([0-9]+(?:\.[0-9]*)?)-([0-9]+(?:\.[0-9]*)?)")
_FORM = (
    "must be FROM-TO in seconds since the scene's first step, such as 120-300, or two UTC times, such as "
    "2024-01-04T10:02:00Z/2024-01-04T10:05:00Z"
)


@dataclass(frozen=True)
class Stretch:
    """From one time to another, both in seconds since the scene's first step."""

    first_s: float
    last_s: float

    def __str__(self) -> str:
        """As it is given."""
        return f"{self.first_s:g}-{self.last_s:g}"


def parse_stretches(text: str, start_s: float | None) -> tuple[Stretch, ...]:
    """Stretches from a text such as `120-300,900-1000`, or with UTC times and a slash between them.

    Args:
        text: What was given to `--empty`.
        start_s: Unix time of the scene's first step; None if the scene does not say.

    Raises:
        InputError: A part has another form, ends before it begins, or is in UTC and the scene does not say when it is.
    """
    stretches, problems = [], []
    for part in (each.strip() for each in text.split(",")):
        found = _stretch(part, start_s)
        if isinstance(found, str):
            problems.append(found)
        else:
            stretches.append(found)
    if problems:
        raise InputError("--empty", problems)
    return tuple(stretches)


def in_stretches(stretches: tuple[Stretch, ...], time_s: Array) -> Mask:
    """Which times (n,) lie in a stretch, its ends included, shape (n,)."""
    inside: Mask = np.zeros(len(time_s), dtype=bool)
    for each in stretches:
        inside |= (time_s >= each.first_s - 1e-9) & (time_s <= each.last_s + 1e-9)
    return inside


def _stretch(part: str, start_s: float | None) -> Stretch | str:
    """A stretch, or what is wrong with it."""
    if "/" in part:
        ends = [_utc_s(each) for each in part.split("/")]
        if len(ends) != 2 or any(math.isnan(each) for each in ends):
            return f"{_FORM} (got {shown(part)})"
        if start_s is None:
            return f"{part}: is in UTC, and the scene does not say when it starts: give seconds since its first step"
        first_s, last_s = (each - start_s for each in ends)
    else:
        found = _SECONDS.fullmatch(part)
        if found is None:
            return f"{_FORM} (got {shown(part)})"
        first_s, last_s = (float(each) for each in found.groups())
    return Stretch(first_s, last_s) if first_s < last_s else f"{part}: must end after it begins"


def _utc_s(text: str) -> float:
    """Unix time of a date and time, NaN if the text is none; without a zone it is UTC."""
    try:
        when = datetime.fromisoformat(text.strip())
    except ValueError:
        return math.nan
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
