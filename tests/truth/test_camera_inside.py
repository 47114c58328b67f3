"""Solid angles of meshes, and the first body that a camera is inside."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.truth.outlines import first_body_around, solid_angle
from modsim3d.world.bodies import Bodies, vessel_bodies
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import vessel

ORIGIN = np.zeros(3)


def test_octant_is_an_eighth_of_the_sphere_and_has_a_sign():
    octant = np.diag([1.0, 2.0, 3.0])[None]
    assert solid_angle(ORIGIN, octant) == pytest.approx(np.pi / 2)
    assert solid_angle(ORIGIN, octant[:, ::-1]) == pytest.approx(-np.pi / 2)


def test_solid_angle_depends_on_directions_alone_and_parts_add_up():
    rng = np.random.default_rng(0)
    for corners in rng.normal([0, 0, 2], 1, (100, 3, 3)):
        whole = solid_angle(ORIGIN, corners[None])
        assert solid_angle(ORIGIN, (corners * rng.uniform(0.1, 9, (3, 1)))[None]) == pytest.approx(whole, rel=1e-9)
        middle = rng.dirichlet(np.ones(3)) @ corners
        parts = [[a, b, middle] for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        assert solid_angle(ORIGIN, np.array(parts)) == pytest.approx(whole, rel=1e-9)


def test_closed_mesh_fills_the_sphere_inside_and_nothing_outside():
    box = shoebox().vertices[shoebox().faces] * [5.0, 2.0, 3.0]
    rng = np.random.default_rng(1)
    inside = rng.uniform([-2.4, -0.9, 0.1], [2.4, 0.9, 2.9], (50, 3))
    outside = inside + rng.choice([-1, 1], (50, 1)) * np.eye(3)[rng.integers(0, 3, 50)] * 6
    np.testing.assert_allclose(solid_angle(inside, box), 4 * np.pi, atol=1e-9)
    np.testing.assert_allclose(solid_angle(outside, box), 0.0, atol=1e-9)


def fleet(present: list[list[int]]) -> list[Bodies]:
    """A boat at the origin, 8 m long and 2 m wide and high, and one 20 m ahead of it that lies across."""
    boats, steps = [vessel("along", 8, 2, 2), vessel("across", 8, 2, 2)], len(present)
    places = np.tile([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]], (steps, 1, 1))
    headings = np.tile([0.0, np.pi / 2], (steps, 1))
    return vessel_bodies(boats, np.array(present, dtype=bool), places, world_R_vehicle(headings))


CASES = [
    ([(3.9, 0.9, 1)], [[1, 1]], (0, 0)),
    ([(20.9, 3.9, 1)], [[1, 1]], (0, 1)),
    ([(23.9, 0.9, 1)], [[1, 1]], None),
    ([(30, 0, 1), (20, 0, 1), (0, 0, 1)], [[1, 1]] * 3, (1, 1)),
    ([(0, 0, 1), (0, 0, 1), (0, 0, 1)], [[0, 1], [0, 1], [1, 1]], (2, 0)),
    ([(0, 0, 1), (20, 0, 1)], [[0, 1], [1, 0]], None),
]


def test_first_frame_with_the_camera_in_a_body_that_is_there(monkeypatch):
    for cameras, present, expected in CASES:
        assert first_body_around(np.array(cameras, dtype=float), fleet(present)) == expected, (cameras, present)
    monkeypatch.setattr("modsim3d.truth.outlines.solid_angle", None)  # needed in the box around a body only
    assert first_body_around(np.array([(0, 3, 1), (6, 0, 1.0)]), fleet([[1, 1]] * 2)) is None


def test_earliest_frame_counts_among_bodies_of_several_shapes_and_faces_that_point_inwards_have_an_inside_too():
    (bodies,) = fleet([[1, 1]] * 2)
    later, sooner = (replace(bodies, present=np.array(there, dtype=bool)) for there in ([[0, 0], [1, 0]], [[1, 0]] * 2))
    sooner = replace(sooner, occluder=sooner.occluder + 2)
    assert first_body_around(np.array([[0.0, 0.0, 1.0]] * 2), [later, sooner]) == (0, 2)
    inward = Solid(shoebox().vertices, shoebox().faces[:, ::-1])
    assert first_body_around(np.array([[20.0, 0.0, 1.0]] * 2), [replace(bodies, solid=inward)]) == (0, 1)
