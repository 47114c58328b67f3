"""Independent draws pass, and lies that leave every single number as it is are found."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from modsim3d import DetectorModel, load_scene, verify_evidence
from modsim3d.detector.draws import select
from modsim3d.detector.file.reading import parse_detector
from modsim3d.verify.box_error_checks import state_fits
from modsim3d.verify.error_fit import Draw, MomentTable, capped_poisson, miss_residuals, residuals_of
from modsim3d.verify.evidence import Evidence, ManyDetections
from modsim3d.verify.independence_checks import GROUP, group_sums, independence_checks, lag_sums
from modsim3d.verify.parameters import Parameter
from tests.detector_variants import Data, thesis_data
from tests.verify.lies import LIES, same_errors_in_both_cameras, told


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


def test_an_honest_run_obeys_and_each_pattern_is_tested(honest: Evidence, table: MomentTable) -> None:
    found = verify_evidence(one_state(), honest, table)
    assert found.obeys, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed]
    tested = {verdict.parameter.name for verdict in found.verdicts if verdict.p_value is not None}
    assert tested >= set().union(*(checks for _, checks in LIES.values()))


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


def test_honest_seeds_have_small_p_values_as_often_as_they_should(many: ManyDetections, table: MomentTable) -> None:
    model = one_state()
    every = np.array([list(p_values(checked(model, many.detect(model, seed), table)).values()) for seed in range(12)])
    assert every.shape[1] >= 18 and every.min() > 1e-4
    # 216 p-values: more of them lie below with a probability of 0.1 %.
    assert every.size == 216 and (every < 0.1).sum() <= 36 and (every < 0.01).sum() <= 8


def test_draws_that_persist_are_no_lie_if_the_file_says_so(many: ManyDetections, table: MomentTable) -> None:
    model = one_state(persistence={"class_s": 1.0, "box_s": 1.0})
    evidence = many.detect(model, 1)
    found = checked(model, evidence, table)
    assert min(p_values(found).values()) > 1e-4
    assert found["box errors: correlation with earlier times"].measure is not None
    asked = checked(one_state(), evidence, table)["box errors: correlation with earlier times"]
    assert asked.measure is not None and asked.measure.p_value() < 1e-9 and asked.note.endswith(" lags, 1 steps back")


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


def test_residuals_have_the_moments_that_they_say(honest: Evidence, table: MomentTable) -> None:
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


def test_moments_of_capped_numbers_are_those_of_many_draws() -> None:
    means, caps = np.array([0.2, 1.5, 6.0]), np.array([1, 3, 9])
    drawn = np.minimum(np.random.default_rng(0).poisson(means, (200_000, 3)), caps)
    mean, variance, third = capped_poisson(means, caps)
    np.testing.assert_allclose(mean, drawn.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(variance, drawn.var(axis=0), rtol=0.02)
    np.testing.assert_allclose(third, ((drawn - drawn.mean(axis=0)) ** 3).mean(axis=0), atol=0.15)
    np.testing.assert_allclose(mean[0], 1 - np.exp(-0.2))


# ---- Sums over pairs of residuals, and the moments that they say ----

RANDOM = np.random.default_rng(1)


def columns(rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return RANDOM.normal(size=(rows, 2)), RANDOM.uniform(0.1, 2, rows), RANDOM.normal(size=(rows, 2))


def test_sums_over_groups_are_those_of_a_loop() -> None:
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


def test_sums_over_lags_are_those_of_a_loop() -> None:
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
