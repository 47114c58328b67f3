"""Report on a learned detector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.boxes import Overlaps, iou
from modsim3d.core.text import counted, in_percent, listed, percent_of
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matching
from modsim3d.learn.bootstrap import MIN_UNITS, Column
from modsim3d.learn.false_positives import NOT_WRITTEN
from modsim3d.learn.figures import ErrorShares, Figures
from modsim3d.learn.learned_detector import Estimates, unknown_numbers
from modsim3d.learn.self_check import SelfCheck
from modsim3d.learn.states import StateMap


@dataclass(frozen=True)
class NearGate:
    """States of which many matches lie near the least IoU, so that larger errors were cut off."""

    shares: tuple[tuple[str, float], ...] = ()  # of the matches that lie near it, by state; only of states with many
    gate: float = 0.0  # IoU below which a match lies near it
    other: str = ""  # which rule cuts off less
    several: bool = False  # whether there are several states

    @property
    def remarks(self) -> tuple[str, ...]:
        """A remark for each state."""
        return tuple(
            f"{in_percent(share)} of the matches{f' in {name}' if self.several else ''} have an IoU of less than "
            f"{self.gate:.2g}: {self._meaning}"
            for name, share in self.shares
        )

    @property
    def remark(self) -> str:
        """One remark for all states; empty without any."""
        if len(self.shares) < 2:
            return "".join(self.remarks)
        shares = ", ".join(f"{in_percent(share)} in {name}" for name, share in self.shares)
        return f"Many matches have an IoU of less than {self.gate:.2g} ({shares}): {self._meaning}"

    @property
    def _meaning(self) -> str:
        return f"larger errors were cut off, and count as a miss and a false positive each ({self.other})"


@dataclass(frozen=True, eq=False)
class LearnReport:
    """Everything that is reported."""

    labelled: LabelledSet
    by_label: Matching | None  # label by label, for average precision and its curves; None without confidences
    conditions: Sequence[Figures]  # the largest F1 first
    states: Sequence[Figures]
    state_map: StateMap
    learned: Estimates
    shares: ErrorShares | None  # what average precision is lost to; None without confidences
    level: float  # of the confidence intervals
    beta: float  # how many times more recall weighs than precision in F-beta
    matched_by: str  # the matching rule in words
    curves_matched_by: str  # the rule of average precision in words
    remarks_on_data: tuple[str, ...] = ()  # what to read the numbers with: entries left out, labels that are off
    near_gate: NearGate = NearGate()  # what matching by IoU cuts off
    warning: str | None = None  # that most matches are lost to the rule, so that the numbers mean little; else None
    check: SelfCheck | None = None  # comparison with real results where it was not learned; None if not asked for

    @property
    def remarks(self) -> tuple[str, ...]:
        """Everything that the numbers have to be read with, one for each state where it is of states."""
        return *self.remarks_on_unknown, *self.remarks_on_check, *self.remarks_on_data, *self.near_gate.remarks

    @property
    def remarks_on_unknown(self) -> tuple[str, ...]:
        """Numbers that have no interval, with the reasons."""
        by_reason: dict[str, list[str]] = {}
        for (state, key), why in unknown_numbers(self.learned.observed, self.learned.numbers).items():
            by_reason.setdefault(why, []).append(key if state is None else f"states.{state}.{key}")
        few = [figures.name for figures in self.states if figures.units < MIN_UNITS]
        unit = "images, or runs of frames, are needed for intervals of all numbers but shares"
        return tuple(f"In state {name} only shares are known: at least {MIN_UNITS} {unit}" for name in few) + tuple(
            f"Not known: {', '.join(keys)}; {why}" for why, keys in by_reason.items()
        )

    @property
    def remarks_on_check(self) -> tuple[str, ...]:
        """Outcome of the check where it was not learned; none where that was not asked for."""
        return () if self.check is None else (self.check.sentence,)

    @property
    def states_differ(self) -> bool:
        """Whether the states are not just the conditions."""
        return any(names != (state,) for state, names in self.state_map.states.items())

    def name(self, figures: Figures) -> str:
        """The name of a group, which says that it is a state where there are conditions beside it."""
        state = self.states_differ and any(figures is other for other in self.states)
        return f"state {figures.name}" if state else figures.name


def lead(report: LearnReport) -> str:
    """One sentence on the data and the method that the numbers rest on."""
    learned, labelled = report.learned, report.labelled
    counted = f"confidence at least {learned.observed.threshold:g}" if labelled.scored else "without confidences"
    drawn = f"runs of {learned.run_s:.3g} s" if learned.run_s else "images"
    return (
        f"{len(labelled.images):,} images, {len(labelled.annotations):,} annotations, "
        f"{len(labelled.results):,} detections; matched by {report.matched_by}, {counted}; "
        f"{in_percent(report.level)} intervals by bootstrap over {learned.units[None]:,} {drawn}."
    )


def overlaps(report: LearnReport) -> Overlaps:
    """IoU of the matches."""
    detection, annotation = report.learned.observed.matched.pairs
    labelled = report.labelled
    return Overlaps.of(iou(labelled.results.boxes_px[detection], labelled.annotations.boxes_px[annotation]))


def data_sentence(report: LearnReport, name: str, sources: Sequence[str]) -> str:
    """Sentence with the count of numbers in the detector file `name`, and their data, the labelled sets `sources`."""
    labelled, learned = report.labelled, report.learned
    numbers = sum(np.size(row.estimate) for row in learned.intervals(report.level) if row.key.remark != NOT_WRITTEN)
    matches = len(learned.observed.matched.pairs[0])
    data = f"{counted(matches, 'match', 'matches')} in {counted(len(labelled.images), 'image')}"
    return (
        f"{name}: {counted(numbers, 'number')} for {counted(len(learned.observed.states), 'performance state')} and "
        f"{counted(len(labelled.labels), 'class', 'classes')} ({listed(labelled.labels)}), learned from {data} of "
        f"{listed(sources)}."
    )


def how_well(report: LearnReport) -> str:
    """Precision of the most important numbers, in the state where they are known least."""
    states = report.states
    missed = _widest(report, [(state, state.any_label.false_negative_rate) for state in states])
    false = _widest(report, [(state, state.any_label.false_discovery_rate) for state in states])
    spread = _widest(report, [(state, state.errors.std) for state in states], relative=True)
    if missed is None or false is None or spread is None:
        return "There are too few images for intervals of the main numbers."
    where = " in the state where they are known least" if len(states) > 1 else ""
    return (
        f"With {in_percent(report.level)} confidence its share of misses is known to within ±{100 * missed:.2g} "
        f"percentage points, its share of false positives to within ±{100 * false:.2g}, and the spread of its "
        f"box errors to within ±{100 * spread:.2g} %{where}."
    )


def _widest(report: LearnReport, columns: Sequence[tuple[Figures, Column]], relative: bool = False) -> float | None:
    """Half the width of the widest interval, also as a share of the estimate; None if one has no ends."""
    halves = []
    for figures, column in columns:
        low, high = column.interval(report.level, figures.units)
        half, size = (np.asarray(high, dtype=float) - np.asarray(low, dtype=float)) / 2, np.abs(column.estimate)
        if relative:
            with np.errstate(divide="ignore", invalid="ignore"):
                half = np.where((half == 0) & (size == 0), 0.0, half / size)
        halves.append(half)
    widest = float(np.max([np.max(part) for part in halves]))
    return widest if np.isfinite(widest) else None


def results(report: LearnReport) -> list[tuple[str, str, str]]:
    """The tiles: a name, a number, and what it is of."""
    observed = report.learned.observed
    matched, matches = observed.matched, len(observed.matched.pairs[0])
    sought, counts = int(np.count_nonzero(matched.sought)), int(np.count_nonzero(matched.counts))
    detections, annotations = matched.pairs
    labelled = report.labelled
    wrong = int(np.sum(labelled.results.label[detections] != labelled.annotations.label[annotations]))
    precise, false = [], counts - matches
    if report.shares is not None:
        points = f"{100 * report.shares.average_precision:.1f}"
        precise = [("Average precision", points, f"points of 100, by {report.curves_matched_by}")]
    return [
        ("Matches", f"{matches:,}", f"of {counted(sought, 'annotation')}"),
        ("Missed", percent_of(sought - matches, sought), f"{sought - matches:,} of {counted(sought, 'annotation')}"),
        ("False positives", percent_of(false, counts), f"{false:,} of {counted(counts, 'detection')}"),
        ("Wrong class", percent_of(wrong, matches), f"{wrong:,} of {counted(matches, 'match', 'matches')}"),
        *precise,
        ("Left simple", f"{len(report.learned.notes):,}", "parts of which the data say too little; listed below"),
    ]
