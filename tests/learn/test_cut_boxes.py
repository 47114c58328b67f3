"""Box errors of boats at the image's edge, and of boats that the matching rule lets match or not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from modsim3d.core.boxes import clip, inside_image, iou, move
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.formats.labelled import LabelledSet, joined
from modsim3d.formats.matching import Rule
from modsim3d.learn.box_errors.estimate import TITLE
from modsim3d.learn.box_errors.fit import completed, slopes
from modsim3d.learn.box_errors.laws import choose_law
from modsim3d.learn.box_errors.matched_edges import OUTWARD, ErrorModel, MatchedEdges
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.matches import ErrorFits
from modsim3d.learn.report_page import tables
from tests.formats.labelled_files import images, truth
from tests.learn import one_state
from tests.learn.one_state import detector_file, learned_from, of_boats
from tests.learn.round_trip import outside

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


def asked_of(law: dict[str, Any]) -> dict[str, np.ndarray]:
    """The numbers of a law by the paths that learning gives them."""
    names = {"mean", "std", "growth", "degrees_of_freedom"} & law.keys()
    asked = {f"states.usual.box_error_{name}": np.array(law[name], dtype=float) for name in names}
    return asked | {"states.usual.box_error_correlation": np.array([_CORRELATION[pair] for pair in ERROR_PAIRS])}


CASES = {
    "edge": (PX, "provenance", False),
    "on the border": (PX, "provenance", True),
    "gate": (RELATIVE, "confidence", False),
    "mixed": (MIXED, "confidence", False),
    "tails": (HEAVY, "provenance", False),
}


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
    asked = asked_of(law)
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
    assert choose_law(fits, 0.0, frozenset({"mixed", "relative", "student_t"})) == choose_law(
        ErrorFits(fits.edges), 0.99, frozenset({"relative", "student_t"})
    )  # errors that hardly change say too little


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
