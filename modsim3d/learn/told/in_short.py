"""What was learned, from what and how well, in a few sentences and numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.display import counted, listed
from modsim3d.learn.false_positives.false_positive_estimate import NOT_WRITTEN
from modsim3d.learn.figures.figures import Figures
from modsim3d.learn.numbers.resampling import Column
from modsim3d.learn.told.report import Report


def learned_from(report: Report, name: str, sources: Sequence[str]) -> str:
    """How many numbers of a detector file were learned, and from what.

    Args:
        report: What was learned.
        name: Name of the detector file.
        sources: The labelled sets, as they were given.
    """
    labelled, learned = report.labelled, report.learned
    numbers = sum(np.size(each.estimate) for each in learned.intervals(report.level) if each.key.remark != NOT_WRITTEN)
    matches = len(learned.observed.matched.pairs[0])
    data = f"{counted(matches, 'match', 'matches')} in {counted(len(labelled.images), 'image')}"
    return (
        f"{name}: {counted(numbers, 'number')} for {counted(len(learned.observed.states), 'performance state')} and "
        f"{counted(len(labelled.labels), 'class', 'classes')} ({listed(labelled.labels)}), learned from {data} of "
        f"{listed(sources)}."
    )


def how_well(report: Report) -> str:
    """How well the most important numbers are known, in the state where they are known least."""
    states = report.states
    missed = _widest(report, [(each, each.any_label.false_negative_rate) for each in states])
    false = _widest(report, [(each, each.any_label.false_discovery_rate) for each in states])
    spread = _widest(report, [(each, each.errors.std) for each in states], relative=True)
    if missed is None or false is None or spread is None:
        return "There are too few images for intervals of the main numbers."
    where = " in the state where they are known least" if len(states) > 1 else ""
    said = (
        f"With {report.level:.0%} confidence its share of misses is known to within ±{100 * missed:.2g} percentage "
        f"points, its share of false detections to within ±{100 * false:.2g}, and the spread of its box errors to "
        f"within ±{100 * spread:.2g} %{where}."
    )
    return said + _again(report)


def _again(report: Report) -> str:
    """What learning again from a simulation of what was learned shows; nothing unless it was asked for."""
    if report.bias is None:
        return ""
    shifted = sum(int(np.count_nonzero(report.bias.significant(each))) for each in report.bias.shifts)
    numbers = sum(np.size(each.shift) for each in report.bias.shifts)
    return (
        f" Simulated and learned again, {numbers - shifted:,} of {numbers:,} numbers come back within what chance "
        f"explains; the other {shifted:,} are shifted by the matching and listed below."
    )


def _widest(report: Report, columns: Sequence[tuple[Figures, Column]], relative: bool = False) -> float | None:
    """Half the width of the widest interval, also as a share of the estimate; None if one has no ends."""
    found = []
    for figures, column in columns:
        low, high = column.interval(report.level, figures.units)
        half = (np.asarray(high, dtype=float) - np.asarray(low, dtype=float)) / 2
        found.append(_share_of(half, np.abs(column.estimate)) if relative else half)
    widest = float(np.max([np.max(each) for each in found]))
    return widest if np.isfinite(widest) else None


def _share_of(half: Array, size: Array) -> Array:
    """Half a width over a size; 0 where both are 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((half == 0) & (size == 0), 0.0, half / size)


def results(report: Report) -> list[tuple[str, str, str]]:
    """The tiles: a name, a number, and what it is of."""
    observed = report.learned.observed
    matched, found = observed.matched, len(observed.matched.pairs[0])
    sought, counts = int(np.count_nonzero(matched.sought)), int(np.count_nonzero(matched.counts))
    wrong = _wrong_class(report)
    precise = []
    if report.shares is not None:
        points = f"{100 * report.shares.average_precision:.1f}"
        precise = [("Average precision", points, f"points of 100, by {report.curves_matched_by}")]
    return [
        ("Matches", f"{found:,}", f"of {counted(sought, 'annotation')}"),
        ("Missed", _percent(sought - found, sought), f"{sought - found:,} of {counted(sought, 'annotation')}"),
        ("False", _percent(counts - found, counts), f"{counts - found:,} of {counted(counts, 'detection')}"),
        ("Wrong class", _percent(wrong, found), f"{wrong:,} of {counted(found, 'match', 'matches')}"),
        *precise,
        ("Left simple", f"{len(report.learned.notes):,}", "parts of which the data say too little; listed below"),
    ]


def _wrong_class(report: Report) -> int:
    detections, annotations = report.learned.observed.matched.pairs
    labelled = report.labelled
    return int(np.count_nonzero(labelled.results.label[detections] != labelled.annotations.label[annotations]))


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "–"
