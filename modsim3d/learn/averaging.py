"""A performance state as the average of conditions, as the thesis makes Tables 9.2 and 9.3 out of its chapter 8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.figures import covariance


@dataclass(frozen=True, eq=False)
class Condition:
    """What was measured under one condition.

    Attributes:
        recall: Share of the truth that was found.
        false_negative_rate: One less the recall.
        false_discovery_rate: False over all detections.
        mean_px: Of the box error, shape (4,).
        covariance_px2: Shape (4, 4).
    """

    recall: float
    false_negative_rate: float
    false_discovery_rate: float
    mean_px: Array
    covariance_px2: Array

    @classmethod
    def of(
        cls,
        recall: float,
        false_discovery_rate: float,
        mean_px: Sequence[float],
        std_px: Sequence[float],
        correlation: Sequence[float],
    ) -> Condition:
        """From standard deviations and the six correlations of `figures.PAIRS` (Tables 8.7 to 8.9)."""
        matrix = covariance(np.array(std_px, dtype=np.float64), np.array(correlation, dtype=np.float64))
        return cls(recall, 1 - recall, false_discovery_rate, np.array(mean_px, dtype=np.float64), matrix)


def average(conditions: Sequence[Condition]) -> Condition:
    """Arithmetic means (Jessen & Mohr (2023), section 9.1.3): every condition counts alike.

    The covariance is the mean within conditions; how their means differ is not added, as in the source.
    """
    return Condition(
        float(np.mean([condition.recall for condition in conditions])),
        float(np.mean([condition.false_negative_rate for condition in conditions])),
        float(np.mean([condition.false_discovery_rate for condition in conditions])),
        np.mean([condition.mean_px for condition in conditions], axis=0),
        np.mean([condition.covariance_px2 for condition in conditions], axis=0),
    )
