"""Opens a file of AIS reports, gzipped or not, and recognises its format by its content."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from modsim3d.ais.layouts import NEEDED, Layout, layout_of, layouts
from modsim3d.errors import InputError
from modsim3d.inputs.misreadings import no_commas
from modsim3d.inputs.opening import open_input
from modsim3d.inputs.validation import shown

UNPACKED_BY = {b"PK\x03\x04": "unzip", b"\x28\xb5\x2f\xfd": "zstd -d"}
SENTENCE = re.compile(rb"[!$][A-Z]{2}VD[MO],")
LOOKED_AT_LINES = 200
"""A log of sentences may begin with comments or sentences of other instruments."""
LONGEST_LINE, LOOKED_AT_BYTES = 1 << 20, 1 << 22
MOST_COLUMNS = 500
"""A header with more names is no table of AIS, which have up to thirty; each costs memory in every row."""
SHOWN_COLUMNS = 40


def source_of(path: Path) -> str:
    """The name of a file in an error."""
    return f"AIS file {path}"


@contextmanager
def open_reports(path: Path) -> Iterator[io.BufferedReader]:
    """The bytes of a file, unpacked if it is gzipped, whatever its name.

    Raises:
        InputError: It cannot be read or unpacked, also later while it is being read.
    """
    with open_input(path, "AIS file") as file:
        packed_by = UNPACKED_BY.get(file.peek(4)[:4])
        if packed_by:
            raise InputError(source_of(path), [f"is packed: unpack it first ({packed_by} {path.name})"])
        yield file


def recognise(path: Path) -> Layout | None:
    """The layout of a CSV file, or None for NMEA sentences.

    Raises:
        InputError: It is neither, is empty, or lacks columns that must be there.
    """
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
        known = ", ".join(f"{known.name} ({','.join(known.columns[name] for name in NEEDED)})" for known in layouts())
        problem = (
            f"is none of the formats that are read: NMEA sentences (!AIVDM,...) or CSV with the columns of {known}"
        )
        raise InputError(source_of(path), [problem + no_commas(lines[0].decode("utf-8", "replace"))])
    if len(header) > MOST_COLUMNS:
        problem = f"looks like {layout.name} CSV, but has {len(header):,} columns, more than {MOST_COLUMNS}"
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
        line = file.readline(min(LONGEST_LINE, left))
        left -= len(line)
        yield line


def header_names(line: bytes) -> list[str]:
    """The names in the first line of a CSV file."""
    text = line.decode("utf-8", "replace").strip("\r\n")
    try:
        return next(csv.reader([text]), [])
    except csv.Error:  # a cell of more than 128 KiB
        return []
