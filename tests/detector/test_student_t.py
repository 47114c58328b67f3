"""Box errors of Student's t law: mean and covariance are the law's own, tails are heavier, and `verify` holds it."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.core.boxes import inside_image, move
from modsim3d.detector.draws import StudentT, standardised
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import Detections
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable, StateErrors, fit_step
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.verification import verify_evidence
from tests.detector import detector_builders as build
from tests.detector_variants import variant

NU = 6.0
SEEN = {"confusion": build.ALL_SEEN, "false_discovery_rate": 0}
C = np.array(build.COVARIANCE_PX2, dtype=float)
LARGE = build.centred(2400, 1800)


def t_error(nu: float = NU, **changes: Any) -> dict[str, Any]:
    error = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)
    return error | {"law": "student_t", "degrees_of_freedom": nu} | changes


def drawn(error: dict[str, Any], box_px: list[float] = LARGE, frames: int = 4000, **sections: Any) -> Detections:
    model = parse_detector(build.one_state_data(**SEEN, box_error=error) | sections)
    return build.detector(model).detect(build.make_frames(frames), build.steady_targets(frames, 20, box_px))


@pytest.fixture(scope="module", params=[{}, {"persistence": {"box_s": 0.05}}], ids=["independent", "persistent"])
def errors(request: pytest.FixtureRequest) -> np.ndarray:
    found = drawn(t_error(), **request.param)
    assert found.redrawn.mean() < 1e-4
    return found.errors_px


def test_errors_have_the_moments_of_the_file_and_their_squared_lengths_the_law_of_a_t_variate(errors) -> None:
    worth, moved = len(errors) / 1.4, errors - build.MEAN_PX  # those that persist for 0.05 s count for fewer
    assert np.all(np.abs(moved.mean(axis=0)) < 4 * np.sqrt(np.diag(C) / worth))
    fourth = (NU - 2) / (NU - 4)  # of a t law over that of a normal one
    variance = fourth * (2 * C**2 + np.outer(np.diag(C), np.diag(C))) - C**2
    assert np.all(np.abs(np.cov(errors.T) - C) < 4 * np.sqrt(variance / worth))
    q = np.einsum("ni,ij,nj->n", moved, np.linalg.inv(C * (NU - 2) / NU), moved)
    sample = q[::401]  # of other vessels and far from each other in time
    assert stats.kstest(q[::7] / 4, stats.f(4, NU).cdf).statistic < 0.02
    assert stats.kstest(sample / 4, stats.f(4, NU).cdf).pvalue > 1e-4


def test_each_component_has_the_kurtosis_of_its_law() -> None:
    nu, moved = 20.0, drawn(t_error(nu=20.0)).errors_px - build.MEAN_PX
    eighth = 105 * (nu - 2) ** 3 / ((nu - 4) * (nu - 6) * (nu - 8))  # moment of a t number with variance one
    standard_error = np.sqrt(eighth / len(moved))
    kurtosis = stats.kurtosis(moved)
    assert kurtosis == pytest.approx(np.full(4, 6 / (nu - 4)), abs=4 * standard_error)
    assert kurtosis.min() > 2 * standard_error


def test_scales_are_those_of_a_chi_square_number_and_normal_numbers_those_of_a_normal_law() -> None:
    levels = (np.arange(2000) + 0.5) / 2000
    scales = StudentT(NU).scales(special.ndtri(levels)[:, None])
    np.testing.assert_allclose(np.sort((NU - 2) / scales**2), stats.chi2(NU).ppf(levels))
    many = StudentT(NU).scales(np.random.default_rng(0).standard_normal((400_000, 1)))
    assert np.mean(many**2) == pytest.approx(1, abs=0.02)
    normal = {"law": "normal", "degrees_of_freedom": None}
    with_t, without = (drawn(t_error() | law, frames=200).errors_px - build.MEAN_PX for law in ({}, normal))
    scale = with_t / without
    np.testing.assert_allclose(scale, scale[:, :1] * np.ones(4), rtol=1e-6)
    latent = np.random.default_rng(0).standard_normal((4000, 5))
    np.testing.assert_allclose(standardised(StudentT(degrees_of_freedom=1e7), latent), latent[:, :4], rtol=1e-2)


def test_a_t_law_in_one_state_leaves_the_bytes_of_another_state_alone() -> None:
    frames, targets = build.make_frames(300), build.steady_targets(300, 3, build.centred(30, 20))
    plain, mixed = (
        build.run(build.detector_data(states={"clear": build.state_data(), "fog": fog}), frames, targets)
        for fog in (build.state_data(), build.state_data(box_error=t_error()))
    )
    clear = plain.states[plain.frame] == 0
    assert np.array_equal(plain.errors_px[clear], mixed.errors_px[clear], equal_nan=True)
    assert plain.redrawn[clear].any()
    assert not np.array_equal(plain.errors_px[~clear], mixed.errors_px[~clear], equal_nan=True)


def test_scales_persist_like_the_errors_do() -> None:
    found = drawn(t_error(), frames=1500, persistence={"box_s": 1.0})
    moved = build.by_frame(found, found.errors_px - build.MEAN_PX, 1500, 20)
    lengths = np.log(np.einsum("tvi,ij,tvj->tv", moved, np.linalg.inv(C), moved))
    near, far = (np.corrcoef(lengths[lag:].ravel(), lengths[:-lag].ravel())[0, 1] for lag in (1, 60))
    assert near > 0.8 and abs(far) < 0.1


BOXES = np.array([[1800.0, 1200, 1840, 1212], [1800.0, 1200, 2200, 1500], [0.0, 700, 15, 790]])


def law_of(nu: float) -> ErrorParameters:
    state = parse_detector(build.one_state_data(box_error=t_error(nu))).states[0]
    return ErrorParameters.of(state.box_error)


@pytest.mark.parametrize("parameter", range(15))
def test_scores_are_derivatives_of_the_t_density(parameter: int) -> None:
    law, h = law_of(NU), 1e-5
    x = np.random.default_rng(8).standard_normal((20, 4)) * 1.5
    step = np.zeros(15)
    step[parameter] = h

    def log_density(moved: ErrorParameters) -> np.ndarray:
        nu = moved.numbers()[-1]
        scale = moved.std / law.std
        shape = moved.correlation * np.outer(scale, scale) * (nu - 2) / nu
        return np.asarray(stats.multivariate_t((moved.mean - law.mean) / law.std, shape, df=nu).logpdf(x))

    slope = (log_density(law.moved(step)) - log_density(law.moved(-step))) / (2 * h)
    weights, _ = law.score_weights(BOXES[:1])
    found = law.statistics(x) @ weights[parameter]
    np.testing.assert_allclose(found - found[0], slope - slope[0], rtol=1e-4, atol=1e-4)


def samples_of(law: ErrorParameters, copies: int, count: int) -> list[StateErrors]:
    """Truncated errors of three boxes, so many of each, so many times over."""
    boxes, rng, pools = np.repeat(BOXES, copies, axis=0), np.random.default_rng(3), []
    nu, images = law.numbers()[-1], np.tile(np.array(build.IMAGE_PX, float), (len(boxes), 1))
    shape = law.correlation * np.outer(law.std, law.std) * (nu - 2) / nu
    for box in BOXES:
        draws = stats.multivariate_t(law.mean, shape, df=nu).rvs(12 * copies * count, random_state=rng)
        pools.append(draws[inside_image(move(box, draws), build.IMAGE_PX)])
    samples = (np.concatenate([pool[k * copies : (k + 1) * copies] for pool in pools]) for k in range(count))
    return [StateErrors(sample, np.arange(len(boxes)), boxes, images) for sample in samples]


def test_steps_of_honest_errors_have_mean_zero_and_their_standard_error() -> None:
    law, table, z = law_of(4.0), MomentTable(), []
    for sample in samples_of(law, 60, 40):
        step = fit_step(law, sample, table)
        assert step is not None
        z.append(step.step / step.errors)
    assert np.abs(np.mean(z, axis=0)).max() < 4.2 / np.sqrt(40)
    assert np.abs(np.std(z, axis=0) - 1).max() < 4.2 / np.sqrt(80)


@pytest.fixture(scope="module")
def many() -> ManyDetections:
    return ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))


@pytest.fixture(scope="module")
def table(many: ManyDetections) -> MomentTable:
    """What is expected of box errors over that truth, most of the work of `verify`."""
    return MomentTable()


def t_data(nu: float = 4.0, spread: float = 1.0, **sections: Any) -> dict[str, Any]:
    data = variant("plain") | sections
    for state in data["states"].values():
        error = state["box_error"]
        error.update(law="student_t", degrees_of_freedom=nu)
        error["covariance"] = [[spread * value for value in row] for row in error["covariance"]]
    return data


def test_honest_seeds_obey_and_their_statistics_have_the_spread_of_a_normal_number(many, table):
    """Standard errors that are a quarter too small are found by their spread, and hardly by whether seeds obey."""
    model, z = parse_detector(t_data()), []
    for seed in range(6):
        found = verify_evidence(model, many.detect(model, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        of_law = (v.parameter.measure for v in found.verdicts if ".box_error." in v.parameter.name)
        z += [measure.z for measure in of_law if measure is not None]
    assert len(z) > 150 and abs(np.mean(z)) < 4 / np.sqrt(len(z))
    assert abs(np.std(z) - 1) < 4 / np.sqrt(2 * len(z))


def test_honest_errors_that_persist_obey(many: ManyDetections, table: MomentTable) -> None:
    model = parse_detector(t_data(persistence={"box_s": 0.5}))
    measured = []
    for seed in range(2):
        found = verify_evidence(model, many.detect(model, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        measured += [v.measured for v in found.verdicts if v.parameter.name == "persistence.box_s"]
    standard_error = 0.045 / np.sqrt(2)
    assert np.mean(measured) == pytest.approx(np.exp(-0.2 / 0.5), abs=4 * standard_error)


def test_a_wrong_law_is_noticed_and_named(many: ManyDetections, table: MomentTable) -> None:
    heavy = parse_detector(t_data())
    for asked, made_with, named in (
        (heavy, t_data(nu=60.0), "box_error.degrees_of_freedom"),
        (heavy, t_data(spread=2.0), "box_error.std"),
        (parse_detector(variant("plain")), t_data(nu=2.5), "box_error"),
    ):
        moments = table if asked is heavy else MomentTable()
        failed = verify_evidence(asked, many.detect(parse_detector(made_with), 1), moments).failed
        assert any(named in verdict.parameter.name for verdict in failed), named
