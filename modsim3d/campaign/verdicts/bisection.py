"""Where a statement changes from true to false."""

from __future__ import annotations

from collections.abc import Callable


def lower_end(excluded: Callable[[float], bool], halvings: int) -> float:
    """The greatest number in [0, 1) up to which all are excluded, 0 if none is.

    Args:
        excluded: Whether a number is; if it is, so are all below it.
        halvings: How often the interval is halved: the number is rounded down by 2**-halvings at most.
    """
    low, high = 0.0, 1.0
    for _ in range(halvings):
        middle = (low + high) / 2
        if excluded(middle):
            low = middle
        else:
            high = middle
    return low


def least_whole(holds: Callable[[int], bool], first: int) -> int:
    """The least whole number, from the first on, for which a statement holds that then holds for all greater ones."""
    step = 1
    while not holds(first + step - 1):
        step *= 2
    low, high = first + step // 2 - 1, first + step - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
