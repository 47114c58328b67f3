"""voyage_registration: do the intervals of a registration hold what they claim? A wrong camera and clock, many seeds.

python -m benchmarks.voyage_registration --camera bow --seeds 50
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable

import numpy as np
from scipy.stats import binom

from modsim3d.errors import ModsimError
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.voyage.registration import Registration, register
from tests.voyage.registration.wrong_camera import WRONG, Voyage, as_reported

LEVEL, SURE = 0.95, 0.99
SETTINGS = {
    "annotation.source": "analytic",
    "detector.states.clear.box_error.mean": [0, 0, 0, 0],
    "detector.states.haze.box_error.mean": [0, 0, 0, 0],
}
"""Mean box errors are zero, as the rule has it."""


STDS, NOISE_M, SILENT = (3.0, 1.0, 0.5), 1.0, 0.2
"""Of AIS: antennas along and across in metres, delays in seconds; noise of positions; share without a transponder."""


def registrations(scene: Scene, camera: str, seeds: Iterable[int], *, ais: bool) -> list[Registration]:
    """The registration from the detections of each seed, which share the truth; those that are refused are told."""
    voyage, done = Voyage.of(scene, camera, WRONG), []
    others = [name for index, name in enumerate(scene.vessel_names) if index not in scene.own_ships]
    expected = {"offsets_m": STDS[0], "noise_m": NOISE_M} if ais else {}
    for seed in seeds:
        known = scene
        if ais:
            silent = np.random.default_rng(seed).choice(others, round(SILENT * len(others)), replace=False)
            known, _ = as_reported(scene, seed, STDS, NOISE_M, silent.tolist())
        try:
            done.append(register(known, camera, voyage.detections(seed), **expected))
        except ModsimError as error:
            print(f"seed {seed}: {error}")
    return done


def coverage(done: list[Registration]) -> list[tuple[str, int, int, float, float, float]]:
    """Each estimated parameter: how often its interval held, of how many, mean and spread of its error, half-width."""
    rows = []
    for name in [estimate.name for estimate in done[0].estimates]:
        known = [each[name] for each in done if not each[name].held]
        truth = WRONG.get(name, 0.0)
        if known:
            held = sum(estimate.low <= truth <= estimate.high for estimate in known)
            errors = np.array([estimate.value - truth for estimate in known])
            half = np.median([(estimate.high - estimate.low) / 2 for estimate in known])
            rows.append((name, held, len(known), float(errors.mean()), float(errors.std()), float(half)))
    return rows


def fewest(count: int) -> int:
    """The fewest intervals that hold, of so many at 95 %, with a probability of at least 1 %."""
    return int(binom.ppf(1 - SURE, count, LEVEL))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="strait")
    parser.add_argument("--camera", default="bow")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--ais", action="store_true", help="with errors of AIS")
    options = parser.parse_args()
    scene = load_scene(options.scene, settings={**SETTINGS, "waves.apply_to": "ownship"})
    start = time.perf_counter()
    done = registrations(scene, options.camera, range(options.first, options.first + options.seeds), ais=options.ais)
    print(f"{options.scene}, {options.camera}: {len(done)} seeds, {time.perf_counter() - start:.0f} s")
    print(f"{'parameter':<20} {'held':>9} {'fewest':>6} {'mean error':>11} {'its std':>10} {'half width':>11}")
    for name, held, count, error, spread, half in coverage(done):
        print(f"{name:<20} {held:>4}/{count:<4} {fewest(count):>6} {error:>11.4g} {spread:>10.4g} {half:>11.4g}")


if __name__ == "__main__":
    main()
