"""Levels and memory of confidences and scores; independent draws pass, and lies that leave single numbers do not."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import special, stats

from modsim3d import DetectorModel, load_scene, verify_evidence
from modsim3d.detector.confidence import LEVELS, NormalScores, QuantileScores, drawn_levels, pair_likelihood, pair_score
from modsim3d.detector.draws import select
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import LatentScore, Persistence
from modsim3d.verify.box_error_checks import latent_paths, state_fits
from modsim3d.verify.class_checks import at_each, memory_checks, miss_covariance, off_diagonal, variance_of_sum
from modsim3d.verify.confidence_checks import KeptScores, TobitModel
from modsim3d.verify.error_fit import Draw, MomentTable, capped_poisson, miss_residuals, residuals_of
from modsim3d.verify.evidence import Evidence, ManyDetections
from modsim3d.verify.independence_checks import GROUP, group_sums, independence_checks, lag_sums
from modsim3d.verify.parameters import Parameter
from tests.detector_variants import Data, thesis_data
from tests.verify.lies import LIES, same_errors_in_both_cameras, told

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


def test_the_variance_of_a_sum_is_that_of_all_pairs_and_scores_of_the_right_correlation_cancel():
    rng, ours = np.random.default_rng(1), kept()
    of_mean, of_square = rng.normal(size=(2, TRACKS * FRAMES, 3))
    same = ours.tracks[:, 1:] == ours.tracks[:, 1]
    correlation = np.where(same, KEPT ** np.abs(ours.times_s[:, None] - ours.times_s), 0)
    whole = [a @ correlation @ a + b @ correlation**2 @ b for a, b in zip(of_mean.T, of_square.T, strict=True)]
    alone = (of_mean**2 + of_square**2).sum(axis=0)
    assert ours.inflation(of_mean, of_square) == pytest.approx(whole / alone, rel=1e-3)
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


@pytest.mark.parametrize("mean", [0.7, 0.95], ids=["hardly clipped", "many are 1"])
def test_statistics_of_confidences_that_persist_have_the_spread_of_a_standard_normal_number(mean: float) -> None:
    rng, ours = np.random.default_rng(2), kept()
    hidden = np.repeat(rng.uniform(0, 0.5, TRACKS), FRAMES)
    design = np.column_stack([np.ones(len(hidden)), -hidden])
    found = []
    for _ in range(120):
        scores = np.clip(mean - 0.3 * hidden + 0.1 * chains(rng).ravel(), 0.2, 1)
        measures = TobitModel(scores, design, 0.2, ours).measures(np.array([mean, 0.3]), 0.1)
        found.append([0.0 if each is None else each.z for each in measures])
    assert np.all(np.abs(np.mean(found, axis=0)) < 0.5)
    assert np.all((np.std(found, axis=0) > 0.7) & (np.std(found, axis=0) < 1.3))


def test_a_number_beyond_a_bound_has_the_probability_there_and_a_step_of_a_law_all_its_levels():
    before, rho = np.array([0.7]), np.array([0.6])
    edges = np.linspace(-8, 8, 4001)
    density = np.exp(pair_likelihood(np.full(4001, 0.7), edges, edges, np.full(4001, 0.6))) / np.sqrt(2 * np.pi)
    found = np.exp(pair_likelihood(before, np.array([1.0]), np.array([np.inf]), rho))[0]
    assert found == pytest.approx(np.trapezoid(density[edges >= 1], edges[edges >= 1]), rel=1e-2)
    values = np.array([0.3, 0.4, 0.5, 0.65, 0.8])
    for shift in np.tile(np.linspace(0, 0.1, 8)[:, None], 5):
        levels = LEVELS["quantiles"](STEPS, values + shift, shift)
        assert levels is not None
        np.testing.assert_allclose(levels[0], [0, 0.375, 0.5, 0.625, 0.75], atol=1e-7)
        np.testing.assert_allclose(levels[1], [0.25, 0.375, 0.5, 0.625, 1], atol=1e-7)
    ends = np.array([0.4, 0.4])
    assert LEVELS["normal"](NormalScores(0.4, 0.0), ends, np.zeros(2)) is None
    assert LEVELS["quantiles"](QuantileScores(ends), ends, np.zeros(2)) is None


# ---- Levels, also where the law is cut off at the ends of the range ----

LAWS = {"normal": NormalScores(0.6, 0.3), "quantiles": QuantileScores(np.array([0.1, 0.3, 0.3, 0.7, 1.2]))}
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


@pytest.fixture(scope="module")
def many() -> ManyDetections:
    return ManyDetections.of_scene(load_scene("simulation_3", mode=2, steps=3000, source="analytic"))


def one_state(**sections: object) -> DetectorModel:
    """A detector of one state whose box errors no box cuts down: errors of one box fit any other."""
    data: Data = thesis_data() | {"transition_matrix": [[1.0]], "initial_state": "good"}
    data["states"] = {"good": data["states"]["good"]}
    error = data["states"]["good"]["box_error"]
    error["mean"] = [value / 20 for value in error["mean"]]
    error["covariance"] = [[value / 400 for value in row] for row in error["covariance"]]
    return parse_detector(data | sections)


@pytest.fixture(scope="module")
def honest(many: ManyDetections) -> Evidence:
    return many.detect(one_state(), 3)


def test_honest_runs_and_seeds_obey_with_residuals_as_they_say_and_told_persistence_is_no_lie(honest, table, many):
    found = verify_evidence(one_state(), honest, table)
    assert found.obeys, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed]
    tested = {verdict.parameter.name for verdict in found.verdicts if verdict.p_value is not None}
    assert tested >= set().union(*(checks for _, checks in LIES.values()))
    fits = [fit for fit in state_fits(one_state(), honest, table).values() if fit is not None]
    for residuals in residuals_of(one_state(), honest, fits):
        rows, components = residuals.values.shape
        expected = components * residuals.variance.sum()
        assert abs(residuals.values.sum()) < 1e-6 * rows
        assert (residuals.values**2).sum() == pytest.approx(expected, rel=8 * rows**-0.5), residuals.draw
        reach = (1 if residuals.draw == Draw.MISS else 6) * rows**0.5
        assert (residuals.values**3).sum() == pytest.approx(residuals.third.sum(), abs=reach), residuals.draw
    missed = honest.instances.outcome == -1
    assert missed.any()
    np.testing.assert_array_equal(miss_residuals(one_state(), honest).values[:, 0] > 0, missed)
    model = one_state()
    every = np.array([list(p_values(checked(model, many.detect(model, seed), table)).values()) for seed in range(12)])
    assert every.shape[1] >= 18 and every.min() > 1e-4
    # 216 p-values: more of them lie below with a probability of 0.1 %.
    assert every.size == 216 and (every < 0.1).sum() <= 36 and (every < 0.01).sum() <= 8
    model = one_state(persistence={"class_s": 1.0, "box_s": 1.0})
    evidence = many.detect(model, 1)
    found = checked(model, evidence, table)
    assert min(p_values(found).values()) > 1e-4
    assert found["box errors: correlation with earlier times"].measure is not None
    asked = checked(one_state(), evidence, table)["box errors: correlation with earlier times"]
    assert asked.measure is not None and asked.measure.p_value() < 1e-9 and asked.note.endswith(" lags, 1 steps back")


@pytest.mark.parametrize("name", LIES)
def test_a_lie_that_leaves_single_numbers_intact_is_found(honest: Evidence, table: MomentTable, name: str) -> None:
    lie, checks = LIES[name]
    failed = verify_evidence(one_state(), told(lie, honest), table).failed
    assert checks <= {verdict.parameter.name for verdict in failed}
    others = {verdict.parameter.name for verdict in failed if verdict.parameter.group != GROUP}
    in_order = {"persistence.confidence_s"} if "confidence in order" in name else set()
    assert others == in_order  # what is in order is also correlated from one sighting to the next


def checked(model: DetectorModel, evidence: Evidence, table: MomentTable) -> dict[str, Parameter]:
    fits = [fit for fit in state_fits(model, evidence, table).values() if fit is not None]
    return {parameter.name: parameter for parameter in independence_checks(model, evidence, fits)}


def p_values(found: dict[str, Parameter]) -> dict[str, float]:
    return {name: parameter.measure.p_value() for name, parameter in found.items() if parameter.measure is not None}


@pytest.mark.parametrize("persists_s", [20.0, 1e9])
def test_what_hardly_changes_is_too_little_seen(honest: Evidence, table: MomentTable, persists_s: float) -> None:
    found = checked(one_state(persistence={"class_s": persists_s, "box_s": persists_s}), honest, table)
    untested = [name for name, parameter in found.items() if parameter.measure is None]
    of_both = [name for name in found if name.startswith(("box errors", "misses"))]
    assert untested == [name for name in of_both if persists_s > 100 or not name.endswith("twice")]


def test_cameras_of_other_frame_rates_are_compared_at_common_steps_and_one_with_none(many, table: MomentTable) -> None:
    first, second = many.inputs
    frames, targets = second.frames, second.targets
    rows = np.flatnonzero(targets.frame % 3 == 0)
    thirds = {name: getattr(frames, name)[::3] for name in ("steps", "times_s", "sea_half_planes")}
    fewer = replace(select(targets, rows), frame=targets.frame[rows] // 3)
    slower = replace(second, frames=replace(frames, **thirds), targets=fewer)
    evidence = replace(many, inputs=(first, slower)).detect(one_state(), 2)
    found = checked(one_state(), evidence, table)
    assert min(p_values(found).values()) > 1e-4
    lie = checked(one_state(), told(same_errors_in_both_cameras, evidence), table)
    within = found["box errors: correlation within images"].measure
    between = lie["box errors: correlation between cameras"].measure
    assert within is not None and between is not None and between.measured > 0.9 and between.count < within.count
    alone = replace(many, inputs=many.inputs[:1]).detect(one_state(), 0)
    assert not [name for name in checked(one_state(), alone, table) if "cameras" in name]


def test_moments_of_capped_numbers_are_those_of_draws_and_sums_those_of_a_loop():
    means, caps = np.array([0.2, 1.5, 6.0]), np.array([1, 3, 9])
    drawn = np.minimum(np.random.default_rng(0).poisson(means, (200_000, 3)), caps)
    mean, variance, third = capped_poisson(means, caps)
    np.testing.assert_allclose(mean, drawn.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(variance, drawn.var(axis=0), rtol=0.02)
    np.testing.assert_allclose(third, ((drawn - drawn.mean(axis=0)) ** 3).mean(axis=0), atol=0.15)
    np.testing.assert_allclose(mean[0], 1 - np.exp(-0.2))
    values, variance, third = columns(30)
    group = RANDOM.integers(0, 5, 30) * 7
    pairs = [(i, j) for i, j in itertools.combinations(range(30), 2) if group[i] == group[j]]
    triples = [c for c in itertools.combinations(range(30), 3) if len({int(group[i]) for i in c}) == 1]
    sums = group_sums(values, variance, third, group)
    assert sums.product[0] == pytest.approx(sum(values[i] @ values[j] for i, j in pairs))
    assert sums.spread[0] == pytest.approx(2 * sum((variance[i] * variance[j]) ** 0.5 for i, j in pairs))
    assert sums.variance[0] == pytest.approx(2 * sum(variance[i] * variance[j] for i, j in pairs))
    of_triples = 6 * 2 * sum(variance[i] * variance[j] * variance[k] for i, j, k in triples)
    assert sums.third[0] == pytest.approx(sum(third[i] @ third[j] for i, j in pairs) + of_triples)
    values, variance, third = columns(40)
    place = RANDOM.permutation(60)[:40]  # three series with gaps, their rows in any order
    series, step = place // 20, 3 + 2 * (place % 20)
    sums = lag_sums(values, variance, third, series, step)
    for lag in range(len(sums.product)):
        pairs = [(i, j) for i in range(40) for j in range(40) if series[i] == series[j] and step[i] - step[j] == lag]
        assert sums.product[lag] == pytest.approx(sum(values[i] @ values[j] for i, j in pairs), abs=1e-10)
        expected = 2 * sum((variance[i] * variance[j]) ** 0.5 for i, j in pairs)
        assert sums.spread[lag] == pytest.approx(expected, abs=1e-10)
        assert sums.variance[lag] == pytest.approx(2 * sum(variance[i] * variance[j] for i, j in pairs), abs=1e-10)
        assert sums.third[lag] == pytest.approx(sum(third[i] @ third[j] for i, j in pairs), abs=1e-10)
    assert len(sums.product) > 30


# ---- Sums over pairs of residuals, and the moments that they say ----

RANDOM = np.random.default_rng(1)


def columns(rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return RANDOM.normal(size=(rows, 2)), RANDOM.uniform(0.1, 2, rows), RANDOM.normal(size=(rows, 2))


def test_cumulants_of_a_sum_over_a_group_are_those_of_all_outcomes() -> None:
    # Four rare events: every one of the sixteen outcomes with its probability.
    p = np.array([0.1, 0.3, 0.5, 0.05])
    variance = p * (1 - p)
    third, moments = (variance * (1 - 2 * p))[:, None], np.zeros(4)
    for outcome in itertools.product((0, 1), repeat=4):
        happened = np.array(outcome)
        chance = np.where(happened == 1, p, 1 - p).prod()
        sums = group_sums((happened - p)[:, None], variance, third, np.zeros(4, dtype=np.int64))
        moments += chance * sums.product[0] ** np.arange(4)
    assert moments == pytest.approx([1, 0, sums.variance[0], sums.third[0]], abs=1e-12)


SCORE = LatentScore(0.3, (0.2, 0.4), (1.0, 6.0))
VESSELS, TURNS, STEP_S = 60, 80, 0.5
NUMBERS = np.repeat(np.arange(VESSELS), TURNS)[:, None]
TIMES_S = np.tile(np.arange(TURNS) * STEP_S, VESSELS)


def drawn(score: LatentScore, count: int, seed: int, vessels: int = VESSELS) -> np.ndarray:
    """Scores of vessels, from the Cholesky root of their covariance, shape (count, vessels · turns)."""
    times_s = np.arange(TURNS) * STEP_S
    covariance = score.correlation(np.abs(times_s[:, None] - times_s))
    np.fill_diagonal(covariance, 1.0)
    normal = np.random.default_rng(seed).standard_normal((count, vessels, TURNS))
    return special.ndtr(normal @ np.linalg.cholesky(covariance).T).reshape(count, -1)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.95])
def test_the_covariance_of_misses_is_that_of_the_bivariate_normal_distribution(correlation: float) -> None:
    first, second = np.array([0.05, 0.3, 0.5, 0.9]), np.array([0.1, 0.3, 0.8, 0.95])
    pair = stats.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]])
    asked = [pair.cdf(special.ndtri([a, b])) - a * b for a, b in zip(first, second, strict=True)]
    np.testing.assert_allclose(miss_covariance(first, second, np.full(4, correlation)), asked, atol=2e-5)


def test_sums_of_misses_have_the_variance_of_draws_and_a_memory_as_asked_passes():
    rng = np.random.default_rng(3)
    chance = np.repeat(rng.uniform(0.1, 0.8, 5), TURNS) + 0.1 * np.sin(np.tile(np.arange(TURNS) / 9, 5))
    amount = rng.normal(1, 0.1, 5 * TURNS)
    sums = (drawn(SCORE, 8000, 4, vessels=5) < chance) @ amount
    alone = float((amount**2 * chance * (1 - chance)).sum())
    tracks, times_s = NUMBERS[: 5 * TURNS], TIMES_S[: 5 * TURNS]
    assert alone + off_diagonal(tracks, times_s, SCORE, chance, amount) == pytest.approx(sums.var(), rel=0.05)
    tracks, times_s, chance = np.arange(5)[:, None], np.zeros(5), np.full(5, 0.3)
    assert off_diagonal(tracks, times_s, SCORE, chance, np.ones(5)) == 0
    assert all(each.measure is None for each in memory_checks(tracks, times_s, SCORE, chance, np.zeros(5)))
    assert memory_checks(tracks[:0], times_s[:0], SCORE, chance[:0], chance[:0]) == []
    chance = np.full(VESSELS * TURNS, 0.25)
    sure = []
    for seed in range(8):
        missed = (drawn(SCORE, 1, seed)[0] < chance).astype(float)
        sure += [each.measure.p_value() for each in memory_checks(NUMBERS, TIMES_S, SCORE, chance, missed)]
    assert np.mean(np.array(sure) < 0.05) < 0.2
    for wrong in (LatentScore(0.0, (0.9,), (0.5,)), LatentScore(0.7, (0.25,), (6.0,))):
        missed = (drawn(wrong, 1, 9)[0] < chance).astype(float)
        assert min(each.measure.p_value() for each in memory_checks(NUMBERS, TIMES_S, SCORE, chance, missed)) < 1e-3


# ---- Sums of misses of vessels that keep a share of their noise ----

FEW, SHARE = (3, 8), 0.4  # vessels, turns


def uniforms(rng: np.random.Generator, count: int, kept: float) -> np.ndarray:
    """Uniform numbers of vessels that keep a share, shape (count, vessels, turns), as the detector draws them."""
    own = rng.random((count, *FEW))
    for turn in range(1, FEW[1]):
        keeps = rng.random((count, FEW[0])) < kept
        own[..., turn] = np.where(keeps, own[..., turn - 1], own[..., turn])
    constant = rng.standard_normal((count, FEW[0], 1))
    return special.ndtr(np.sqrt(SHARE) * constant + np.sqrt(1 - SHARE) * special.ndtri(own))


@pytest.mark.parametrize("class_s", [0.0, 0.9])
def test_the_variance_of_a_sum_of_vessels_that_keep_a_share_is_that_of_many_draws(class_s: float) -> None:
    rng = np.random.default_rng(5)
    low, high = np.sort(rng.random((2, 24)), axis=0)
    amount = rng.normal(1, 0.5, 24)
    drawn = uniforms(rng, 40_000, np.exp(-STEP_S / class_s) if class_s else 0.0).reshape(-1, 24)
    sums = ((drawn >= low) & (drawn < high)) @ amount
    tracks = np.repeat(np.arange(3), 8)[:, None]
    times_s = np.tile(np.arange(8) * STEP_S, 3)
    persistence = Persistence(class_s=class_s, class_vessel_share=SHARE)
    assert variance_of_sum(tracks, times_s, persistence, (low, high), amount) == pytest.approx(sums.var(), rel=0.03)


def test_bounds_at_what_a_vessel_keeps_have_their_mean_and_replayed_errors_keep_their_share():
    bounds = np.array([0.0, 0.01, 0.5, 0.9, 1.0])
    np.testing.assert_allclose(sum(weight * found for weight, (found,) in at_each(SHARE, bounds)), bounds, atol=1e-9)
    tracks, times_s = np.repeat(np.arange(4), 2)[:, None], np.tile([0.0, 100.0], 4)
    rng = np.random.default_rng(6)
    for box_s in (0.0, 50.0):
        paths = latent_paths(tracks, times_s, Persistence(box_s=box_s, box_vessel_share=SHARE), rng, 20_000, 5)
        kept = np.exp(-100 / box_s) if box_s else 0.0
        asked = np.array([SHARE + (1 - SHARE) * kept] * 4 + [kept])
        np.testing.assert_allclose((paths[:, ::2] * paths[:, 1::2]).mean(axis=(0, 1)), asked, atol=0.02)
