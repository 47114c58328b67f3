"""Misses of a learned detector in another scene than the one that it was learned in, beside those of the true one."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.campaign.drawn_detectors import MIN_UNITS
from modsim3d.core.arrays import Array, Mask
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.learn.learned_detector import Estimates
from modsim3d.learn.self_check import SequencePart, parts_of
from tests.learn.one_state import drawn_models
from tests.learn.round_trip import simulate

DRAWS = 39
"""Of so many drawn detectors and the true one, the true one has the lowest or the highest rate in 5 % of the seeds, if
it is one like them: so their range is one of 95 %."""

COLUMNS = ("true", "learned", "width", "inside")
TITLES = ("learned", "width of the range", "true in the range")
SAID = (
    "Misses are checked in another scene, too, with other distances and another traffic: of the vessels there, and of "
    "some of them, the mean chance of a miss by the file, given what each looks like, and by what was learned. The "
    f"range is that of {DRAWS} detectors drawn as [campaigns draw them](../uncertainty.md), which holds the true rate "
    "in 95 % of the seeds if the draws are right. Near, far, small and large are halves; states count alike."
)
"""What the page says of it."""


@dataclass(frozen=True)
class OtherScene:
    """A scene that nothing is learned from: a shipped one, its annotation mode and its steps."""

    scene: str
    mode: int
    steps: int

    def __str__(self) -> str:
        """Its name on a page."""
        return f"{self.scene}, {self.steps:,} steps"


HARBOUR, STRAIT, BASIN = OtherScene("harbour", 2, 150), OtherScene("strait", 2, 150), OtherScene("simulation_2", 0, 600)


@dataclass(frozen=True, eq=False)
class OtherTruth:
    """The truth of a scene, and masks of some of its annotations by their names, shapes (n,)."""

    parts: tuple[SequencePart, ...]
    bins: dict[str, Mask]

    @classmethod
    @cache
    def of(cls, other: OtherScene, detector: Path) -> OtherTruth:
        """Of a scene whose vessels have the labels of the detector, in turn; the same with all seeds."""
        with tempfile.TemporaryDirectory() as folder:
            run = simulate(other.scene, Path(folder), other.mode, other.steps, 0, detector)
            labelled, _ = labelled_run(run)
        parts = tuple(parts_of(labelled, np.zeros(len(labelled.images), dtype=np.int64)))
        sides = np.concatenate([part.targets.boxes_px[:, 2:] - part.targets.boxes_px[:, :2] for part in parts])
        size_px = np.sqrt(sides.prod(axis=1))
        depth_m, visible = (
            np.concatenate([getattr(part.targets, name) for part in parts]) for name in ("depth_m", "visible_fraction")
        )
        far, large, hidden = depth_m > np.median(depth_m), size_px > np.median(size_px), visible < 1
        bins = {"all": np.ones(len(far), dtype=bool), "near": ~far, "far": far, "small": ~large, "large": large}
        return cls(parts, bins | {"hidden": hidden, "visible": ~hidden})

    def miss_rates(self, model: DetectorModel, statistics: TargetStatistics) -> Array:
        """Mean rate of misses of each state and bin, shape (states, bins)."""
        classifier = ConfusionClassifier.from_model(model, statistics)
        rates = [
            np.concatenate([classifier.miss_rates(np.full(len(part.rows), state), part.targets) for part in self.parts])
            for state in range(len(model.states))
        ]
        return np.array([[rate[chosen].mean() for chosen in self.bins.values()] for rate in rates])


def elsewhere(other: OtherTruth, true: DetectorModel, counts: TargetStatistics, learned: Estimates) -> dict[str, Any]:
    """By bin: the true rates, the learned ones, and whether the true ones lie in the range of detectors that a campaign
    draws; one number of each for each state that the data tell enough of. Counts are those of the scene that was
    learned from, to which the true rates may be anchored."""
    enough = np.array([learned.units[name] >= MIN_UNITS for name in learned.observed.states])
    with tempfile.TemporaryDirectory() as folder:
        models = [parse_detector(learned.detector()), *drawn_models(learned, Path(folder), DRAWS)]
    asked = other.miss_rates(true, counts)
    value, *rates = (other.miss_rates(model, TargetStatistics()) for model in models)
    drawn = np.stack(rates)
    inside = (drawn.min(axis=0) <= asked) & (asked <= drawn.max(axis=0))
    columns = {"true": asked, "learned": value, "inside": inside.astype(float), "width": np.ptp(drawn, axis=0)}
    return {
        name: {key: column[enough, place].tolist() for key, column in columns.items()}
        for place, name in enumerate(other.bins)
    }


def mean_elsewhere(runs: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Means over runs and states, by bin: the true rate, the learned one, whether the true one is inside, and the width
    of the range."""
    return {
        name: {key: float(np.mean(np.concatenate([run[name][key] for run in runs]))) for key in COLUMNS}
        for name in (runs[0] if runs else ())
    }


def table(other: OtherScene, ways: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[str]:
    """Misses in another scene, by bin and by what the ways of learning are called; one way needs no name."""
    heads = [f"{way}: {title}" if way else title for way in ways for title in TITLES]
    lines = [f"| misses in {other} | true | {' | '.join(heads)} |", f"|---|---|{'---|' * len(heads)}"]
    for name, first in next(iter(ways.values())).items():
        cells = " | ".join(f"{way[name][key]:.3f}" for way in ways.values() for key in COLUMNS[1:])
        lines.append(f"| {name} | {first['true']:.3f} | {cells} |")
    return lines
