"""The plan of a campaign: its runs, numbered, each with all that decides its row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from modsim3d.campaign.file.keys import CampaignKeys, TrackerKeys
from modsim3d.campaign.plan.conditions import Condition, conditions
from modsim3d.campaign.plan.drawn import drawn_values
from modsim3d.campaign.plan.seeds import detector_seed, traffic_seed


@dataclass(frozen=True)
class PlannedRun:
    """One run: a row of the results.

    Attributes:
        number: Its place in the plan, from 0.
        seed_index: Number of the traffic seed, from 0.
        condition_index: Number of the condition, from 0.
        condition: The scene, and the values of all varied keys, drawn ones too.
        traffic_seed: Seed of the scene.
        detector_seed: Seed of the detector.
        tracker: The tracker.
    """

    number: int
    seed_index: int
    condition_index: int
    condition: Condition
    traffic_seed: int
    detector_seed: int
    tracker: TrackerKeys


@dataclass(frozen=True)
class Plan:
    """All runs of a campaign in order: traffic seed, condition, detector seed, tracker, the last one changing first.

    So the first runs are a smaller campaign of the same kind, and all conditions, detectors and trackers meet the same
    seeds.

    Attributes:
        keys: The campaign file.
        conditions: All combinations of scenes and values that are not drawn.
    """

    keys: CampaignKeys
    conditions: tuple[Condition, ...]

    @classmethod
    def of(cls, keys: CampaignKeys) -> Plan:
        """The plan of a campaign file."""
        return cls(keys, tuple(conditions(keys.scenes, keys.vary, keys.settings)))

    def __len__(self) -> int:
        """Number of runs."""
        return self.keys.seeds.traffic * self.runs_by_seed

    @property
    def runs_by_seed(self) -> int:
        """Number of runs with each traffic seed."""
        return len(self.conditions) * self.keys.seeds.detector * len(self.keys.trackers)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The keys that are varied, in the order of the file; `scene` first if there are several."""
        named: dict[str, None] = {"scene": None} if len(self.keys.scenes) > 1 else {}
        for condition in self.conditions:
            named |= dict.fromkeys(condition.values)
        for factor in self.keys.vary:
            named |= dict.fromkeys(factor.ranges)
        return tuple(named)

    @property
    def drawn(self) -> tuple[str, ...]:
        """The keys whose values are drawn for each traffic seed."""
        return tuple(key for factor in self.keys.vary for key in factor.ranges)

    def run(self, number: int) -> PlannedRun:
        """The run with a number."""
        return self.runs([number])[0]

    def runs(self, numbers: Sequence[int]) -> list[PlannedRun]:
        """The runs with some numbers."""
        drawn = cache(self._drawn)  # for the runs of a traffic seed, which follow each other
        return [self._run(number, drawn) for number in numbers]

    def _run(self, number: int, drawn: Callable[[int], dict[str, Any]]) -> PlannedRun:
        rest, tracker = divmod(number, len(self.keys.trackers))
        rest, look = divmod(rest, self.keys.seeds.detector)
        seed_index, condition_index = divmod(rest, len(self.conditions))
        traffic = traffic_seed(self.keys.seed, seed_index)
        return PlannedRun(
            number,
            seed_index,
            condition_index,
            self.conditions[condition_index].with_values(drawn(seed_index)),
            traffic,
            detector_seed(traffic, look),
            self.keys.trackers[tracker],
        )

    def _drawn(self, seed_index: int) -> dict[str, Any]:
        return drawn_values(self.keys.vary, self.keys.seed, seed_index, self.keys.seeds.traffic)
