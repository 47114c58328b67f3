import gc
import pickle
import weakref
from dataclasses import replace

import numpy as np
import trimesh

from modsim3d.core.errors import InputError
from modsim3d.truth import scan_conversion, silhouettes
from modsim3d.truth.occlusion_order import _distinct_directions, corners_from_vertices
from modsim3d.world.mesh_reading import load_mesh, shipped_meshes
from modsim3d.world.vessels import Vessel, shoebox


def test_a_shoebox_is_the_box_that_trimesh_creates():
    unit, reference = shoebox(), trimesh.creation.box(extents=(1, 1, 1))
    np.testing.assert_array_equal(unit.vertices, reference.vertices + np.array([0, 0, 0.5]))
    np.testing.assert_array_equal(unit.faces, reference.faces)
    mesh = trimesh.Trimesh(unit.vertices, unit.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.isclose(mesh.volume, 1.0)  # negative if its faces were inside out
    np.testing.assert_array_equal(mesh.bounds, [[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])


def test_the_trimesh_of_a_vessel_is_a_copy_of_the_solid_that_is_drawn(tmp_path):
    box = Vessel("boat", "Vessel", 8.0, 3.0, 2.0)
    reference = trimesh.creation.box(extents=(8.0, 3.0, 2.0)).apply_translation([0, 0, 1])
    hulls = [replace(box, solid=load_mesh(name, tmp_path), shape=name) for name in shipped_meshes()]
    for vessel in (box, *hulls):
        vessel.to_trimesh().apply_scale(2.0)
        mesh = vessel.to_trimesh()
        np.testing.assert_array_equal(mesh.vertices, vessel.solid.vertices * [8.0, 3.0, 2.0])
        np.testing.assert_array_equal(mesh.faces, vessel.solid.faces)
        np.testing.assert_array_equal(mesh.triangles, vessel.triangles_m)
        assert mesh.is_watertight and mesh.volume > 0
    np.testing.assert_array_equal(box.to_trimesh().vertices, reference.vertices)
    np.testing.assert_array_equal(box.to_trimesh().faces, reference.faces)


def test_a_worker_process_knows_which_vessels_have_a_mesh():
    """A hull without a mesh does not hide what its own camera sees."""
    box = Vessel("boat", "Vessel", 8.0, 3.0, 2.0)
    hull = replace(box, solid=replace(shoebox(), convex=False))
    of_worker = pickle.loads(pickle.dumps((box, hull)))
    assert [vessel.has_mesh for vessel in of_worker] == [False, True]
    np.testing.assert_array_equal(of_worker[1].solid.faces, hull.solid.faces)
    assert not of_worker[1].solid.convex


def test_input_errors_come_through_from_another_process():
    error = InputError("scene x.yaml", ["a: wrong", "b: wrong"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.source, again.problems) == (str(error), error.source, error.problems)


def test_what_is_worked_out_for_a_solid_goes_with_it():
    """A process of a campaign makes thousands of runs, each with solids of its own."""
    solid = replace(shoebox())
    for function in (scan_conversion._edges_of, _distinct_directions, corners_from_vertices, silhouettes.edges_of):
        assert function(solid) is function(solid)
    left = weakref.ref(solid)
    del solid
    gc.collect()
    assert left() is None
