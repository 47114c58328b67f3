"""What `modsim3d learn --json` says of what was learned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modsim3d.learn.figures.figures import Figures
    from modsim3d.learn.numbers.entries import Interval
    from modsim3d.learn.numbers.resampling import Column
    from modsim3d.learn.told.report import Report


def learn_json(report: Report, written: Sequence[Path]) -> dict[str, Any]:
    """The figures of each condition and state, and the numbers of the detector file, with their intervals."""
    labelled, learned = report.labelled, report.learned
    groups = {"conditions": report.conditions, "states": report.states}
    return {
        "format": 1,
        "command": "learn",
        "images": len(labelled.images),
        "annotations": len(labelled.annotations),
        "detections": len(labelled.results),
        "labels": list(labelled.labels),
        "matched_by": report.matched_by,
        "confidence_threshold": learned.observed.threshold,
        "level": report.level,
        "beta": report.beta,
        **{name: [_figures(figures, report) for figures in group] for name, group in groups.items()},
        "state_conditions": dict(report.state_map.states),
        "numbers": [number for each in learned.intervals(report.level) for number in _numbers(each)],
        "lost_average_precision": report.shares
        and {share.kind.value: share.gain_points for share in report.shares.shares},
        "warning": report.warning,
        "remarks": list(report.remarks),
        "left_simple": list(learned.notes),
        "written": list(written),
    }


def _figures(figures: Figures, report: Report) -> dict[str, Any]:
    """Figures of a condition or state whatever the label, and the mean average precision."""

    def found(column: Column) -> dict[str, Any]:
        low, high = column.interval(report.level, figures.units)
        return {"value": float(column.estimate), "low": float(low), "high": float(high)}

    return {
        "name": figures.name,
        "images": figures.images,
        **{name: found(column) for name, column in figures.any_label._asdict().items()},
        "average_precision": figures.mean_average_precision and found(figures.mean_average_precision.all_points),
    }


def _numbers(interval: Interval) -> list[dict[str, Any]]:
    """Each number of an entry of the detector file, after the name of its key."""
    import numpy as np

    ends = {"value": interval.estimate, "low": interval.low, "high": interval.high}
    return [
        {"name": interval.key.at(place), **{name: float(np.asarray(array)[place]) for name, array in ends.items()}}
        for place in np.ndindex(*np.shape(interval.estimate))
    ]
