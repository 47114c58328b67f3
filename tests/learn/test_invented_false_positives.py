"""False positives that are drawn anew in every image are not learned as ones that stay."""

from __future__ import annotations

import numpy as np
import pytest

from modsim3d.learn.matches import FalseSightings
from modsim3d.learn.persistent_false_positives import Lasting, find_lasting
from tests.formats.labelled_sets import found, images, truth
from tests.learn.one_state import observed_in, of_boats

FRAMES, SETS = 300, 200


def learned(rate: float, seed: int, stays: int = 0) -> bool:
    """Whether false positives of a rate an image, and so many that stay for 20 frames, are learned to stay."""
    rng = np.random.default_rng(seed)
    image = np.repeat(np.arange(FRAMES), rng.poisson(rate, FRAMES))
    centre = rng.uniform(40, 560, (len(image), 2))
    for _ in range(stays):
        begin = int(rng.integers(0, FRAMES - 20))
        image = np.append(image, np.arange(begin, begin + 20))
        centre = np.concatenate([centre, np.tile(rng.uniform(40, 560, 2), (20, 1))])
    order = np.argsort(image, kind="stable")
    image, centre = image[order], centre[order]
    side = rng.uniform(15, 30, (len(image), 1))
    detections = found(image, 0 * image, np.hstack([centre - side, centre + side]), np.full(len(image), 0.5))
    frames = images(FRAMES, time_s=np.arange(FRAMES) * 0.25)
    observed = observed_in(of_boats(frames, truth([], [], []), detections))
    sightings = FalseSightings.of(observed)
    return isinstance(find_lasting(observed, sightings, np.full(FRAMES, len(image) / FRAMES)), Lasting)


@pytest.mark.parametrize("rate", [0.02, 0.1, 0.6])
def test_none_is_invented_in_two_hundred_sets(rate: float) -> None:
    assert sum(learned(rate, seed) for seed in range(SETS)) == 0


def test_those_that_stay_are_found() -> None:
    assert sum(learned(0.1, seed, stays=4) for seed in range(10)) >= 9  # two may lie at one place, far apart in time
