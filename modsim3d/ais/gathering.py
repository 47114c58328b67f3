"""Reads all files and keeps what a scene may need."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from modsim3d.ais.cleaning import sift, without_position
from modsim3d.ais.coordinate_order import check_order, exchanged
from modsim3d.ais.layouts import Layout
from modsim3d.ais.options import COMMAND_LINE, Options, time_text
from modsim3d.ais.recognise import recognise, source_of
from modsim3d.ais.reports import Chunk, Particulars, Positions
from modsim3d.arrays import Array
from modsim3d.errors import InputError

NMEA = "NMEA sentences"
WITHOUT_POSITION = "particulars_only"
BAD_SHARE, FEW_BAD = 0.1, 2
"""A file is refused if more than this share of its messages, and more than this number, cannot be read."""
BAD = ("unreadable", "checksum", "undecodable")
SHOWN_PROBLEMS = 20


@dataclass
class FileTally:
    """What was found in one file.

    Attributes:
        path: The file.
        format: Name of its format.
        messages: Number of messages read.
        dropped: Reason → number of messages dropped when the file was read.
        problems: One line on each of the first dropped messages.
    """

    path: Path
    format: str
    messages: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


@dataclass
class Extent:
    """The least and greatest time, latitude and longitude of all positions that were read, shape (3,) each."""

    least: Array = field(default_factory=lambda: np.full(3, np.inf))
    greatest: Array = field(default_factory=lambda: np.full(3, -np.inf))

    def add(self, positions: Positions) -> None:
        """Widen it by some positions."""
        known = positions.take(~without_position(positions))
        if len(known):
            values = np.stack([known.time_s, known.latitude_deg, known.longitude_deg])
            self.least = np.minimum(self.least, values.min(axis=1))
            self.greatest = np.maximum(self.greatest, values.max(axis=1))

    def __str__(self) -> str:
        """As an error message says it."""
        if not np.isfinite(self.least).all():
            return "the files hold no positions at all"
        (first, south, west), (last, north, east) = self.least, self.greatest
        return (
            f"the files reach from {time_text(first)} to {time_text(last)}, "
            f"latitude {south:.4f} to {north:.4f}, longitude {west:.4f} to {east:.4f}"
        )


@dataclass(frozen=True, eq=False)
class Gathered:
    """What was kept of all files.

    Attributes:
        positions: Positions of ships in the region and span that the user chose.
        particulars: Particulars of all vessels.
        files: One tally each.
        extent: What all positions cover, also those that were dropped.
    """

    positions: Positions
    particulars: Particulars
    files: list[FileTally]
    extent: Extent

    @property
    def dropped(self) -> Counter[str]:
        """Reason → number of messages left out, in all files."""
        return sum((tally.dropped for tally in self.files), Counter[str]())


def gather(paths: Sequence[Path], options: Options) -> Gathered:
    """Read files of any of the known formats.

    Args:
        paths: The files.
        options: Region and span of time; positions up to the longest gap before and after are kept as well.

    Raises:
        InputError: A file cannot be read or is of no known format (every such file is named), too much of it cannot be
            read, or latitude and longitude are swapped.
    """
    layouts = _formats(paths)
    if not layouts:
        raise InputError("AIS", ["no files given"])
    if options.swap_coordinates and not any(layouts):
        problem = "--swap-coordinates is for tables; AIS sentences say which number is the latitude"
        raise InputError(COMMAND_LINE, [problem])
    tallies = [
        FileTally(path, NMEA if layout is None else layout.name) for path, layout in zip(paths, layouts, strict=True)
    ]
    extent = Extent()
    parts = [
        part
        for tally, layout in zip(tallies, layouts, strict=True)
        for part in _read_file(tally, layout, options, extent)
    ]
    positions, particulars = zip(*parts, strict=True)
    return Gathered(Positions.join(positions), Particulars.join(particulars), tallies, extent)


def _read_file(
    tally: FileTally, layout: Layout | None, options: Options, extent: Extent
) -> Iterator[tuple[Positions, Particulars]]:
    """Positions and particulars of one file, a part at a time; fills in its tally and widens the extent."""
    for chunk in _chunks(tally.path, layout):
        _count(chunk, tally)
        positions = chunk.positions
        if layout is not None and options.swap_coordinates:
            positions = exchanged(positions)
        # Radio lets single wrong bits through, and a region leaves impossible positions out.
        if layout is not None and options.region is None:
            check_order(source_of(tally.path), positions, options.swap_coordinates)
        extent.add(positions)
        kept, dropped = sift(positions, options.region, *options.window_s)
        tally.dropped.update(dropped)
        yield kept, chunk.particulars
    _refuse_rubbish(tally)


def _formats(paths: Sequence[Path]) -> list[Layout | None]:
    layouts: list[Layout | None] = []
    problems: list[str] = []
    sources = []
    for path in paths:
        try:
            layouts.append(recognise(path))
        except InputError as error:
            sources.append(error.source)
            problems += [f"{error.source}: {problem}" for problem in error.problems]
            only = error
    if len(problems) == 1:
        raise only
    if problems:
        raise InputError("AIS files", problems)
    return layouts


def _chunks(path: Path, layout: Layout | None) -> Iterator[Chunk]:
    if layout is None:
        from modsim3d.ais.read_nmea import read_nmea

        return read_nmea(path)
    from modsim3d.ais.read_csv import read_csv

    return read_csv(path, layout)


def _count(chunk: Chunk, tally: FileTally) -> None:
    tally.messages += chunk.messages
    tally.dropped.update(chunk.dropped)
    others = chunk.messages - len(chunk.positions) - sum(chunk.dropped.values())
    tally.dropped.update({WITHOUT_POSITION: others})
    tally.problems += chunk.problems[: SHOWN_PROBLEMS - len(tally.problems)]


def _refuse_rubbish(tally: FileTally) -> None:
    bad = sum(tally.dropped[reason] for reason in BAD)
    if bad and (bad == tally.messages or bad > max(FEW_BAD, BAD_SHARE * tally.messages)):
        raise InputError(
            source_of(tally.path),
            [*tally.problems, f"too much of it cannot be read: {bad} of {tally.messages} messages"],
        )
