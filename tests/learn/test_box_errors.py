"""Box errors of Student's t law and normal ones, of boats at the image's edge, and of such as the rule lets match."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import optimize, stats

from modsim3d.core.boxes import clip, inside_image, iou, move
from modsim3d.detector.draws import StudentT, standardised
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.formats.labelled import LabelledSet, joined
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule
from modsim3d.io.input_files import data_folder
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.box_errors.estimate import TITLE, choose_box_errors
from modsim3d.learn.box_errors.fit import ErrorFit, completed, slopes
from modsim3d.learn.box_errors.laws import ErrorSample, choose_law, heavy_tails, learned_errors
from modsim3d.learn.box_errors.matched_edges import MIN_DEGREES, OUTWARD, ErrorModel, MatchedEdges, Unit, fit_student_t
from modsim3d.learn.box_errors.persistence import correlation_left
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import LearnSettings
from modsim3d.learn.matches import ErrorFits
from modsim3d.learn.report_page import tables
from modsim3d.learn.states import each_its_own
from tests.formats.labelled_files import images, truth
from tests.learn import one_state
from tests.learn.one_state import detector_file, learned_from, normal_chain, observed_as, of_boats
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


SIZE = (640.0, 480.0)
_CORRELATION = np.array([[1, 0.2, 0.3, 0], [0.2, 1, 0, -0.2], [0.3, 0, 1, 0.4], [0, -0.2, 0.4, 1]])
PX = {"unit": "px", "mean": [2, -1, 3, -2], "std": [6, 5, 9, 8]}
RELATIVE = {"unit": "relative", "mean": [0.01, -0.02, 0.03, -0.01], "std": [0.12, 0.12, 0.14, 0.16]}
MIXED = {"unit": "mixed", "mean": [2, -1, 3, -2], "std": [2, 2, 3, 3], "growth": [0.04, 0.03, 0.06, 0.05]}
HEAVY = {**PX, "law": "student_t", "degrees_of_freedom": 4.0}


def detector(law: dict[str, Any]) -> dict[str, Any]:
    """A detector that finds everything, with box errors of a law."""
    covariance = _CORRELATION * np.outer(law["std"], law["std"])
    box_error = {key: value for key, value in law.items() if key != "std"} | {"covariance": covariance.tolist()}
    return detector_file(missed=0.0, false=0.0, box_error=box_error)


def boats(count: int, seed: int) -> LabelledSet:
    """One boat in each image, anywhere: many are cut by the edge or lie close to it."""
    rng = np.random.default_rng(seed)
    side = np.exp(rng.uniform(np.log(40), np.log(200), (count, 1))) * np.exp(rng.normal(0, 0.15, (count, 2)))
    centre = rng.uniform(-0.05, 1.05, (count, 2)) * SIZE
    boxes = np.clip(np.hstack([centre - side / 2, centre + side / 2]), 0, [*SIZE, *SIZE])
    middle = np.hstack([np.array(SIZE) / 2 - side / 2, np.array(SIZE) / 2 + side / 2])
    boxes = np.where(np.all(boxes[:, 2:] - boxes[:, :2] >= 4, axis=1)[:, None], boxes, middle)
    image = np.arange(count)
    return of_boats(images(count, SIZE), truth(image, image * 0, boxes))


def detected(law: dict[str, Any], count: int, seed: int) -> LabelledSet:
    """Boats with detections of a simulated detector, of which it is not told what they are of."""
    return one_state.detected(boats(count, seed), detector(law), seed)


def numbers_of(law: dict[str, Any]) -> dict[str, np.ndarray]:
    """The numbers of a law by the paths that learning gives them."""
    names = {"mean", "std", "growth", "degrees_of_freedom"} & law.keys()
    asked = {f"states.usual.box_error_{name}": np.array(law[name], dtype=float) for name in names}
    return asked | {"states.usual.box_error_correlation": np.array([_CORRELATION[pair] for pair in ERROR_PAIRS])}


CASES = {"edge": (PX, "provenance", False), "on the border": (PX, "provenance", True)}
CASES |= {"gate": (RELATIVE, "confidence", False), "mixed": (MIXED, "confidence", False)}
CASES |= {"tails": (HEAVY, "provenance", False)}


@pytest.mark.parametrize(("law", "method", "real"), CASES.values(), ids=CASES)
def test_errors_come_back_from_boats_that_the_edge_and_the_matching_cut(law, method: str, real: bool) -> None:
    labelled = detected(law, 800, 11)
    if real:  # sides of which the truth is cut are detected exactly on the border, as many real detectors do
        results, true = labelled.results, labelled.annotations.boxes_px[labelled.results.origin]
        cut = (true <= 0) | (true >= np.tile(SIZE, 2))
        labelled = replace(labelled, results=replace(results, boxes_px=np.where(cut, true, results.boxes_px)))
    learned = learned_from(labelled, Rule(method))
    (form,), (used,) = learned.form.box_errors.states, learned.numbers.box_errors.used
    assert (form.unit, form.law) == (law["unit"], law.get("law", "normal"))
    asked = numbers_of(law)
    assert outside(asked, learned.intervals(1 - 0.01 / sum(value.size for value in asked.values()))) == {}
    std = {each.key.path: each for each in learned.intervals(0.95)}["states.usual.box_error_std"]
    assert np.all(std.high / std.low < (3.0 if law is MIXED else 1.6))  # not because they are as wide as can be
    assert used.used == used.matches > 700 and used.cut > 0.3 * used.used and used.censored > 0.01 * used.used
    measured = learned.observed.pairs.edges.errors_px
    if law is RELATIVE:
        assert used.lost > 0.05
        measured = measured / learned.observed.pairs.sides_px
    if law in (PX, RELATIVE):  # as measured they are off by several standard errors
        of_mean = np.abs(measured.mean(axis=0) - law["mean"]) / law["std"] * np.sqrt(len(measured))
        of_std = np.abs(measured.std(axis=0) / law["std"] - 1) * np.sqrt(2 * len(measured))
        assert max(of_mean.max(), of_std.max()) > 3.4
    written = parse_detector(learned.detector()).states[0].box_error
    assert written.unit == law["unit"] and (written.growth > 0).any() == (law is MIXED)


def test_models_that_are_left_out_are_not_learned() -> None:
    edges = learned_from(detected(MIXED, 300, 1), replicates=0).observed.pairs.edges
    fits = ErrorFits(edges.take(edges.usable))
    assert choose_law(fits, 0.0, frozenset()).unit == "mixed"
    assert choose_law(fits, 0.0, frozenset({"mixed"})).unit in ("px", "relative")
    hardly = choose_law(ErrorFits(fits.edges), 0.99, frozenset({"relative", "student_t"}))  # errors that hardly change
    assert choose_law(fits, 0.0, frozenset({"mixed", "relative", "student_t"})) == hardly


def test_a_note_says_that_tails_are_as_heavy_as_is_fitted() -> None:
    notes = []
    for power in (0, 3):
        labelled = detected({**PX, "std": [0.6, 0.5, 0.9, 0.8]}, 300, 1)
        results, true = labelled.results, labelled.annotations.boxes_px[labelled.results.origin]
        scale = np.minimum(np.exp(power * np.random.default_rng(1).normal(size=(len(results), 1))), 30)
        labelled = replace(labelled, results=replace(results, boxes_px=true + scale * (results.boxes_px - true)))
        learned = learned_from(labelled, replicates=0)
        notes.append([note for note in learned.notes if "degrees_of_freedom at the least that is fitted, 2.5" in note])
    assert [len(each) for each in notes] == [0, 1]


def test_the_report_says_how_many_matches_count() -> None:
    labelled = detected(PX, 60, 1)
    annotations, results = labelled.annotations, labelled.results
    boxes, found = annotations.boxes_px.copy(), results.boxes_px.copy()
    boxes[:5] = found[results.origin < 5] = [0, 0, *SIZE]  # it fills the image
    annotations, results = replace(annotations, boxes_px=boxes), replace(results, boxes_px=found)
    labelled = replace(labelled, annotations=annotations, results=results)
    report = learn_detector(labelled, LearnSettings(Rule("provenance"), replicates=20), LearnOptions())
    assert [each.rows[0][:3] for each in tables(report) if each.title == TITLE] == [("usual", "60", "55")]
    note = "states.usual.box_error: from 55 of 60 matches; 5 with all sides cut by the image's edge"
    assert note in report.learned.notes


def with_unsure(unsure: np.ndarray) -> tuple[LabelledSet, LabelledSet]:
    """Boats of which some boxes are unsure: more of them is seen than is thought; without and with word of that."""
    labelled = detected(PX, len(unsure), 1)
    results, found = labelled.results, labelled.results.boxes_px.copy()
    found[(results.origin >= 0) & unsure[results.origin], 2] += 40
    labelled = replace(labelled, results=replace(results, boxes_px=found))
    return labelled, replace(labelled, annotations=replace(labelled.annotations, unsure_box=unsure))


def test_unsure_boxes_tell_no_box_errors_unless_too_few_are_sure() -> None:
    labelled, told = with_unsure(np.arange(400) % 4 == 0)
    width, asked = [], float(PX["std"][2])
    for each in (labelled, told):
        learned = learned_from(each, replicates=0)
        width.append(float(learned.numbers.box_errors.states[0].std.estimate[2]))
        notes = [note for note in learned.notes if "100 partly hidden, where positions are not surely known" in note]
        assert len(notes) == (each is told)
    assert width[0] > 2 * asked and width[1] == pytest.approx(asked, rel=0.15)
    unsure = np.arange(400) >= 8
    plain, told = with_unsure(unsure)
    learned = learned_from(told, replicates=0)
    assert float(learned.numbers.box_errors.states[0].mean.estimate[2]) == pytest.approx(PX["mean"][2], abs=8)
    assert any("and surely not hidden, needs" in note for note in learned.notes)
    both = joined([told, plain]).annotations.unsure_box
    assert both is not None and both.tolist() == [*unsure.tolist(), *[False] * len(unsure)]


@pytest.mark.parametrize("rule", [Rule(), Rule("centre", most_distance_px=9.0), Rule("provenance")])
def test_what_passes_is_what_matching_lets_match(rule: Rule) -> None:
    rng = np.random.default_rng(0)
    truth = boats(400, 3).annotations.boxes_px
    size = np.tile(SIZE, (400, 1))
    errors = rng.normal(0, 30, (400, 4))
    edges = MatchedEdges.of(truth, truth, size, np.arange(400), rule)
    found = clip(move(truth, errors), size)
    right = inside_image(move(truth, errors), size)
    if rule.method == "confidence":
        right &= iou(found, truth) >= rule.least_iou
    if rule.method == "centre":
        right &= np.hypot(*((found - truth)[:, :2] + (found - truth)[:, 2:]).T / 2) <= rule.most_distance_px
    assert 0 < right.sum() < 400 and np.array_equal(edges.passes((errors @ OUTWARD.T)[:, None])[:, 0], right)
    for scale in (0.05, 0.3):
        outward = scale * errors @ OUTWARD.T
        surely = edges.surely_passes(np.abs(outward))
        assert surely.sum() > 0 and edges.passes(outward[:, None])[surely].all()


@pytest.mark.parametrize("freedom", [np.inf, 5.0])
def test_the_likelihood_of_a_censored_edge_is_the_probability_beyond_it(freedom: float) -> None:
    truth = np.array([[40.0, 100, 140, 180]])
    found = np.array([[0.0, 98, 143, 182]])  # the left edge lies on the border, 40 px beyond the true one
    edges = MatchedEdges.of(truth, found, np.array([SIZE]), np.arange(1), Rule("provenance"))
    assert edges.censored.tolist() == [[True, False, False, False]]
    model = ErrorModel.of_moments(np.zeros(4), 400 * np.eye(4) + 100, "px", freedom)
    beyond = np.linspace(39.5, 2500, 60_000)
    count = len(beyond)
    found = np.column_stack([40 - beyond, np.tile(found[:, 1:], (count, 1))])
    nowhere = np.full((count, 2), np.nan)
    many = MatchedEdges.of(np.tile(truth, (count, 1)), found, nowhere, np.arange(count), Rule("provenance"))
    (part,) = completed(model, many)
    asked = np.log(np.trapezoid(np.exp(part.log_likelihood), beyond))
    assert slopes(model, edges, None).value == pytest.approx(asked, abs=0.03)
