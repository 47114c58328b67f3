"""Why box errors by AIS differ from those by full truth: causes are added one by one, film by film."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from enum import StrEnum
from typing import Any

import numpy as np

from benchmarks.stand_in.films import Film
from benchmarks.voyages.pixels import STD, VARIANTS, by_tracks, numbers_of
from benchmarks.voyages.reported import AisErrors
from modsim3d.core.arrays import Mask
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matching, match
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import Estimates, LearnSettings
from modsim3d.learn.voyage.learn_voyage import with_sure_boxes

NUMBERS = (STD.format("e_x"), STD.format("e_w"), "persistence.box_s")
REPLICATES = 20
"""Values alone are compared."""


class Truth(StrEnum):
    """What a film is learned from; each has a cause of other box errors more than the one before it."""

    FULL = "full truth"
    SAME_VESSELS = "the same of vessels with transponders"
    ALL_DETECTIONS = "with detections of the others"
    TRACKS = "true tracks"
    IN_VIEW = "without partly hidden boxes"
    REPORTS = "AIS, true camera"


def causes(pool: Executor, films: Sequence[Film]) -> dict[str, Any]:
    """Of each film what `film_causes` finds."""
    return {film.name: each for film, each in zip(films, pool.map(film_causes, films), strict=True)}


def film_causes(film: Film) -> dict[str, Any]:
    """`NUMBERS` of a film by variant and truth, and how many detections match another vessel than by full truth."""
    scene, some = film.scene(), VARIANTS["some"]
    full = by_tracks(film, AisErrors(), registered=False, replicates=REPLICATES)
    labelled, settings = with_sure_boxes(full.voyage_report.voyage.labelled), full.sources.settings
    silent = np.isin(scene.vessel_names, some.silent(scene, film.seed))
    unknown = silent[labelled.annotations.identity]
    matched = match(labelled, settings.rule, settings.threshold)
    fewer = _without(labelled, annotations=unknown)
    own = _without(fewer, results=np.append(unknown, False)[matched.annotation])
    tracks = by_tracks(film, AisErrors(absent=some.absent), registered=False, replicates=REPLICATES)
    by_truth = {
        Truth.FULL: _learned(labelled, settings),
        Truth.SAME_VESSELS: _learned(own, settings),
        Truth.ALL_DETECTIONS: _learned(fewer, settings),
        Truth.TRACKS: tracks.report.learned,
        Truth.IN_VIEW: _learned(tracks.voyage_report.voyage.labelled, settings),
        Truth.REPORTS: by_tracks(film, some, registered=False, replicates=REPLICATES).report.learned,
    }
    of_all = {
        Truth.FULL: by_truth[Truth.FULL],
        Truth.IN_VIEW: _learned(full.voyage_report.voyage.labelled, settings),
        Truth.REPORTS: by_tracks(film, VARIANTS["all"], registered=False, replicates=REPLICATES).report.learned,
    }
    again = match(fewer, settings.rule, settings.threshold)
    return {
        "some": {truth.name: _values(learned) for truth, learned in by_truth.items()},
        "all": {truth.name: _values(learned) for truth, learned in of_all.items()},
        "matches": len(again.pairs[0]),
        "of_others": _of_others(labelled, matched, fewer, again, unknown),
    }


def _of_others(full: LabelledSet, matched: Matching, fewer: LabelledSet, again: Matching, unknown: Mask) -> int:
    """How many detections match a vessel with fewer vessels that with all of them match an unknown one, mask (T,)."""
    rows, _ = again.pairs
    before = matched.annotation[rows]
    return int((unknown[before] & (before >= 0)).sum())


def _without(labelled: LabelledSet, annotations: Mask | None = None, results: Mask | None = None) -> LabelledSet:
    """A set without some annotations (T,) or some detections (D,)."""
    return replace(
        labelled,
        annotations=_dropped(labelled.annotations, annotations),
        results=_dropped(labelled.results, results),
    )


def _dropped(table: Any, drop: Mask | None) -> Any:
    if drop is None:
        return table
    return replace(table, **{name: column[~drop] for name, column in vars(table).items() if column is not None})


def _learned(labelled: LabelledSet, settings: LearnSettings) -> Estimates:
    return learn_detector(labelled, settings, LearnOptions()).learned


def _values(learned: Estimates) -> dict[str, float]:
    numbers = numbers_of(learned)
    return {name: float(f"{numbers[name]['value']:.6g}") for name in NUMBERS if name in numbers}
