"""Box errors of Student's t law are learned as such, and normal ones as normal."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import optimize, stats

from modsim3d.core.boxes import move
from modsim3d.detector.draws import StudentT, standardised
from modsim3d.detector.file.reading import load_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule
from modsim3d.io.input_files import data_folder
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.box_errors.estimate import choose_box_errors
from modsim3d.learn.box_errors.fit import ErrorFit, slopes
from modsim3d.learn.box_errors.laws import ErrorSample, choose_law, heavy_tails, learned_errors
from modsim3d.learn.box_errors.matched_edges import MIN_DEGREES, ErrorModel, MatchedEdges, Unit, fit_student_t
from modsim3d.learn.box_errors.persistence import correlation_left
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.matches import ErrorFits
from modsim3d.learn.states import each_its_own
from tests.formats.labelled_files import images
from tests.learn.one_state import normal_chain, observed_as
from tests.learn.round_trip import DETECTOR, asked_of, command, outside, simulate

MEAN = np.array([1.0, -2.0, 0.5, 3.0])
ROOT = np.array([[4.0, 0, 0, 0], [1, 3, 0, 0], [2, 0, 5, 0], [0, -1, 1, 2]])
COVARIANCE = ROOT @ ROOT.T
KEPT = np.exp(-0.1 / 0.6)
UNITS: tuple[Unit, ...] = ("px", "relative")


def t_errors(count: int, nu: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(stats.multivariate_t(MEAN, COVARIANCE * (nu - 2) / nu, df=nu).rvs(count, random_state=rng))


def at_sea(errors: np.ndarray) -> ErrorFits:
    """Errors of large boxes in images without an edge, matched by provenance."""
    truth = np.tile([0.0, 0, 1000, 1000], (len(errors), 1))
    nowhere, image = np.full((len(errors), 2), np.nan), np.arange(len(errors))
    return ErrorFits(MatchedEdges.of(truth, move(truth, errors), nowhere, image, Rule("provenance")))


def fitted(errors: np.ndarray) -> ErrorFit:
    fit = at_sea(errors).fit("px", heavy=True)
    assert fit is not None and fit.settled
    return fit


@pytest.mark.parametrize("nu", [3.0, 6.0])
def test_the_fit_is_where_the_density_of_scipy_is_largest(nu: float) -> None:
    errors = t_errors(800, nu)
    fit = fitted(errors)
    model = fit.model
    scatter = model.covariance * (model.freedom - 2) / model.freedom

    def log_likelihood(shift: float = 0.0, scale: float = 1.0, degrees: float = model.freedom) -> float:
        return float(stats.multivariate_t(model.mean + shift, scatter * scale, df=degrees).logpdf(errors).sum())

    best = log_likelihood()
    assert fit.value == pytest.approx(best)
    for changes in ({"shift": 0.1}, {"shift": -0.1}, {"scale": 1.03}, {"scale": 0.97}):
        assert log_likelihood(**changes) < best
    likeliest = optimize.minimize_scalar(lambda nu: -log_likelihood(degrees=nu), bounds=(2.1, 30), method="bounded")
    assert model.freedom == pytest.approx(likeliest.x, rel=1e-3)
    assert np.abs(fit.slopes().scores[:, 4:].sum(axis=0)).max() < 0.05  # their standard deviations are about 28


@pytest.mark.parametrize("freedom", [np.inf, 4.0])
@pytest.mark.parametrize("unit", ["px", "relative", "mixed"])
def test_scores_are_slopes_of_the_log_likelihood(unit: Unit, freedom: float) -> None:
    edges = at_sea(t_errors(20, 4.0)).edges
    scale = 1e-3 if unit == "relative" else 1.0
    model = ErrorModel.of_moments(scale * MEAN, scale**2 * COVARIANCE, unit, freedom)
    model = replace(model, growth=np.full(4, 0.01)) if unit == "mixed" else model
    numbers, scores = model.numbers(), slopes(model, edges, None).scores.sum(axis=0)
    for place in range(len(numbers)):
        step = 1e-5 * scale * np.eye(len(numbers))[place]
        low, high = (slopes(model.with_numbers(numbers + side * step), edges, None).value for side in (-1, 1))
        assert scores[place] == pytest.approx((high - low) / (2e-5 * scale), rel=1e-3, abs=1e-2)


@pytest.mark.parametrize("nu", [4.0, 6.0])
def test_estimates_stray_as_far_as_their_replicates_and_lie_around_the_truth(nu: float) -> None:
    asked = np.concatenate([MEAN, np.sqrt(np.diag(COVARIANCE)), [nu]])
    z = []
    for seed in range(24):
        errors = t_errors(600, nu, seed)
        sample = ErrorSample(errors, np.arange(600), 0.0, "clear", "px", fitted(errors))
        learned = learned_errors(resample(images(600), 100, seed), sample)
        entries = (learned.mean, learned.std, learned.degrees_of_freedom)
        columns = [entry.column for entry in entries if entry is not None]
        values = np.concatenate([np.atleast_2d(column.values.T).T for column in columns], axis=1)
        z.append((values[0] - asked) / values[1:].std(axis=0))
    assert np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(24) and np.abs(np.std(z, axis=0) - 1).max() < 4 / np.sqrt(48)


@pytest.mark.parametrize("kept", [0.0, 0.9])
def test_normal_errors_stay_normal_and_heavy_ones_do_not(kept: float) -> None:
    for seed in range(20):
        normal = normal_chain(kept, np.random.default_rng(seed), 50, 20, 4)
        assert not heavy_tails(at_sea(normal.reshape(-1, 4) @ ROOT.T), "px", kept)
    heavy = standardised(StudentT(6.0), normal_chain(kept, np.random.default_rng(7), 150, 20, 5))
    heavy = heavy.reshape(-1, 4) @ ROOT.T
    assert "tails are heavier" in heavy_tails(at_sea(heavy), "px", kept)
    fits = at_sea(heavy)
    for unit in UNITS:
        normal_fit = fits.fit(unit)
        assert normal_fit is not None
        fits._found[unit, False] = fits._again[unit] = replace(normal_fit, settled=False)
    without_normal = heavy_tails(fits, "px", kept)
    assert "no normal errors fit" in without_normal and "inf" not in without_normal
    assert not heavy_tails(at_sea(t_errors(99, 3.0)), "px", 0.0)


@pytest.mark.parametrize(("count", "seed"), [(200, 2), (200, 28), (700, 2)])
def test_normal_errors_that_grow_are_not_heavy_tails_where_their_fit_settles_late_only(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sides = np.exp(rng.normal(np.log([110, 60]), [0.8, 0.7], (count, 2)))
    truth = np.column_stack([np.zeros((count, 2)), sides])
    spread = np.array([2, 2, 3, 3]) + np.array([0.05, 0.05, 0.08, 0.08]) * np.tile(sides, 2)
    found = move(truth, rng.normal(size=(count, 4)) * spread)
    edges = MatchedEdges.of(truth, found, np.full((count, 2), np.nan), np.arange(count), Rule("provenance"))
    fits = ErrorFits(edges)
    assert not fits.value("mixed") > -np.inf
    law = choose_law(fits, 0.54, frozenset())
    assert (law.unit, law.law) == ("mixed", "normal")


def test_a_few_boxes_that_are_none_of_the_vessel_are_no_heavy_tails() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        errors = rng.normal(size=(1200, 4)) @ ROOT.T
        strays = rng.choice(1200, 1 + seed, replace=False)
        errors[strays] = rng.uniform(-60, 60, (1 + seed, 4))
        fits = at_sea(errors)
        assert fits.value("px", heavy=True) - fits.value("px") > 10  # which alone would be enough
        assert not heavy_tails(fits, "px", 0.0), seed
        assert heavy_tails(at_sea(np.vstack([errors[:20], t_errors(400, 6.0, seed)])), "px", 0.0), seed


def test_a_fit_that_cannot_reach_what_is_asked_is_given_up() -> None:
    errors = t_errors(400, 4.0)
    best = fitted(errors)
    kept = at_sea(errors).fit("px", heavy=True, least=best.value - 1)
    assert kept is not None and kept.settled and np.array_equal(kept.model.numbers(), best.model.numbers())
    fits = at_sea(errors)
    assert fits.value("px", heavy=True, least=best.value + 50) == -np.inf
    given_up = fits.fit("px", heavy=True)
    assert given_up is not None and not given_up.settled and given_up.value <= best.value


def test_errors_without_a_likeliest_t_law_stay_normal() -> None:
    many_right = t_errors(400, 3.0)
    many_right[:250] = 0  # annotated by the detector itself
    assert fit_student_t(many_right) is None and not heavy_tails(at_sea(many_right), "px", 0.0)
    flat = t_errors(400, 3.0)
    flat[:, 3] = flat[:, 2]
    assert not heavy_tails(at_sea(flat), "px", 0.0)
    assert fitted(np.random.default_rng(1).standard_cauchy((400, 4))).model.freedom < MIN_DEGREES + 0.01


def test_directions_show_how_the_normal_numbers_behind_t_errors_persist() -> None:
    errors = standardised(StudentT(4.0), normal_chain(KEPT, np.random.default_rng(2), 1000, 60, 5))
    for numbers in (4, 2):
        direction = errors[..., :numbers] / np.linalg.norm(errors[..., :numbers], axis=-1, keepdims=True)
        cosine = (direction[1:] * direction[:-1]).sum(axis=-1).mean()
        left = float(correlation_left(np.array(KEPT), np.array(numbers)))
        assert cosine == pytest.approx(KEPT * left, abs=0.004) and cosine < KEPT - 0.02
        assert float(correlation_left(np.array(1.0), np.array(numbers))) == pytest.approx(1)


def test_every_number_of_a_t_law_comes_back_inside_its_interval_and_in_the_file_of_the_command(tmp_path) -> None:
    data = yaml.safe_load(DETECTOR.read_text())
    for state in data["states"].values():
        state["box_error"] |= {"law": "student_t", "degrees_of_freedom": 4.0}
    detector, out = tmp_path / "asked.yaml", tmp_path / "learned.yaml"
    detector.write_text(yaml.safe_dump(data))
    run = simulate("simulation_1", tmp_path, mode=0, steps=700, detector=detector)
    settings = LearnSettings(Rule("provenance"), replicates=150)
    learned = learn_detector(labelled_run(run)[0], settings, LearnOptions(interval_s=1.0)).learned
    asked = asked_of(detector)
    degrees = {f"states.{state}.box_error_degrees_of_freedom" for state in ("clear", "haze")}
    assert {path for path in asked if "degrees" in path} == degrees
    assert outside(asked, learned.intervals(1 - 0.01 / sum(value.size for value in asked.values()))) == {}
    intervals = {each.key.path: each for each in learned.intervals(0.95)}
    for path, most in (("box_error_std", 1.35), ("box_error_degrees_of_freedom", 1.8)):
        interval = intervals[f"states.clear.{path}"]
        assert np.all(interval.high / interval.low < most)  # not because they are as wide as can be
    result = command("learn", run, "--match", "provenance", "--out", out, "--replicates", 20, "--no-check")
    page, text = out.with_suffix(".html").read_text(), out.read_text()
    for each in (result.output, page, text):
        assert "states.clear.box_error: student_t, for tails are heavier than normal ones" in each
    assert "states.clear.box_error_degrees_of_freedom" in page.replace("<wbr>", "") and "law: student_t" in text
    assert all(isinstance(state.box_error.distribution, StudentT) for state in load_detector(out).states)


def of_thesis(folder: Path, seed: int) -> LabelledSet:
    """A run of the thesis's detector, whose errors are drawn anew for half of the boxes."""
    thesis = data_folder("scenes") / "detectors/thesis.yaml"
    return labelled_run(simulate("simulation_1", folder, 0, 900, seed, thesis))[0]


def test_normal_errors_half_of_which_were_drawn_anew_are_learned_as_normal_ones_and_not_known(tmp_path: Path) -> None:
    settings = LearnSettings(Rule("provenance"), replicates=20)
    report = learn_detector(of_thesis(tmp_path, 0), settings, LearnOptions(check=False))
    assert re.fullmatch(
        r"Not known: (states\.\w+\.box_error(, )?)+; so many boxes fail the matching, or were drawn anew, that "
        "errors may spread farther",
        report.remarks[0],
    )
    state = report.remarks[0].split(".")[1]
    interval = {each.key.path: each for each in report.learned.intervals(0.95)}[f"states.{state}.box_error_mean"]
    assert np.isnan(interval.low).all() and np.isnan(interval.high).all() and np.isfinite(interval.estimate).all()
    labelled = of_thesis(tmp_path, 3)
    states = each_its_own(("excellent", "good", "bad", "terrible"))
    image_state = states.of_images(labelled.images, labelled.conditions)
    other = choose_box_errors(observed_as(labelled, states.names, image_state, Rule("provenance")))
    assert {state.law for form in (report.learned.form.box_errors, other) for state in form.states} == {"normal"}
