"""Python's search for garbage in cycles, which holds up whatever runs while it lasts."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_COLLECT_AFTER = 700
"""New objects: looking through so few takes a tenth of a millisecond."""


@contextmanager
def short_collections() -> Iterator[None]:
    """Leave out of every search what is there now: to look through all objects of the libraries takes 10 to 20 ms."""
    threshold = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(_COLLECT_AFTER, *threshold[1:])
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
        gc.unfreeze()
