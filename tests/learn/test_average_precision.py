import contextlib
import io
from dataclasses import replace

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from modsim3d.formats.matching import Rule, match
from modsim3d.learn.figures import Curve, Ranking
from tests.formats.labelled_files import random_set


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
