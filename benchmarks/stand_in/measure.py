"""Measures each rung of the ladder on films: scores, differences, rankings and distributions, as JSON has them."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.stand_in.differences import difference
from benchmarks.stand_in.distributions import (
    OF_DETECTIONS,
    OF_TRACKS,
    Samples,
    compared,
    holm,
    of_detections,
    of_tracks,
)
from benchmarks.stand_in.exchange import EXCHANGES, PARTS, Parts, exchanged
from benchmarks.stand_in.exchange import SCORES as EXCHANGED_SCORES
from benchmarks.stand_in.margins import BY_KEY, SCORES
from benchmarks.stand_in.ranking import ranking
from benchmarks.stand_in.scores import (
    SETTINGS_OF,
    TRACKERS,
    OpenFilm,
    found_vessels,
    open_film,
    real_detections,
    recall_of_bins,
    scored_tracks,
    scores_of,
    simulated_detections,
)
from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.tracking.trackers.registry import named_tracker

if TYPE_CHECKING:
    from benchmarks.stand_in.films import Film

FORMAT = 1
REAL = "real"
BIN_MARGIN = 0.05
"""Of recall and association in a part of the vessel-frames, which are fewer."""
PACKAGES = ("modsim3d", "trackers", "trackeval", "numpy", "scipy")
Numbers = dict[str, float]


@dataclass(frozen=True)
class Output:
    """What is known of one set of detections of a film.

    Attributes:
        scores: Tracker → score → value.
        bins: Tracker → bin → `recall` and `association`.
        detections: The values of each distribution of detections.
        tracks: Tracker → the values of each distribution of tracks.
    """

    scores: dict[str, Numbers]
    bins: dict[str, dict[str, Numbers]]
    detections: Samples
    tracks: dict[str, Samples]


@dataclass(frozen=True)
class Measured:
    """A film, its outputs, `real` alone and of each rung one for each seed, and scores with exchanged parts."""

    facts: dict[str, Any]
    outputs: dict[str, list[Output]]
    exchanged: list[dict[str, Numbers]]


@dataclass(frozen=True)
class Job:
    """A film to measure; fields as the arguments of `measure`."""

    film: Film
    detectors: Mapping[str, Path]
    seeds: Sequence[int]
    trackers: Sequence[str]
    threshold: float


def measure(
    films: Sequence[Film],
    detectors: Mapping[str, Path],
    seeds: Sequence[int],
    trackers: Sequence[str] = TRACKERS,
    threshold: float = 0.2,
    *,
    of_films: Mapping[str, Mapping[str, Path]] | None = None,
    titles: Mapping[str, str] | None = None,
    workers: int = 2,
    learned_from: int = 0,
    judged: bool = False,
) -> dict[str, Any]:
    """Compare simulated detections with real ones on films.

    Args:
        films: Films that no detector file was learned from.
        detectors: A detector file for each rung of the ladder, the plain one first.
        seeds: Seeds of the simulated detector.
        trackers: Names of trackers.
        threshold: The least confidence of a detection, real or simulated.
        of_films: Detector files of single films by their names, in place of `detectors`.
        titles: What each rung adds, in words.
        workers: Number of processes; no number depends on it.
        learned_from: Number of films that the detector files were learned from.
        judged: Whether no model was settled in sight of these films.

    Raises:
        ModsimError: There are no films or no seeds, or a file cannot be read.
    """
    if not films or not seeds or not detectors:
        raise ModsimError(
            f"a comparison needs films, seeds and detector files (got {len(films)}, {len(seeds)}, {len(detectors)})"
        )
    jobs = [Job(film, (of_films or {}).get(film.name, detectors), seeds, trackers, threshold) for film in films]
    measured = list(_told(_each(measured_film, jobs, workers), len(jobs)))
    named = [{"name": name, "title": (titles or {}).get(name, name)} for name in detectors]
    found: dict[str, Any] = rounded(
        {
            "format": FORMAT,
            "rungs": named,
            "trackers": list(trackers),
            "seeds": len(seeds),
            "learned_from": learned_from,
            "judged": judged,
            "threshold": threshold,
            "settings": {place: _settings(trackers, place) for place in sorted({film.place for film in films})},
            "versions": {name: version(name) for name in PACKAGES},
            **results(measured, tuple(detectors), tuple(trackers)),
        }
    )
    return found


def measured_film(job: Job) -> Measured:
    """Score all trackers behind all detections of a film."""
    opened = open_film(job.film)
    real = real_detections(opened, job.threshold)
    outputs = {REAL: [output(opened, real, job.trackers)]}
    made: list[TrackerDetections] = []
    for name, file in job.detectors.items():
        made = simulated_detections(opened, file, job.seeds, job.threshold)
        outputs[name] = [output(opened, each, job.trackers) for each in made]
    return Measured(facts_of(opened, real), outputs, _exchanged(opened, real, made[0], job.trackers))


def _exchanged(
    opened: OpenFilm, real: TrackerDetections, simulated: TrackerDetections, trackers: Sequence[str]
) -> list[dict[str, Numbers]]:
    """Scores of each tracker behind each of `EXCHANGES` put into simulated detections, and then into the real ones."""
    parts = Parts.of(opened, real), Parts.of(opened, simulated)
    made = [exchanged(opened, usual, other, chosen) for usual, other in (parts[::-1], parts) for chosen in EXCHANGES]
    return [{name: scores_of(opened, scored_tracks(opened, each, name)) for name in trackers} for each in made]


def output(opened: OpenFilm, detections: TrackerDetections, trackers: Sequence[str]) -> Output:
    """Score the trackers behind one set of detections."""
    scored = {name: scored_tracks(opened, detections, name) for name in trackers}
    return Output(
        {name: scores_of(opened, each) for name, each in scored.items()},
        {name: recall_of_bins(opened, each) for name, each in scored.items()},
        of_detections(opened, detections),
        {name: of_tracks(opened, each) for name, each in scored.items()},
    )


def facts_of(opened: OpenFilm, real: TrackerDetections) -> dict[str, Any]:
    """What a film is, and what the detector that looks at pixels does in it."""
    film, scored = opened.film, opened.truth.scored
    found, row = found_vessels(opened, real)
    judged = np.append(scored, True)[row]  # what is on a vessel that is not scored counts neither way
    return {
        "name": film.name,
        "place": film.place,
        "weather": film.weather,
        "seed": film.seed,
        "frames": len(opened.sequence.steps),
        "vessel_frames": int(scored.sum()),
        "hidden": int((opened.hidden & scored).sum()),
        "found": int((found & scored).sum()),
        "found_hidden": int((found & opened.hidden & scored).sum()),
        "detections": int(judged.sum()),
    }


def results(measured: Sequence[Measured], rungs: Sequence[str], trackers: Sequence[str]) -> dict[str, Any]:
    """What the page is made of, from the films' outputs."""
    facts = [each.facts for each in measured]
    every = {
        name: np.array(
            [[[_values(each.scores[t]) for t in trackers] for each in film.outputs[name]] for film in measured]
        )
        for name in (REAL, *rungs)
    }  # of each rung: films, seeds, trackers, scores
    groups = _groups(facts)
    share = np.array([each["hidden"] / max(each["vessel_frames"], 1) for each in facts])
    return {
        "films": facts,
        "hidden_share_of_groups": float(np.median(share)),
        "scores": {
            tracker: {
                score.key: {name: _over_seeds(every[name][:, :, t, s]).tolist() for name in (REAL, *rungs)}
                for s, score in enumerate(SCORES)
            }
            for t, tracker in enumerate(trackers)
        },
        "differences": {
            name: {
                tracker: {
                    score.key: _difference(every, name, t, s, np.ones(len(facts), dtype=bool))
                    for s, score in enumerate(SCORES)
                }
                for t, tracker in enumerate(trackers)
            }
            for name in rungs
        },
        "groups": {
            name: {
                tracker: {group: _difference(every, name, t, 0, films) for group, films in groups.items()}
                for t, tracker in enumerate(trackers)
            }
            for name in rungs
        },
        "exchanged": _exchanges(measured, trackers),
        "film_correlation": {
            name: {
                tracker: _film_correlation(every[REAL][:, 0, t, 0], every[name][:, :, t, 0])
                for t, tracker in enumerate(trackers)
            }
            for name in rungs
        },
        "bins": {name: {tracker: _bins(measured, name, tracker) for tracker in trackers} for name in rungs},
        "ranking": {
            name: ranking(every[REAL][:, 0, :, 0], every[name][:, :, :, 0].transpose(0, 2, 1), tuple(trackers))
            for name in rungs
        },
        "distributions": {name: _distributions(measured, name, trackers) for name in rungs},
    }


def _exchanges(measured: Sequence[Measured], trackers: Sequence[str]) -> list[dict[str, Any]]:
    """Differences from the real scores for each exchange, with the parts in words and where they are put."""
    kinds = [(into, [part for part in PARTS if part in chosen]) for into in ("simulated", REAL) for chosen in EXCHANGES]
    return [
        {
            "into": into,
            "parts": parts,
            "trackers": {
                tracker: {
                    key: difference(
                        np.array([film.outputs[REAL][0].scores[tracker][key] for film in measured]),
                        np.array([[film.exchanged[place][tracker][key]] for film in measured]),
                        BY_KEY[key].least,
                    ).as_json()
                    for key in EXCHANGED_SCORES
                }
                for tracker in trackers
            },
        }
        for place, (into, parts) in enumerate(kinds)
    ]


def _film_correlation(real: Array, simulated: Array) -> dict[str, float | None]:
    """Mean correlation over films of the real score with each seed's, and of one seed's with another's."""
    known = ~np.isnan(real) & ~np.isnan(simulated).any(axis=1)
    if known.sum() < 3 or not np.ptp(real[known]) or not np.ptp(simulated[known], axis=0).all():
        return {"real": None, "seeds": None}
    table = np.corrcoef(np.column_stack([real, simulated])[known].T)
    seeds = table[1:, 1:][np.triu_indices(len(table) - 1, 1)]
    return {"real": float(table[0, 1:].mean()), "seeds": float(seeds.mean()) if len(seeds) else None}


def _values(scores: Numbers) -> list[float]:
    return [scores[score.key] for score in SCORES]


def _over_seeds(values: Array) -> Array:
    """The mean over seeds of each film, NaN where it is undefined with all of them; shapes (F, S) and (F,)."""
    known = ~np.isnan(values)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, values, 0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _groups(facts: Sequence[Mapping[str, Any]]) -> dict[str, Mask]:
    """Films that have something in common, by its name: weather, place, and how much is hidden in them."""
    share = np.array([each["hidden"] / max(each["vessel_frames"], 1) for each in facts])
    groups = {
        f"{kind}: {value}": np.array([each[kind] == value for each in facts])
        for kind in ("weather", "place")
        for value in dict.fromkeys(each[kind] for each in facts)
    }
    much = share > np.median(share)
    return groups | {"occlusion: little": ~much, "occlusion: much": much}


def _difference(every: Mapping[str, Array], rung: str, tracker: int, score: int, films: Mask) -> dict[str, Any]:
    real, simulated = every[REAL][films, 0, tracker, score], every[rung][films, :, tracker, score]
    known = real[~np.isnan(real)]
    margin = SCORES[score].margin(float(known.mean()) if len(known) else 0.0)
    return difference(real, simulated, margin).as_json()


def _bins(measured: Sequence[Measured], rung: str, tracker: str) -> dict[str, Any]:
    """Differences of recall and association in each of `BINS`."""

    def of(name: str, bin_name: str, kind: str) -> Array:
        return np.array([[each.bins[tracker][bin_name][kind] for each in film.outputs[name]] for film in measured])

    return {
        bin_name: {
            kind: difference(of(REAL, bin_name, kind)[:, 0], of(rung, bin_name, kind), BIN_MARGIN).as_json()
            for kind in ("recall", "association")
        }
        for bin_name in measured[0].outputs[REAL][0].bins[tracker]
    }


def _distributions(measured: Sequence[Measured], rung: str, trackers: Sequence[str]) -> list[dict[str, Any]]:
    """Comparisons of all distributions at a rung, with p-values adjusted for their number."""
    wanted: list[tuple[str, str | None]] = [(name, None) for name in OF_DETECTIONS]
    wanted += [(name, tracker) for tracker in trackers for name in OF_TRACKS]

    def values(output: Output, name: str, tracker: str | None) -> Array:
        return (output.detections if tracker is None else output.tracks[tracker])[name]

    found = [
        {"name": name, "tracker": tracker}
        | compared(
            [values(film.outputs[REAL][0], name, tracker) for film in measured],
            [[values(each, name, tracker) for each in film.outputs[rung]] for film in measured],
        )
        for name, tracker in wanted
    ]
    adjusted = holm([each["p_value"] for each in found])
    return [each | {"adjusted_p": p} for each, p in zip(found, adjusted, strict=True)]


def _settings(trackers: Sequence[str], place: str) -> dict[str, Any]:
    """The settings of each tracker at a place."""
    return {name: named_tracker(name, {}, SETTINGS_OF.get(place)).origin.settings for name in trackers}


def _each(work: Callable[[Job], Measured], jobs: Sequence[Job], workers: int) -> Iterable[Measured]:
    if workers == 1:
        yield from map(work, jobs)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(work, jobs)


def _told(measured: Iterable[Measured], count: int) -> Iterable[Measured]:
    """Say that a film is done."""
    for done, each in enumerate(measured, 1):
        print(f"{each.facts['name']} ({done} of {count})", file=sys.stderr, flush=True)
        yield each


def rounded(value: Any, digits: int = 6) -> Any:
    """Numbers with so many significant digits, None for NaN, in lists and mappings of any depth."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each, digits) for each in value]
    if isinstance(value, float):
        return None if np.isnan(value) else float(f"{value:.{digits}g}")
    return value
