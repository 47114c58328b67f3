"""Parts of the ranges of a campaign file that no draw came near."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Mask
from modsim3d.campaign.file.keys import CampaignKeys, Range
from modsim3d.campaign.results.done_rows import text_of
from modsim3d.campaign.work.row import DONE

TENTHS, QUARTERS = 10, 4
"""A range is looked at in tenths, and each pair of ranges in squares of quarters."""


def empty_draws(keys: CampaignKeys, table: pa.Table) -> list[str]:
    """In words, which parts of the drawn ranges have no run that is done.

    Args:
        keys: The campaign file.
        table: The rows.
    """
    done = table.filter(pc.equal(table["status"], DONE))
    drawn = {key: values for factor in keys.vary for key, values in factor.ranges.items() if key in table.column_names}
    said = [text for key, values in drawn.items() for text in _of_key(key, values, done[key])]
    numbers = {key: values for key, values in drawn.items() if values.choices is None}
    for one, other in combinations(numbers, 2):
        squares = {
            (int(a), int(b))
            for a, b in zip(
                *(np.floor(_shares(numbers[key], done[key]) * QUARTERS) for key in (one, other)), strict=True
            )
        }
        if missing := QUARTERS**2 - len(squares):
            said.append(f"{one} with {other}: no draw in {missing} of {QUARTERS**2} squares of quarters of both ranges")
    return said


def _of_key(key: str, values: Range, column: pa.ChunkedArray) -> Iterator[str]:
    if values.choices is not None:
        as_text = pa.types.is_string(column.type)  # so it is if not all choices are numbers
        found = set(column.to_pylist())
        missing = [text_of(each) for each in values.choices if (text_of(each) if as_text else each) not in found]
        if missing:
            yield f"{key}: {', '.join(missing)}: never drawn"
        return
    filled = np.zeros(TENTHS, dtype=bool)
    filled[np.floor(_shares(values, column) * TENTHS).astype(int)] = True
    parts = [[_at(values, place / TENTHS) for place in part] for part in _stretches(~filled)]
    if parts:
        yield f"{key}: no draw from {', '.join(f'{low:.4g} to {high:.4g}' for low, high in parts)}"


def _shares(values: Range, column: pa.ChunkedArray) -> Array:
    """Where drawn values lie in their range, in [0, 1), shape (n,)."""
    assert values.low is not None and values.high is not None
    drawn, ends = np.asarray(column.to_numpy(), dtype=np.float64), np.array([values.low, values.high])
    if values.whole:
        ends[1] += 1
    if values.scale == "log" and not values.whole:
        drawn, ends = np.log10(drawn), np.log10(ends)
    shares: Array = np.clip((drawn - ends[0]) / (ends[1] - ends[0]), 0.0, np.nextafter(1.0, 0.0))
    return shares


def _at(values: Range, share: float) -> float:
    assert values.low is not None and values.high is not None
    if values.scale == "log" and not values.whole:
        return float(values.low * (values.high / values.low) ** share)
    return values.low + share * (values.high - values.low)


def _stretches(empty: Mask) -> Iterator[tuple[int, int]]:
    """First and stop of each stretch of empty parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], empty, [False]])))
    return ((int(first), int(stop)) for first, stop in list(pairwise(edges.tolist()))[::2])
