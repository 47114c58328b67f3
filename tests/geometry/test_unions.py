"""Unions of polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from modsim3d.geometry.kinematics import union_of

SLIVERS = Path(__file__).with_name("slivers.npy")
"""The faces of a boat close to a camera, turned to it, in pixels, shape (206, 3, 2). GEOS 3.14 cannot unite them."""
STEP_PX = 0.5


def test_slivers_have_a_union() -> None:
    triangles = np.load(SLIVERS)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    x, y = (np.stack(np.meshgrid(*map(np.arange, low, high, [STEP_PX] * 2)))).reshape(2, -1)
    faces = shapely.polygons(triangles)
    covered = np.any([shapely.contains_xy(face, x, y) for face in faces], axis=0)
    union = union_of(faces)
    assert union.area == pytest.approx(covered.sum() * STEP_PX**2, rel=0.01)
    assert (shapely.contains_xy(union, x, y) == covered).mean() > 0.999


def test_ordinary_triangles_are_united_without_a_grid() -> None:
    triangles = shapely.polygons([[(0, 0), (1 / 3, 0), (0, 1 / 7)], [(0, 0), (1 / 3, 0), (1 / 3, 1 / 7)]])
    assert union_of(triangles).wkb == shapely.union_all(triangles).wkb
