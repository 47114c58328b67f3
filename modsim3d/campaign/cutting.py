"""Cuts runs into tasks of about equal time, without making a truth twice if that can be helped."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from modsim3d.campaign.plan.conditions import layer_of
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.work.checking import ConditionFacts
from modsim3d.campaign.work.task import TaskReport

TASK_S = 30.0
"""Long against what a scheduler spends on a task, short against what a lost worker costs."""
FIRST_RUNS = 8
"""Most runs of a task while nothing is known of their time."""
WEIGHT = 0.3
"""Of the latest task in the mean time of a run."""


def same_truth(plan: Plan, facts: Sequence[ConditionFacts], numbers: Iterable[int]) -> list[list[int]]:
    """Runs grouped by their truth, in the order of the first run of each group.

    Args:
        plan: The plan.
        facts: What is known of its conditions.
        numbers: Numbers of runs, ascending.
    """
    drawn = any(layer_of(key) == "truth" for key in plan.drawn)
    by_condition = plan.keys.seeds.detector * len(plan.keys.trackers)
    groups: dict[tuple[str, int], list[int]] = {}
    for number in numbers:
        seed, place = divmod(number, plan.runs_by_seed)
        found = facts[place // by_condition]
        key = found.truth_sha256, seed if found.truth_has_seed or drawn else 0
        groups.setdefault(key, []).append(number)
    return list(groups.values())


class Cutter:
    """Gives the numbers of the runs of one task after another; learns from tasks that are done how long a run takes."""

    def __init__(self, width: int) -> None:
        """Take the number of tasks that are worked on at once; it may change."""
        self.width = width
        self._groups: deque[list[int]] = deque()
        self._run_s: float | None = None
        self.waiting = 0

    def add(self, groups: Iterable[list[int]]) -> None:
        """Add runs, grouped by their truth."""
        for group in groups:
            self._groups.append(group)
            self.waiting += len(group)

    def learn(self, report: TaskReport) -> None:
        """Take in what a task took."""
        if report.wall_s > 0:
            latest = report.wall_s / report.runs
            self._run_s = latest if self._run_s is None else (1 - WEIGHT) * self._run_s + WEIGHT * latest

    def next(self) -> list[int]:
        """The runs of the next task."""
        most = FIRST_RUNS if self._run_s is None else max(1, int(TASK_S / self._run_s))
        fair = max(1, self.waiting // (2 * self.width))  # towards the end smaller ones, so that all end together
        taken = self._groups.popleft()
        if len(taken) > most:
            cut = min(most, max(fair, FIRST_RUNS))
            taken, rest = taken[:cut], taken[cut:]
            self._groups.appendleft(rest)
        while self._groups and len(taken) + len(self._groups[0]) <= min(most, fair):
            taken = taken + self._groups.popleft()
        self.waiting -= len(taken)
        return taken

    def seconds(self, runs: int) -> float | None:
        """How long some runs will take at this rate; None while nothing is known."""
        return None if self._run_s is None else runs * self._run_s / self.width
