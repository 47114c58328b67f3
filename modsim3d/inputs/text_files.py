"""The text of an input file, gzipped or not, within a budget, and what marks it as no table with commas."""

from __future__ import annotations

import unicodedata
from pathlib import Path

from modsim3d.inputs import budgets
from modsim3d.inputs.opening import open_input


def read_text(path: Path, what: str, most_bytes: int | None = None) -> str:
    """The text of an input file, unpacked if it is gzipped; its name does not matter.

    Its lines end with line feeds, it has no byte order mark, and letters with accents are one character each (NFC):
    files of Macs have them apart, so that one name would be two.

    Args:
        path: The file.
        what: What it is, for errors.
        most_bytes: Budget of the text; None for that of all texts.

    Raises:
        InputError: As `open_input`.
    """
    with open_input(path, what, most_bytes or budgets.MAX_TEXT_BYTES) as file:
        content = bytearray()
        while piece := file.read(budgets.PIECE_BYTES):
            content += piece
        text = content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
        return text if text.isascii() else unicodedata.normalize("NFC", text)


def no_commas(first_line: str) -> str:
    """Why the first line of a table has no commas between its cells, to be added to a message; empty if it has."""
    if first_line.strip().lower().startswith("sep="):
        return ": line 1 is for spreadsheets alone, leave it out"
    marks = {";": "semicolons", "\t": "tabs", "|": "bars"}
    found = [word for mark, word in marks.items() if first_line.count(mark) > first_line.count(",")]
    return f": its cells have {found[0]} between them, must have commas" if found else ""
