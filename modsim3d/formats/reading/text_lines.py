"""Numbers from the lines of a text file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import Problems
from modsim3d.inputs.budgets import MAX_LINE_CHARACTERS
from modsim3d.inputs.misreadings import LOST, has_lost_digits, no_commas
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import shown

_LOOKED_AT_LINES = 20


def number_lines(
    path: Path, what: str, separator: str | None, least: int, problems: Problems
) -> Iterator[tuple[str, list[float]]]:
    """Lines of numbers, each with its place in the file; skips empty lines.

    Args:
        path: The file.
        what: Name of the file in messages.
        separator: Between numbers, and perhaps at the end of a line; white space if None.
        least: Numbers that a line must have.
        problems: Collects the lines that are wrong.

    Raises:
        InputError: The file cannot be read, or its first lines hold no number at all.
    """
    lines = read_text(path, what).splitlines()
    begin = list(islice(filter(str.strip, lines), _LOOKED_AT_LINES))
    cells = (cell for line in begin for cell in line[:MAX_LINE_CHARACTERS].split(separator))
    if begin and not any(map(_is_number, cells)):
        form = "white space" if separator is None else f"'{separator}'"
        told = f"its first lines hold no numbers, must be numbers with {form} between them{_why(begin[0], separator)}"
        raise InputError(f"{what} {path}", [told])
    for index, line in enumerate(lines):
        if not line.strip():
            continue
        where = f"{path.name} line {index + 1}"
        if len(line) > MAX_LINE_CHARACTERS:
            problems.add(f"{where}: has {len(line):,} characters, must have at most {MAX_LINE_CHARACTERS:,}")
            continue
        try:
            parts = line.strip().removesuffix(separator or "").split(separator)
            numbers = [float(part) for part in parts]
        except ValueError:
            problems.add(f"{where}: must be numbers (got {shown(line)}){_why(line, separator)}")
            continue
        if len(numbers) < least:
            problems.add(f"{where}: has {len(numbers)} numbers, must have at least {least} (got {shown(line)})")
        elif separator and has_lost_digits(parts[1]):  # of MOT, whose second number is an identity
            problems.add(f"{where}: identity {LOST} (got {shown(parts[1])})")
        elif not all(map(math.isfinite, numbers)):
            problems.add(f"{where}: must be finite (got {shown(line)})")
        else:
            yield where, numbers


def _why(line: str, separator: str | None) -> str:
    """Why the numbers of a line cannot be read, to be added to a message; empty if that is not known."""
    return no_commas(line) if separator else ": commas stand neither between nor in them" * ("," in line)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
