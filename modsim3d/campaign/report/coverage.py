"""The sections of a page on what a campaign covered, and what not."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.folder import FILE, VERDICTS, CampaignFolder
from modsim3d.campaign.keys import CampaignKeys, Range
from modsim3d.campaign.plan import Plan, text_of
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.verdicts.wording import with_name
from modsim3d.campaign.work.coverage import COVERED, KINDS, MET, OCCLUSIONS, RANGES, SIZES, VESSELS
from modsim3d.campaign.work.row import DONE
from modsim3d.campaign.work.task import PLAN
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.document import Block, BlockRow, Heading, Items, Table, Text
from modsim3d.core.text import UNKNOWN, counted, listed
from modsim3d.view.pages.provenance import shown_path

_NEEDED = (COVERED, MET, "condition", "frames", "traffic_seed")
"""How the columns begin that are counted; those of scores are many, and left where they are."""


@dataclass(frozen=True)
class CountedBin:
    """A bin."""

    label: str
    count: int  # how often it was met, each truth counted once
    runs: int  # number of those in which it was
    seeds: int  # number of traffic seeds in which it was

    @property
    def cells(self) -> list[str]:
        """As a page shows them; dashes if there was none."""
        numbers = [f"{number:,}" for number in (self.count, self.runs, self.seeds)] if self.count else [UNKNOWN] * 3
        return [self.label, *numbers]


@dataclass(frozen=True, eq=False)
class RunGroups:
    """Rows that each stand for several runs: n of them."""

    rows: pa.Table  # columns of the first run of each
    runs: Indices  # number of runs of each, shape (n,)

    @classmethod
    def by(cls, table: pa.Table, key: str) -> Self:
        """The rows of runs that are done, one for each value of a column."""
        needed = [name for name in table.column_names if name.startswith(_NEEDED) or name.endswith(".frames")]
        done = table.select(list(dict.fromkeys([key, *needed]))).filter(pc.equal(table["status"], DONE))
        codes = done[key].combine_chunks().dictionary_encode().indices.to_numpy(zero_copy_only=False)
        _, first, runs = np.unique(codes, return_index=True, return_counts=True)
        return cls(done.take(pa.array(first, pa.int64())), np.asarray(runs, dtype=np.int64))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.runs)

    def numbers(self, name: str) -> Array:
        """A column, NaN for null and where there is no such column, shape (n,)."""
        if name not in self.rows.column_names:
            return np.full(len(self), np.nan)
        return np.asarray(self.rows[name].to_numpy(zero_copy_only=False), dtype=np.float64)

    def in_rows(self, chosen: Mask, label: str, count: int) -> CountedBin:
        """A bin that is in some of the rows."""
        seeds = self.rows["traffic_seed"].to_numpy()[chosen]
        return CountedBin(label, count, int(self.runs[chosen].sum()), len(np.unique(seeds)))


class Truths(RunGroups):
    """The truths of a campaign: what all runs over one truth have in common is counted once."""

    @classmethod
    def of(cls, table: pa.Table) -> Self:
        """The truths of all runs that are done."""
        return cls.by(table, "truth_key")

    @property
    def runs_in_all(self) -> int:
        """Number of runs that are done."""
        return int(self.runs.sum())

    @property
    def seeds_in_all(self) -> int:
        """Number of traffic seeds that differ in their truth."""
        return len(np.unique(self.rows["traffic_seed"].to_numpy()))

    def known(self, name: str) -> bool:
        """Whether any run has a column."""
        return bool(np.isfinite(self.numbers(name)).any())

    def total(self, name: str) -> float:
        """The sum of a column over the truths."""
        return float(np.nansum(self.numbers(name)))

    def counted(self, name: str, label: str) -> CountedBin:
        """The bin of a column that counts."""
        values = self.numbers(name)
        return self.in_rows(values > 0, label, int(np.nansum(values)))

    def within(self, name: str, low: float, high: float, label: str) -> CountedBin:
        """Truths in which a column is at least `low` and below `high`."""
        values = self.numbers(name)
        chosen = (values >= low) & (values < high)
        return self.in_rows(chosen, label, int(np.count_nonzero(chosen)))

    def unknown(self, name: str, label: str) -> CountedBin:
        """Truths in which a column is null."""
        chosen = np.isnan(self.numbers(name))
        return self.in_rows(chosen, label, int(np.count_nonzero(chosen)))

    def span(self, least: str, most: str, unit: str, what: str = "All of them") -> str:
        """The least and the greatest of all truths in words; empty if there are none."""
        low, high = self.numbers(least), self.numbers(most)
        if not np.isfinite(low).any():
            return ""
        return f"{what}: from {_short(np.nanmin(low))} to {_short(np.nanmax(high))} {unit}."


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def counted_states(folder: CampaignFolder, table: pa.Table) -> tuple[CountedBin, ...]:
    """Frames in each performance state, the frames of a detector over a truth counted once."""
    looks = RunGroups.by(table, "detections_key")
    conditions = folder.facts["conditions"]
    condition = looks.rows["condition"].to_numpy()
    bins = []
    for state in dict.fromkeys(state for entry in conditions for state in entry["states"]):
        only = np.isin(condition, [index for index, entry in enumerate(conditions) if entry["states"] == [state]])
        frames = np.nan_to_num(np.where(only, looks.numbers("frames"), looks.numbers(f"state.{state}.frames")))
        bins.append(looks.in_rows(frames > 0, state, int(frames.sum())))
    return tuple(bins)


_MAX_RANGES = 6
_MAX_ROWS = 200  # of a table; the files of the campaign have all
_DIGITS = 16  # hexadecimal digits of a checksum on the page; `plan.json` has all


def trace_sections(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> list[Block]:
    """Evidence of each verdict: runs, seeds, checksums, versions, and the commands that repeat it."""
    return [
        Heading("What each verdict rests on"),
        *_verdicts(folder.plan, table, verdicts),
        *_conditions(folder),
        *_repeating(folder, table),
    ]


def _verdicts(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict]) -> Iterator[Block]:
    if not verdicts:
        yield Text("The campaign has no requirements.")
        return
    conditions = table["condition"].to_numpy()
    trackers = table["tracker"].to_numpy(zero_copy_only=False)
    runs, seeds, looks = (table[name].to_numpy() for name in ("run", "traffic_seed", "detector_seed"))
    names, rows = {tracker.label for tracker in plan.keys.trackers}, []
    for verdict in verdicts[:_MAX_ROWS]:
        labels = [verdict.tracker]
        if verdict.tracker not in names:  # a difference between two
            requirement = plan.keys.require[verdict.requirement]
            labels = [label for label in (requirement.of, requirement.minus) if label is not None]
        chosen = (conditions == verdict.condition) & np.isin(trackers, labels)
        text, numbers = f"{verdict.requirement + 1}. {with_name(verdict.text)}", numbers_in_words(runs[chosen])
        counts = numbers_in_words(np.unique(seeds[chosen])), f"{len(np.unique(looks[chosen]))}"
        rows.append([text, verdict.tracker, f"{verdict.condition}", verdict.outcome, numbers, *counts])
    header = ["requirement", "tracker", "condition", "outcome", "runs", "traffic seeds", "detector seeds"]
    yield Table("", header, rows)
    yield from _omission(len(verdicts), VERDICTS)


def _omission(count: int, file: str) -> Iterator[Block]:
    if count > _MAX_ROWS:
        yield Text(f"{count - _MAX_ROWS} more are in {file}.")


def numbers_in_words(numbers: Indices) -> str:
    """Ascending numbers, shape (n,): `3, 9, … 57 (10, every 6th)`, or ranges; at most six of them."""
    values = numbers.tolist()
    if not values:
        return "none"
    steps = np.diff(numbers)
    if len(values) > 3 and len(set(steps.tolist())) == 1 and steps[0] > 1:
        return f"{values[0]}, {values[1]}, … {values[-1]} ({len(values)} of them, {int(steps[0])} apart)"
    ends = np.flatnonzero(steps != 1)
    firsts, lasts = numbers[np.append(0, ends + 1)], numbers[np.append(ends, -1)]
    ranges = [f"{a}" if a == b else f"{a}–{b}" for a, b in zip(firsts, lasts, strict=True)]
    more = f" and {len(ranges) - _MAX_RANGES} ranges more" if len(ranges) > _MAX_RANGES else ""
    return ", ".join(ranges[:_MAX_RANGES]) + more + (f" ({len(values)} of them)" if len(values) > 1 else "")


def _conditions(folder: CampaignFolder) -> Iterator[Block]:
    rows = []
    conditions = folder.facts["conditions"]
    for number, condition in enumerate(conditions[:_MAX_ROWS]):
        values = ", ".join(f"{key} {text_of(value)}" for key, value in condition["values"].items())
        sums = (condition[name][:_DIGITS] for name in ("truth_sha256", "detector_sha256"))
        rows.append([f"{number}", condition["scene"], values or "as it is", *sums])
    yield Table("Conditions", ["condition", "scene", "values", "SHA-256 of the scene", "SHA-256 of the detector"], rows)
    yield from _omission(len(conditions), PLAN)
    if folder.plan.drawn:
        keys = ", ".join(folder.plan.drawn)
        yield Text(f"Checksums are those of the first traffic seed: {keys} differ from seed to seed.", "soft")


def _repeating(folder: CampaignFolder, table: pa.Table) -> Iterator[Block]:
    number = int(table["run"][0].as_py()) if len(table) else 0
    versions = dict(folder.facts["versions"])
    for condition in folder.facts["conditions"]:
        for tracker in condition["trackers"].values():
            versions |= tracker["versions"]
    yield Table("Versions", ["package", "version"], list(versions.items()))
    yield Heading("Again", 3)
    yield Text(
        f"SHA-256 of the plan: {folder.facts['sha256']}. {PLAN} has all checksums in full. With the same plan and the "
        "same versions the rows come out the same, byte by byte. "
        f"Paths in {FILE} are relative to {shown_path(Path(folder.facts['base']))}."
    )
    path, again = folder.path, f"{folder.path.name}_again"
    commands = {
        "the whole campaign again": ["modsim3d", "campaign", "run", str(path / FILE), "--out", again],
        f"run {number} alone": ["modsim3d", "campaign", "reproduce", str(path), str(number), "--out", f"run_{number}"],
    }
    for what, words in commands.items():
        yield Text(f"{what[0].upper()}{what[1:]}:")
        yield Text(shlex.join(words), "code")


TENTHS, QUARTERS = 10, 4  # a range is looked at in tenths, and each pair of ranges in squares of quarters


def empty_draws(keys: CampaignKeys, table: pa.Table) -> list[str]:
    """Parts of the drawn ranges that have no run that is done, in words."""
    done = table.filter(pc.equal(table["status"], DONE))
    drawn = {key: values for factor in keys.vary for key, values in factor.ranges.items() if key in table.column_names}
    gaps = [text for key, values in drawn.items() for text in _of_key(key, values, done[key])]
    numbers = {key: values for key, values in drawn.items() if values.choices is None}
    for one, other in combinations(numbers, 2):
        quarters = (np.floor(_shares(numbers[key], done[key]) * QUARTERS).tolist() for key in (one, other))
        if missing := QUARTERS**2 - len(set(zip(*quarters, strict=True))):
            gaps.append(f"{one} with {other}: no draw in {missing} of {QUARTERS**2} squares of quarters of both ranges")
    return gaps


def _of_key(key: str, values: Range, column: pa.ChunkedArray) -> Iterator[str]:
    if values.choices is not None:
        as_text = pa.types.is_string(column.type)  # so it is if not all choices are numbers
        draws = set(column.to_pylist())
        missing = [text_of(value) for value in values.choices if (text_of(value) if as_text else value) not in draws]
        if missing:
            yield f"{key}: {', '.join(missing)}: never drawn"
        return
    filled = np.zeros(TENTHS, dtype=bool)
    filled[np.floor(_shares(values, column) * TENTHS).astype(int)] = True
    parts = [[_at(values, place / TENTHS) for place in part] for part in _stretches(~filled)]
    if parts:
        yield f"{key}: no draw from {', '.join(f'{low:.4g} to {high:.4g}' for low, high in parts)}"


def _shares(values: Range, column: pa.ChunkedArray) -> Array:
    """Places of drawn values in their range, in [0, 1), shape (n,)."""
    assert values.low is not None and values.high is not None
    drawn, ends = np.asarray(column.to_numpy(), dtype=np.float64), np.array([values.low, values.high])
    if values.whole:
        ends[1] += 1
    if values.scale == "log" and not values.whole:
        drawn, ends = np.log10(drawn), np.log10(ends)
    shares: Array = np.clip((drawn - ends[0]) / (ends[1] - ends[0]), 0.0, np.nextafter(1.0, 0.0))
    return shares


def _at(values: Range, share: float) -> float:
    assert values.low is not None and values.high is not None
    if values.scale == "log" and not values.whole:
        return float(values.low * (values.high / values.low) ** share)
    return values.low + share * (values.high - values.low)


def _stretches(empty: Mask) -> Iterator[tuple[int, int]]:
    """First and stop of each stretch of empty parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], empty, [False]])))
    return ((int(first), int(stop)) for first, stop in list(pairwise(edges.tolist()))[::2])


NO_CLAIM = (
    "A verdict holds for what is counted here. A dash stands for what was not covered: no claim is made about it."
)
_ENCOUNTERS = "head-on", "crossing from starboard", "crossing from port", "own ship overtakes", "own ship is overtaken"
ENCOUNTERS = dict(zip(KINDS.values(), _ENCOUNTERS, strict=True))
_DEGREES = "calm", "smooth", "slight", "moderate", "rough", "very rough", "high", "very high"
SEAS = dict(zip(_DEGREES, (0.0, 0.1, 0.5, 1.25, 2.5, 4.0, 6.0, 9.0), strict=True))
"""Degrees of the sea, WMO code table 3700, and the significant height in metres from which on."""
ROLLS_DEG = (0.0, 2.0, 5.0, 10.0, 20.0)
_FRAMES = "vessel-frames"


@dataclass(frozen=True)
class CoverageTable:
    """A table of a page."""

    title: str  # what its bins are of
    unit: str  # what is counted
    rows: tuple[CountedBin, ...]
    note: str = ""  # sentence on what the bins mean, or why there are none

    @property
    def empty(self) -> tuple[str, ...]:
        """The bins that nothing is in."""
        return tuple(row.label for row in self.rows if not row.count)

    @property
    def block(self) -> Table:
        """The table with its note."""
        header = ["", self.unit, "runs", "traffic seeds"]
        return Table(self.title, header, [row.cells for row in self.rows], about=self.note)


def coverage_sections(folder: CampaignFolder, table: pa.Table) -> list[Block]:
    """Coverage of the rows of a campaign, in the order of a page."""
    truths = Truths.of(table)
    parts = tuple(_parts(folder, table, truths))
    return [
        Heading("What was covered"),
        Text(_extent(folder, table, truths)),
        Text(NO_CLAIM),
        *_gaps(folder, table, parts),
        BlockRow([part.block for part in parts]),
        *_trackers(folder),
    ]


def _extent(folder: CampaignFolder, table: pa.Table, truths: Truths) -> str:
    crashed = len(table) - truths.runs_in_all
    text = (
        f"{truths.runs_in_all:,} of {counted(len(folder.plan), 'run')} are done, over "
        f"{counted(len(truths), 'different truth')} and {counted(truths.seeds_in_all, 'traffic seed')}."
    )
    if crashed:
        text += f" {crashed:,} more crashed and cover nothing."
    fixed = sorted({entry["scene"] for entry in folder.facts["conditions"] if not entry["traffic_has_seed"]})
    if fixed:
        text += f" The traffic of {', '.join(fixed)} is not drawn: it is the same for every seed, and counts as one."
    return text


def _parts(folder: CampaignFolder, table: pa.Table, truths: Truths) -> Iterator[CoverageTable]:
    """All tables; the counts of a truth are counted once, however many detectors and trackers met it."""
    yield _encounters(truths)
    yield CoverageTable("Performance states of the detector", "frames", counted_states(folder, table))
    classes = sorted(name for name in table.column_names if name.startswith(VESSELS))
    seen = tuple(truths.counted(name, name.removeprefix(VESSELS)) for name in classes)
    yield CoverageTable("Classes", "vessels", seen, "Vessels that a camera saw.")
    span = truths.span("covered.least_range_m", "covered.most_range_m", "m")
    note = f"Distance of a visible vessel from the camera. {span}"
    yield CoverageTable("Range", _FRAMES, _binned(truths, RANGES.names, RANGES.labels), note)
    span = truths.span("covered.least_size_px", "covered.most_size_px", "px")
    note = f"√(width × height) of the box of a visible vessel. {span}"
    yield CoverageTable("Size", _FRAMES, _binned(truths, SIZES.names, SIZES.labels), note)
    yield _occlusions(truths)
    yield _waves(truths)
    yield _rolls(truths)


def _binned(truths: Truths, names: Sequence[str], labels: Sequence[str]) -> tuple[CountedBin, ...]:
    return tuple(truths.counted(*pair) for pair in zip(names, labels, strict=True))


def _encounters(truths: Truths) -> CoverageTable:
    title, unit = "Encounters of own ship", "encounters"
    if not truths.known("met.seen"):
        none = "No vessel carries a camera, so there is no own ship that could meet another."
        return CoverageTable(title, unit, (), none)
    rows = tuple(truths.counted(*pair) for pair in ENCOUNTERS.items())
    met, seen = sum(row.count for row in rows), truths.counted("met.seen", "").count
    nearest = truths.span("covered.closest_approach_m", "covered.closest_approach_m", "m", "Closest approach of a run")
    note = (
        f"Vessels that came nearer and passed within a nautical mile; a camera saw {seen:,} of {met:,} before the "
        f"closest approach. {nearest}"
    )
    return CoverageTable(title, unit, rows, note)


def _occlusions(truths: Truths) -> CoverageTable:
    title, unit = "Occlusions by length", "occlusions"
    if not truths.known(OCCLUSIONS.names[0]):
        none = "The source of the truth cannot tell what is hidden: no occlusion is known."
        return CoverageTable(title, unit, (), none)
    hidden_s = truths.total("covered.hidden_s")
    note = "Less than half of the vessel's silhouette is visible. "
    note += f"Vessels are wholly hidden for {hidden_s:,.0f} s, all of them together."
    return CoverageTable(title, unit, _binned(truths, OCCLUSIONS.names, OCCLUSIONS.labels), note)


def _waves(truths: Truths) -> CoverageTable:
    name = "covered.wave_height_m"
    rows = []
    for (sea, low), (_, high) in pairwise((*SEAS.items(), ("", np.inf))):
        label = f"{sea} ({low:g} to {high:g} m)" if np.isfinite(high) else f"{sea} ({low:g} m and more)"
        rows.append(truths.within(name, low, high, label))
    unknown = truths.unknown(name, "wave levels, which have no height")
    note = "Significant wave height, by the degrees of WMO code table 3700."
    return CoverageTable("Sea", "truths", (*rows, *([unknown] if unknown.count else [])), note)


def _rolls(truths: Truths) -> CoverageTable:
    rows = []
    for low, high in pairwise((*ROLLS_DEG, 180.0)):
        label = f"{low:g} to {high:g}°" if high < 180 else f"{low:g}° and more"
        rows.append(truths.within("covered.camera_roll_rad", np.radians(low), np.radians(high), label))
    return CoverageTable("Roll of a camera", "truths", tuple(rows), "By the largest angle of the horizon in an image.")


def _gaps(folder: CampaignFolder, table: pa.Table, parts: Sequence[CoverageTable]) -> Iterator[Block]:
    gaps = [f"{part.title}: {', '.join(part.empty)}" for part in parts if part.empty]
    gaps += [f"{part.title}: {part.note}" for part in parts if not part.rows]
    gaps += empty_draws(folder.keys, table)
    yield Heading("Not covered", 3)
    yield Items(gaps or ["No bin is empty."])


def _trackers(folder: CampaignFolder) -> Iterator[Block]:
    by_row: dict[tuple[str, ...], list[int]] = {}
    for number, condition in enumerate(folder.facts["conditions"]):
        for label, facts in condition["trackers"].items():
            settings = ", ".join(f"{key} {value}" for key, value in sorted(facts["settings"].items()))
            row = label, facts["tracker"], facts["package"], settings or "defaults", facts["chosen"]
            by_row.setdefault(row, []).append(number)
    every = len(folder.facts["conditions"])
    rows = [
        [*row, "all" if len(numbers) == every else listed([*map(str, numbers)], 10)] for row, numbers in by_row.items()
    ]
    header = ["name", "tracker", "package", "settings", "where they are from", "conditions"]
    yield Table("Trackers and their settings", header, rows)
