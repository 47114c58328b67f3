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
        undefined: Number of seeds without a value: nothing to be scored in any of their runs.
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
    undefined: int = 0
    values: dict[str, Any] = field(default_factory=dict)
