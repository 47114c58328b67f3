"""One voyage with one seed: simulated, registered, learned, and compared with what is known."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.processes import ROOT
from benchmarks.voyages.cases import BY_NAME, TOLD_M, Case, scene_of_sample
from benchmarks.voyages.guessed import Guesses
from benchmarks.voyages.reported import as_reported
from benchmarks.voyages.wrong_camera import Voyage, drawn_traffic, drawn_wrong
from modsim3d.core.errors import ModsimError
from modsim3d.learn.bootstrap import Interval
from modsim3d.learn.voyage.learn_voyage import VoyageResult, learn_voyage
from modsim3d.learn.voyage.registration.registering import Registration, register
from modsim3d.scene.scene import Scene
from tests.learn.round_trip import asked_of

REPLICATES = 100
LEVEL = 0.95
BY_RULE = "box_error_mean"
"""Registration takes mean box errors as zero; what is left of them is no number of the detector."""
BOX_S = "persistence.box_s"
"""What persists of a component that is an upper bound is not taken off it, so it is one too."""
_BOX_ERRORS = "states.voyage.box_error_"
_CERTAIN = 1e-9

Number = dict[str, float]
"""A number of a trial: `asked`, `value`, `low`, `high`; `bound` is 1 if it was said to be an upper bound, and `unknown`
if it was said that nothing is known of it."""


def trial(name: str, seed: int) -> dict[str, Any]:
    """A voyage of a case: `registration` and `detector` by the numbers' names; or `refused`; and its CPU time."""
    case, start = BY_NAME[name], time.process_time()
    result: dict[str, Any] = {"seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        wrong = drawn_wrong(seed)
        voyage, known = _really_and_known(case, seed, Path(folder), wrong)
        try:
            if case.learns:
                learned = _learned(case, voyage, known, seed, Path(folder))
                result["detector"] = detector_numbers(learned, asked_of(case.detector))
                done = [each.registration for each in learned.registered if each.registration is not None]
            else:
                done = [register(known, case.camera, voyage.detections(seed), **dict(case.priors))]
            numbers = [registration_numbers(each, wrong) for each in done]
            result["registration"] = {name: number for each in numbers for name, number in each.items()}
        except ModsimError as error:
            result["refused"] = str(error).replace(f"{ROOT}/", "")
    return result | {"cpu_s": time.process_time() - start}


def _really_and_known(case: Case, seed: int, folder: Path, wrong: Mapping[str, float]) -> tuple[Voyage, Scene]:
    """What the camera really saw, and the scene that the user has; one from AIS is in the folder."""
    said = drawn_traffic(scene_of_sample(folder) if case.guessed else case.true_scene(), seed)
    if not case.guessed:
        return Voyage.of(said, case.camera, wrong), as_reported(said, seed, case.errors)[0]
    guesses = Guesses.drawn(said, seed)
    true = guesses.true_scene(said)
    known, _ = as_reported(true, seed, case.errors)
    return Voyage.of(true, case.camera, wrong), guesses.as_said(known, said)


def registration_numbers(done: Registration, wrong: Mapping[str, float]) -> dict[str, Number]:
    """What was estimated of the camera and the clock, beside what is known."""
    return {
        each.name: {"asked": wrong.get(each.name, 0.0), "value": each.value, "low": each.low, "high": each.high}
        for each in done.estimates
        if not each.held
    }


def detector_numbers(learned: VoyageResult, asked: Mapping[str, np.ndarray]) -> dict[str, Number]:
    """What was learned of the detector, beside what its file says; numbers of models that it does not have are not."""
    are_bounds = bounds(learned)
    found: dict[str, Number] = {}
    for each in learned.report.learned.intervals(LEVEL):
        path = each.key.path
        other = path.startswith(_BOX_ERRORS) and each.key.remark not in ("", "px")
        if path in asked and path != "transition_matrix" and not path.endswith(BY_RULE) and not other:
            for place, value in np.ndenumerate(asked[path]):
                found[each.key.at(place)] = _number(each, place, float(value), path, are_bounds)
    return found


def _number(each: Interval, place: tuple[int, ...], asked: float, path: str, are_bounds: np.ndarray) -> Number:
    ends = [float(np.broadcast_to(end, np.shape(each.estimate))[place]) for end in (each.low, each.high)]
    number = {"asked": asked, "value": float(each.estimate[place]), "low": ends[0], "high": ends[1]}
    bound = are_bounds[place[0]] if path == f"{_BOX_ERRORS}std" else path == BOX_S and are_bounds.any()
    unknown = np.isnan(ends).any() or (path == f"{_BOX_ERRORS}correlation" and ends[0] <= -1 and ends[1] >= 1)
    return number | ({"bound": 1.0} if bound else {}) | ({"unknown": 1.0} if unknown else {})


def bounds(learned: VoyageResult) -> np.ndarray:
    """Which components of the box error were said to be upper bounds, shape (4,)."""
    (state,) = learned.voyage_report.correction.states
    noisy = learned.voyage_report.correction.noise.position_m > 0
    return np.zeros(4, dtype=bool) if state is None else ~state.taken_off & noisy


def holds(number: Number) -> bool:
    """Whether what is known lies in the interval, or below its upper end if it is a bound."""
    over = bool(number.get("bound")) or number["asked"] >= number["low"] - _CERTAIN
    return over and number["asked"] <= number["high"] + _CERTAIN


def _learned(case: Case, voyage: Voyage, known: Scene, seed: int, folder: Path) -> VoyageResult:
    log = folder / "detections.csv"
    voyage.write_log(seed, log)
    return learn_voyage(
        known,
        log,
        fixed=() if case.registered else "all",
        position_noise=TOLD_M if case.errors.position_m else 0.0,
        match="centre",  # as is usual with AIS; by IoU slivers at the border would be false positives
        replicates=REPLICATES,
        seed=seed,
    )
