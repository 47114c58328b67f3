"""Stretches of time in which a user knows that the sea is empty, as given to `--empty`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from modsim3d.ais.options import time_text
from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError
from modsim3d.inputs.validation import shown
from modsim3d.voyage.logs.times import LEAST_UNIX_S, utc_s

_SECONDS = re.compile(r"([0-9]+(?:\.[0-9]*)?)-([0-9]+(?:\.[0-9]*)?)")
_FORM = (
    "must be FROM-TO in seconds since the scene's first step, such as 120-300, or two UTC times, such as "
    "2024-01-04T10:02:00Z/2024-01-04T10:05:00Z"
)


@dataclass(frozen=True)
class Stretch:
    """From one time to another, both in seconds since the scene's first step.

    Attributes:
        start_s: Unix time of that step if the stretch was given in UTC, to show it so.
    """

    first_s: float
    last_s: float
    start_s: float | None = field(default=None, compare=False)

    def __str__(self) -> str:
        """As it is given."""
        if self.start_s is None:
            return f"{self.first_s:g}-{self.last_s:g}"
        return f"{self.when(self.first_s)}/{self.when(self.last_s)}"

    def when(self, time_s: float) -> str:
        """A time since the scene's first step, in words."""
        return f"{time_s:g} s" if self.start_s is None else time_text(self.start_s + time_s)


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


def check_stretches(stretches: tuple[Stretch, ...], time_s: Array, counts: Mask | None = None) -> None:
    """Refuse a stretch without frames.

    Args:
        stretches: The stretches.
        time_s: Times of all frames, at least one, shape (n,).
        counts: Which frames count; all if None, shape (n,).

    Raises:
        InputError: No frame that counts lies in a stretch.
    """
    for stretch in stretches:
        inside = in_stretches((stretch,), time_s)
        if not (inside if counts is None else inside & counts).any():
            low, high = (stretch.when(float(end)) for end in (np.nanmin(time_s), np.nanmax(time_s)))
            raise InputError("--empty", [f"{stretch}: no frame lies in it; they are from {low} to {high}"])


def _stretch(part: str, start_s: float | None) -> Stretch | str:
    """A stretch, or what is wrong with it."""
    seconds = _SECONDS.fullmatch(part)
    ends = [float(each) for each in seconds.groups()] if seconds else [utc_s(each) for each in part.split("/")]
    if len(ends) != 2 or any(math.isnan(each) for each in ends):
        return f"{_FORM} (got {shown(part)})"
    utc = not seconds or min(ends) >= LEAST_UNIX_S
    if utc and start_s is None:
        return f"{part}: is in UTC, and the scene does not say when it starts: give seconds since its first step"
    zero = start_s if utc and start_s is not None else 0.0
    first_s, last_s = (each - zero for each in ends)
    return Stretch(first_s, last_s, zero if utc else None) if first_s < last_s else f"{part}: must end after it begins"
