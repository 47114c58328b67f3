"""What a requirement comes to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

Outcome = Literal["met", "failed", "undecided"]


@dataclass(frozen=True)
class Verdict:
    """A requirement, judged for one tracker in one condition.

    Attributes:
        requirement: Its place in the file, from 0.
        text: It in words, such as `hota at least 0.6 in state haze`.
        tracker: Name of the tracker in tables.
        condition: Number of the condition.
        values: The values of the varied keys in this condition, without those that are drawn.
        outcome: Whether it is met.
        why: In a sentence, what that rests on.
        confidence: The least probability that the verdict is right if the truth is at the threshold.
        estimate: The mean, or the share of seeds that are right; None if unknown.
        low: The lower end of its interval: what `met` of an `at_least` or of a share is held against; None if unknown.
        high: The upper end.
        seeds: Number of traffic seeds that it rests on.
        crashed: Number of runs that crashed.
        nothing: Number of those in which the tracker gave nothing to score, or too little: they count as crashes do.
        undefined: Number of seeds without a value that are left out: their truth has nothing to score.
        left_out: Number of runs without a value that are left out for the same reason, in seeds that have others.
        rests_on: The share of what is to be followed that the score rests on, mean over runs; None if unknown.
        met_without_tracks: Whether a tracker without any track would have met it too.
    """

    requirement: int
    text: str
    tracker: str
    condition: int
    outcome: Outcome
    why: str
    confidence: float
    estimate: float | None
    low: float | None
    high: float | None
    seeds: int
    crashed: int = 0
    nothing: int = 0
    undefined: int = 0
    left_out: int = 0
    rests_on: float | None = None
    met_without_tracks: bool = False
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def qualified(self) -> bool:
        """Whether there is more to say than its interval does: runs that are missing, or nothing that it takes."""
        return bool(self.crashed or self.nothing or self.undefined or self.left_out or self.met_without_tracks)
