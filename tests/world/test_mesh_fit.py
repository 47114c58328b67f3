"""Vessels, and meshes that do not go with their length, beam and air draft: a warning with what would fit."""

import gc
import pickle
import struct
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from modsim3d.core.errors import InputError
from modsim3d.truth import scan_conversion, silhouettes
from modsim3d.truth.occlusion_order import _distinct_directions, corners_from_vertices
from modsim3d.world.mesh_reading import load_mesh, shipped_meshes
from modsim3d.world.vessels import Vessel, misfit, shoebox
from tests.scenes import camera_keys
from tests.world.test_meshes import NAMES

SIZE_M = (90.0, 15.0, 22.0)
Z_UP_TO_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Bow at +x still, and up from +z to +y, as Blender exports a ship along x by default."""
TO_GLTF = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # bow +x to +z, port +y to +x, up +z to +y


MISFIT = {"length_m": 90, "beam_m": 15, "air_draft_m": 22, "label": "ship", "mesh": "blender.obj"}
AHEAD = {"vessel": "own", "position_m": [3, 0, 2.2], "pitch_rad": 0.02}
TRACKS = {"own": [[0, 0, 0], [30, 30, 0]], "v": [[0, 250, 60], [30, 250, -60]], "w": [[0, 250, 160], [30, 250, 60]]}
SCENE = {
    "steps": 2,
    "time_step_s": 0.5,
    "vessels": {"own": {"length_m": 10, "beam_m": 4, "air_draft_m": 3, "label": "boat"}, "v": MISFIT, "w": MISFIT},
    "poses": {"tracks": TRACKS},
    "cameras": {"bow": camera_keys(1920, 1080, focal_length_m=0.016, mount=AHEAD)},
    "annotation": {"mode": 2, "source": "rendered"},
    "detector": "coastal",
}


def ship(scale: float = 1.0) -> trimesh.Trimesh:
    """A hull with a house and a mast, bow along x, 90 × 15 × 22."""
    parts = [((90, 15, 8), (0, 0, 4)), ((18, 12, 8), (-30, 0, 12)), ((1, 1, 6), (-30, 0, 19))]
    boxes = [trimesh.creation.box(size).apply_translation(at) for size, at in parts]
    return trimesh.util.concatenate(boxes).apply_scale(scale)


def warned(mesh: trimesh.Trimesh, file: str, folder: Path, **axes: str) -> str | None:
    """What is said of a mesh in a file, for a ship of 90 × 15 × 22 m."""
    mesh.export(folder / file)
    return misfit(load_mesh({"file": file, **axes}, folder), np.array(SIZE_M))


def test_a_mesh_that_does_not_fit_vessels_or_an_obstacle_is_warned_of_once_with_axes_that_do(tmp_path, call) -> None:
    ship().apply_transform(Z_UP_TO_Y_UP).export(tmp_path / "blender.obj")
    ship().export(tmp_path / "wreck.stl")
    place = {"mesh": "wreck.stl", "position_m": [300, 0, 0], "heading_rad": 0.7}
    sizes = {"right": [90, 15, 22], "wrong": [15, 90, 22]}
    scene = SCENE | {"obstacles": {name: {**place, "size_m": size} for name, size in sizes.items()}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    status, said = call("check", "scene", tmp_path / "scene.yaml")
    words = " ".join(said.split())
    assert status == 0 and "no errors, 2 warnings" in words
    assert "vessel 'v' and 1 more: the mesh blender measures 90 × 22 × 15 along x, y and z of its file" in words
    assert 'forward: "+x" or "-x", up: "+y" would fit' in words
    assert "length × beam × air draft of 90 × 15 × 22 m" in words
    assert "obstacle 'wrong': the mesh measures 90 × 15 × 22 along x, y and z of its file" in words


def test_the_right_axes_are_not_warned_of_and_a_bow_along_x_and_other_proportions_are(tmp_path):
    assert warned(ship().apply_transform(Z_UP_TO_Y_UP), "ship.obj", tmp_path, forward="+x", up="+y") is None
    for file in ("ship.obj", "ship.stl", "ship.ply"):
        assert warned(ship(1000), file, tmp_path) is None
    assert warned(ship().apply_transform(TO_GLTF), "ship.glb", tmp_path) is None
    said = warned(ship().apply_transform(Z_UP_TO_Y_UP), "ship.glb", tmp_path)
    assert said is not None and "measures 90 × 22 × 15 along x, y and z" in said
    assert 'with forward "+z" and up "+y" it is stretched 36 times as much along one axis as along another' in said
    assert 'forward: "+x" or "-x", up: "+y" would fit' in said
    for stretch, is_told in ((2.9, False), (3.1, True)):
        longer = ship().apply_transform(np.diag([stretch, 1, 1, 1]))
        assert (warned(longer, "ship.stl", tmp_path) is not None) == is_told


CORNERS = [(x * 2000.0, y * 2000.0, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
PARTS = {
    "sea": trimesh.Trimesh(CORNERS, [(0, 1, 2), (0, 2, 3)], process=False),
    "sky": trimesh.creation.icosphere(1, 3000.0),
    "marker": trimesh.creation.box((1, 1, 1)).apply_translation([900, 0, 3]),
}


@pytest.mark.parametrize("extra", PARTS.values(), ids=PARTS)
def test_a_part_that_makes_a_speck_of_the_ship_is_warned_of(extra: trimesh.Trimesh, tmp_path: Path) -> None:
    said = warned(trimesh.util.concatenate([ship(), extra]).apply_transform(TO_GLTF), "sea.glb", tmp_path)
    assert said is not None and "take that part out of the file" in said
    assert f"without one part of {len(extra.faces)} faces it would measure 15 × 22 × 90" in said


@pytest.mark.parametrize("size_m", [SIZE_M, (10.0, 4.0, 3.0), (28.0, 10.0, 14.0), (5.0, 0.7, 1.3), (11.0, 3.5, 16.0)])
@pytest.mark.parametrize("name", NAMES)
def test_shipped_meshes_and_others_that_fill_the_unit_box_are_not_warned_of(name: str, size_m) -> None:
    path = shipped_meshes()[name]
    for entry in (name, path.name):
        assert misfit(load_mesh(entry, path.parent), np.array(size_m)) is None


def test_bytes_behind_the_facets_are_passed_over_and_solids_are_those_of_trimesh(tmp_path):
    content = bytes(80) + ship().export(file_type="stl")[80:]
    assert struct.unpack("<I", content[80:84]) == (36,)
    for behind in (b"", b"\r\n", bytes(49)):
        (tmp_path / f"{len(behind)}.stl").write_bytes(content + behind)
        plain, other = (load_mesh(f"{length}.stl", tmp_path) for length in (0, len(behind)))
        np.testing.assert_array_equal(other.vertices, plain.vertices)
        np.testing.assert_array_equal(other.faces, plain.faces)
    unit, reference = shoebox(), trimesh.creation.box(extents=(1, 1, 1))
    np.testing.assert_array_equal(unit.vertices, reference.vertices + np.array([0, 0, 0.5]))
    np.testing.assert_array_equal(unit.faces, reference.faces)
    mesh = trimesh.Trimesh(unit.vertices, unit.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.isclose(mesh.volume, 1.0)  # negative if its faces were inside out
    np.testing.assert_array_equal(mesh.bounds, [[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
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


def test_meshes_input_errors_and_what_is_worked_out_for_a_solid_come_through_from_another_process():
    """A hull without a mesh does not hide what its own camera sees."""
    box = Vessel("boat", "Vessel", 8.0, 3.0, 2.0)
    hull = replace(box, solid=replace(shoebox(), convex=False))
    of_worker = pickle.loads(pickle.dumps((box, hull)))
    assert [vessel.has_mesh for vessel in of_worker] == [False, True]
    np.testing.assert_array_equal(of_worker[1].solid.faces, hull.solid.faces)
    assert not of_worker[1].solid.convex
    error = InputError("scene x.yaml", ["a: wrong", "b: wrong"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.source, again.problems) == (str(error), error.source, error.problems)
    # A process of a campaign makes thousands of runs, each with solids of its own.
    solid = replace(shoebox())
    for function in (scan_conversion._edges_of, _distinct_directions, corners_from_vertices, silhouettes.edges_of):
        assert function(solid) is function(solid)
    left = weakref.ref(solid)
    del solid
    gc.collect()
    assert left() is None
