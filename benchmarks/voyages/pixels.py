"""A detector that looks at pixels, learned from films by the truth of AIS and by full truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stand_in.films import WORK, Film, all_films
from benchmarks.stand_in.rungs import MIN_CONFIDENCE, MIN_IOU
from benchmarks.stand_in.stored import restore_films
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.trials import BY_RULE, LEVEL, REPLICATES, bounds, registration_numbers
from benchmarks.voyages.wrong_camera import WRONG, really, write_table
from modsim3d.core.errors import ModsimError
from modsim3d.learn.learned_detector import Estimates
from modsim3d.learn.learning import learn_detector
from modsim3d.learn.voyage.learn_voyage import VoyageResult, learn_voyage
from modsim3d.learn.voyage.log_to_scene import Correction

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
_FULL = {"match": "confidence", "least_iou": MIN_IOU, "confidence": MIN_CONFIDENCE, "without": WITHOUT,
         "replicates": REPLICATES}  # fmt: skip
STD = "box_error_std[{}] (px)"
_COMPONENTS = ("e_x", "e_y", "e_w", "e_h")

Numbers = dict[str, dict[str, float]]
"""Numbers by their names, each with `value`, `low` and `high`."""


@dataclass(frozen=True)
class Compared:
    """A film learned by full truth and by AIS.

    Attributes:
        numbers: Those of both; with `ais_` before, those by AIS; `ais_bound` is 1 if that is said to be an upper bound.
        clock: What registration finds of the clock, as `registration_numbers` has it.
    """

    numbers: Numbers
    clock: dict[str, float]


def pixel_films(work: Path = WORK) -> list[Film]:
    """The first films of each place in clear weather from ashore."""
    films = [film for film in all_films(work) if film.weather == "clear" and film.viewpoint == "shore"]
    places = dict.fromkeys(film.place for film in films)
    return [film for place in places for film in [each for each in films if each.place == place][:FILMS_OF_A_PLACE]]


def restored_films(work: Path = WORK) -> list[Film]:
    """These films; those that are not in the work folder are made of what was found in them, without pictures."""
    films = pixel_films(work)
    restore_films(work, films)
    return films


def pixel_voyages(pool: Executor, films: list[Film]) -> dict[str, Any]:
    """All films: their names, each variant's comparisons, number by number, and each film's clock and values."""
    found: dict[str, Any] = {"films": [film.name for film in films], "refused": {}, "registered": {}}
    for variant in VARIANTS:
        done = dict(zip((film.name for film in films), pool.map(compared, films, [variant] * len(films)), strict=True))
        found["refused"] |= {f"{name}, {variant}": each for name, each in done.items() if isinstance(each, str)}
        learned = {name: each for name, each in done.items() if not isinstance(each, str)}
        found[variant] = comparisons(each.numbers for each in learned.values())
        found["registered"][variant] = {
            name: {"clock": each.clock} | {key: number["ais_value"] for key, number in each.numbers.items()}
            for name, each in learned.items()
        }
    return found


def compared(film: Film, variant: str) -> Compared | str:
    """A film by full truth and by AIS; or why it was refused."""
    full = learn_detector(truth=film.truth, detections=film.real, **_FULL)
    try:
        by_ais = by_tracks(film, VARIANTS[variant])
    except ModsimError as error:
        return str(error)
    first, second = numbers_of(full.report.learned), numbers_of(by_ais.report.learned)
    numbers = {name: first[name] | {f"ais_{key}": value for key, value in second[name].items()}
               for name in first if name in second}  # fmt: skip
    for component, bound in zip(_COMPONENTS, bounds(by_ais), strict=True):
        if bound and STD.format(component) in numbers:
            numbers[STD.format(component)]["ais_bound"] = 1.0
    (done,) = by_ais.registered
    return Compared(numbers, registration_numbers(done.registration, WRONG)["clock_s"])


def comparisons(films: Iterable[Numbers]) -> dict[str, dict[str, float]]:
    """Over films: means by both truths, in how many films both intervals are known, in how many of them they overlap,
    and in how many the value by AIS lies in that of full truth."""
    every = list(films)
    result = {}
    for name in dict.fromkeys(name for each in every for name in each):
        rows = [each[name] for each in every if name in each]
        value, low, high, ais, ais_low, ais_high = (
            np.array([row[key] for row in rows]) for key in ("value", "low", "high", "ais_value", "ais_low", "ais_high")
        )
        result[name] = {
            "films": int(np.isfinite([low, high, ais_low, ais_high]).all(axis=0).sum()),
            "full": float(f"{value.mean():.6g}"),
            "ais": float(f"{ais.mean():.6g}"),
            "overlap": int(((ais_low <= high) & (low <= ais_high)).sum()),
            "inside": int(((low <= ais) & (ais <= high)).sum()),
            "bounds": sum(row.get("ais_bound", 0) > 0 for row in rows),
        }
    return result


def by_tracks(film: Film, errors: AisErrors, *, registered: bool = True, replicates: int = REPLICATES) -> VoyageResult:
    """Learned from what the detector found, by the tracks of AIS.

    The camera and the clock are wrong and registered, or known.
    """
    true = film.scene()
    camera = true.cameras[0].name
    opposite = {name: -value for name, value in WRONG.items()} | {"focal_share": 1 / (1 + WRONG["focal_share"]) - 1}
    known, _ = as_reported(really(true, camera, opposite if registered else {}), film.seed, errors)
    right = None if registered else Correction(clock_s=WRONG["clock_s"])
    how = _FULL | {"replicates": replicates}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "detections.csv"
        _write_log(film, camera, log)
        return learn_voyage(known, log, position_noise=errors.position_m, registration=right, **how)


def _write_log(film: Film, camera: str, path: Path) -> None:
    """What was found in a film, by a clock that is late."""
    images = json.loads(film.truth.read_text(encoding="utf-8"))["images"]
    real = json.loads(film.real.read_text(encoding="utf-8"))
    row = {image["id"]: k for k, image in enumerate(images)}
    times_s = np.array([image["time_s"] for image in images]) - WRONG["clock_s"]
    frame, boxes = np.array([row[each["image_id"]] for each in real]), np.array([each["bbox"] for each in real])
    boxes[:, 2:] += boxes[:, :2]
    write_table(path, times_s, camera, frame, [LABEL] * len(real), np.array([each["score"] for each in real]), boxes)


def numbers_of(learned: Estimates) -> Numbers:
    """Each number with its interval; not the quantiles of confidence, which are many, nor what a rule settles."""
    found = {}
    for each in learned.intervals(LEVEL):
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
