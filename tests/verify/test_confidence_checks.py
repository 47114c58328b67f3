"""Levels of confidences in their own law; those that persist count for fewer, and how long they do is tested."""

import numpy as np
import pytest
from scipy import stats

from modsim3d.detector.confidence import LEVELS, NormalScores, QuantileScores, drawn_levels, pair_likelihood, pair_score
from modsim3d.verify.confidence_checks import Clipped, KeptScores

TRACKS, FRAMES, KEPT = 12, 60, 0.8
CORRELATION_S = -1 / np.log(KEPT)


def chains(rng: np.random.Generator) -> np.ndarray:
    """Standard normal numbers of each track (row) with a share that is kept from one second to the next."""
    values = rng.normal(size=(TRACKS, FRAMES))
    for k in range(1, FRAMES):
        values[:, k] = KEPT * values[:, k - 1] + np.sqrt(1 - KEPT**2) * values[:, k]
    return values


def kept() -> KeptScores:
    tracks = np.column_stack([np.zeros(TRACKS * FRAMES), np.repeat(np.arange(TRACKS), FRAMES)]).astype(np.int64)
    return KeptScores(tracks, np.tile(np.arange(FRAMES), TRACKS).astype(float), CORRELATION_S)


def test_the_variance_of_a_sum_is_that_of_all_pairs() -> None:
    rng, ours = np.random.default_rng(1), kept()
    of_mean, of_square = rng.normal(size=(2, TRACKS * FRAMES, 3))
    same = ours.tracks[:, 1:] == ours.tracks[:, 1]
    correlation = np.where(same, KEPT ** np.abs(ours.times_s[:, None] - ours.times_s), 0)
    whole = [a @ correlation @ a + b @ correlation**2 @ b for a, b in zip(of_mean.T, of_square.T, strict=True)]
    alone = (of_mean**2 + of_square**2).sum(axis=0)
    assert ours.inflation(of_mean, of_square) == pytest.approx(whole / alone, rel=1e-3)


@pytest.mark.parametrize("mean", [0.7, 0.95], ids=["hardly clipped", "many are 1"])
def test_statistics_of_confidences_that_persist_have_the_spread_of_a_standard_normal_number(mean: float) -> None:
    rng, ours = np.random.default_rng(2), kept()
    hidden = np.repeat(rng.uniform(0, 0.5, TRACKS), FRAMES)
    design = np.column_stack([np.ones(len(hidden)), -hidden])
    found = []
    for _ in range(120):
        scores = np.clip(mean - 0.3 * hidden + 0.1 * chains(rng).ravel(), 0.2, 1)
        measures = Clipped(scores, design, 0.2, ours).measures(np.array([mean, 0.3]), 0.1)
        found.append([0.0 if each is None else each.z for each in measures])
    assert np.all(np.abs(np.mean(found, axis=0)) < 0.5)
    assert np.all((np.std(found, axis=0) > 0.7) & (np.std(found, axis=0) < 1.3))


def test_scores_of_the_right_correlation_cancel_and_those_of_others_do_not() -> None:
    rng, found = np.random.default_rng(3), {KEPT: [], 0.7: []}
    for _ in range(120):
        values = chains(rng)
        bounded = np.stack([values, values])
        bounded[1][values > 1] = np.inf
        bounded[0][values > 1] = 1.0
        low, high = bounded
        known = low[:, :-1] == high[:, :-1]
        pairs = low[:, :-1][known], low[:, 1:][known], high[:, 1:][known]
        for correlation, z in found.items():
            score = pair_score(*pairs, np.full(len(pairs[0]), correlation))
            z.append(score.sum() / np.sqrt((score**2).sum()))
    assert abs(np.mean(found[KEPT])) < 0.4 and 0.8 < np.std(found[KEPT]) < 1.2 and np.mean(found[0.7]) > 2


def test_a_number_beyond_a_bound_has_the_probability_of_what_lies_there() -> None:
    before, rho = np.array([0.7]), np.array([0.6])
    edges = np.linspace(-8, 8, 4001)
    density = np.exp(pair_likelihood(np.full(4001, 0.7), edges, edges, np.full(4001, 0.6))) / np.sqrt(2 * np.pi)
    found = np.exp(pair_likelihood(before, np.array([1.0]), np.array([np.inf]), rho))[0]
    assert found == pytest.approx(np.trapezoid(density[edges >= 1], edges[edges >= 1]), rel=1e-2)


# ---- Levels, also where the law is cut off at the ends of the range ----

LAWS = {
    "normal": NormalScores(0.6, 0.3),
    "quantiles": QuantileScores(np.array([0.1, 0.3, 0.3, 0.7, 1.2])),
}
STEPS = QuantileScores(np.array([0.3, 0.3, 0.5, 0.8, 0.8]))


@pytest.mark.parametrize("name", LAWS)
def test_levels_are_uniform_and_those_of_the_draw(name: str) -> None:
    rng = np.random.default_rng(4)
    uniforms, shift = rng.random(4000), np.where(np.arange(4000) % 2, 0.05, 0.0)
    values = LAWS[name].at(uniforms) + shift
    confidence = np.clip(values, 0.2, 1)
    levels = LEVELS[name](LAWS[name], confidence, np.zeros(4000) + shift)
    assert levels is not None
    drawn = drawn_levels(levels, confidence, 0.2, rng)
    assert stats.kstest(drawn, "uniform").pvalue > 1e-3
    level = np.interp(values - shift, [0.3 - 1e-9, 0.3 + 1e-9], [0, 1])
    alone = (confidence > 0.2) & (confidence < 1) & ((name == "normal") | (level == 0) | (level == 1))
    assert 0.3 < alone.mean() < 0.95
    np.testing.assert_allclose(drawn[alone], uniforms[alone], atol=1e-5)
    assert np.abs(drawn[~alone] - uniforms[~alone]).max() > 0.01


def test_a_step_of_a_law_has_all_its_levels_and_a_law_of_one_value_none() -> None:
    values = np.array([0.3, 0.4, 0.5, 0.65, 0.8])
    for shift in np.tile(np.linspace(0, 0.1, 8)[:, None], 5):
        levels = LEVELS["quantiles"](STEPS, values + shift, shift)
        assert levels is not None
        np.testing.assert_allclose(levels[0], [0, 0.375, 0.5, 0.625, 0.75], atol=1e-7)
        np.testing.assert_allclose(levels[1], [0.25, 0.375, 0.5, 0.625, 1], atol=1e-7)
    ends = np.array([0.4, 0.4])
    assert LEVELS["normal"](NormalScores(0.4, 0.0), ends, np.zeros(2)) is None
    assert LEVELS["quantiles"](QuantileScores(ends), ends, np.zeros(2)) is None
