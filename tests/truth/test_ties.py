"""Ties of depth: of two vessels with faces in one plane, the one that comes first in the scene is in front."""

import numpy as np
import pytest
import shapely

from modsim3d.geometry.camera_poses import Mount, world_R_vehicle
from modsim3d.render.id_pass import Region
from modsim3d.truth.buffer_drawing import triangles_of
from tests.scenes import INTRINSICS, outlines_of, vessel

ABOVE = Mount((0.0, 0.0, 40.0), pitch_rad=0.55, yaw_rad=0.1, roll_rad=0.05)


def raft(heading: float, overlap_m: float):
    """Two boats of one size side by side; the tenth of a beam that they share is a part of both decks."""
    boat, across = vessel("boat", 20, 6, 5), (6 - overlap_m) * np.array([-np.sin(heading), np.cos(heading)])
    return [(boat, (60.0, 5.0), heading), (boat, (60.0 + across[0], 5.0 + across[1]), heading)]


def pixels_inside(corners_m: np.ndarray) -> np.ndarray:
    """Whether each pixel is inside a face with these corners (4, 3) in the world, half a pixel from its edges."""
    outline_px = INTRINSICS.project((corners_m - ABOVE.position_m) @ ABOVE.camera_R_parent.T)
    x, y = np.meshgrid(np.arange(800) + 0.5, np.arange(600) + 0.5)
    return shapely.contains_xy(shapely.Polygon(outline_px).buffer(-0.5), x, y)


@pytest.mark.parametrize("heading", [0.0, 0.3, 1.2, -2.0, np.pi / 2])
def test_deck_that_two_vessels_share_is_that_of_the_first_in_the_scene(renderer, heading):
    places = raft(heading, 0.6)
    corners = np.array([(-10, 3, 5), (10, 3, 5), (10, 2.4, 5), (-10, 2.4, 5)]) @ world_R_vehicle(heading).T
    shared = pixels_inside(corners + np.array([60.0, 5.0, 0.0]))
    assert shared.sum() > 300
    for order in (places, places[::-1]):
        triangles = triangles_of(outlines_of(order, mount=ABOVE), INTRINSICS)
        ids = renderer.draw(triangles.corners_px, triangles.inverse_depth, triangles.row + 1, Region(0, 0, 800, 600))
        assert (ids[shared] == 1).all()
