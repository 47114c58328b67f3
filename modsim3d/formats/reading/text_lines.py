"""Numbers from the lines of a text file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from modsim3d.formats.reading.builder import Problems
from modsim3d.inputs.text_files import read_text


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
    """
    for index, line in enumerate(read_text(path, what).splitlines()):
        if not line.strip():
            continue
        where = f"{path.name} line {index + 1}"
        try:
            numbers = [float(part) for part in line.strip().removesuffix(separator or "").split(separator)]
        except ValueError:
            problems.add(f"{where}: must be numbers (got {line[:60]!r})")
            continue
        if len(numbers) < least:
            problems.add(f"{where}: has {len(numbers)} numbers, must have at least {least} (got {line[:60]!r})")
        elif not all(map(math.isfinite, numbers)):
            problems.add(f"{where}: must be finite (got {line[:60]!r})")
        else:
            yield where, numbers
