"""Changes to binary files that know their form: meshes, images, tables, NumPy archives, sentences with a checksum."""

import hashlib
import io
import random
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import reduce
from operator import xor
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.runs.files.block_files import DIGEST_BYTES
from tests.fuzz.structures import change_structure
from tests.fuzz.texts import CELLS, FLOATS, INTEGERS, TEXTS, WORDS, change_bytes

SINGLES = tuple(value for value in FLOATS if not 3.4e38 < abs(value) < np.inf)
"""Numbers that have a place in single precision."""


def change_glb(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A GLB with another description or other data, in chunks whose lengths are right (or not)."""
    try:
        length = struct.unpack_from("<I", content, 12)[0]
        text, rest = content[20 : 20 + length], content[20 + length :]
    except struct.error:
        return content
    if rng.random() < 0.25:
        rest = rest[:8] + overwrite_numbers(rng, rest[8:])
    else:
        text = change_structure(rng, text.rstrip(b" \0"), others)
    text += b" " * (-len(text) % 4)
    claimed = rng.choice(WORDS) if rng.random() < 0.05 else len(text)
    whole = rng.choice(WORDS) if rng.random() < 0.05 else 20 + len(text) + len(rest)
    return struct.pack("<4sIII4s", b"glTF", 2, whole, claimed, b"JSON") + text + rest


def overwrite_numbers(rng: random.Random, content: bytes) -> bytes:
    """Another float or integer in place of four bytes, once or a few times."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 3, 20)) if len(changed) >= 4 else 0):
        place = 4 * rng.randrange(len(changed) // 4)
        word = struct.pack("<f", rng.choice(SINGLES)) if rng.random() < 0.6 else struct.pack("<I", rng.choice(WORDS))
        changed[place : place + 4] = word
    return bytes(changed)


def change_binary_stl(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Another number of faces, other coordinates, or faces that are left out or repeated."""
    kind = rng.randrange(4)
    if kind == 0:
        return content[:80] + struct.pack("<I", rng.choice(WORDS)) + content[84:]
    faces = [content[84 + 50 * k : 134 + 50 * k] for k in range((len(content) - 84) // 50)]
    if not faces:
        return content
    place = rng.randrange(len(faces))
    if kind == 1:
        faces[place] = overwrite_numbers(rng, faces[place])
    elif kind == 2:
        faces[place : place + 1] = [faces[place]] * rng.choice((0, 2, 1000))
    else:
        faces = [overwrite_numbers(rng, face) for face in faces]
    return content[:80] + struct.pack("<I", len(faces)) + b"".join(faces)


def change_after_header(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Other numbers behind the header of a binary PLY."""
    start = content.find(b"end_header") + 11
    return content[:start] + overwrite_numbers(rng, content[start:])


def change_image(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Another size in the header of a PNG, with a checksum that is right; other bytes in other images."""
    if not content.startswith(b"\x89PNG") or len(content) < 33 or rng.random() < 0.3:
        return change_bytes(rng, content, others)
    sides = [rng.choice((*WORDS, 100, 65_536, 2**31 - 1)) for _ in range(2)]
    header = b"IHDR" + struct.pack(">II", *sides) + content[24:29]
    return content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:]


def change_sentence(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Another field or letter in a sentence of AIS, whose checksum is right again."""
    lines = content.split(b"\n")
    places = [place for place, line in enumerate(lines) if b"!AI" in line]
    if not places:
        return content
    place = rng.choice(places)
    before, _, sentence = lines[place].partition(b"!")
    fields = sentence.split(b"*")[0].split(b",")
    index = rng.randrange(len(fields))
    kind = rng.random()
    if kind < 0.5 and len(fields) > 5 and fields[5]:
        payload = bytearray(fields[5])
        for _ in range(rng.choice((1, 1, 4))):
            payload[rng.randrange(len(payload))] = rng.choice((*range(48, 88), *range(96, 120), rng.randrange(256)))
        fields[5] = bytes(payload)
    elif kind < 0.6 and len(fields) > 5:
        fields[5] = fields[5][: rng.randrange(len(fields[5]) + 1)] * rng.choice((0, 1, 1, 40))
    elif kind < 0.7:
        del fields[index]
    else:
        fields[index] = rng.choice((*CELLS, b"9", b"10", b"AIVDO", b"B", b"5", b"255"))
    body = b",".join(fields)
    lines[place] = before + b"!" + body + b"*%02X" % reduce(xor, body, 0)
    return b"\n".join(lines)


def change_archive(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Kept truth with one array of another kind or shape, with other values, or gone; its checksum is right."""
    try:
        with np.load(io.BytesIO(content[:-DIGEST_BYTES])) as archive:
            arrays: dict[str, Any] = dict(archive)
    except (OSError, ValueError, EOFError, zlib.error, KeyError, zipfile.BadZipFile):
        return change_bytes(rng, content, others)
    if not arrays:
        return content
    name = rng.choice(list(arrays))
    changed = _other_array(rng, arrays.pop(name))
    if changed is not None:
        arrays[name if rng.random() < 0.95 else "extra"] = changed
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue() + hashlib.sha256(out.getbuffer()).digest()


def _other_array(rng: random.Random, array: Any) -> Any:
    changes = (*[_other_values] * 4, *[_other_shape] * 4, _other_kind, _other_kind, lambda rng, array: None)
    return rng.choice(changes)(rng, array)


def _other_kind(rng: random.Random, array: Any) -> Any:
    """The array as numbers of another kind, as text or as Python objects."""
    if rng.random() < 0.3:
        return np.array(rng.choice((None, "x", 3, [], {})), dtype=object)
    return array.astype(rng.choice((np.float32, np.int8, np.uint64, bool, np.complex128, "U8", "S3", object)))


def _other_shape(rng: random.Random, array: Any) -> Any:
    """The array cut, repeated, emptied, reversed, or with more or fewer axes."""
    if not array.ndim:
        return array.reshape(1)
    longer, empty = np.concatenate([array] * rng.choice((2, 50))), np.zeros((0, *array.shape[1:]), dtype=array.dtype)
    turned = array.reshape(-1) if array.ndim > 1 else array.reshape(-1, 1)
    return rng.choice((array[: len(array) // 2], array[::-1], longer, empty, turned))


def _other_values(rng: random.Random, array: Any) -> Any:
    """The array with one value, or all values, out of their range."""
    if not array.size:
        return np.zeros(3)
    changed = array.copy()
    whole = [number for number in INTEGERS if abs(number) < 2**63]
    odd: Any = not changed.flat[0]
    if array.dtype != bool:
        odd = rng.choice(whole if array.dtype.kind in "iu" else SINGLES)
    changed.flat[:] = odd if rng.random() < 0.3 else changed.flat[:]
    changed.flat[rng.randrange(array.size)] = odd
    return changed


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
