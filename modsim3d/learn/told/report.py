"""What is reported of a learned detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched
from modsim3d.learn.figures.error_shares import ErrorShares
from modsim3d.learn.figures.figures import Figures
from modsim3d.learn.gate.gate_bias import Bias
from modsim3d.learn.learned import Learned
from modsim3d.learn.states.states import StateMap


@dataclass(frozen=True)
class NearGate:
    """States of which many matches lie near the least IoU, so that larger errors were cut off.

    Attributes:
        shares: Share of the matches that lie near it, by state; only of states with many.
        gate: The IoU below which a match lies near it.
        other: Which rule cuts off less.
        several: Whether there are several states.
        simulated: Whether `--bias` could tell how much that does; it cannot for a voyage.
    """

    shares: tuple[tuple[str, float], ...] = ()
    gate: float = 0.0
    other: str = ""
    several: bool = False
    simulated: bool = True

    @property
    def remarks(self) -> tuple[str, ...]:
        """A remark for each state."""
        return tuple(
            f"{share:.0%} of the matches{f' in {name}' if self.several else ''} have an IoU of less than "
            f"{self.gate:.2g}: {self._meaning}"
            for name, share in self.shares
        )

    @property
    def remark(self) -> str:
        """One remark for all states; empty without any."""
        if len(self.shares) < 2:
            return "".join(self.remarks)
        shares = ", ".join(f"{share:.0%} in {name}" for name, share in self.shares)
        return f"Many matches have an IoU of less than {self.gate:.2g} ({shares}): {self._meaning}"

    @property
    def _meaning(self) -> str:
        told = "--bias says how much that does; " if self.simulated else ""
        return f"larger errors were cut off, and count as a miss and a false detection each ({told}{self.other})"


@dataclass(frozen=True, eq=False)
class Report:
    """Everything that is reported.

    Attributes:
        by_label: Matches label by label, for average precision and its curves; None without confidences.
        conditions: Figures of each condition, the largest F1 first.
        shares: What average precision is lost to; None without confidences.
        bias: By how much matching shifts the numbers; None where that was not asked for.
        level: Level of the confidence intervals.
        beta: How many times more recall weighs than precision in F-beta.
        matched_by: The matching rule in words.
        curves_matched_by: The rule of average precision in words.
        remarks_on_data: What the numbers have to be read with: entries left out, labels that are off.
        near_gate: What matching by IoU cuts off.
        warning: That most matches are lost to the rule, so that the numbers mean little; None where they are not.
    """

    labelled: LabelledSet
    by_label: Matched | None
    conditions: Sequence[Figures]
    states: Sequence[Figures]
    state_map: StateMap
    learned: Learned
    shares: ErrorShares | None
    bias: Bias | None
    level: float
    beta: float
    matched_by: str
    curves_matched_by: str
    remarks_on_data: tuple[str, ...] = ()
    near_gate: NearGate = NearGate()
    warning: str | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Everything that the numbers have to be read with, one for each state where it is of states."""
        return *self.remarks_on_data, *self.near_gate.remarks

    @property
    def states_differ(self) -> bool:
        """Whether the states are not just the conditions."""
        return any(names != (state,) for state, names in self.state_map.states.items())

    def name(self, figures: Figures) -> str:
        """The name of a group, which says that it is a state where there are conditions beside it."""
        state = self.states_differ and any(figures is each for each in self.states)
        return f"state {figures.name}" if state else figures.name


def lead(report: Report) -> str:
    """One sentence on the data and the method that the numbers rest on."""
    learned, labelled = report.learned, report.labelled
    counted = f"confidence at least {learned.observed.threshold:g}" if labelled.scored else "without confidences"
    drawn = f"runs of {learned.run_s:.3g} s" if learned.run_s else "images"
    return (
        f"{len(labelled.images)} images, {len(labelled.annotations)} annotations, {len(labelled.results)} detections; "
        f"matched by {report.matched_by}, {counted}; "
        f"{report.level:.0%} intervals by bootstrap over {learned.units[None]} {drawn}."
    )
