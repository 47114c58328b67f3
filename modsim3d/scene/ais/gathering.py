"""Reads all files and keeps what a scene may need."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.io.input_files import MAX_BAD_ENTRIES
from modsim3d.scene.ais.messages import Chunk, Particulars, Positions, check_order, exchanged, sift, without_position
from modsim3d.scene.ais.options import COMMAND_LINE, Options, time_text
from modsim3d.scene.ais.read_csv import Layout, read_csv, recognise, source_of
from modsim3d.scene.ais.read_nmea import read_nmea

NMEA = "NMEA sentences"
BAD_SHARE, FEW_BAD = 0.1, 2  # a file with more than this share, and this number, of unreadable messages is refused
BAD = ("unreadable", "checksum", "undecodable")
SHOWN_PROBLEMS = 20


def by_sender(reason: str, mmsi: Indices) -> Counter[tuple[int, str]]:
    """Sender and reason → number of positions, given the sender of each, shape (n,)."""
    senders, counts = np.unique(mmsi, return_counts=True)
    return Counter({(sender, reason): count for sender, count in zip(senders.tolist(), counts.tolist(), strict=True)})


@dataclass
class FileTally:
    """Counts of one file."""

    path: Path
    format: str
    messages: int = 0  # read
    dropped: Counter[str] = field(default_factory=Counter)  # reason → messages, when the file was read
    senders: Counter[tuple[int, str]] = field(default_factory=Counter)
    """Sender and reason → number of positions dropped, of those that could be read."""
    problems: list[str] = field(default_factory=list)  # one line on each of the first dropped messages
    odd: str = ""  # what cannot be right in all messages; empty if nothing is

    def add(self, chunk: Chunk) -> None:
        """Count the messages of a part of the file."""
        self.messages, self.odd = self.messages + chunk.messages, chunk.odd
        self.dropped.update(chunk.dropped)
        self.dropped["particulars_only"] += chunk.messages - len(chunk.positions) - sum(chunk.dropped.values())
        self.problems += chunk.problems[: SHOWN_PROBLEMS - len(self.problems)]

    def drop(self, reason: str, mmsi: Indices) -> None:
        """Count positions that are dropped, given the sender of each, shape (n,)."""
        self.dropped[reason] += len(mmsi)
        self.senders.update(by_sender(reason, mmsi))

    def refuse_rubbish(self, whole: bool = True) -> None:
        """Raise an InputError if too many messages could not be read; of a part of the file, only if most of many."""
        bad = sum(self.dropped[reason] for reason in BAD)
        most = max(FEW_BAD, BAD_SHARE * self.messages) if whole else max(MAX_BAD_ENTRIES, self.messages / 2)
        if bad > most or (whole and bad and bad == self.messages):
            too_much = f"too much of it cannot be read: {bad} of {self.messages} messages"
            raise InputError(source_of(self.path), [*self.problems, too_much])


@dataclass
class Extent:
    """The least and greatest time, latitude and longitude of all positions that were read, shape (3,) each."""

    least: Array = field(default_factory=lambda: np.full(3, np.inf))
    greatest: Array = field(default_factory=lambda: np.full(3, -np.inf))

    def add(self, positions: Positions) -> None:
        """Widen it by some positions."""
        points = positions.take(~without_position(positions))
        values = np.stack([points.time_s, points.latitude_deg, points.longitude_deg])
        self.least = np.minimum(self.least, values.min(axis=1, initial=np.inf))
        self.greatest = np.maximum(self.greatest, values.max(axis=1, initial=-np.inf))

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
class GatheredReports:
    """Reports kept of all files."""

    positions: Positions  # of ships in the region and span that the user chose
    particulars: Particulars
    files: list[FileTally]
    extent: Extent  # of all positions, also those that were dropped

    @property
    def dropped(self) -> Counter[str]:
        """Reason → number of messages left out, in all files."""
        return sum((tally.dropped for tally in self.files), Counter[str]())


def gather(paths: Sequence[Path], options: Options) -> GatheredReports:
    """Read files of any of the known formats; positions up to the longest gap before and after the scene are kept.
    Raises InputError if a file cannot be read or is of no known format (every such file is named), too much of it
    cannot be read, or latitude and longitude are swapped."""
    layouts = _layouts(paths)
    if not layouts:
        raise InputError("AIS", ["no files given"])
    if options.swap_coordinates and not any(layouts):
        problem = "--swap-coordinates is for tables; AIS sentences say which number is the latitude"
        raise InputError(COMMAND_LINE, [problem])
    extent = Extent()
    tallies: list[FileTally] = []
    parts: list[tuple[Positions, Particulars]] = []
    for path, layout in zip(paths, layouts, strict=True):
        tally = FileTally(path, NMEA if layout is None else layout.name)
        tallies.append(tally)
        parts += _read_file(tally, layout, options, extent)
    positions, particulars = zip(*parts, strict=True)
    return GatheredReports(Positions.join(positions), Particulars.join(particulars), tallies, extent)


def _layouts(paths: Sequence[Path]) -> list[Layout | None]:
    """The layout of each CSV file, None for NMEA sentences; one error names all files that are neither."""
    layouts: list[Layout | None] = []
    errors: list[InputError] = []
    for path in paths:
        try:
            layouts.append(recognise(path))
        except InputError as error:
            errors.append(error)
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise InputError("AIS files", [f"{error.source}: {problem}" for error in errors for problem in error.problems])
    return layouts


def _read_file(
    tally: FileTally, layout: Layout | None, options: Options, extent: Extent
) -> Iterator[tuple[Positions, Particulars]]:
    """Positions and particulars of one file, a part at a time; fills in its tally and widens the extent."""
    for chunk in read_nmea(tally.path) if layout is None else read_csv(tally.path, layout):
        tally.add(chunk)
        tally.refuse_rubbish(whole=False)
        positions = chunk.positions
        if layout is not None and options.swap_coordinates:
            positions = exchanged(positions)
        # Radio lets single wrong bits through, and a region leaves impossible positions out.
        if layout is not None and options.region is None:
            check_order(source_of(tally.path), positions, options.swap_coordinates)
        extent.add(positions)
        kept, dropped = sift(positions, options.region, *options.window_s)
        for reason, mmsi in dropped.items():
            tally.drop(reason, mmsi)
        yield kept, chunk.particulars
    tally.refuse_rubbish()
