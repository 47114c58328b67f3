"""Not a bit of a result depends on how many steps are looked at together: a live run has blocks of one step."""

import numpy as np
import pytest

from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import camera_R_parent
from modsim3d.runs.pipeline import Simulation, block_ranges, truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.truth.record import COLUMNS, concatenate
from tests.scenes import outlines_of, vessel

STEPS = 14
SCENES = {"harbour": {}, "simulation_1": {"sea": "curved"}, "simulation_3": {}, "strait": {}}
"""Shipped scenes, with settings; the strait has obstacles, and cameras of rates of their own."""


@pytest.mark.parametrize("source", ["rendered", "analytic", "rectangles"])
@pytest.mark.parametrize("name", SCENES)
def test_truth_and_detections_are_the_same_bits_in_blocks_of_one_step_and_of_many(name, source, renderer):
    scene = load_scene(name, mode=2, source=source, steps=STEPS, settings=SCENES[name])
    truths, boxes = [], []
    for size in (1, 7, STEPS):
        simulation, parts, found = Simulation(scene, TargetStatistics()), [], []
        for first, stop in block_ranges(STEPS, size):
            truth = truth_block(scene, first, stop, renderer)
            parts += [truth.take(truth.step == step) for step in range(first, stop)]
            block = simulation.detect(truth, first, stop)
            found.append([(part.detections.boxes_px, part.detections.confidence) for part in block.cameras])
        truths.append(concatenate(parts))
        boxes.append([np.concatenate([part[camera][i] for part in found]) for camera in range(len(scene.cameras))
                      for i in range(2)])  # fmt: skip
    for other in (1, 2):
        for column in COLUMNS:
            np.testing.assert_array_equal(getattr(truths[0], column), getattr(truths[other], column), column)
        np.testing.assert_equal(boxes[0], boxes[other])


def test_one_horizon_and_one_silhouette_are_the_same_bits_as_among_many():
    rng = np.random.default_rng(3)
    rotations = camera_R_parent(*rng.normal(0, 0.2, (3, 200)))
    lens = Intrinsics((2855.4, 2855.4), (1232.0, 1028.0), (2464, 2056), skew=3.0)
    alone = [lens.sea_half_plane(rotations[step]) for step in range(200)]
    np.testing.assert_array_equal(lens.sea_half_plane(rotations), alone)
    places = [((rng.uniform(50, 500), rng.uniform(-20, 20)), rng.uniform(-np.pi, np.pi)) for _ in range(15)]
    boats = [(vessel(f"v{i}"), *place) for i, place in enumerate(places)]
    together, alone = outlines_of(boats), [outlines_of([boat]) for boat in boats]
    assert len(together) == 15
    (part,) = together.parts
    np.testing.assert_array_equal(part.vertices_px, np.concatenate([one.parts[0].vertices_px for one in alone]))
    for name in ("areas_px", "boxes_px", "depth_m", "in_frame_fraction"):
        np.testing.assert_array_equal(getattr(together, name), np.concatenate([getattr(one, name) for one in alone]))
