"""The source's Simulation 1 as shipped (Jessen & Mohr (2023), Tables 9.4, 9.5)."""

from itertools import pairwise

import numpy as np
import pytest

from modsim3d.scene.reading import load_scene
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.world.poses.circular import swept_ring


@pytest.fixture(scope="module")
def scene():
    return load_scene("simulation_1")


def test_scene_follows_the_tables(scene):
    assert (scene.steps, scene.annotation.mode, scene.detector.confidence_threshold) == (1500, 0, 0.2)
    assert scene.timestamps(0, 4) == ("0.0", "0.2", "0.4", "0.6")
    sizes = [(v.air_draft_m, v.beam_m, v.length_m) for v in scene.vessels]
    assert sizes == [(20, 4, 14)] * 2 + [(4, 3, 7)] * 3 and {v.label for v in scene.vessels} == {"Vessel"}
    (camera,) = scene.cameras
    lens, mount = camera.intrinsics, camera.mount
    assert (lens.image_size_px, lens.principal_point_px) == ((3600, 2400), (1800, 1200))
    np.testing.assert_allclose(lens.focal_px, (5000, 5000))
    assert mount.position_m == (2444, 1000, 20)
    assert (mount.roll_rad, mount.pitch_rad, mount.yaw_rad) == (0, 0.008, np.pi)
    assert [state.name for state in scene.detector.states] == ["excellent", "good", "bad", "terrible"]


def test_hulls_can_never_touch(scene):
    rings = sorted(swept_ring(r, v.length_m, v.beam_m) for r, v in zip(scene.poses.radii_m, scene.vessels, strict=True))
    assert all(outer < inner for (_, outer), (inner, _) in pairwise(rings))


def test_rendered_and_projected_full_boxes_agree_within_a_pixel_over_the_whole_simulation(scene, renderer):
    camera = scene.cameras[0]
    worst, compared = 0.0, 0
    for first in range(0, scene.steps, 250):
        outlines = scene.sight(camera, np.arange(first, first + 250)).outlines()
        seen = rendered_occlusion(outlines, camera.intrinsics, renderer)
        difference = np.abs(seen.full_boxes_px - outlines.boxes_px)
        worst, compared = max(worst, float(difference.max())), compared + len(outlines)
    assert compared > 7000 and worst <= 1.0
