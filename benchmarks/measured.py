"""What a benchmark gives: rows of a table, sections and profiles; and how numbers are written."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.processes import ROOT, child, say

BUSY_LOAD = 0.5
"""More than this many processes waiting for a core before the start, and the figures are marked."""


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        figure: What was measured.
        promise: What it should be; empty if nothing was promised.
        measured: What it is.
        met: Whether it is; None if nothing was promised.
        limit: The time over the time that memory needs for the drawn regions, as text.
    """

    figure: str
    promise: str
    measured: str
    met: bool | None
    limit: str

    def cells(self) -> list[str]:
        """Its cells in the table."""
        verdict = {True: "yes", False: "**no**", None: "–"}[self.met]
        return [self.figure, self.promise or "–", self.measured, verdict, self.limit]


@dataclass
class Found:
    """What measuring gave."""

    rows: list[Row] = field(default_factory=list)
    sections: list[str] = field(default_factory=list)
    profiles: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Bench:
    """How much to measure, and where.

    Attributes:
        quick: One round of little work: a trial of the bench and not a measurement.
        folder: For files that are thrown away.
        bytes_per_s: Memory bandwidth of this machine.
    """

    quick: bool
    folder: Path
    bytes_per_s: float

    def rounds(self, wanted: int = 5) -> Iterator[int]:
        """The rounds of a figure."""
        for number in range(1 if self.quick else wanted):
            say(f"  round {number + 1}")
            yield number

    def steps(self, wanted: int) -> int:
        """That many steps, or a tenth of them in a trial."""
        return max(wanted // 10, 1) if self.quick else wanted

    def times_limit(self, seconds: float, drawn_bytes: float) -> str:
        """How many times longer than memory needs to be written with what is drawn."""
        if not drawn_bytes:
            return "nothing is drawn"
        return significant(seconds * self.bytes_per_s / drawn_bytes)

    def scene(self, name: str, text: str) -> str:
        """A scene file of that text, with paths that hold where it is."""
        path = self.folder / f"{name}.yaml"
        detectors = (ROOT / "scenes" / "detectors").as_posix()
        path.write_text(
            text.replace("../scenes/detectors", detectors).replace("detector: detectors", f"detector: {detectors}")
        )
        return str(path)


def significant(value: float, digits: int = 3) -> str:
    """A number with three digits, without exponent."""
    if value == 0:
        return "0"
    places = max(digits - 1 - int(f"{value:e}".partition("e")[2]), 0)
    return f"{round(value, places):,.{places}f}" if places else f"{float(f'{value:.{digits}g}'):,.0f}"


def spread(values: Sequence[float], unit: str = "") -> str:
    """Median, and least to greatest."""
    middle = f"{significant(statistics.median(values))}{unit}"
    if len(values) == 1:
        return f"{middle} (one round)"
    return f"{middle} ({significant(min(values))}–{significant(max(values))})"


def ratios(upper: Sequence[float], lower: Sequence[float]) -> list[float]:
    """Round by round."""
    return [a / b for a, b in zip(upper, lower, strict=True)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def profile_text(title: str, rows: Sequence[Sequence[str]]) -> str:
    return f"### {title}\n\n" + table(("own s", "with calls s", "calls", "where"), rows)


def profile_of_run(title: str, **given: Any) -> str:
    say("  profile, because it falls short")
    return profile_text(title, child("profile", **given)["rows"])
