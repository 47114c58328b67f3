"""Odd values, and changes to lines of text and the cells in them, and to bytes without a look at what they mean."""

import gzip
import json
import random
import re
import struct
from functools import cache
from pathlib import Path
from typing import Any

_CELL = re.compile(rb"[^\s,;/\\=:*]+|(?<=,)(?=,)")
WORDS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000, 0x7FC00000, 0x00000400)
_REPEATS = (2, 10, 1000)
_BOMB_BYTES = 64_000_000


def change_cell(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Another text in place of one cell, or of the same cell in all lines."""
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    cells = list(_CELL.finditer(lines[place]))
    if not cells:
        return change_line(rng, content, others)
    index = rng.randrange(len(cells))
    cell = _other_cell(rng, cells[index][0])
    rows = range(len(lines)) if rng.random() < 0.1 else [place]
    for row in rows:
        found = list(_CELL.finditer(lines[row]))
        if index < len(found):
            start, stop = found[index].span()
            lines[row] = lines[row][:start] + cell + lines[row][stop:]
    return b"\n".join(lines)


def _other_cell(rng: random.Random, cell: bytes) -> bytes:
    try:
        number = float(cell)
    except ValueError:
        number = None
    if number is None or rng.random() < 0.5:
        return rng.choice(CELLS)
    other = rng.choice((-number, number + 1, number - 1, number * 10.0 ** rng.randint(-9, 9), rng.uniform(-2, 2)))
    return f"{other:g}".encode() if rng.random() < 0.5 or abs(other) > 1e15 or other != other else b"%d" % int(other)


def change_line(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A line is lost, repeated, moved, cut, joined with the next or taken from another file."""
    lines = content.split(b"\n")
    place, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(9)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines[place:place] = [lines[place]] * rng.choice(_REPEATS)
    elif kind == 2:
        lines[place], lines[other] = lines[other], lines[place]
    elif kind == 3:
        lines[place] = lines[place][: rng.randrange(len(lines[place]) + 1)]
    elif kind == 4:
        lines[place : place + 2] = [b"".join(lines[place : place + 2])]
    elif kind == 5:
        foreign = rng.choice(others).split(b"\n") if others else lines
        lines.insert(place, rng.choice(foreign))
    elif kind == 6:
        lines.insert(place, rng.choice(CELLS))
    elif kind == 7:
        lines[place] += rng.choice((b",", b" ", b";", b"\r", b",,,,", b"," * 1000, b" 1", b",1")) + rng.choice(CELLS)
    else:
        rng.shuffle(lines)
    return b"\n".join(lines)


def change_bytes(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Bytes are flipped, cut, inserted, overwritten, repeated, or two files are put together."""
    kind, size = rng.randrange(10), len(content)
    place = rng.randrange(size + 1)
    stop = min(size, place + rng.choice((1, 1, 2, 4, 8, 64, 1024)))
    if kind <= 2:
        changed = bytearray(content)
        for _ in range(rng.choice((1, 1, 2, 8)) if size else 0):
            where = rng.randrange(size)
            changed[where] = rng.choice((changed[where] ^ (1 << rng.randrange(8)), 0xFF, 0, rng.randrange(256)))
        return bytes(changed)
    if kind == 3:
        return content[:place]
    if kind == 4:
        return content[:place] + content[stop:]
    if kind == 5:
        return content[:place] + rng.choice(CELLS) + content[place:]
    if kind == 6:
        return content[:place] + struct.pack("<I", rng.choice(WORDS)) + content[place + 4 :]
    if kind == 7:
        return content[:stop] + content[place:stop] * rng.choice(_REPEATS) + content[stop:]
    if kind == 8 and others:
        other = rng.choice(others)
        return content[:place] + other[rng.randrange(len(other) + 1) :]
    return content[:place] + rng.randbytes(rng.choice((1, 4, 40))) + content[place:]


def change_whole(rng: random.Random, content: bytes, others: list[bytes]) -> bytes | None:
    """The file as another program, another system or an accident leaves it; None for a folder of its name."""
    packed = content[:2] == b"\x1f\x8b"
    text = content.decode("utf-8", "replace")
    return rng.choice(
        (
            *(lambda: b"", lambda: None, lambda: b"\n\n \n", lambda: b"\xef\xbb\xbf" + content),
            *(lambda: text.encode("utf-16"), lambda: text.encode("utf-32")),
            *(lambda: content.replace(b"\n", b"\r\n"), lambda: content.replace(b"\n", b"\r")),
            *(lambda: content.replace(b"\n", b" "), lambda: content.replace(b",", b";")),
            *(lambda: content + content, lambda: bytes(len(content))),
            *(lambda: _pack(content) if not packed else content, lambda: _pack(content)[: rng.randrange(1, 60)]),
            *(lambda: _pack(content) + rng.randbytes(20), lambda: _pack(content) + _pack(content)),
            lambda: rng.choice(others) if others else content,
            *(lambda: rng.choice(MAGIC) + content, lambda: rng.choice(MAGIC)),
        )
    )()


def _pack(content: bytes) -> bytes:
    return gzip.compress(content, compresslevel=1, mtime=0)


def change_packed(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A bomb: the file, and then the same few bytes, in all 64 MB that take some kilobytes."""
    return _pack(content) + _bomb(rng.choice((b"\0", b" ", b"\n", b"[", b"1,1\n", b"- a\n")))


@cache
def _bomb(filler: bytes) -> bytes:
    return _pack(filler * (_BOMB_BYTES // len(filler)))


JSON, YAML = "json", "yaml"


def _spelled_out(value: Any) -> Any:
    """A value of the file; `{"repeat": [text, times, ...]}` stands for a long text."""
    if isinstance(value, dict) and "repeat" in value:
        parts = value["repeat"]
        return "".join(text * times for text, times in zip(parts[::2], parts[1::2], strict=True))
    return value


_FILE = json.loads((Path(__file__).parent / "odd_values.json").read_text(encoding="utf-8"))
_TABLE = {name: tuple(map(_spelled_out, values)) for name, values in _FILE.items()}
INTEGERS, FLOATS, TEXTS, OTHERS = (_TABLE[name] for name in ("integers", "floats", "texts", "others"))
NUMBERS = INTEGERS + FLOATS
CELLS, MAGIC = (tuple(text.encode("latin-1") for text in _TABLE[name]) for name in ("cells", "magic"))
_LITERALS = {form: _TABLE[form] for form in (JSON, YAML)}


class Literal(str):
    """Text that stands in a file as it is, not quoted."""


def odd_number(rng: random.Random, value: float) -> Any:
    """A number near the one that was there, or far from it."""
    if not abs(value) < 1e290:
        return rng.choice(NUMBERS)
    return rng.choice(
        (
            *(lambda: -value, lambda: value * rng.choice((0.5, 0.999, 1.001, 2)), lambda: value * (1 + 1e-12)),
            *(lambda: 0, lambda: value + rng.choice((-1, 1)), lambda: value * 10.0 ** rng.randint(-12, 12)),
            *(lambda: float(value), lambda: round(value), lambda: str(value), lambda: [value]),
            *(lambda: rng.uniform(-10, 10), lambda: rng.randint(-3, 20), lambda: rng.choice(NUMBERS)),
        )
    )()


def odd_value(rng: random.Random, value: Any, form: str) -> Any:
    """Something in place of a value of a file of that form."""
    chance = rng.random()
    if isinstance(value, int | float) and chance < 0.45:
        return odd_number(rng, value)
    if isinstance(value, str) and chance < 0.2:
        return rng.choice((value + " ", value.upper(), value[:-1], value * 50, [value], value + "\x07", value + "\0"))
    if chance < 0.6:
        return rng.choice(NUMBERS)
    if chance < 0.75:
        return rng.choice(TEXTS)
    if chance < 0.87:
        return rng.choice(OTHERS)
    return Literal(rng.choice(_LITERALS[form]))
