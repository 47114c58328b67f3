"""The laws that measured numbers are held against, each against a slow and obvious one."""

import itertools

import numpy as np
import pytest
from scipy import stats

from modsim3d.core.boxes import inside_image, move
from modsim3d.detector.confidence import clipped_score
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import Persistence
from modsim3d.detector.truncation import ordered_root
from modsim3d.verify.box_error_checks import latent_paths, replayed_errors
from modsim3d.verify.class_checks import inflation, lag_pairs
from modsim3d.verify.confidence_checks import Clipped
from modsim3d.verify.error_fit import MomentTable, StateErrors, fit_step, fitted_law
from modsim3d.verify.error_parameters import ErrorParameters, directions
from modsim3d.verify.figures import expected_run_lengths
from modsim3d.verify.verification import occupancy_law
from tests.detector_variants import thesis_data

IMAGE_PX = (3600, 2400)
BOXES_PX = np.array(
    [
        [1800.0, 1200, 1840, 1212],  # small, far from every edge
        [1800.0, 1200, 2200, 1500],  # large
        [0.0, 700, 15, 790],  # at the left edge
        [3590.0, 2380, 3600, 2400],  # in a corner
        [500.0, 0, 501, 1],  # a pixel
    ]
)
MODEL = parse_detector(thesis_data())


def law_of(**changes) -> ErrorParameters:
    law = ErrorParameters.of(MODEL.states[3].box_error)
    return ErrorParameters(**{**{name: getattr(law, name) for name in ("mean", "std", "correlation")}, **changes})


LAWS = {
    "px": law_of(),
    "relative": law_of(mean=np.array([0.1, 0, -0.1, 0.2]), std=np.array([0.3, 0.4, 0.6, 0.5]), relative=True),
    "mixed": law_of(std=np.array([5.0, 4, 6, 5]), growth=np.array([0.1, 0, 0.3, 0.2])),
}


def sampled(law: ErrorParameters, box: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Errors of one box by drawing until they count, standardised."""
    rng = np.random.default_rng(seed)
    means, stds = law.at(box[None])
    drawn = rng.multivariate_normal(np.zeros(4), law.correlation, size=count)
    return drawn[inside_image(move(box, means[0] + stds[0] * drawn), IMAGE_PX)]


CASES = [(name, box) for name in LAWS for box in range(5) if (name, box) != ("mixed", 4)]  # which hardly ever counts


@pytest.mark.parametrize("name, box", CASES)
def test_truncated_moments_are_those_of_draws_that_count(name, box):
    law, boxes = LAWS[name], BOXES_PX[[box] * 40]  # many shifts of the points, one box
    first, _, acceptance = MomentTable().of(law, boxes, np.tile(np.array(IMAGE_PX, float), (40, 1)), np.arange(40))
    draws = sampled(law, BOXES_PX[box], 100_000)
    share = len(draws) / 100_000
    assert acceptance.mean() == pytest.approx(share, abs=5 * np.sqrt(share / 100_000) + 0.003)
    values = law.statistics(draws)
    tolerance = 5 * values.std(axis=0) / np.sqrt(len(draws)) + 5 * first.std(axis=0) / np.sqrt(40)
    np.testing.assert_array_less(np.abs(first.mean(axis=0) - values.mean(axis=0)), tolerance + 1e-3)


def test_ordered_root_is_a_root_also_of_a_singular_covariance():
    covariance = np.outer([2.0, 0, 3, 1], [2.0, 0, 3, 1]) + np.diag([0, 0, 1.0, 0])
    root = ordered_root(covariance)
    order = np.array([2, 3, 0, 1])
    np.testing.assert_allclose(root @ root.T, covariance[order[:, None], order], atol=1e-9)


@pytest.mark.parametrize("parameter", range(14))
def test_directions_are_derivatives_of_the_normal_density(parameter):
    law, h = LAWS["px"], 1e-5
    x = np.random.default_rng(8).standard_normal((20, 4))
    step = np.zeros(14)
    step[parameter] = h

    def log_density(moved: ErrorParameters) -> np.ndarray:
        mean, std = (moved.mean - law.mean) / law.std, moved.std / law.std
        return stats.multivariate_normal(mean, moved.correlation * np.outer(std, std)).logpdf(x)

    slope = (log_density(law.moved(step)) - log_density(law.moved(-step))) / (2 * h)
    found = law.statistics(x) @ directions(law.correlation)[parameter]
    np.testing.assert_allclose(found - found[0], slope - slope[0], rtol=1e-4, atol=1e-4)


def enough(law: ErrorParameters, box: np.ndarray, count: int, seed: int) -> np.ndarray:
    """At least so many errors of one box, of which one in a hundred may count."""
    parts: list[np.ndarray] = []
    while sum(map(len, parts)) < count:
        assert len(parts) < 20
        parts.append(sampled(law, box, 15 * count, 100 * seed + len(parts)))
    return np.concatenate(parts)


def samples_of(law: ErrorParameters, copies: int, count: int) -> list[StateErrors]:
    """Errors of four boxes, so many of each, so many times over."""
    boxes = np.repeat(BOXES_PX[:4], copies, axis=0)
    images = np.tile(np.array(IMAGE_PX, float), (len(boxes), 1))
    means, stds = law.at(boxes)
    pools = [enough(law, box, copies * count, seed) for seed, box in enumerate(BOXES_PX[:4])]
    standard = [np.concatenate([pool[k * copies : (k + 1) * copies] for pool in pools]) for k in range(count)]
    return [StateErrors(means + stds * errors, np.arange(len(boxes)), boxes, images) for errors in standard]


@pytest.mark.parametrize("name", LAWS)
def test_steps_of_honest_errors_have_mean_zero_and_their_standard_error(name):
    law, table, z = LAWS[name], MomentTable(), []
    for sample in samples_of(law, 30, 40):
        fit = fit_step(law, sample, table)
        z.append(fit.step / fit.errors)
    z = np.array(z)
    assert np.abs(z.mean(axis=0)).max() < 4.2 / np.sqrt(40) and np.abs(z.std(axis=0) - 1).max() < 4.2 / np.sqrt(80)


def test_the_fit_finds_a_law_that_is_another_than_the_one_asked_for():
    law = law_of()
    true = law_of(mean=law.mean + 0.4 * law.std, std=law.std * [1.5, 1, 1, 1])
    (sample,) = samples_of(true, 400, 1)
    fit = fit_step(law, sample, MomentTable())
    found, errors = fitted_law(law, fit, sample), fit.errors[:4] * law.std
    np.testing.assert_array_less(np.abs(found.mean - true.mean), 5 * errors)
    assert found.std[0] == pytest.approx(true.std[0], rel=0.15)


def test_replayed_errors_have_the_truncated_law_and_keep_their_correlation():
    law = law_of()
    frames = 40
    boxes = np.tile(BOXES_PX[1], (frames, 1))
    sample = StateErrors(np.zeros((frames, 4)), np.arange(frames), boxes, np.tile([3600.0, 2400], (frames, 1)))
    tracks, times = np.zeros((frames, 1), dtype=np.int64), 0.1 * np.arange(frames)
    rng = np.random.default_rng(2)
    errors = replayed_errors(law, sample, latent_paths(tracks, times, Persistence(box_s=0.5), rng, 400, 4), rng)
    np.testing.assert_allclose(errors.mean(axis=(0, 1)), sampled(law, BOXES_PX[1], 100_000).mean(axis=0), atol=0.06)
    lagged = [np.corrcoef(errors[:, :-1, k].ravel(), errors[:, 1:, k].ravel())[0, 1] for k in range(4)]
    np.testing.assert_allclose(lagged, np.exp(-0.2), atol=0.06)


def test_clipped_scores_are_derivatives_of_the_likelihood():
    def likelihood(mean: float, std: float) -> np.ndarray:
        low, high = stats.norm.logcdf((0.2 - mean) / std), stats.norm.logsf((1 - mean) / std)
        inner = stats.norm.logpdf(scores, mean, std)
        return np.where(scores <= 0.2, low, np.where(scores >= 1, high, inner))

    scores, h = np.array([0.2, 0.5, 0.9, 1.0]), 1e-6
    for column, (mean, std) in zip(clipped_score(scores, 0.65, 0.3, 0.2).T, ((h, 0), (0, h)), strict=True):
        slope = (likelihood(0.65 + mean, 0.3 + std) - likelihood(0.65 - mean, 0.3 - std)) / (2 * h)
        np.testing.assert_allclose(column, slope, rtol=1e-5)


def test_clipped_confidence_is_measured_without_bias_and_with_its_standard_error():
    rng, z = np.random.default_rng(4), []
    hidden = rng.random(300)
    design = np.column_stack([np.ones(300), -hidden])
    for _ in range(40):
        scores = np.clip(0.85 - 0.4 * hidden + 0.25 * rng.standard_normal(300), 0.2, 1)
        z.append([measure.z for measure in Clipped(scores, design, 0.2).measures(np.array([0.85, 0.4]), 0.25)])
    z = np.array(z)
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(40) and np.abs(z.std(axis=0) - 1).max() < 4 / np.sqrt(80)


def test_occupancy_law_is_that_of_every_path():
    transitions = np.array([1, 0, 2, 1, 1])
    matrix, expected = MODEL.transition_matrix, np.zeros(len(transitions) + 2)
    for path in itertools.product(range(4), repeat=len(transitions)):
        states, chance = (0, *path), 1.0
        for before, after, steps in zip(states, path, transitions, strict=False):
            chance *= np.linalg.matrix_power(matrix, steps)[after, before]
        expected[sum(state == 1 for state in states)] += chance
    np.testing.assert_allclose(occupancy_law(MODEL, 1, transitions, start=0), expected, atol=1e-12)


def test_lag_pairs_are_all_pairs_of_a_track_that_are_near():
    rng = np.random.default_rng(5)
    tracks, times = rng.integers(0, 3, (40, 1)), rng.random(40) * 10
    parts = (zip(later.tolist(), earlier.tolist(), strict=True) for later, earlier, _ in lag_pairs(tracks, times, 0.3))
    near = (tracks == tracks[:, 0]) & (times[:, None] > times) & (times[:, None] - times <= 3.0)
    assert set(itertools.chain.from_iterable(parts)) == {*map(tuple, np.argwhere(near).tolist())}


def test_inflation_of_a_rate_that_persists_is_that_of_a_kept_uniform():
    frames, keep = 400, np.exp(-0.1 / 1.0)
    rng, counts = np.random.default_rng(6), []
    for _ in range(2000):
        fresh, new = rng.random(frames), rng.random(frames) >= keep
        new[0] = True
        counts.append((fresh[np.maximum.accumulate(np.where(new, np.arange(frames), 0))] >= 0.7).sum())
    track, times_s = np.zeros((frames, 1), dtype=np.int64), 0.1 * np.arange(frames)
    factor = inflation(track, times_s, 1.0, np.full(frames, 0.21), lambda a, b: np.full(len(a), 0.21))
    assert np.var(counts) == pytest.approx(frames * 0.21 * factor, rel=5 * np.sqrt(2 / 2000))


@pytest.mark.parametrize("keep", [0.0, 0.6])
def test_run_lengths_expected_are_those_of_every_outcome(keep):
    before, chance = np.array([-1, 0, 1, 2, -1, 4]), np.array([0.3, 0.3, 0.3, 0.3, 0.4, 0.4])
    again = np.where(before >= 0, keep + (1 - keep) * chance, chance)
    spared = np.where(before >= 0, (1 - keep) * chance, chance)  # a miss where the frame before was none
    expected = np.zeros(7)
    for missed in itertools.product((0, 1), repeat=6):
        rates = [again[i] if i not in (0, 4) and missed[i - 1] else spared[i] for i in range(6)]
        weight = np.prod([rate if miss else 1 - rate for miss, rate in zip(missed, rates, strict=True)])
        for track in ("".join(map(str, missed[:4])), "".join(map(str, missed[4:]))):
            for run in track.split("0"):
                expected[len(run)] += weight
    np.testing.assert_allclose(expected_run_lengths(chance, again, before, 6), expected[1:], atol=1e-12)
