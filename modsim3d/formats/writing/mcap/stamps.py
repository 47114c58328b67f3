"""Times of steps in ROS's nanoseconds, from their texts, so that no digit is lost on the way."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN, Context, Decimal, InvalidOperation

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.errors import InputError

NANO = 1_000_000_000
MOST_S = 2**31 - 1
"""ROS keeps seconds in 32 bits with a sign, and a bag holds no negative times."""
_UNIT, _EXACT = Decimal("1e-9"), Context(prec=40)


def stamps_ns(timestamps: Sequence[str], source: str) -> Indices:
    """Nanoseconds of steps with ascending times, shape (n,); digits beyond the ninth decimal are rounded.

    Args:
        timestamps: Texts of the times in seconds.
        source: What errors call the scene.

    Raises:
        InputError: A time is before 0 or too late for ROS, or two times differ by less than ROS can tell.
    """
    stamps = [_nanoseconds(text) for text in timestamps]
    for text, stamp in zip(timestamps, stamps, strict=True):
        if stamp is None:
            problem = f"time {text} s: ROS knows times from 0 to {MOST_S} s; count the times of the poses from 0"
            raise InputError(source, [problem])
    ns = np.array(stamps, dtype=np.int64)
    same = np.flatnonzero(np.diff(ns) <= 0)
    if len(same):
        first, second = timestamps[int(same[0])], timestamps[int(same[0]) + 1]
        raise InputError(
            source, [f"times {first} s and {second} s: ROS counts in nanoseconds and cannot tell them apart"]
        )
    return ns


def _nanoseconds(text: str) -> int | None:
    """Nanoseconds of a time; None if ROS does not know it."""
    try:
        ns = int(Decimal(text).quantize(_UNIT, ROUND_HALF_EVEN, _EXACT).scaleb(9, _EXACT))
    except InvalidOperation:
        return None
    return ns if 0 <= ns < (MOST_S + 1) * NANO else None
