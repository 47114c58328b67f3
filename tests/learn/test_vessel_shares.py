"""What vessels keep of their misses and box errors comes back, and is not seen where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from scipy.stats import binom

from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.bootstrap import Resampling
from modsim3d.learn.learned import Learned
from modsim3d.learn.misses import choose_classes
from modsim3d.learn.persistence import LagTable
from tests.formats.labelled_sets import found, images, truth
from tests.learn.one_state import learned_in, observed_in, of_boats
from tests.learn.test_persistence import RATE_HZ, chain

BOATS, FRAMES, CLASS_S, BOX_S = 40, 120, 1.0, 0.7
MISSES = 0.35


def boats(seed: int, class_share: float, box_share: float) -> LabelledSet:
    """Boats in a row, whose misses and errors are made like a detector's with shares that vessels keep."""
    rng = np.random.default_rng(seed)
    errors = chain(np.exp(-1 / RATE_HZ / BOX_S), rng, FRAMES, BOATS, 4)
    errors = np.sqrt(box_share) * rng.normal(size=(BOATS, 4)) + np.sqrt(1 - box_share) * errors
    latent = rng.normal(size=(FRAMES, BOATS))
    for frame in range(1, FRAMES):
        keeps = rng.random(BOATS) < np.exp(-1 / RATE_HZ / CLASS_S)
        latent[frame] = np.where(keeps, latent[frame - 1], latent[frame])
    latent = np.sqrt(class_share) * rng.normal(size=BOATS) + np.sqrt(1 - class_share) * latent
    seen = (latent < -special.ndtri(MISSES)).ravel()
    image, identity = np.repeat(np.arange(FRAMES), BOATS), np.tile(np.arange(BOATS), FRAMES)
    x = 100.0 + 150 * identity
    boxes = np.column_stack([x, 0 * x + 300, x + 60, 0 * x + 360])
    centre, side = errors.reshape(-1, 4)[:, :2] * 2, errors.reshape(-1, 4)[:, 2:] * 2
    moved = boxes + np.concatenate([centre - side / 2, centre + side / 2], axis=1)
    pictures = images(FRAMES, (200.0 + 150 * BOATS, 800.0), np.arange(FRAMES) / RATE_HZ)
    results = found(image[seen], 0 * image[seen], moved[seen], np.full(seen.sum(), 0.9))
    return of_boats(pictures, truth(image, 0 * image, boxes, identity=identity), results)


def learned_from(labelled: LabelledSet, without: frozenset[str] = frozenset()) -> Learned:
    return learned_in(observed_in(labelled, without=without), replicates=30)


def test_shares_and_correlation_times_come_back_inside_their_intervals() -> None:
    asked = {"class_s": CLASS_S, "class_vessel_share": 0.4, "box_s": BOX_S, "box_vessel_share": 0.3}
    inside: dict[str, list[bool]] = {key: [] for key in (*asked, "misses", "means")}
    estimates: dict[str, list[float]] = {key: [] for key in asked}
    for seed in range(4):
        learned = learned_from(boats(seed, 0.4, 0.3))
        intervals = {each.key.path: each for each in learned.intervals(0.95)}
        for key, value in asked.items():
            each = intervals[f"persistence.{key}"]
            estimates[key].append(float(each.estimate))
            inside[key].append(bool(each.low <= value <= each.high))
        missed, mean = intervals["states.usual.confusion"], intervals["states.usual.box_error_mean"]
        inside["misses"].append(bool(missed.low[1, 0] <= MISSES <= missed.high[1, 0]))
        inside["means"] += [bool(low <= 0 <= high) for low, high in zip(mean.low, mean.high, strict=True)]
    for key, value in asked.items():
        assert np.median(estimates[key]) == pytest.approx(value, rel=0.15)
    for key, hits in inside.items():
        assert binom.cdf(sum(hits), len(hits), 0.95) > 0.01, key
    assert parse_detector(learned.detector()).persistence.class_vessel_share > 0.2


def test_what_the_mean_of_few_things_takes_of_a_share_is_made_up_for() -> None:
    """Of n equal things with a share s, residuals from their mean keep s·(1 − 1/n)/(1 − s/n)."""
    things, share, time_s = 10, 0.4, 1.5
    lag_s = np.array([0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 16])
    lag, thing = (each.ravel() for each in np.meshgrid(np.arange(len(lag_s)), np.arange(things), indexing="ij"))
    level = share * (1 - 1 / things) / (1 - share / things)
    products = level + (1 - level) * np.exp(-lag_s[lag] / time_s)
    same = np.ones(len(lag))
    table = LagTable(products, same, lag_s[lag], lag, thing, 0 * lag, lag_s, things, 1 / things)
    fits = table.fit(Resampling(np.ones((1, 1)), np.zeros(1, dtype=np.int64)))
    assert fits.levels[0] == pytest.approx(share, abs=0.003)
    assert fits.times_s[0] == pytest.approx(time_s, rel=0.03)


def test_noise_that_is_forgotten_is_not_said_to_be_kept() -> None:
    for seed in range(2):
        learned = learned_from(boats(seed, 0.0, 0.0))
        assert learned.detector()["persistence"].keys() == {"class_s", "box_s"}
        notes = [note for note in learned.notes if "vessel_share" in note]
        assert len(notes) == 2 and all("standard errors from 0 with 40 things, needs 3.3" in note for note in notes)


def test_vessels_that_are_harder_by_themselves_give_no_slope() -> None:
    """Each boat stays at one distance, so chance makes far ones harder in as many frames as there are."""
    steeper, seeds = 0, 12
    for seed in range(seeds):
        labelled = boats(seed, 0.4, 0.0)
        distance_m = np.random.default_rng(100 + seed).uniform(100, 1000, BOATS)[labelled.annotations.identity]
        labelled = replace(labelled, annotations=replace(labelled.annotations, depth_m=distance_m))
        steeper += bool(choose_classes(observed_in(labelled)).effects)
    assert steeper <= binom.isf(0.001, seeds, 0.01)


def test_shares_can_be_left_out() -> None:
    learned = learned_from(boats(1, 0.4, 0.3), frozenset({"vessels"}))
    assert learned.detector()["persistence"].keys() == {"class_s", "box_s"}
    assert not [note for note in learned.notes if "vessel_share" in note]
