"""Changes to binary files that know their form: meshes, images, NumPy archives, and sentences with a checksum."""

import hashlib
import io
import random
import struct
import zipfile
import zlib
from functools import reduce
from operator import xor
from typing import Any

import numpy as np

from modsim3d.runs.files.block_files import DIGEST_BYTES
from tests.fuzz.structures import change_structure
from tests.fuzz.texts import WORDS, change_bytes
from tests.fuzz.values import CELLS, FLOATS, INTEGERS

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
