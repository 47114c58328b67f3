"""How well the numbers of a learned detector are known together, as a file beside the detector file.

Each number is nearly normal on the scale of its kind, see `resampling`. The file has the number, its standard deviation
on that scale – of a share or a rate the independent observations that it is worth – and the correlations between the
numbers of a state over the replicates. The intervals that are reported are made of the same values.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.core.arrays import Array, Mask
from modsim3d.learn.bootstrap import Entry, entries_of, nested, spread, to_scale
from modsim3d.learn.false_positives import NOT_WRITTEN
from modsim3d.learn.learned import Learned
from modsim3d.learn.misses import filled

FORMAT = 1
COUNTED = ("share", "rate")
"""Kinds of numbers whose uncertainty is that of a count."""
_DECIMALS = 3
_MOST_SPREADS = 4.0


def uncertainty_file(detector: Path) -> Path:
    """The file that belongs to a detector file."""
    return detector.with_name(f"{detector.stem}.uncertainty.json")


def uncertainty_text(learned: Learned, detector: str) -> bytes:
    """The content of the file.

    Args:
        learned: What was learned.
        detector: The text of the detector file that it belongs to.
    """
    written = [_filled(entry) for entry in entries_of(learned.numbers) if _is_written(entry)]
    transitions = learned.transitions
    content = {
        "format": FORMAT,
        "detector_sha256": hashlib.sha256(detector.encode()).hexdigest(),
        "confidence_threshold": learned.observed.threshold,
        "transitions": transitions.counts.astype(int).tolist() if transitions.observed else None,
        "groups": [
            _group(name, units, [entry for entry in written if entry.key.state == name])
            for name, units in learned.units.items()
        ],
    }
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _is_written(entry: Entry) -> bool:
    """Whether the number stands in the detector file."""
    if entry.key.names[-1] == "confusion":
        return True
    absent = entry.key.names[0] == "persistence" and not np.all(entry.estimate > 0)
    return entry.key.remark != NOT_WRITTEN and not absent and bool(np.all(np.isfinite(entry.estimate)))


def _filled(entry: Entry) -> Entry:
    """The entry; a confusion matrix with columns of labels that were never there, as the detector file has them."""
    if entry.key.names[-1] != "confusion":
        return entry
    values = np.concatenate([filled(entry.estimate)[None], entry.column.values[1:]])
    return replace(entry, column=replace(entry.column, values=values))


def _group(state: str | None, units: int, entries: Sequence[Entry]) -> dict[str, Any]:
    """The numbers of one state, or of None, those that all states share."""
    return {
        "state": state,
        "units": units,
        "numbers": [
            {
                "key": list(entry.key.names),
                "kind": entry.column.kind,
                "estimate": nested(entry.estimate),
                **_width(entry),
            }
            for entry in entries
        ],
        "correlations": _correlations(entries),
    }


def _width(entry: Entry) -> dict[str, Any]:
    """How well a number is known."""
    column = entry.column
    if column.kind in COUNTED:
        return {"observations": nested(column.independent)}
    found = spread(_without_outliers(to_scale(column.values[1:], column.kind)))
    return {"spread": nested(np.where(np.isfinite(found), found, 0.0))}


def _without_outliers(scaled: Array) -> Array:
    """Replicates (replicates, ...), each held within four standard deviations of the median.

    The standard deviation is that of the inner two thirds. A few replicates in which all errors are equal, with a
    logarithm of nearly −∞, would make the spread many times as large.
    """
    finite = np.where(np.isfinite(scaled), scaled, np.nan)
    if not np.isfinite(finite).any(axis=0).all():
        return scaled
    low, middle, high = np.nanquantile(finite, [0.1587, 0.5, 0.8413], axis=0)
    reach = _MOST_SPREADS * (high - low) / 2
    held: Array = np.clip(finite, middle - reach, middle + reach)
    return held


def correlated(names: Sequence[str], shape: tuple[int, ...]) -> Mask:
    """Mask of the places of an entry that have correlations, of its shape.

    Of a confusion matrix, whose columns sum to one, the misses; of a distribution over labels or cells, none.
    """
    places: Mask = np.ones(shape, dtype=bool)
    if names[-1] == "confusion":
        places[:-1] = False
    elif names[-1] in ("false_positive_labels", "density"):
        places[:] = False
    return places


def _correlations(entries: Sequence[Entry]) -> list[list[float]]:
    """The rows of the lower triangle of the correlation matrix, without its diagonal."""
    scores = [_standard(replicates) for entry in entries for replicates in _replicates(entry)]
    rows = min(map(len, scores), default=0)
    return [
        [round(float(first[:rows] @ second[:rows]) / (rows - 1), _DECIMALS) for second in scores[:place]]
        for place, first in enumerate(scores)
    ]


def _replicates(entry: Entry) -> Array:
    """Replicates of the numbers of an entry that have correlations, on their scale, shape (numbers, replicates)."""
    scaled = _without_outliers(to_scale(entry.column.values[1:], entry.column.kind))
    return scaled[:, correlated(entry.key.names, scaled.shape[1:])].T  # one row for each number


def _standard(values: Array) -> Array:
    """Values (n,) with mean zero and standard deviation one, 0 where they are not finite or all are equal."""
    known = np.isfinite(values)
    if not known.any() or np.ptp(values[known]) == 0:
        return np.zeros(len(values))
    moved = np.where(known, values - values[known].mean(), 0.0)
    result: Array = moved / moved.std(ddof=1)
    return result
