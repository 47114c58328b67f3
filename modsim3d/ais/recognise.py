"""Opens a file of AIS reports, gzipped or not, and recognises its format by its content."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from modsim3d.ais.layouts import NEEDED, Layout, layout_of, layouts
from modsim3d.errors import InputError
from modsim3d.inputs.validation import shown

GZIP = b"\x1f\x8b"
UNPACKED_BY = {b"PK\x03\x04": "unzip", b"\x28\xb5\x2f\xfd": "zstd -d"}
SENTENCE = re.compile(rb"[!$][A-Z]{2}VD[MO],")
LOOKED_AT_LINES = 200
"""A log of sentences may begin with comments or sentences of other instruments."""
LONGEST_LINE = 1 << 20


def source_of(path: Path) -> str:
    """The name of a file in an error."""
    return f"AIS file {path}"


@contextmanager
def open_reports(path: Path) -> Iterator[IO[bytes]]:
    """The bytes of a file, unpacked if it is gzipped, whatever its name.

    Raises:
        InputError: It cannot be read or unpacked, also later while it is being read.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(4)
            file.seek(0)
            if magic in UNPACKED_BY:
                problem = f"is packed: unpack it first ({UNPACKED_BY[magic]} {path.name})"
                raise InputError(source_of(path), [problem])
            if magic.startswith(GZIP):
                with gzip.open(file) as unpacked:
                    yield io.BufferedReader(unpacked, 1 << 20)
            else:
                yield file
            return
    except FileNotFoundError:
        problem = "no such file"
    except IsADirectoryError:
        problem = "this is a folder, a file was expected"
    except (gzip.BadGzipFile, EOFError, zlib.error):
        problem = "is not a complete gzip file"
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
    raise InputError(source_of(path), [problem])


def recognise(path: Path) -> Layout | None:
    """The layout of a CSV file, or None for NMEA sentences.

    Raises:
        InputError: It is neither, is empty, or lacks columns that must be there.
    """
    with open_reports(path) as file:
        lines = [line for _ in range(LOOKED_AT_LINES) if (line := file.readline(LONGEST_LINE)).strip()]
    if not lines:
        raise InputError(source_of(path), ["the file is empty"])
    if any(SENTENCE.search(line) for line in lines):
        return None
    header = header_names(lines[0])
    layout = layout_of(header)
    if layout is None:
        known = ", ".join(f"{known.name} ({','.join(known.columns[name] for name in NEEDED)})" for known in layouts())
        problem = (
            f"is none of the formats that are read: NMEA sentences (!AIVDM,...) or CSV with the columns of {known}. "
            f"Its first line: {shown(lines[0].decode('utf-8', 'replace').strip())}"
        )
        raise InputError(source_of(path), [problem])
    if missing := layout.missing(header):
        problem = f"looks like {layout.name} CSV, but has no column {', '.join(missing)} (it has: {', '.join(header)})"
        raise InputError(source_of(path), [problem])
    return layout


def header_names(line: bytes) -> list[str]:
    """The names in the first line of a CSV file."""
    text = line.decode("utf-8-sig", "replace").strip("\r\n")
    try:
        return next(csv.reader([text]), [])
    except csv.Error:  # a cell of more than 128 KiB
        return []
