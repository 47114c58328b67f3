"""What is reported of a voyage besides the detector, and its tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from modsim3d.learn.told.report import Report
from modsim3d.learn.told.tables import Table
from modsim3d.voyage.labelled_voyage import LabelledVoyage
from modsim3d.voyage.told.coverage import Coverage, coverages, range_table
from modsim3d.voyage.told.registration_table import exchanges, registration_lead, registration_table
from modsim3d.voyage.told.stretches import (
    Stretch,
    missed_stretches,
    missed_table,
    unmatched_stretches,
    unmatched_table,
)
from modsim3d.voyage.truth_noise import taken_off as truth_noise
from modsim3d.voyage.truth_noise.taken_off import TakenOff
from modsim3d.voyage.unseen import told as unseen
from modsim3d.voyage.unseen.judged import Judged
from modsim3d.voyage.unseen.rates import StateRates

NOT_REGISTERED = "Cameras and clocks were taken as the scene and the log have them: nothing was registered."


@dataclass(frozen=True, eq=False)
class VoyageReport:
    """What is reported of a voyage besides the detector.

    Attributes:
        voyage: The labelled set, the cameras and their registrations.
        judged: Which unmatched detections are of vessels without a transponder.
        taken_off: What errors of truth were taken off the box errors.
        rates: Rates of false positives in each state, as bounds and between them.
        level: Level of their intervals.
    """

    voyage: LabelledVoyage
    judged: Judged
    taken_off: TakenOff
    rates: tuple[StateRates, ...]
    level: float

    @classmethod
    def of(
        cls, voyage: LabelledVoyage, judged: Judged, taken_off: TakenOff, report: Report, replicates: int, seed: int
    ) -> VoyageReport:
        """That of a report; the rates are resampled so many times."""
        return cls(voyage, judged, taken_off, judged.own_rates(replicates, seed), report.level)

    @property
    def registration(self) -> list[tuple[str, Table, tuple[str, ...]]]:
        """What each registration rests on, its table, and what could not be told apart."""
        return [
            (registration_lead(each), registration_table(each, self.voyage.scene), (*exchanges(each.registration),))
            for each in self.voyage.registered
        ]

    @property
    def unseen(self) -> Table:
        """The rates of false positives."""
        return Table(unseen.TITLE, unseen.HEADER, tuple(unseen.rows_of(self.rates, self.level)))

    @property
    def truth_noise(self) -> Table:
        """Box errors with and without errors of truth; without rows if none are assumed."""
        return Table(truth_noise.TITLE, truth_noise.HEADER, tuple(self.taken_off.rows()))

    @cached_property
    def coverage(self) -> list[Coverage]:
        """What each camera matched and missed."""
        return coverages(self.judged.telling, self.voyage.views)

    @cached_property
    def missed(self) -> list[Stretch]:
        """Stretches in which vessels were missed."""
        return missed_stretches(self.voyage, self.judged)

    @cached_property
    def unmatched(self) -> list[Stretch]:
        """Detections of nothing known."""
        return unmatched_stretches(self.voyage, self.judged)

    @property
    def tables(self) -> list[Table]:
        """Tables besides those of registration."""
        coverage = [range_table(each) for each in self.coverage]
        return [self.unseen, self.truth_noise, *coverage, missed_table(self.missed), unmatched_table(self.unmatched)]
