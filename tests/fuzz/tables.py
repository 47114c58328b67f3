"""Changes to the columns and rows of Parquet tables."""

import io
import random
from collections.abc import Callable
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from tests.fuzz.texts import change_bytes
from tests.fuzz.values import FLOATS, INTEGERS, TEXTS

_INTEGERS = (pa.int8(), pa.int32(), pa.int64(), pa.uint64())
_TYPES = (pa.string(), *_INTEGERS, pa.float32(), pa.float64(), pa.bool_(), pa.null())
_OTHER_TYPES = (pa.binary(), pa.large_string(), pa.decimal128(20, 2), pa.timestamp("us"), pa.list_(pa.int64()))


def change_table(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A table with another column, other values or other rows."""
    try:
        table = pq.read_table(io.BytesIO(content), use_threads=False)
    except (pa.ArrowException, OSError):
        return change_bytes(rng, content, others)
    if not table.num_columns:
        return content
    place = rng.randrange(table.num_columns)
    out = io.BytesIO()
    try:
        changed = rng.choice(_CHANGES)(rng, table, place)
        pq.write_table(changed, out, compression=rng.choice(("zstd", "none")))
    except (pa.ArrowException, OverflowError, ValueError, TypeError):
        return content  # a value that the type cannot hold
    return out.getvalue()


def _with(table: Any, place: int, values: Any, name: str | None = None) -> Any:
    return table.set_column(place, name or table.column_names[place], values)


def _renamed(rng: random.Random, table: Any, place: int) -> Any:
    name = rng.choice((*TEXTS[:30], rng.choice(table.column_names), table.column_names[place].upper()))
    return _with(table, place, table.column(place), name.replace("\ud800", "?"))


def _retyped(rng: random.Random, table: Any, place: int) -> Any:
    kind = rng.choice(_TYPES + _OTHER_TYPES)
    try:
        return _with(table, place, table.column(place).cast(kind, safe=False))
    except (pa.ArrowException, ValueError):
        return _with(table, place, pa.nulls(table.num_rows, kind))


def _null(rng: random.Random, table: Any, place: int) -> Any:
    share = rng.choice((0.0, 0.5, 1.0))
    values, kind = table.column(place).to_pylist(), table.schema.field(place).type
    if share == 0.0 and values:
        values[rng.randrange(len(values))] = None
    else:
        values = [None if rng.random() < share else value for value in values]
    return _with(table, place, pa.array(values, kind))


def _odd_values(rng: random.Random, table: Any, place: int) -> Any:
    values, kind = table.column(place).to_pylist(), table.schema.field(place).type
    if not values:
        return table
    rows = range(len(values)) if rng.random() < 0.3 else [rng.randrange(len(values))]
    odd = _odd(rng, kind)
    for row in rows:
        values[row] = odd
    return _with(table, place, pa.array(values, kind))


def _odd(rng: random.Random, kind: Any) -> Any:
    if pa.types.is_floating(kind):
        return float(rng.choice(FLOATS))
    if pa.types.is_integer(kind):
        return rng.choice([number for number in INTEGERS if abs(number) < 2**63])
    if pa.types.is_boolean(kind):
        return rng.choice((True, False))
    if pa.types.is_list(kind):
        nobody, nothing, many = [{"id": "nobody", "px": 1}], [{"id": None, "px": None}], [{"id": "", "px": -5}] * 40
        return rng.choice(([], None, nobody, nothing, [None], many))
    return rng.choice(TEXTS).replace("\ud800", "?")


def _rows(rng: random.Random, table: Any, place: int) -> Any:
    count = table.num_rows
    if not count:
        return pa.concat_tables([table] * 2)
    row, stop = rng.randrange(count), rng.randrange(count + 1)
    return rng.choice(
        (
            lambda: table.slice(0, 0),
            lambda: table.slice(row),
            lambda: table.slice(0, stop),
            lambda: pa.concat_tables([table, table.slice(row, 1)]),
            lambda: pa.concat_tables([table] * rng.choice((2, 40))),
            lambda: table.take(list(range(count))[::-1]),
            lambda: table.take(rng.sample(range(count), count)),
            lambda: pa.concat_tables([table.slice(0, row), table.slice(row + 1)]),
        )
    )()


_METADATA: tuple[dict[Any, Any] | None, ...] = (None, {"modsim3d": "x"}, {b"ARROW:schema": b"x"})
_CHANGES: tuple[Callable[[random.Random, Any, int], Any], ...] = (
    *[lambda rng, table, place: table.remove_column(place)] * 2,
    *(_renamed, _retyped, _retyped, _null, _null, _odd_values, _odd_values, _odd_values, _odd_values, _rows, _rows),
    lambda rng, table, place: table.select(table.column_names[::-1]),
    lambda rng, table, place: _with(table, place, table.column(rng.randrange(table.num_columns))),
    lambda rng, table, place: table.append_column(table.column_names[place], table.column(place)),
    lambda rng, table, place: table.append_column("extra", pa.nulls(table.num_rows, pa.string())),
    lambda rng, table, place: table.replace_schema_metadata(rng.choice(_METADATA)),
)
