"""The laws that measured numbers are held against, with tail probabilities, intervals and noticeable changes."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from modsim3d.core.boxes import inside_image, move
from modsim3d.detector.confidence import clipped_score
from modsim3d.detector.draws import StudentT
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import Persistence
from modsim3d.detector.truncation import ordered_root
from modsim3d.verify import measures
from modsim3d.verify.box_error_checks import latent_paths, replayed_errors
from modsim3d.verify.class_checks import inflation, lag_pairs
from modsim3d.verify.confidence_checks import TobitModel
from modsim3d.verify.error_fit import MomentTable, StateErrors, fit_step, fitted_law
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.figures import expected_run_lengths
from modsim3d.verify.independence_checks import Strongest, SumDrift
from modsim3d.verify.measures import AMOUNT, CORRELATION, SHARE, DiscoveryRate, Estimate, Exact, ImageRate, Rate
from modsim3d.verify.parameters import DIFFERS, FALLS_SHORT, OBEYS, UNTESTED, Law, Occupancy, Parameter, judge
from modsim3d.verify.verification import occupancy_law, verify_evidence
from modsim3d.verify.verify_run import conclusion
from tests.detector_variants import thesis_data, variant

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
    "student_t": law_of(distribution=StudentT(4.0)),
}


def density(law: ErrorParameters, box: np.ndarray, other: ErrorParameters) -> Any:
    """The distribution of a law's errors of a box, from the mean of another law and in its standard deviations."""
    nu = getattr(law.distribution, "degrees_of_freedom", np.inf)
    ((mean,), (std,)), ((middle,), (unit,)) = law.at(box[None]), other.at(box[None])
    shape = (1 - 2 / nu) * law.correlation * np.outer(std / unit, std / unit)
    return stats.multivariate_t((mean - middle) / unit, shape, df=nu)


def sampled(law: ErrorParameters, box: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Errors of one box by drawing until they count, standardised."""
    rng = np.random.default_rng(seed)
    means, stds = law.at(box[None])
    drawn = density(law, box, law).rvs(count, random_state=rng)
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


def test_ordered_roots_lag_pairs_quantiles_and_the_shared_level_are_those_of_a_slow_way():
    covariance = np.outer([2.0, 0, 3, 1], [2.0, 0, 3, 1]) + np.diag([0, 0, 1.0, 0])
    root = ordered_root(covariance)
    order = np.array([2, 3, 0, 1])
    np.testing.assert_allclose(root @ root.T, covariance[order[:, None], order], atol=1e-9)
    rng = np.random.default_rng(5)
    tracks, times = rng.integers(0, 3, (40, 1)), rng.random(40) * 10
    parts = (zip(later.tolist(), earlier.tolist(), strict=True) for later, earlier, _ in lag_pairs(tracks, times, 0.3))
    near = (tracks == tracks[:, 0]) & (times[:, None] > times) & (times[:, None] - times <= 3.0)
    assert set(itertools.chain.from_iterable(parts)) == {*map(tuple, np.argwhere(near).tolist())}
    rng = np.random.default_rng(1)
    quantiles = np.array([0.2, 0.2, 0.5, 0.9, 1.0])
    values = np.interp(rng.random((200, 300)), np.linspace(0, 1, 5), quantiles)
    assert 0 <= np.mean([Law.of(each, quantiles).p_value() < 0.05 for each in values]) < 0.1
    assert Law.of(rng.random(300), quantiles).p_value() < 1e-4
    some = [Parameter(f"p{i}", "group", Rate(10, 100, 0.1)) for i in range(49)]
    off = Parameter("off", "group", Rate(35, 100, 0.1))
    verification = judge([*some, off, Parameter("unseen", "group", None, 0.3)])
    assert verification.alpha == pytest.approx(0.01 / 50)
    assert [v.verdict for v in verification.verdicts[-2:]] == [DIFFERS, UNTESTED] and not verification.obeys
    assert verification.cause.parameter is off


@pytest.mark.parametrize("name, parameter", [(name, k) for name in LAWS for k in range(len(LAWS[name].names()))])
def test_scores_are_derivatives_of_the_density(name, parameter):
    law, box = LAWS[name], BOXES_PX[1]
    x = np.random.default_rng(8).standard_normal((20, 4)) * 1.5
    step = 1e-5 * (np.arange(len(law.names())) == parameter)
    above, below = (density(law.moved(each), box, law).logpdf(x) for each in (step, -step))
    slope, (weights, (gains,)) = (above - below) / 2e-5, law.score_weights(box[None])
    found = gains[parameter] * (law.statistics(x) @ weights[parameter])
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


def test_the_fit_finds_another_law_and_replayed_errors_have_the_truncated_one():
    law = law_of()
    true = law_of(mean=law.mean + 0.4 * law.std, std=law.std * [1.5, 1, 1, 1])
    (sample,) = samples_of(true, 400, 1)
    fit = fit_step(law, sample, MomentTable())
    found, errors = fitted_law(law, fit, sample), fit.errors[:4] * law.std
    np.testing.assert_array_less(np.abs(found.mean - true.mean), 5 * errors)
    assert found.std[0] == pytest.approx(true.std[0], rel=0.15)
    frames = 40
    boxes = np.tile(BOXES_PX[1], (frames, 1))
    sample = StateErrors(np.zeros((frames, 4)), np.arange(frames), boxes, np.tile([3600.0, 2400], (frames, 1)))
    tracks, times = np.zeros((frames, 1), dtype=np.int64), 0.1 * np.arange(frames)
    rng = np.random.default_rng(2)
    errors = replayed_errors(law, sample, latent_paths(tracks, times, Persistence(box_s=0.5), rng, 400, 4), rng)
    np.testing.assert_allclose(errors.mean(axis=(0, 1)), sampled(law, BOXES_PX[1], 100_000).mean(axis=0), atol=0.06)
    lagged = [np.corrcoef(errors[:, :-1, k].ravel(), errors[:, 1:, k].ravel())[0, 1] for k in range(4)]
    np.testing.assert_allclose(lagged, np.exp(-0.2), atol=0.06)


def test_clipped_scores_are_derivatives_and_occupancy_and_inflation_laws_those_of_every_path():
    def likelihood(mean: float, std: float) -> np.ndarray:
        low, high = stats.norm.logcdf((0.2 - mean) / std), stats.norm.logsf((1 - mean) / std)
        inner = stats.norm.logpdf(scores, mean, std)
        return np.where(scores <= 0.2, low, np.where(scores >= 1, high, inner))

    scores, h = np.array([0.2, 0.5, 0.9, 1.0]), 1e-6
    for column, (mean, std) in zip(clipped_score(scores, 0.65, 0.3, 0.2).T, ((h, 0), (0, h)), strict=True):
        slope = (likelihood(0.65 + mean, 0.3 + std) - likelihood(0.65 - mean, 0.3 - std)) / (2 * h)
        np.testing.assert_allclose(column, slope, rtol=1e-5)
    rng, z = np.random.default_rng(4), []
    hidden = rng.random(300)
    design = np.column_stack([np.ones(300), -hidden])
    for _ in range(40):
        scores = np.clip(0.85 - 0.4 * hidden + 0.25 * rng.standard_normal(300), 0.2, 1)
        z.append([measure.z for measure in TobitModel(scores, design, 0.2).measures(np.array([0.85, 0.4]), 0.25)])
    z = np.array(z)
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(40) and np.abs(z.std(axis=0) - 1).max() < 4 / np.sqrt(80)
    transitions = np.array([1, 0, 2, 1, 1])
    matrix, expected = MODEL.transition_matrix, np.zeros(len(transitions) + 2)
    for path in itertools.product(range(4), repeat=len(transitions)):
        states, chance = (0, *path), 1.0
        for before, after, steps in zip(states, path, transitions, strict=False):
            chance *= np.linalg.matrix_power(matrix, steps)[after, before]
        expected[sum(state == 1 for state in states)] += chance
    np.testing.assert_allclose(occupancy_law(MODEL, 1, transitions, start=0), expected, atol=1e-12)
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


def test_intervals_are_clopper_and_pearsons_and_garwoods_and_wider_for_fewer_effective_trials():
    # 10 of 100 at 95 %: 0.0490, 0.1762, e.g. Newcombe (1998), Statistics in Medicine 17, 857-872.
    np.testing.assert_allclose(Rate(10, 100, 0.1).interval(0.05), (0.0490, 0.1762), atol=5e-5)
    # 10 events at 95 %: 4.795, 18.390, Garwood (1936), Biometrika 28, 437-442.
    np.testing.assert_allclose(measures.poisson_interval(10, 0.05), (4.795, 18.390), atol=5e-4)
    low, high = ImageRate(false=40, images=100, asked=0.4).interval(0.05)
    np.testing.assert_allclose((low * 100, high * 100), measures.poisson_interval(40, 0.05))
    assert ImageRate(40, 100, 0.4).p_value() == 1 and ImageRate(80, 100, 0.4).p_value() < 1e-6
    alone, together = Rate(100, 1000, 0.1).interval(0.01), Rate(100, 1000, 0.1, inflation=4).interval(0.01)
    assert together[1] - together[0] == pytest.approx(2 * (alone[1] - alone[0]), rel=0.05)


@given(st.integers(0, 200), st.integers(1, 200), st.floats(0.01, 0.99), st.floats(1e-4, 0.2))
def test_a_rate_fails_just_where_its_interval_leaves_the_asked_value_out(hits, more, asked, alpha):
    measure = Rate(hits, hits + more, asked)
    low, high = measure.interval(alpha)
    if min(abs(asked - low), abs(asked - high)) > 1e-9:
        assert (measure.p_value() < alpha) == (not low <= asked <= high)


@given(st.floats(-4, 4), st.floats(-0.5, 0.5) | st.floats(1.1, 9) | st.floats(-9, -1.1), st.floats(1e-4, 0.2))
def test_an_estimate_fails_just_where_its_interval_leaves_the_asked_value_out(z, skewness, alpha):
    measure = Estimate(measured=5 + z, asked=5.0, error=1.0, count=10, skewness=skewness)
    low, high = measure.interval(alpha)
    if min(abs(5 - low), abs(5 - high)) > 1e-6:
        assert (measure.p_value() < alpha) == (not low <= 5 <= high)


@pytest.mark.parametrize("trials, asked", [(400, 0.133), (2000, 0.0085), (50, 0.99), (3000, 0.381)])
def test_a_rate_notices_its_smallest_change_nine_times_in_ten(trials, asked):
    alpha = 1e-4
    below, above = Rate(0, trials, asked).noticed(alpha)
    rejected = np.array([Rate(k, trials, asked).p_value() < alpha for k in range(trials + 1)])
    for change, rate in ((above, asked + (above or 0)), (below, asked - (below or 0))):
        if change is not None:
            assert stats.binom.pmf(np.arange(trials + 1), trials, rate)[rejected].sum() == pytest.approx(0.9, abs=0.01)


def test_a_false_discovery_rate_notices_its_smallest_change_nine_times_in_ten():
    alpha, true, asked, counts = 1e-4, 1500, 0.089, np.arange(400)
    expected = true * asked / (1 - asked)
    below, above = DiscoveryRate(0, true, expected).noticed(alpha)
    rejected = np.array([DiscoveryRate(k, true, expected).p_value() < alpha for k in counts])
    for rate in (asked - below, asked + above):
        assert stats.poisson.pmf(counts, true * rate / (1 - rate))[rejected].sum() == pytest.approx(0.9, abs=0.01)


@given(st.integers(20, 2000), st.floats(-3.5, 4.5))
def test_skewed_tails_are_exact_for_a_sample_variance(n, z):
    # The sum of n squared normal numbers has mean n, variance 2n and skewness √(8/n).
    below, above = measures.skewed_tails(z, (8 / n) ** 0.5)
    expected = stats.chi2.sf(n + z * (2 * n) ** 0.5, n)
    assert above == pytest.approx(expected, rel=1e-6, abs=1e-12) and below + above == pytest.approx(1)


@given(st.tuples(st.floats(1e-6, 0.4), st.floats(-0.8, 0.8)) | st.tuples(st.floats(1e-6, 0.3), st.floats(1.01, 30)))
def test_quantile_undoes_the_tail_also_of_rare_events(case):
    tail, skewness = case
    assert measures.skewed_tails(measures.skewed_quantile(tail, skewness), skewness)[1] == pytest.approx(tail, rel=1e-6)
    if skewness > 1:  # that none happens is likelier than any such tail
        assert measures.skewed_quantile(tail, -skewness) == math.inf


@pytest.mark.parametrize("mean", [0.9, 0.05, 1e-6])
def test_tails_of_rare_events_are_those_of_a_poisson_number(mean):
    skewness = mean**-0.5
    for count in range(1, 5):
        below, above = measures.skewed_tails((count - mean) * skewness, skewness)
        assert above == pytest.approx(stats.poisson.sf(count - 1, mean), rel=1e-6)
        assert below == pytest.approx(stats.poisson.cdf(count, mean), rel=1e-6)
    for z in (-mean / mean**0.5, -mean / mean**0.5 - 1e-3):  # none, and as much as that by rounding
        assert measures.skewed_tails(z, skewness)[0] == pytest.approx(math.exp(-mean))
        assert measures.skewed_tails(-z, -skewness)[1] == pytest.approx(math.exp(-mean))


@pytest.mark.parametrize(("measure", "interval"), [
    (Estimate(0.004, 0.006, 0.01, 300, possible=SHARE), "[0, 0.0"),
    (Estimate(0.944, 0.925, 0.04, 300, -0.3, possible=SHARE), "1]"),
    (Estimate(0.003, 0.006, 0.01, 300, 5.0, possible=SHARE), "1]"),  # ∞ without what is possible
    (Estimate(0.95, 0.8, 0.09, 90, possible=CORRELATION), "1]"),
    (Estimate(1.02, 1.0, 1.2, 40, possible=AMOUNT), "[0, "),
    (Estimate(1.3, 0.7, 0.2, 90, possible=CORRELATION), "1]"),
    (SumDrift(0.01, 100.0), "[0, "),
    (Rate(1, 40, 0.05), "[0"),
    (ImageRate(0, 30, 0.1), "[0, "),
])  # fmt: skip
def test_intervals_and_what_is_noticed_are_cut_to_what_is_possible(measure: measures.Measure, interval: str) -> None:
    (verdict,) = judge([Parameter("p", "group", measure)]).verdicts
    low, high = getattr(measure, "possible", AMOUNT)
    assert verdict.interval is not None and verdict.measured is not None
    assert low <= verdict.interval[0] <= verdict.measured <= verdict.interval[1] <= high
    assert interval in f"[{verdict.interval[0]:g}, {verdict.interval[1]:g}]"
    below, above = verdict.noticed
    assert below is None or measure.asked - below >= low - 1e-6
    assert above is None or measure.asked + above <= high + 1e-6


def test_what_no_violation_would_have_changed_is_too_little_seen_and_only_entries_are_causes():
    even = np.full(400, 1 / 400)
    for measure, verdict in (
        (Rate(1, 2, 0.92), UNTESTED),
        (Rate(1, 1, 0.7), UNTESTED),
        (Rate(45, 50, 0.92), OBEYS),
        (Rate(0, 2, 0.999), DIFFERS),  # two misses where one in a thousand was asked for
        (Estimate(0.9, 0.5, 0.4, 12, possible=SHARE), UNTESTED),
        (Estimate(0.9, 0.0, 0.2, 12, possible=CORRELATION), DIFFERS),
        (Strongest(0.3, 0.0, 0.5, 9, trials=20, possible=CORRELATION), UNTESTED),
        (Occupancy(1, np.array([0.3, 0.7])), UNTESTED),
        (Occupancy(0, even), DIFFERS),
        (Occupancy(200, even), OBEYS),
        (Exact(0, 0), UNTESTED),
        (Exact(0, 3), OBEYS),
        (Exact(1, 3), DIFFERS),
        (Law(0.4, 4), UNTESTED),
    ):
        found = judge([Parameter("p", "group", measure)])
        assert [each.verdict for each in found.verdicts] == [verdict], measure
        nothing = "The run obeys its detector file: nothing in 0 tests speaks against it."
        assert (conclusion(found) == nothing) == (verdict == UNTESTED)
        assert found.obeys == (verdict != DIFFERS)
    follows = Parameter("overall", "group", Rate(900, 1000, 0.1), in_file=False)
    entry = Parameter("entry", "group", Rate(35, 100, 0.1))
    assert judge([follows, entry]).cause.parameter is entry and judge([follows]).cause.parameter is follows
    rule = Parameter("fdr", "group", DiscoveryRate(0, 5000, 0.0), 0.089, promised=0.089)
    fine = Parameter("fdr", "group", DiscoveryRate(480, 5000, 490), 0.089, promised=0.089)
    assert [v.verdict for v in judge([rule, fine]).verdicts] == [FALLS_SHORT, OBEYS] and judge([rule]).obeys


def t_data(nu: float = 4.0, spread: float = 1.0, **sections: Any) -> dict[str, Any]:
    data = variant("plain") | sections
    for state in data["states"].values():
        error = state["box_error"]
        error.update(law="student_t", degrees_of_freedom=nu)
        error["covariance"] = [[spread * value for value in row] for row in error["covariance"]]
    return data


def test_honest_seeds_and_errors_that_persist_obey_and_a_wrong_law_is_noticed_and_named(many, table):
    """Standard errors that are a quarter too small are found by their spread, and hardly by whether seeds obey."""
    model, z = parse_detector(t_data()), []
    for seed in range(6):
        found = verify_evidence(model, many.detect(model, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        of_law = (v.parameter.measure for v in found.verdicts if ".box_error." in v.parameter.name)
        z += [measure.z for measure in of_law if measure is not None]
    assert len(z) > 150 and abs(np.mean(z)) < 4 / np.sqrt(len(z))
    assert abs(np.std(z) - 1) < 4 / np.sqrt(2 * len(z))
    model = parse_detector(t_data(persistence={"box_s": 0.5}))
    measured = []
    for seed in range(2):
        found = verify_evidence(model, many.detect(model, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        measured += [v.measured for v in found.verdicts if v.parameter.name == "persistence.box_s"]
    standard_error = 0.045 / np.sqrt(2)
    assert np.mean(measured) == pytest.approx(np.exp(-0.2 / 0.5), abs=4 * standard_error)
    heavy = parse_detector(t_data())
    for asked, made_with, named in (
        (heavy, t_data(nu=60.0), "box_error.degrees_of_freedom"),
        (heavy, t_data(spread=2.0), "box_error.std"),
        (parse_detector(variant("plain")), t_data(nu=2.5), "box_error"),
    ):
        moments = table if asked is heavy else MomentTable()
        failed = verify_evidence(asked, many.detect(parse_detector(made_with), 1), moments).failed
        assert any(named in verdict.parameter.name for verdict in failed), named
