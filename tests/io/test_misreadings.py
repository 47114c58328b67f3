"""Files whose numbers parse but cannot be what their columns say: no reader takes one of them without a word."""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.errors import ModsimError
from tests.formats.labelled_files import HEIGHT, WIDTH
from tests.io.condition_readers import BOX, START_UNIX_S, Reader, Reading, Row, all_readers

# ---- conditions ----

Spoiled = Callable[[Reader], tuple[Row, ...] | None]
Change = Callable[..., tuple[float, ...]]


def rows_with(role: str, change: Callable[[Row], Row]) -> Spoiled:
    """All rows, changed; None where a reader has not got a role."""
    return lambda reader: tuple(row | change(row) for row in reader.rows) if role in reader.roles else None


def each_of(role: str, change: str | Callable[[str], str], *more: str, of: str = "") -> Spoiled:
    """All values of some roles, changed by a function or a text, in which `{}` stands for what was there; None where a
    reader has not got the first role, or that which is named by `of`."""
    new = change.format if isinstance(change, str) else change
    return rows_with(of or role, lambda row: {each: new(row[each]) for each in (role, *more)})


def of_ais(role: str, change: Callable[[str], str], *more: str) -> Spoiled:
    """Roles of the table of AIS reports alone."""
    return each_of(role, change, *more, of="latitude")


def number(change: Callable[[float], float]) -> Callable[[str], str]:
    return lambda text: f"{change(float(text)):.12g}"


def times(change: Callable[[float], float], stamps: bool = True) -> Spoiled:
    """Times in seconds, changed; those of AIS are dates, and stamps of ROS cannot be all that a text can."""
    spoil = each_of("time", number(change))
    return lambda reader: None if "latitude" in reader.roles or not (stamps or reader.text) else spoil(reader)


def boxes(change: Change | None, corners: Change | None = None, centres: Change | None = None) -> Spoiled:
    """All boxes in another form; of files with corners, and with centres, the change may be another."""

    def spoil(reader: Reader) -> tuple[Row, ...] | None:
        use = {"right": change, "corners": corners, "centres": centres or change}[reader.boxes]
        if use is None or not {*BOX} <= reader.roles:
            return None
        numbers = (use(*(float(row[role]) for role in BOX), *reader.size) for row in reader.rows)
        texts = ((f"{n:.9g}" for n in four) for four in numbers)
        return tuple(row | dict(zip(BOX, four, strict=True)) for row, four in zip(reader.rows, texts, strict=True))

    return spoil


def from_zero(empty: bool) -> Spoiled:
    """Frames that count from 0, of which the first may be empty."""

    def spoil(reader: Reader) -> tuple[Row, ...] | None:
        if "frame" not in reader.roles or reader.name in ("t.csv", "gt.json", "dt.json"):
            return None
        rows = [row for row in reader.rows if not empty or row["frame"] != "1"]
        return tuple(row | {"frame": str(int(row["frame"]) - 1)} for row in rows)

    return spoil


def quoted(role: str, text: str) -> Spoiled:
    """A flag of JSON as text."""
    return lambda reader: None if reader.separator else each_of(role, text)(reader)


ROWS: dict[str, Spoiled] = {
    "identities in scientific notation": each_of("id", "2.19E+08"), "identities as 7.0": each_of("id", "{}.0"),
    "identities as 7.5": each_of("id", "{}.5"), "identities below 0": each_of("id", "-7"),
    "identities of 15 digits": each_of("id", "219012345678901"),
    "identities through single precision": of_ais("id", lambda text: f"{float(np.float32(text)):.0f}"),
    "identities as words": lambda reader: None if reader.name == "w.csv" else each_of("id", "'vessel'")(reader),
    "identities of a few ships through single precision": lambda reader: (
        tuple(
            row | {"id": str(16 * (13_688_271 + int(row["id"]) % 40 + 50 * (4 * n // len(reader.rows))))}
            for n, row in enumerate(reader.rows)
        )
        if "id" in reader.roles and "latitude" not in reader.roles
        else None
    ),
    "images as 1.0": each_of("image", "{}.0"), "images as 1.5": each_of("image", "{}.5"),
    "images as text": each_of("image", '"{}"'),
    "frames as 1.0": each_of("frame", "{}.0"), "frames as 1.5": each_of("frame", "{}.5"),
    "frames from 0": from_zero(False), "frames from 0, the first empty": from_zero(True),
    "frames below 0": each_of("frame", "-{}"), "frames in scientific notation": each_of("frame", "1E+08"),
    "times in milliseconds": times(lambda time: 1000 * time), "times in microseconds": times(lambda time: 1e6 * time),
    "times in nanoseconds": times(lambda time: 1e9 * time, stamps=False),
    "times of 1970": times(lambda time: 86_400 * 200 + time), "times of an identity": times(lambda time: 219_012_345),
    "times of today": times(lambda time: START_UNIX_S + time),
    "frame numbers as times": times(lambda time: round(2 * time)),
    "one time": lambda reader: times(lambda time: 3.0, stamps=False)(reader) if reader.separator else None,
    "times below 0": times(lambda time: -time - 100, stamps=False),
    "corners for sizes, or sizes for corners": boxes(
        lambda x, y, w, h, *_: (x, y, x + w, y + h),
        lambda a, b, c, d, *_: (a, b, c - a, d - b),
        lambda x, y, w, h, *_: (x - w / 2, y - h / 2, x + w / 2, y + h / 2),
    ),
    "centres for corners, or corners for centres": boxes(
        lambda x, y, w, h, *_: (x + w / 2, y + h / 2, w, h),
        lambda a, b, c, d, *_: ((a + c) / 2, (b + d) / 2, c - a, d - b),
        lambda x, y, w, h, *_: (x - w / 2, y - h / 2, w, h),
    ),
    "x and y exchanged": boxes(lambda x, y, w, h, *_: (y, x, h, w), lambda a, b, c, d, *_: (b, a, d, c)),
    "shares of the image": boxes(
        lambda x, y, w, h, W, H: (
            (x / W, y / H, w / W, h / H) if W > 1 else (x * WIDTH, y * HEIGHT, w * WIDTH, h * HEIGHT)
        ),
        lambda a, b, c, d, W, H: (a / W, b / H, c / W, d / H),
    ),
    "per cent of image": boxes(*[lambda a, b, c, d, W, H: (100 * a / W, 100 * b / H, 100 * c / W, 100 * d / H)] * 2),
    "y from below": boxes(
        lambda x, y, w, h, W, H: (x, H - y - h, w, h) if W > 1 else (x, 1 - y, w, h),
        lambda a, b, c, d, W, H: (a, H - d, c, H - b),
        lambda x, y, w, h, W, H: (x, H - y, w, h),
    ),
    "boxes of an image twice as large": boxes(*[lambda a, b, c, d, *_: (2 * a, 2 * b, 2 * c, 2 * d)] * 2),
    "sizes below 0": boxes(lambda x, y, w, h, *_: (x, y, -w, -h), lambda a, b, c, d, *_: (c, d, a, b)),
    "boxes without area": boxes(lambda x, y, w, h, *_: (x, y, 0, 0), lambda a, b, c, d, *_: (a, b, a, b)),
    "boxes in scientific notation": boxes(lambda x, y, w, h, *_: (1e9, 1e9, w, h), lambda *_: (1e9, 1e9, 2e9, 2e9)),
    "confidences in per cent": each_of("score", number(lambda score: 100 * score)),
    "confidences of 8 bits": each_of("score", number(lambda score: round(255 * score))),
    "confidences as logits": each_of("score", number(lambda score: math.log(score / (1 - score)))),
    "confidences of -1": each_of("score", "-1"), "confidences all 1": each_of("score", "1"),
    "confidences as flags": each_of("score", lambda text: str(int(float(text) > 0.5))),
    "classes as 1.5": each_of("class", "{}.5"), "classes as 1.0": each_of("class", "{}.0"),
    "classes below 0": each_of("class", "-1"),
    "classes beyond the list": each_of("class", lambda text: str(int(text) + 70)),
    "labels of others": each_of("label", lambda text: '"tanker"' if text.startswith('"') else "tanker"),
    "labels as numbers": each_of("label", "1"),
    "flags of 2": each_of("flag", "2"), "flags of 0.5": each_of("flag", "0.5"),
    **{f"flags '{word}'": quoted("flag", f'"{word}"') for word in ("0", "false", "1", "no")},
    "flags as lists": quoted("flag", "[0]"),
    "visibility in per cent": each_of("visible", number(lambda share: 100 * share)),
    "visibility of 0": each_of("visible", "0"), "visibility of -1": each_of("visible", "-1"),
    "visibility as words": each_of("visible", "full"),
    "angles in degrees": each_of("heading", number(math.degrees)),
    "compass headings": each_of("heading", number(lambda angle: math.pi / 2 - angle + 1), of="roll"),
    "roll in degrees": each_of("roll", number(lambda angle: 50 * math.degrees(angle))),
    "axes exchanged": lambda reader: (
        rows_with("w1", lambda row: {"w1": row["w2"], "w2": row["w1"], "v1": row["v2"], "v2": row["v1"]})(reader)
        or rows_with("latitude", lambda row: {"latitude": row["longitude"], "longitude": row["latitude"]})(reader)
    ),
    "w2 to starboard": each_of("w2", lambda text: f"{-float(text):g}", "v2"),
    "kilometres": each_of("w1", lambda text: f"{float(text) / 1000:.9g}", "w2"),
    "millimetres": each_of("w1", lambda text: f"{float(text) * 1000:.9g}", "w2"),
    "degrees in radians": of_ais("latitude", number(math.radians), "longitude"),
    "dates of 1899": of_ais("time", lambda text: "1899-12-30T" + text[11:]),
    "dates to come": of_ais("time", lambda text: "2099" + text[4:]),
    "no dates": of_ais("time", lambda text: text[11:]), "dates of 1980": of_ais("time", lambda text: "1980" + text[4:]),
    "Unix times in milliseconds": each_of("unix", "{}000"),
    "Unix times in nanoseconds": each_of("unix", "{}000000000"),
    "Unix times of 1980": each_of("unix", lambda text: str(int(text) - 24 * 365 * 86_400)),
    "Unix times to come": each_of("unix", lambda text: str(int(text) + 76 * 365 * 86_400)),
    "an identity beside sentences": each_of("unix", "219012345"),
    "a station beside sentences": each_of("unix", "1234567890"),
    "a counter beside sentences": lambda reader: (
        tuple(row | {"unix": str(1_234_567_890 + 11 * n)} for n, row in enumerate(reader.rows))
        if "unix" in reader.roles
        else None
    ),
    "local dates beside sentences": each_of("unix", lambda text: f"2024-01-04 10:{int(text) // 60 % 60:02}:00 CET"),
}  # fmt: skip
TEXTS: dict[str, Callable[[str, str], bytes | None]] = {
    "a byte order mark": lambda text, _: f"\ufeff{text}".encode(), "no content": lambda text, _: b"",
    "UTF-16": lambda text, _: text.encode("utf-16"), "CR": lambda text, _: text.replace("\n", "\r").encode(),
    "CR LF": lambda text, _: text.replace("\n", "\r\n").encode(),
    "blank lines at the end": lambda text, _: f"{text}\n\n".encode(),
    "no end of the last line": lambda text, _: text.rstrip("\n").encode(),
    "a zero byte": lambda text, _: f"{text}\0".encode(),
    "half of the file": lambda text, comma: text[: len(text) * 3 // 5].rpartition(comma or ",")[0].encode(),
    "semicolons": lambda text, comma: text.replace(",", ";").encode() if comma == "," else None,
    "tabs": lambda text, comma: text.replace(comma, "\t").encode() if comma else None,
    "decimal commas": lambda text, comma: text.replace(",", ";").replace(".", ",").encode() if comma else None,
    "a line sep=": lambda text, comma: f"sep={comma}\n{text}".encode() if comma else None,
    "a column more": lambda text, comma: text.replace("\n", f"{comma}3\n").encode() if comma else None,
    "a column less": lambda text, comma: (
        "".join(f"{line.rpartition(comma)[0]}\n" for line in text.splitlines()).encode() if comma else None
    ),
    "quotes": lambda text, comma: (
        "".join('"' + line.replace(",", '","') + '"\n' for line in text.splitlines()).encode() if comma == "," else None
    ),
}  # fmt: skip
"""From the right text and its separator."""


def same(one: Any, other: Any) -> bool:
    """Whether two results are equal, arrays to the last digits that files have."""
    if isinstance(one, np.ndarray):
        if one.shape != np.shape(other) or one.dtype.kind not in "fiub":
            return np.array_equal(one, other)
        return np.allclose(one, other, atol=1e-3, equal_nan=True)
    if is_dataclass(one):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


NOTHING = "a detector or a tracker may have found nothing, and images may show nothing"
ALONE = "detections, against which it would be held, are not given"
UNDECIDABLE: dict[tuple[str, str], str] = {
    **{(name, "no content"): NOTHING for name in ("MOT truth", "MOT classes", "MOT truth alone", "MOT detections")},
    **{(name, "no content"): NOTHING for name in ("YOLO labels", "YOLO detections", "tracks MOT")},
    **{(f"{kind} truth alone", "centres for corners, or corners for centres"): ALONE for kind in ("MOT", "COCO")},
    **{(f"{kind} truth alone", "y from below"): ALONE for kind in ("MOT", "COCO")},
    ("MOT truth alone", "frames from 0, the first empty"): ALONE,
    **{(name, "visibility of -1"): "-1 stands for what is not known" for name in ("MOT truth", "MOT truth alone")},
    ("log CSV", "a column less"): "a log may have no confidences",
    ("AIS sentences", "half of the file"): "a log may end anywhere",
}
"""Conditions that nothing in the file or beside it tells from a right file, with the reason."""


def outcome(reader: Reader, path: Path, content: bytes, right: Reading) -> str:
    path.write_bytes(content)
    try:
        read, notes = reader.read(path)
    except ModsimError:
        return "refused"
    if {*notes} - {*right[1]}:
        return "noted"
    return "read" if same(right[0], read) else "SILENT"


def spoiled(reader: Reader) -> Iterator[tuple[str, bytes]]:
    text = reader.form(reader.rows)
    for name, spoil in ROWS.items():
        if (rows := spoil(reader)) is not None and (content := reader.form(rows)) != text:
            yield name, content.encode()
    for name, mark in TEXTS.items() if reader.text else ():
        if (content := mark(text, reader.separator)) is not None:
            yield name, content


KINDS = {
    "text": TEXTS.keys(),
    "identities": ("identities", "images"),
    "frames": ("frames",),
    "times": ("times", "one time", "frame numbers", "dates", "no dates", "local", "Unix", "an id", "a "),
    "boxes": ("corners", "centres", "x and y", "shares", "per cent", "y from", "boxes", "sizes"),
    "confidences": ("confidences",),
    "classes": ("classes", "labels"),
    "flags": ("flags", "visibility"),
    "axes": ("angles", "compass", "roll", "axes", "w2", "kilometres", "millimetres", "degrees"),
}
"""The columns of the page, and how conditions of each begin."""
PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"
BEGIN, END = "<!-- what tests/io/test_conditions.py finds -->\n", "<!-- end of what it finds -->"


def kind_of(condition: str) -> str:
    if condition in TEXTS:
        return "text"
    return next(kind for kind, words in KINDS.items() if kind != "text" and condition.startswith(tuple(words)))


def page(outcomes: dict[tuple[str, str], str]) -> str:
    """The tables of the page: readers and kinds of conditions, and what cannot be decided."""
    lines = ["| |" + "".join(f" {kind} |" for kind in KINDS), "|---|" + "---|" * len(KINDS)]
    for name in dict.fromkeys(name for name, _ in outcomes):
        cells = []
        for kind in KINDS:
            counts = Counter(o for (who, what), o in outcomes.items() if (who, kind_of(what)) == (name, kind))
            told = "/".join(str(counts[each]) for each in ("refused", "noted", "read"))
            cells.append(told + f" +{counts['SILENT']}" * bool(counts["SILENT"]) if counts else "")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    whole = Counter(outcomes.values())
    counts = [whole[each] for each in ("refused", "noted", "read")]
    told = "{} are refused, {} named in a remark and {} read as they are meant".format(*counts)
    lines += ["", f"Of {whole.total()} conditions {told}.", ""]
    lines += [f"{whole['SILENT']} cannot be told from a right file:", ""]
    for reason in dict.fromkeys(UNDECIDABLE.values()):
        where = dict.fromkeys(what for (_, what), why in UNDECIDABLE.items() if why == reason)
        who = dict.fromkeys(name for (name, _), why in UNDECIDABLE.items() if why == reason)
        lines.append(f"- {'; '.join(where)} ({', '.join(who)}): {reason}")
    return "\n" + "\n".join(lines) + "\n\n"


def test_no_file_is_misread_without_a_word(tmp_path: Path) -> None:
    """Each condition spoils a role or the text of a right file, which is then refused, noted or read as meant. The page
    has the outcomes: with MODSIM3D_WRITE_PAGE=1 they are written there, to be looked at and committed."""
    outcomes: dict[tuple[str, str], str] = {}
    for place, (name, reader) in enumerate(all_readers(tmp_path).items()):
        folder = tmp_path / str(place)
        folder.mkdir()
        path = folder / reader.name
        path.write_text(reader.form(reader.rows))
        right = reader.read(path)
        for condition, content in spoiled(reader):
            outcomes[name, condition] = outcome(reader, path, content, right)
    silent = {key for key, value in outcomes.items() if value == "SILENT"}
    assert silent ^ UNDECIDABLE.keys() == set()
    before, begin, rest = PAGE.read_text().partition(BEGIN)
    old, end, after = rest.partition(END)
    if os.environ.get("MODSIM3D_WRITE_PAGE"):
        PAGE.write_text(before + begin + page(outcomes) + end + after)
    else:
        assert old == page(outcomes)
