"""How two files of the same name differ, in words: rows, columns and the largest difference of a table's numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.arrays import Mask
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.columns import numbers
from modsim3d.runs.files.stored_tables import damage_named

_MOST_COLUMNS = 6
SAME_ROWS = "the same rows, stored in other bytes"
"""What `difference` says of tables of another writer."""


def difference(one: Path, other: Path) -> str:
    """What differs between two files of a run that have different bytes."""
    if one.suffix == ".parquet":
        return _of_tables(one, other)
    lines, others = one.read_bytes().splitlines(), other.read_bytes().splitlines()
    if len(lines) != len(others):
        return f"{len(lines)} lines against {len(others)}"
    return f"{sum(a != b for a, b in zip(lines, others, strict=True))} of {len(lines)} lines differ"


def settings_difference(one: bytes, other: bytes, left_out: frozenset[str]) -> str:
    """Which entries differ between two JSON objects, `left_out` aside; empty if none does."""
    first, second = (_flat(orjson.loads(text), left_out) for text in (one, other))
    keys = [key for key in sorted(first | second) if first.get(key) != second.get(key)]
    said = [f"{key} {_shown(first, key)} against {_shown(second, key)}" for key in keys[:_MOST_COLUMNS]]
    return _listed(said, len(keys))


def _flat(value: object, left_out: frozenset[str], path: str = "") -> dict[str, object]:
    """Values of nested objects by their path with dots."""
    if not isinstance(value, dict):
        return {path: value}
    inner = [(f"{path}.{key}" if path else key, entry) for key, entry in value.items()]
    found: dict[str, object] = {}
    for key, entry in inner:
        if key not in left_out:
            found |= _flat(entry, left_out, key)
    return found


def _shown(values: dict[str, object], key: str) -> str:
    return orjson.dumps(values[key]).decode() if key in values else "nothing"


def _of_tables(one: Path, other: Path) -> str:
    try:
        first, second = _rows(one), _rows(other)
    except RunDirectoryError as error:
        return str(error)
    if first.schema != second.schema:
        return "the columns are others"
    if len(first) != len(second):
        return f"{len(first)} rows against {len(second)}"
    found = {name: _column(first, second, name) for name in first.column_names}
    differs = {name: rows for name, (rows, _) in found.items() if rows.any()}
    if not differs:
        return SAME_ROWS
    rows = np.logical_or.reduce(list(differs.values())).sum()
    said = [f"{name} in {mask.sum()}{found[name][1]}" for name, mask in differs.items()]
    return f"{rows} of {len(first)} rows differ: {_listed(said[:_MOST_COLUMNS], len(said))}"


def _rows(path: Path) -> pa.Table:
    with damage_named(path):
        return pq.read_table(path)


def _column(first: pa.Table, second: pa.Table, name: str) -> tuple[Mask, str]:
    """Which rows differ in a column, shape (n,), and by how much at most."""
    one, other, kind = first[name], second[name], first.schema.field(name).type
    if one.equals(other):
        return np.zeros(len(one), dtype=bool), ""
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        return np.array([a != b for a, b in zip(one.to_pylist(), other.to_pylist(), strict=True)]), ""
    a, b = numbers(first, name), numbers(second, name)
    differs: Mask = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    apart = np.abs(a - b)[differs]
    most = apart[~np.isnan(apart)].max(initial=0.0)
    return differs, f" by {most:.2g} at most" if most else ""


def _listed(said: list[str], count: int) -> str:
    return "; ".join([*said, *([f"and {count - len(said)} more"] if count > len(said) else [])])
