"""Which rule matches what is learned from, that average precision follows it, and what is said where it loses most."""

import contextlib
import io
from dataclasses import replace

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from modsim3d import load_scene, run_scene
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.figures import Curve, ErrorKind, Ranking, error_shares
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import RICHER, LearnSettings
from tests.formats.labelled_files import found, images, random_set, truth
from tests.learn.one_state import of_boats
from tests.learn.round_trip import command, simulate

WITHOUT = frozenset(RICHER) - {"duplicates", "merges", "splits"}
"""What is learned beside matching, and would be most of the work. Second boxes and parts count as matching has them."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Three labels, with errors that are small against the boxes."""
    return simulate("simulation_1", tmp_path_factory.mktemp("run"), mode=0, steps=150)


@pytest.fixture(scope="module")
def far_off(tmp_path_factory):
    """A run whose boxes hardly touch their vessels."""
    scene = load_scene("simulation_1", steps=60, source="analytic")
    return run_scene(scene, tmp_path_factory.mktemp("far") / "run").folder


def learn(tmp_path, *parts):
    options = ("--overwrite", "--replicates", 20, "--no-check", "--without", ",".join(sorted(WITHOUT)))
    result = command("learn", *parts, "--out", tmp_path / "d.yaml", *options)
    assert result.exit_code == 0, result.output
    return result.output


def pair(labelled, rule, d, t):
    """Whether a detection may match an annotation, and how well it does, for one pair."""
    ours, theirs = labelled.results.boxes_px[d].tolist(), labelled.annotations.boxes_px[t].tolist()
    if rule.method == "provenance":
        return labelled.results.origin[d] == t, 1.0
    if rule.method == "centre":
        middle = [[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2] for box in (ours, theirs)]
        away = ((middle[0][0] - middle[1][0]) ** 2 + (middle[0][1] - middle[1][1]) ** 2) ** 0.5
        return away <= rule.most_distance_px, -away
    width = min(ours[2], theirs[2]) - max(ours[0], theirs[0])
    height = min(ours[3], theirs[3]) - max(ours[1], theirs[1])
    common = max(width, 0) * max(height, 0)
    area = [(box[2] - box[0]) * (box[3] - box[1]) for box in (ours, theirs)]
    share = common / (area[0] + area[1] - common)
    return share >= rule.least_iou, share


def slow_average_precision(labelled, rule, label, of_image):
    """Area under the interpolated curve of a label, one detection after another; None with nothing to detect."""
    there = labelled.annotations
    sought = [t for t in range(len(there)) if there.label[t] == label and of_image[there.image[t]]]
    if not sought:
        return None
    results = labelled.results
    rows = [d for d in range(len(results)) if results.label[d] == label and of_image[results.image[d]]]
    taken, points = set(), []
    for number, d in enumerate(sorted(rows, key=lambda d: (-results.confidence[d], d)), start=1):
        same_image = [t for t in sought if there.image[t] == results.image[d] and t not in taken]
        fitting = [(how, t) for t in same_image for good, how in [pair(labelled, rule, d, t)] if good]
        taken |= {max(fitting)[1]} if fitting else set()
        points.append((len(taken) / len(sought), len(taken) / number))
    area, before = 0.0, 0.0
    for k, (recall, _) in enumerate(points):
        area += (recall - before) * max(precision for _, precision in points[k:])
        before = recall
    return area


@pytest.mark.parametrize("near", [True, False], ids=["near", "far off"])
@pytest.mark.parametrize("rule", [Rule("provenance"), Rule("centre", most_distance_px=9), Rule(least_iou=0.6)], ids=str)
def test_average_precision_follows_the_rule_as_a_slow_count_has_it(rule, near, run, far_off):
    labelled, _ = labelled_run(run if near else far_off)
    report = learn_detector(labelled, LearnSettings(rule, replicates=20, without=WITHOUT), LearnOptions())
    for figures in report.states:
        of_image = labelled.images.condition == labelled.conditions.index(figures.name)
        slow = [slow_average_precision(labelled, rule, k, of_image) for k in range(len(labelled.labels))]
        ours = figures.average_precision.all_points.estimate
        assert ours == pytest.approx([np.nan if each is None else each for each in slow], abs=1e-12, nan_ok=True)
        assert (np.nanmean(ours) > 0.1) == (near or rule.method == "provenance")


def test_an_optimal_assignment_ranks_by_confidence_for_average_precision_and_says_so(run, tmp_path):
    labelled, _ = labelled_run(run)
    asked = [
        learn_detector(labelled, LearnSettings(Rule(method), replicates=20, without=WITHOUT), LearnOptions()).states
        for method in ("optimal", "confidence")
    ]
    for states in zip(*asked, strict=True):
        np.testing.assert_array_equal(*(state.average_precision.all_points.values for state in states))
    said = learn(tmp_path, run, "--match", "optimal")
    assert "matched by IoU at least 0.5, optimal assignment, confidence at least" in said
    assert "every detection counted, matched by IoU at least 0.5, in order of confidence" in said
    assert "in order of confidence</h2>" in (tmp_path / "d.html").read_text()


def test_kinds_of_errors_follow_the_rule_by_provenance_and_by_centres(run):
    labelled, _ = labelled_run(run)
    results, there = labelled.results, labelled.annotations
    everything, rule = np.ones(len(labelled.images), dtype=bool), Rule("provenance", by_label=True)
    shares = error_shares(labelled, match(labelled, rule), everything, rule)
    own = results.origin >= 0
    other = int((results.label[own] != there.label[results.origin[own]]).sum())
    expected = {ErrorKind.CLASSIFICATION: other, ErrorKind.BACKGROUND: int((~own).sum()),
                ErrorKind.MISSED: len(there) - int(own.sum())}  # fmt: skip
    assert other > 10 and {each.kind: each.count for each in shares.shares} == dict.fromkeys(ErrorKind, 0) | expected
    # By centres an error is well placed where the centres are near.
    boxes = [[1000.0 * k, 0, 1000.0 * k + 100, 100] for k in range(4)]
    seen = [([60, 0, 160, 100], 0), ([1060, 0, 1160, 100], 1), ([2080, 0, 2180, 100], 0), ([3600, 0, 3700, 100], 0)]
    labelled = replace(
        random_set(1, 1, 2), images=images(1, (9999, 999)), annotations=truth([0] * 4, [0] * 4, boxes),
        results=found([0] * 4, [label for _, label in seen], [box for box, _ in seen], [0.9, 0.8, 0.7, 0.6]),
    )  # fmt: skip
    rule = Rule("centre", most_distance_px=70, by_label=True)
    shares = error_shares(labelled, match(labelled, rule), np.ones(1, dtype=bool), rule)
    named = {each.kind.value: each.count for each in shares.shares if each.count}
    assert named == {"classification": 1, "localisation": 1, "background": 1, "missed": 1}


def test_a_run_is_matched_by_provenance_unless_asked_otherwise(far_off, tmp_path):
    usual, asked = (learn(tmp_path, far_off, *options) for options in ((), ("--match", "provenance")))
    assert usual == asked and "matched by provenance" in usual and "warning" not in usual
    assert "Precision against recall, matched by provenance" in (tmp_path / "d.html").read_text()
    assert "IoU at least" in learn(tmp_path, far_off, "--match", "confidence")


@pytest.mark.parametrize(
    ("rule", "limit"), [(Rule(), ""), (Rule("optimal", 0.4), ":0.4"), (Rule("centre", 0.5, 5.0), ":5")], ids=str
)
def test_the_last_line_says_that_the_rule_loses_most_detections_of_a_run(rule, limit, far_off, tmp_path):
    labelled, _ = labelled_run(far_off)
    own = np.flatnonzero(labelled.results.origin >= 0)
    lost = sum(not pair(labelled, rule, d, labelled.results.origin[d])[0] for d in own)
    last = learn(tmp_path, far_off, "--match", rule.method + limit).splitlines()[-1]
    assert last.startswith(f"warning: {lost:,} of {len(own):,} detections have ")
    assert last.endswith("counts them as missed. Use --match provenance")
    recall = len(match(labelled, rule, 0.2).pairs[0]) / len(labelled.annotations)
    assert f": recall {recall:.3f} counts" in last
    for text in ((tmp_path / "d.yaml").read_text(), (tmp_path / "d.html").read_text()):
        assert f"Warning: {lost:,} of {len(own):,} detections" in text


def test_the_last_line_says_so_of_files_too_which_are_learned_together_with_runs(far_off, run, tmp_path):
    for name, folder in (("far", far_off), ("near", run)):
        command("export", folder, "--format", "coco", "--out", tmp_path / name)
    files = {name: ("--truth", tmp_path / name / "gt.json", "--detections", tmp_path / name / "dt.json")
             for name in ("far", "near")}  # fmt: skip
    last = learn(tmp_path, *files["far"]).splitlines()[-1]
    assert last.startswith("warning: ") and "missed annotations overlap a false positive, and only" in last
    assert "Use --match centre" in last and "warning" not in learn(tmp_path, *files["near"])
    both = learn(tmp_path, far_off, *files["far"], "--match", "confidence")  # a rule that both know
    assert both.startswith("120 images")


def test_a_detector_that_finds_little_is_not_called_one_whose_matches_are_lost(tmp_path):
    boxes = [[100.0 * k, 0, 100.0 * k + 50, 50] for k in range(20)]
    seen = [*boxes[:2], *([60.0 + 100 * k, 0, 90.0 + 100 * k, 50] for k in range(10))]
    annotations, results = truth([0] * 20, [0] * 20, boxes), found([0] * 12, [0] * 12, seen, [0.9] * 12)
    labelled = of_boats(images(1, (9999, 999)), annotations, results)
    report = learn_detector(labelled, LearnSettings(replicates=20), LearnOptions())
    assert report.states[0].any_label.recall.estimate == pytest.approx(0.1) and report.warning is None


def coco_average_precision(labelled):
    """At IoU 0.5, of each label, by COCO's own tools; NaN where they have none."""
    size = lambda box: [box[0], box[1], box[2] - box[0], box[3] - box[1]]  # noqa: E731
    truth, found = labelled.annotations, labelled.results
    content = {
        "info": {},
        "images": [{"id": k, "width": 600, "height": 600} for k in range(len(labelled.images))],
        "categories": [{"id": 7 * k + 3, "name": name} for k, name in enumerate(labelled.labels)],
        "annotations": [
            {"id": t + 1, "image_id": int(truth.image[t]), "category_id": 7 * int(truth.label[t]) + 3,
             "bbox": size(truth.boxes_px[t].tolist()), "area": 1000.0, "iscrowd": int(truth.crowd[t])}
            for t in range(len(truth))
        ],
    }  # fmt: skip
    results = [
        {"image_id": int(found.image[d]), "category_id": 7 * int(found.label[d]) + 3,
         "bbox": size(found.boxes_px[d].tolist()), "score": float(found.confidence[d])}
        for d in range(len(found))
    ]  # fmt: skip
    with contextlib.redirect_stdout(io.StringIO()):
        ground = COCO()
        ground.dataset = content
        ground.createIndex()
        run = COCOeval(ground, ground.loadRes(results), "bbox")
        run.params.iouThrs = np.array([0.5])
        run.params.maxDets = [10_000]
        run.params.areaRng, run.params.areaRngLbl = [[0, 1e10]], ["all"]
        run.evaluate()
        run.accumulate()
    precision = run.eval["precision"][0, :, :, 0, 0]  # (101, k)
    return np.where(precision[0] > -1, precision.mean(axis=0), np.nan)


@pytest.mark.parametrize("seed", range(12))
def test_average_precision_at_101_points_is_that_of_pycocotools(seed):
    labelled = random_set(seed, image_count=25)
    # COCO's files know crowds, and nothing else that is ignored.
    crowds = replace(labelled.annotations, ignored=labelled.annotations.crowd)
    labelled = replace(labelled, annotations=crowds)
    matched = match(labelled, Rule(by_label=True))
    everything = np.ones(len(labelled.images), dtype=bool)
    curves = [Ranking.of(labelled, matched, label, everything).curve() for label in range(3)]
    ours = [np.nan if curve is None else curve.at_points(101) for curve in curves]
    assert ours == pytest.approx(coco_average_precision(labelled).tolist(), abs=1e-12, nan_ok=True)


def test_all_points_eleven_points_and_the_area_of_a_curve_worked_by_hand():
    # Four to find; right, wrong, right, right: recall 1/4, 1/4, 2/4, 3/4 at precision 1, 1/2, 2/3, 3/4.
    curve = Curve(np.array([0.25, 0.25, 0.5, 0.75]), np.array([1, 0.5, 2 / 3, 0.75]), np.array([0.9, 0.8, 0.7, 0.6]))
    assert curve.all_points() == pytest.approx(0.25 * 1 + 0.5 * 0.75)
    assert curve.at_points(11) == pytest.approx((3 * 1 + 5 * 0.75) / 11)
    assert curve.area() == pytest.approx(0.25 * 1 + 0.25 * (0.5 + 2 / 3) / 2 + 0.25 * (2 / 3 + 0.75) / 2)


def test_a_weight_of_two_is_the_image_twice():
    labelled = random_set(9, image_count=10, labels=1)
    ranking = Ranking.of(labelled, match(labelled, Rule(by_label=True)), 0, np.ones(10, dtype=bool))
    weights = np.array([2.0, 0, 1, 1, 3, 1, 0, 2, 1, 1])
    curve = ranking.curve(weights)
    times, sought = weights[ranking.image].astype(int), ranking.annotation_image
    image, right = np.repeat(ranking.image, times), np.repeat(ranking.right, times)
    again = Ranking(image, right, 0.0 * image, np.repeat(sought, weights[sought].astype(int))).curve()
    assert curve.recall[-1] == pytest.approx(again.recall[-1])
    assert curve.precision[-1] == pytest.approx(again.precision[-1])
