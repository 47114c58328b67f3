"""Tables of texts, as CSV or Parquet: their columns as numbers and names, and what is wrong with their rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import ArrayLike
from pyarrow import csv

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted
from modsim3d.io.input_files import note_input, read_text
from modsim3d.io.misreadings import LOST, ROUNDED, SCIENTIFIC, are_rounded, has_lost_digits, no_commas
from modsim3d.io.validation import nearest, shown

_MAX_ROWS = 10  # rows that are named; the others are counted


@dataclass
class RowProblems:
    """The wrong rows of a file, collected over the checks of one stage."""

    source: str
    line: Indices  # numbers of the rows in the file, (k,)
    word: str = "line"  # what messages call a row
    _found: dict[int, tuple[str, set[int]]] = field(default_factory=dict)  # by row: the message, and rows that it is of
    _wrong: set[int] = field(default_factory=set)

    def refuse(self, bad: ArrayLike, say: Callable[[int], str], alike: Indices | None = None) -> None:
        """Record wrong rows, shape (k,); `say` has the message for a row, which is the same for all wrong rows with the
        same number in `alike`, shape (k,). Only the first problem of a row is kept."""
        rows = np.flatnonzero(bad)
        self._wrong.update(rows.tolist())
        number = rows if alike is None else alike[rows]
        for first in np.sort(np.unique(number, return_index=True)[1])[:_MAX_ROWS].tolist():
            same = rows[number == number[first]].tolist()
            more = f", and in {counted(len(same) - 1, f'more {self.word}')}" if len(same) > 1 else ""
            self._found.setdefault(same[0], (say(same[0]) + more, {*same}))

    def settle(self) -> None:
        """End a stage. Raises InputError if there are wrong rows."""
        if not self._wrong:
            return
        rows = sorted(self._found)[:_MAX_ROWS]
        lines = [f"{self.word} {self.line[row]}: {self._found[row][0]}" for row in rows]
        if more := len(self._wrong.difference(*(self._found[row][1] for row in rows))):
            lines.append(f"… and {more:,} more {self.word}s")
        raise InputError(self.source, lines)


_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$"
_MAX_NUMBER = 1e15  # a larger number is no identity and no place, and neighbours of it cannot be told apart


@dataclass(frozen=True, eq=False)
class TextTable:
    """The k rows of a file."""

    columns: dict[str, pa.ChunkedArray]  # texts without white space around them, each (k,)
    problems: RowProblems

    @classmethod
    def of(cls, text: str, names: Sequence[str], source: str, first_line: int = 1) -> TextTable:
        """The rows of a text, of which each line holds the cells `names`; empty lines are passed over. The text begins
        at `first_line` of the file `source`. Raises InputError for a line with another number of cells."""
        rows, other = _cells(text, names, source)
        kept = np.any([_mask(pc.greater(pc.binary_length(column), 0)) for column in rows], axis=0)
        count = len(kept) + len(other)
        line = np.delete(np.arange(count), [number - 1 for number, _, _ in other]) + first_line
        if wrong := [(number, cells, line_text) for number, cells, line_text in other if line_text.strip()]:
            number, cells, line_text = wrong[0]
            problem = f"line {number - 1 + first_line}: has {counted(cells, 'cell')}, must have {len(names)}"
            lines = [f"{problem}: {', '.join(names)} (got {shown(line_text)}){no_commas(','.join(names))}"]
            if len(wrong) > 1:
                lines.append(f"… and {len(wrong) - 1:,} more lines")
            raise InputError(source, lines)
        return cls(
            {name: column.filter(pa.array(kept)) for name, column in zip(names, rows, strict=True)},
            RowProblems(source, line[kept]),
        )

    @classmethod
    def read(cls, path: Path, what: str) -> TextTable:
        """Read a table with a line of names, as CSV or, if its name says so, as Parquet; `what` names it in messages.
        Raises InputError if it cannot be read."""
        source = f"{what} {path}"
        if path.suffix == ".parquet":
            return cls(*_parquet(path, source))
        names, body = named_lines(path, what)
        if names == [""] and not body.strip():
            raise InputError(source, ["the file is empty"])
        if repeated := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise InputError(source, [f"line 1: the column {shown(name)} is there twice" for name in repeated])
        return cls.of(body, names, source, first_line=2)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.problems.line)

    def has(self, name: str) -> bool:
        """Whether there is a column of the name."""
        return name in self.columns

    def numbers(self, name: str, *, missing: Sequence[str] = ()) -> Array:
        """A column of finite numbers, (k,). Cells with one of the texts of `missing` are nan, and so is a column that
        is not there if there are such texts."""
        if missing and not self.has(name):
            return np.full(len(self), np.nan)
        texts = self.columns[name]
        good = pc.match_substring_regex(texts, _NUMBER)
        cells = pc.if_else(good, texts, pa.scalar(None, pa.string()))
        values = np.asarray(pc.cast(cells, pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        bad = ~(_mask(good) | _mask(pc.is_in(texts, value_set=pa.array(missing, pa.string()))))
        self.problems.refuse(bad, lambda row: f"{name} must be a number (got {self._cell(name, row)})")
        too_large = np.abs(values) > _MAX_NUMBER
        self.problems.refuse(too_large, lambda row: f"{name} must be at most 1e15 (got {self._cell(name, row)})")
        return np.where(too_large, np.nan, values)

    def whole_numbers(self, name: str, least: int) -> Indices:
        """A column of whole numbers, (k,); a wrong one is a problem, and `NOBODY`."""
        values = self.numbers(name)
        bad = ~np.isnan(values) & ((values != np.floor(values)) | (values < least))
        self.problems.refuse(
            bad, lambda row: f"{name} must be a whole number, at least {least} (got {self._cell(name, row)})"
        )
        return np.where(bad | np.isnan(values), NOBODY, values).astype(np.int64)

    def identities(self, name: str, least: int) -> Indices:
        """A column of whole numbers that are names, none of which may have lost digits, (k,)."""
        values = self.whole_numbers(name, least)
        lost = _mask(pc.match_substring_regex(self.columns[name], SCIENTIFIC))
        lost[lost] = [has_lost_digits(self.columns[name][row].as_py()) for row in np.flatnonzero(lost).tolist()]
        self.problems.refuse(lost, lambda row: f"{name} {LOST} (got {self._cell(name, row)})")
        self.problems.refuse(
            np.full(len(self), are_rounded(np.unique(values).tolist())), lambda _: f"{name}: all {ROUNDED}"
        )
        return values

    def names(self, name: str, choices: Sequence[str], *, needed: bool = True) -> Indices:
        """A column of names as indices of the `choices`, (k,). `NOBODY` where a cell is empty or the column is not
        there, unless it is `needed`."""
        if not needed and not self.has(name):
            return np.full(len(self), NOBODY)
        texts = self.columns[name]
        index = pc.fill_null(pc.index_in(texts, value_set=pa.array(list(choices), pa.string())), NOBODY)
        indices = np.asarray(index.to_numpy(zero_copy_only=False), dtype=np.int64)
        unknown = indices == NOBODY
        if not needed:
            unknown &= ~_mask(pc.equal(pc.binary_length(texts), 0))
        self.problems.refuse(
            unknown,
            lambda row: f"there is no {name} {self._cell(name, row)} ({nearest(texts[row].as_py(), choices)})",
            np.unique(texts.to_numpy(zero_copy_only=False).astype(str), return_inverse=True)[1],
        )
        return indices

    def _cell(self, name: str, row: int) -> str:
        return shown(self.columns[name][row].as_py())


def named_lines(path: Path, what: str) -> tuple[list[str], str]:
    """The names in the first line of a text with commas, and the lines after it. Raises InputError if unreadable."""
    head, _, body = read_text(path, what).partition("\n")
    return [name.strip().strip('"') for name in head.split(",")], body


def _parquet(path: Path, source: str) -> tuple[dict[str, pa.ChunkedArray], RowProblems]:
    """The columns of a Parquet file that are not nested, as texts."""
    note_input(path)
    try:
        read = pq.read_table(path)
        columns = {
            name: pc.fill_null(pc.cast(_plain(read[name]), pa.string()), "")
            for name in read.column_names
            if not pa.types.is_nested(read[name].type)
        }
    except (OSError, KeyError, pa.ArrowException) as error:  # KeyError: two columns of one name
        raise InputError(source, [f"cannot be read as Parquet: {error}"]) from None
    return columns, RowProblems(source, np.arange(len(read)), "row")


def _plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column whose times are texts of ISO 8601."""
    if pa.types.is_dictionary(column.type):
        return column.cast(column.type.value_type)
    if not pa.types.is_timestamp(column.type):
        return column
    return pc.strftime(column.cast(pa.timestamp(column.type.unit)), "%Y-%m-%dT%H:%M:%S")  # without its zone: in UTC


def _mask(values: pa.ChunkedArray) -> Mask:
    return np.array(values.to_numpy(zero_copy_only=False), dtype=bool)


def _cells(text: str, names: Sequence[str], source: str) -> tuple[list[pa.ChunkedArray], list[tuple[int, int, str]]]:
    """The columns, and lines with another number of cells: number from 1, cells and text."""
    if not text:
        return [pa.chunked_array([], pa.string()) for _ in names], []
    other: list[tuple[int, int, str]] = []

    def leave_out(row: csv.InvalidRow) -> str:
        other.append((row.number, row.actual_columns, row.text))
        return "skip"

    try:
        table = csv.read_csv(
            pa.BufferReader(text.encode("utf-8")),
            csv.ReadOptions(use_threads=False, column_names=list(names)),
            csv.ParseOptions(ignore_empty_lines=False, invalid_row_handler=leave_out),
            csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False),
        )
    except pa.ArrowInvalid as error:
        raise InputError(source, [f"is no table of cells with commas between them: {error}"]) from None
    return [pc.utf8_trim_whitespace(table[name]) for name in names], other
