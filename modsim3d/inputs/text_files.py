"""The text of an input file, gzipped or not, within a budget."""

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
        return composed(content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n"))


def composed(text: str) -> str:
    """A text or the name of a file with letters and their accents as one character each, as `read_text` has them."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)
