"""Reads AIS reports from CSV, block by block: a day of Danish waters is several gigabytes."""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.io.input_files import MAX_BAD_ROWS, open_input
from modsim3d.io.misreadings import LOST, SCIENTIFIC, has_lost_digits, no_commas
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import shown
from modsim3d.scene.ais.messages import Chunk, Particulars, Positions

TABLE = Path(__file__).with_name("layouts.yaml")
NEEDED = ("time", "mmsi", "latitude", "longitude")
MIN_NAMES = 3  # a header with fewer known names is of some other kind of file


@dataclass(frozen=True)
class Layout:
    """A CSV layout, by who publishes it."""

    name: str
    columns: Mapping[str, str]  # our name of a column → its name in the file, in the published case
    time_format: str  # of `strptime`
    ships: frozenset[str]  # words in the column `station` that mean ships, in lower case

    def columns_in(self, header: Sequence[str]) -> dict[str, str]:
        """Our name → the file's own name, of the columns that a header has."""
        names = {_plain_name(name): name for name in header}
        return {key: names[_plain_name(name)] for key, name in self.columns.items() if _plain_name(name) in names}

    def missing(self, header: Sequence[str]) -> list[str]:
        """Columns that a header lacks and must have."""
        names = self.columns_in(header)
        return [self.columns[name] for name in NEEDED if name not in names]


@cache
def layouts() -> tuple[Layout, ...]:
    """All layouts."""
    entries = load_yaml(TABLE, "table of CSV layouts").items()
    return tuple(
        Layout(name, entry["columns"], entry["time_format"], frozenset(entry.get("ships", ())))
        for name, entry in entries
    )


def layout_of(header: Sequence[str]) -> Layout | None:
    """The layout that a header fits best, or None if it fits none. A layout that misses fewer of its needed columns
    comes first, because layouts share the names of many others."""
    best = max(layouts(), key=lambda layout: (-len(layout.missing(header)), len(layout.columns_in(header))))
    # Any table may have an A and a B.
    telling = [name for name in best.columns_in(header).values() if len(name.strip()) > 1]
    return best if len(telling) >= MIN_NAMES else None


def _plain_name(name: str) -> str:
    """A column's name in lower case, without the mark that makes a header of `# Timestamp`."""
    return name.strip().lstrip("# ").lower()


UNPACKED_BY = {b"PK\x03\x04": "unzip", b"\x28\xb5\x2f\xfd": "zstd -d"}
SENTENCE = re.compile(rb"[!$][A-Z]{2}VD[MO],")
LOOKED_AT_LINES = 200  # a log of sentences may begin with comments or sentences of other instruments
MAX_LINE_BYTES, LOOKED_AT_BYTES = 1 << 20, 1 << 22
MAX_COLUMNS = 500  # a header with more names is no table of AIS, which have up to thirty; each costs memory in all rows
SHOWN_COLUMNS = 40


def source_of(path: Path) -> str:
    """The name of a file in an error."""
    return f"AIS file {path}"


@contextmanager
def open_reports(path: Path) -> Iterator[io.BufferedReader]:
    """The bytes of a file, unpacked if it is gzipped, whatever its name. Raises InputError if it cannot be read or
    unpacked, also later while it is being read."""
    with open_input(path, "AIS file") as file:
        packed_by = UNPACKED_BY.get(file.peek(4)[:4])
        if packed_by:
            raise InputError(source_of(path), [f"is packed: unpack it first ({packed_by} {path.name})"])
        yield file


def recognise(path: Path) -> Layout | None:
    """The layout of a CSV file, or None for NMEA sentences. Raises InputError if it is neither, is empty, or lacks
    columns that must be there."""
    with open_reports(path) as file:
        lines = [line for line in _first_lines(file) if line.strip()]
    if not lines:
        raise InputError(source_of(path), ["the file is empty"])
    if lines[0].rstrip(b"\r\n").count(b"\r") > 1:
        problem = "its lines end with carriage returns alone: save it with line feeds, as Linux and Windows have them"
        raise InputError(source_of(path), [problem])
    if any(SENTENCE.search(line) for line in lines):
        return None
    header = header_names(lines[0])
    layout = layout_of(header)
    if layout is None:
        formats = ", ".join(f"{entry.name} ({','.join(entry.columns[name] for name in NEEDED)})" for entry in layouts())
        problem = (
            f"is none of the formats that are read: NMEA sentences (!AIVDM,...) or CSV with the columns of {formats}"
        )
        raise InputError(source_of(path), [problem + no_commas(lines[0].decode("utf-8", "replace"))])
    if len(header) > MAX_COLUMNS:
        problem = f"looks like {layout.name} CSV, but has {len(header):,} columns, more than {MAX_COLUMNS}"
        raise InputError(source_of(path), [problem])
    if missing := layout.missing(header):
        names = ", ".join(shown(name)[1:-1] for name in header[:SHOWN_COLUMNS])
        problem = f"looks like {layout.name} CSV, but has no column {', '.join(missing)} (it has: {names})"
        raise InputError(source_of(path), [problem])
    return layout


def _first_lines(file: io.BufferedReader) -> Iterator[bytes]:
    """The first lines of a file, as many as are looked at; a line that is very long is cut."""
    left = LOOKED_AT_BYTES
    for _ in range(LOOKED_AT_LINES):
        line = file.readline(min(MAX_LINE_BYTES, left))
        left -= len(line)
        yield line


def header_names(line: bytes) -> list[str]:
    """The names in the first line of a CSV file."""
    text = line.decode("utf-8", "replace").strip("\r\n")
    try:
        return next(csv.reader([text]), [])
    except csv.Error:  # a cell of more than 128 KiB
        return []


BLOCK_BYTES = 1 << 24
SHOWN_PROBLEMS = 5  # problems listed of each block, so that a mistake in every row does not fill the screen
EXAMPLE = datetime(2024, 12, 31, 23, 59, 59)
NUMBER = r"^[-+]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?$"
MOTION = ("latitude", "longitude", "speed", "course", "heading")
SIZES = ("to_bow", "to_stern", "to_port", "to_starboard", "length", "beam")
PARTICULARS = ("name", "ship_type", *SIZES)
MAX_CHARACTERS = 120
"""Of a name or a ship type, which have 20 in the messages. All are stored as wide as the widest, so the rest is cut."""
FIRST_S, LAST_S = 631_152_000.0, 4_102_444_800.0  # reports are from 1990 to 2099; others have a wrong clock
NOT_SAID = "Unknown"  # text in Danish files where no name was received


def read_csv(path: Path, layout: Layout) -> Iterator[Chunk]:
    """Reports of a CSV file, a block at a time. A row with too many or too few cells, or one that cannot be read, is
    dropped and counted. Raises InputError if the file cannot be read, or an identity has lost digits, so that several
    ships have become one."""
    with open_reports(path) as stream:
        first_row, nothing = 2, True  # the header is row 1, or that after blank rows
        while (line := stream.readline(MAX_LINE_BYTES)) and not line.strip():
            first_row += 1
        header = header_names(line)
        columns = layout.columns_in(header)
        for raw in _blocks(stream, path):
            block, begin = _plain(raw), first_row
            first_row += block.count(b"\n")
            if not block.strip(b"\n"):
                continue
            rows = np.flatnonzero([line != b"" for line in block.split(b"\n")]) + begin
            table, skipped = _table(block, path, header, list(columns.values()))
            table = pa.table({key: table.column(name) for key, name in columns.items()})
            rows = rows[: len(table) + len(skipped)]  # a cell in quotes may have several lines
            nothing = False
            kept = np.delete(rows, skipped)
            for place in np.flatnonzero(pc.match_substring_regex(table.column("mmsi"), SCIENTIFIC)).tolist():
                if has_lost_digits(identity := _text(table.column("mmsi")[place])):
                    problem = f"row {kept[place]}: {columns['mmsi']} {LOST} (got {shown(identity)})"
                    raise InputError(source_of(path), [problem])
            wrong = rows[skipped][:SHOWN_PROBLEMS]
            problems = [f"row {row}: does not have the {len(header)} cells of the header" for row in wrong]
            yield _chunk(table, columns, layout, kept, len(skipped), problems)
    if nothing:
        empty = pa.table({key: pa.array([], pa.string()) for key in columns})
        yield _chunk(empty, columns, layout, np.zeros(0, dtype=np.int64), 0, [])


def _blocks(stream: IO[bytes], path: Path) -> Iterator[bytes]:
    """The rest of a file, cut at the ends of rows. Raises InputError if a row does not end."""
    rest = b""
    while piece := stream.read(BLOCK_BYTES):
        rest += piece
        stop = rest.rfind(b"\n") + 1
        if stop:
            yield rest[:stop]
            rest = rest[stop:]
        elif len(rest) > MAX_LINE_BYTES:
            raise InputError(source_of(path), [f"has a row of more than {MAX_LINE_BYTES} bytes: is it a table at all?"])
    if rest:
        yield rest


def _plain(block: bytes) -> bytes:
    """A block whose lines end with line feeds only, with a mark for each byte that is not UTF-8, as some names have."""
    block = block.replace(b"\r\n", b"\n").replace(b"\r", b" ")
    try:
        block.decode("utf-8")
    except UnicodeDecodeError:
        return block.decode("utf-8", "replace").encode("utf-8")
    return block


def _table(block: bytes, path: Path, header: list[str], columns: list[str]) -> tuple[pa.Table, Indices]:
    """Some columns of whole rows, as texts, and which rows have more or fewer cells than the header."""
    skipped: list[int] = []

    def skip(row: Any) -> str:
        skipped.append(int(row.number) - 1)
        return "skip" if len(skipped) <= MAX_BAD_ROWS else "error"

    try:
        table = arrow_csv.read_csv(
            pa.BufferReader(block),
            arrow_csv.ReadOptions(use_threads=False, block_size=len(block) + 1, column_names=header),
            arrow_csv.ParseOptions(invalid_row_handler=skip),
            arrow_csv.ConvertOptions(
                check_utf8=False,  # the block is UTF-8
                strings_can_be_null=False,
                include_columns=columns,
                column_types=dict.fromkeys(columns, pa.string()),
            ),
        )
    except pa.ArrowInvalid as error:
        if len(skipped) > MAX_BAD_ROWS:
            problem = f"more than {MAX_BAD_ROWS:,} rows in a row do not have the {len(header)} cells of the header"
            raise InputError(source_of(path), [f"too much of it cannot be read: {problem}"]) from None
        raise InputError(source_of(path), [f"cannot be read as CSV: {shown(str(error))}"]) from None
    return table, np.array(sorted(skipped), dtype=np.int64)


def _chunk(
    table: pa.Table, columns: dict[str, str], layout: Layout, rows: Indices, skipped: int, problems: list[str]
) -> Chunk:
    """The reports of a table with our names of columns. `table` has texts of the rows that have all cells, `columns`
    our name of a column → the file's, and `rows` the number of each row in the file, shape (n,). `skipped` further rows
    have too many or too few cells; `problems` has one line on each of the first of those."""
    bad = np.zeros(len(table), dtype=bool)

    def note(wrong: Mask, column: str, what: str) -> None:
        bad[wrong] = True
        for place in np.flatnonzero(wrong)[: max(0, SHOWN_PROBLEMS - len(problems))]:
            cell = shown(_text(table.column(column)[int(place)]))
            problems.append(f"row {rows[place]}: {columns[column]} is not {what} (got {cell})")

    times, wrong = _times(table.column("time").combine_chunks(), layout.time_format)
    note(wrong, "time", f"a time like {EXAMPLE:{layout.time_format}}")
    values: dict[str, Array] = {}
    for name in ("mmsi", *MOTION, *SIZES):
        if name in columns:
            values[name], wrong = _numbers(table.column(name).combine_chunks())
            note(wrong, name, "a number")
        else:
            values[name] = np.full(len(table), np.nan)
    numbers = values["mmsi"]
    whole = (numbers >= 0) & (numbers < 1e9) & (numbers == np.floor(numbers))  # false where NaN
    note(~whole & ~bad, "mmsi", "a whole number of at most nine digits")
    mmsi = np.where(whole, numbers, 0).astype(np.int64)
    ship = np.ones(len(table), dtype=bool)
    if "station" in columns:
        reported = pc.utf8_lower(pc.ascii_trim_whitespace(table.column("station").combine_chunks()))
        ship = np.asarray(pc.is_in(reported, value_set=pa.array(sorted(layout.ships))))
    latitude, longitude, speed, course, heading = (values[name] for name in MOTION)
    positions = Positions(mmsi, times, latitude, longitude, speed, course, heading, ship, rows)
    particulars = _particulars(table, mmsi, times, ~bad & ship)
    dropped = {"unreadable": int(bad.sum()) + skipped}
    return Chunk(positions.take(~bad), particulars, len(table) + skipped, dropped, tuple(problems))


def _particulars(table: pa.Table, mmsi: Indices, times_s: Array, rows: Mask) -> Particulars:
    """Each distinct set of particulars once, with the time at which it was last reported."""
    empty = pa.array([""] * len(table), pa.string())
    texts = {name: table.column(name) if name in table.column_names else empty for name in PARTICULARS}
    reported = pa.table({"mmsi": mmsi, "time": times_s, **texts}).filter(pa.array(rows))
    last = reported.group_by(["mmsi", *PARTICULARS], use_threads=False).aggregate([("time", "max")])

    def words(name: str) -> Any:
        texts = [_text(cell).strip()[:MAX_CHARACTERS] for cell in last.column(name)]
        return np.array(["" if text == NOT_SAID else text for text in texts], dtype=object)

    return Particulars(
        last.column("mmsi").to_numpy(),
        last.column("time_max").to_numpy(),
        words("name"),
        words("ship_type"),
        *(_numbers(last.column(name).combine_chunks())[0] for name in SIZES),
    )


def _text(cell: Any) -> str:
    raw = cell.as_buffer()
    return "" if raw is None else raw.to_pybytes().decode("utf-8", "replace")


def _numbers(texts: pa.Array) -> tuple[Array, Mask]:
    """Values, NaN where a cell is empty or NaN, and which cells are not numbers, shape (n,) each. A decimal comma is
    read as a point: the Danish description shows positions as 57,8794."""
    trimmed = pc.ascii_trim_whitespace(texts)
    given = pc.if_else(pc.equal(trimmed, ""), pa.scalar(None, pa.string()), trimmed)
    wrong = np.zeros(len(texts), dtype=bool)
    try:
        values = pc.cast(given, pa.float64())
    except pa.ArrowInvalid:
        fits = pc.match_substring_regex(given, NUMBER)
        wrong = ~np.asarray(pc.fill_null(fits, True))
        points = pc.replace_substring(pc.if_else(fits, given, None), ",", ".")
        values = pc.cast(points, pa.float64())
    numbers = pc.fill_null(values, float("nan")).to_numpy(zero_copy_only=False)
    return numbers, wrong | np.isinf(numbers)


def _times(texts: pa.Array, time_format: str) -> tuple[Array, Mask]:
    """Unix times, and which cells are not times of AIS, shape (n,) each; fractions and a final Z are ignored."""
    plain = pc.replace_substring(pc.ascii_trim_whitespace(texts), "T", " ")
    plain = pc.replace_substring_regex(plain, r"(?:\.[0-9]+)?Z?$", "")
    stamps = pc.strptime(plain, format=time_format, unit="s", error_is_null=True)
    wrong = np.asarray(pc.is_null(stamps))
    seconds = pc.fill_null(pc.cast(stamps, pa.int64()), 0).to_numpy(zero_copy_only=False).astype(np.float64)
    return seconds, wrong | (seconds < FIRST_S) | (seconds >= LAST_S)
