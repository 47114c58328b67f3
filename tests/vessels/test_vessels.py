import gc
import pickle
import weakref
from dataclasses import replace

import numpy as np
import trimesh

from modsim3d.truth import scan_conversion, winding
from modsim3d.truth.occlusion_order import corners_from_vertices
from modsim3d.truth.separating_axes import _distinct_directions
from modsim3d.vessels.vessel import Vessel, shoebox


def test_shoebox_is_the_closed_box_of_trimesh():
    unit = shoebox()
    mesh = trimesh.Trimesh(unit.vertices, unit.faces, process=False)
    reference = trimesh.creation.box(extents=(1, 1, 1))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.isclose(mesh.volume, 1.0)  # negative if its faces were inside out
    np.testing.assert_array_equal(mesh.bounds, [[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
    shifted = np.add(reference.vertices, (0, 0, 0.5))
    assert {tuple(v) for v in mesh.vertices} == {tuple(v) for v in shifted}
    assert len(mesh.faces) == len(reference.faces)


def test_a_worker_process_knows_which_vessels_have_a_mesh():
    """A hull without a mesh does not hide what its own camera sees."""
    box = Vessel("boat", "Vessel", 8.0, 3.0, 2.0)
    hull = replace(box, solid=replace(shoebox(), convex=False))
    of_worker = pickle.loads(pickle.dumps((box, hull)))
    assert [vessel.has_mesh for vessel in of_worker] == [False, True]
    np.testing.assert_array_equal(of_worker[1].solid.faces, hull.solid.faces)
    assert not of_worker[1].solid.convex


def test_what_is_worked_out_for_a_solid_goes_with_it():
    """A process of a campaign makes thousands of runs, each with solids of its own."""
    solid = replace(shoebox())
    for function in (scan_conversion._edges_of, _distinct_directions, corners_from_vertices, winding.edges_of):
        assert function(solid) is function(solid)
    left = weakref.ref(solid)
    del solid
    gc.collect()
    assert left() is None
