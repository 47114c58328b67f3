"""Each rung before the classifier: can it tell the rung's detections from those of the pretrained detector?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.stand_in.classifier import between_seeds, tell_apart
from benchmarks.stand_in.films import Film
from benchmarks.stand_in.scores import OpenFilm, open_film, real_detections, simulated_detections
from benchmarks.stand_in.sighted import shown_as
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run

SEEDS_APART = "seeds"
"""Name of the check that two seeds of the last rung cannot be told apart."""


def told_apart(
    films: Sequence[Film], detectors: Mapping[str, Path], seeds: Sequence[int], threshold: float
) -> dict[str, Any]:
    """The classifier's results by rung, and under `seeds` those of the last rung's first seed against its others."""
    opened = {film.name: open_film(film) for film in films}
    truth = {film.name: labelled_run(film.run)[0] for film in films}
    names = list(opened)
    real = {name: shown_as(truth[name], real_detections(each, threshold)) for name, each in opened.items()}
    results, simulated = {}, {}
    for rung, file in detectors.items():
        simulated = _simulated(opened, truth, file, seeds, threshold)
        results[rung] = tell_apart(names, real, simulated, threshold)
    results[SEEDS_APART] = between_seeds(names, simulated, threshold)
    return results


def _simulated(
    opened: Mapping[str, OpenFilm],
    truth: Mapping[str, LabelledSet],
    file: Path,
    seeds: Sequence[int],
    threshold: float,
) -> dict[str, list[LabelledSet]]:
    return {
        name: [shown_as(truth[name], each) for each in simulated_detections(film, file, seeds, threshold)]
        for name, film in opened.items()
    }
