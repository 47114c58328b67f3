"""A detector that looks at pixels, learned from films by the truth of AIS and by full truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stand_in.films import WORK, Film, all_films
from benchmarks.stand_in.rungs import LEAST_CONFIDENCE, LEAST_IOU
from benchmarks.stand_in.stored import restore_films
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.trials import BY_RULE, LEVEL, REPLICATES
from benchmarks.voyages.wrong_camera import WRONG, really, write_table
from modsim3d.errors import ModsimError
from modsim3d.learn.learning import LearnResult, learn_detector
from modsim3d.voyage.learned import learn_voyage

PIXELS = "pixels"
NEAR_AIS = AisErrors(position_m=1.0, position_s=300.0, delay_s=0.2)
"""The vessels are 50 to 300 m away, where 3 m would be as much as a boat is long."""
VARIANTS = {"all": NEAR_AIS, "some": replace(NEAR_AIS, absent=0.2)}
"""All vessels have a transponder, or a fifth has none."""
FILMS_OF_A_PLACE = 2
WITHOUT = ("relative", "mixed", "student_t", "effects", "vessels", "places", "lasting", "slopes", "duplicates",
           "merges", "splits")  # fmt: skip
"""A film of half a minute is too short for them; the same with both truths."""
LABEL = "boat"
_FULL = {"match": "confidence", "least_iou": LEAST_IOU, "confidence": LEAST_CONFIDENCE, "without": WITHOUT,
         "replicates": REPLICATES}  # fmt: skip


def pixel_films(work: Path = WORK) -> list[Film]:
    """The first films of each place in clear weather from ashore."""
    films = [film for film in all_films(work) if film.weather == "clear" and film.viewpoint == "shore"]
    places = dict.fromkeys(film.place for film in films)
    return [film for place in places for film in [each for each in films if each.place == place][:FILMS_OF_A_PLACE]]


def pixel_voyages(pool: Executor, work: Path = WORK) -> dict[str, Any]:
    """All films: their names, and each variant's comparisons, number by number.

    Films that are not in the work folder are made of what was found in them, without pictures.
    """
    films = pixel_films(work)
    restore_films(work, films)
    found: dict[str, Any] = {"films": [film.name for film in films], "refused": {}}
    for variant in VARIANTS:
        done = list(pool.map(compared, films, [variant] * len(films)))
        found["refused"] |= {f"{film.name}, {variant}": each for film, each in zip(films, done, strict=True)
                             if isinstance(each, str)}  # fmt: skip
        found[variant] = comparisons(each for each in done if not isinstance(each, str))
    return found


def compared(film: Film, variant: str) -> dict[str, dict[str, float]] | str:
    """Each number of a film by full truth and by AIS, with its intervals; or why the film was refused."""
    full = learn_detector(truth=film.truth, detections=film.real, **_FULL)
    try:
        by_ais = _by_ais(film, VARIANTS[variant])
    except ModsimError as error:
        return str(error)
    first, second = _numbers(full), _numbers(by_ais)
    return {name: first[name] | {f"ais_{key}": value for key, value in second[name].items()}
            for name in first if name in second}  # fmt: skip


def comparisons(films: Iterable[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Over films: means by both truths, in how many films intervals overlap, and in how many AIS is in the full one."""
    every = list(films)
    result = {}
    for name in dict.fromkeys(name for each in every for name in each):
        rows = [each[name] for each in every if name in each]
        value, low, high, ais, ais_low, ais_high = (
            np.array([row[key] for row in rows]) for key in ("value", "low", "high", "ais_value", "ais_low", "ais_high")
        )
        result[name] = {
            "films": len(rows),
            "full": float(f"{value.mean():.6g}"),
            "ais": float(f"{ais.mean():.6g}"),
            "overlap": int(((ais_low <= high) & (low <= ais_high)).sum()),
            "inside": int(((low <= ais) & (ais <= high)).sum()),
        }
    return result


def _by_ais(film: Film, errors: AisErrors) -> LearnResult:
    """Learned from what the detector found, by the tracks of AIS and through a camera and a clock that are wrong."""
    true = film.scene()
    camera = true.cameras[0].name
    opposite = {name: -value for name, value in WRONG.items()} | {"focal_share": 1 / (1 + WRONG["focal_share"]) - 1}
    known, _ = as_reported(really(true, camera, opposite), film.seed, errors)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "detections.csv"
        _write_log(film, camera, log)
        return learn_voyage(known, log, position_noise=errors.position_m, **_FULL)


def _write_log(film: Film, camera: str, path: Path) -> None:
    """What was found in a film, by a clock that is late."""
    images = json.loads(film.truth.read_text(encoding="utf-8"))["images"]
    real = json.loads(film.real.read_text(encoding="utf-8"))
    row = {image["id"]: k for k, image in enumerate(images)}
    times_s = np.array([image["time_s"] for image in images]) - WRONG["clock_s"]
    frame, boxes = np.array([row[each["image_id"]] for each in real]), np.array([each["bbox"] for each in real])
    boxes[:, 2:] += boxes[:, :2]
    write_table(path, times_s, camera, frame, [LABEL] * len(real), np.array([each["score"] for each in real]), boxes)


def _numbers(learned: LearnResult) -> dict[str, dict[str, float]]:
    """Each number with its interval; not the quantiles of confidence, which are many, nor what a rule settles."""
    found = {}
    for each in learned.report.learned.intervals(LEVEL):
        path = each.key.path
        if path != "transition_matrix" and not path.endswith((BY_RULE, "quantiles", "false_positive_labels")):
            ends = [np.broadcast_to(end, np.shape(each.estimate)) for end in (each.low, each.high)]
            for place, value in np.ndenumerate(each.estimate):
                low, high = (float(end[place]) for end in ends)
                found[_short(each.key.at(place))] = {"value": float(value), "low": low, "high": high}
    return found


def _short(name: str) -> str:
    """A number's name without the state, whose name is that of the film's weather or of the voyage."""
    return name.split(".", 2)[2] if name.startswith("states.") else name
