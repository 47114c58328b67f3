"""Vessels and scenes as trimesh objects, held against what the ID pass draws."""

import io

import numpy as np
import pytest
import trimesh

from modsim3d import ModsimError, load_scene
from modsim3d.render.id_pass import Region
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.sight import CV_TO_GL
from modsim3d.truth.buffer_drawing import triangles_of
from tests.scenes import write_scene

STEP = 255
PIXELS = 400


@pytest.fixture(scope="module")
def scene():
    return load_scene("strait")


@pytest.fixture(scope="module")
def exported(scene):
    return scene.at(STEP).to_trimesh()


def seen_from(camera, exported, name):
    """Vertices of a node of the trimesh scene in the axes of a camera's frame in it, shape (K, 3), and its faces."""
    world_T_node, geometry = exported.graph[name]
    world_T_camera, _ = exported.graph[f"camera#{camera.name}"]
    camera_T_node, mesh = np.linalg.inv(world_T_camera) @ world_T_node, exported.geometry[geometry]
    return trimesh.transform_points(mesh.vertices, camera_T_node) @ CV_TO_GL, mesh.faces


def nearest(triangles, rays):
    """Index of the first triangle that each ray from the origin meets, −1 for none (Möller & Trumbore, 1997)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    depth = np.full((len(rays), len(triangles)), np.inf)
    for i, ray in enumerate(rays):
        cross = np.cross(ray, c - a)
        determinant = (cross * (b - a)).sum(axis=1)
        with np.errstate(all="ignore"):
            u = (cross * -a).sum(axis=1) / determinant
            other = np.cross(-a, b - a)
            v = (other @ ray) / determinant
            t = (other * (c - a)).sum(axis=1) / determinant
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (t * ray[2] > 0.1)
        depth[i, meets] = t[meets]
    return np.where(np.isfinite(depth.min(axis=1)), depth.argmin(axis=1), -1)


@pytest.mark.parametrize("index", [0, 1])
def test_rays_meet_what_the_rendered_source_draws_and_silhouettes_have_its_full_boxes(scene, exported, renderer, index):
    camera = scene.cameras[index]
    outlines, width, height = scene.sight(camera, np.array([STEP])).outlines(), *camera.intrinsics.image_size_px
    drawn = triangles_of(outlines, camera.intrinsics)
    owners = outlines.occluder[drawn.row] + 1
    ids = renderer.draw(drawn.corners_px, drawn.inverse_depth, owners, Region(0, 0, width, height)).astype(int) - 1
    # At a silhouette's edge either answer is right; elsewhere all neighbours of a pixel agree with it.
    middle = ids[1:-1, 1:-1]
    around = [ids[1 + i : height - 1 + i, 1 + j : width - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    calm = np.all([part == middle for part in around], axis=0)
    rng, picked = np.random.default_rng(0), []
    for owner in np.unique(middle[calm]):
        places = np.argwhere(calm & (middle == owner)) + 1
        picked.append(places[rng.choice(len(places), min(len(places), PIXELS // 8), replace=False)])
    rows, columns = np.concatenate(picked).T
    expected = ids[rows, columns]
    assert len(set(expected.tolist())) >= 6
    names = [name for name in exported.graph.nodes_geometry if name != camera.mount.vessel or index == 0]
    parts = [seen_from(camera, exported, name) for name in names]
    triangles = np.concatenate([vertices[faces] for vertices, faces in parts])
    owner = np.repeat([scene.occluder_names.index(name) for name in names], [len(faces) for _, faces in parts])
    rays = camera.intrinsics.unproject(np.stack([columns, rows], axis=1) + 0.5, np.ones(len(rows)))
    hit = nearest(triangles, rays)
    assert np.where(hit >= 0, owner[hit], -1).tolist() == expected.tolist()
    camera = scene.cameras[index]
    truth = truth_block(scene, STEP, STEP + 1, renderer)
    compared = 0
    for row in np.flatnonzero(truth.camera == index).tolist():
        name = scene.vessel_names[truth.vessel[row]]
        vertices, faces = seen_from(camera, exported, name)
        points = camera.intrinsics.project(vertices[np.unique(faces)])
        box = np.concatenate([points.min(axis=0), points.max(axis=0)])
        if np.all(box[:2] >= 0) and np.all(box[2:] <= camera.intrinsics.image_size_px):
            np.testing.assert_allclose(truth.full_boxes_px[row], box, atol=1.0, err_msg=name)
            compared += 1
    assert compared >= 2


def test_every_vessel_obstacle_and_camera_is_a_node_at_its_pose_also_in_a_glb_file(scene, exported, tmp_path):
    assert set(exported.graph.nodes_geometry) == set(scene.occluder_names)
    poses = scene.motion.at(np.array([STEP]))
    assert poses.poses.positions_m[0, :, 2].any()  # waves lift
    for index, vessel in enumerate(scene.vessels):
        matrix, geometry = exported.graph[vessel.name]
        assert geometry == vessel.name
        np.testing.assert_array_equal(matrix[:3, :3], poses.world_R_vessel[0, index])
        np.testing.assert_array_equal(matrix[:3, 3], poses.poses.positions_m[0, index])
        np.testing.assert_allclose(exported.geometry[geometry].extents, vessel.extents_m, rtol=1e-12)
    for camera in scene.cameras:
        pose = scene.sight(camera, np.array([STEP])).camera_poses
        matrix, _ = exported.graph[f"camera#{camera.name}"]
        np.testing.assert_array_equal(matrix[:3, 3], pose.positions_m[0])
        np.testing.assert_array_equal(-matrix[:3, 2], pose.camera_R_world[0, 2])  # looks along its −z
    camera, lens = exported.camera, scene.cameras[0].intrinsics
    assert (camera.name, tuple(camera.resolution)) == ("camera#bow", lens.image_size_px)
    np.testing.assert_allclose(np.diag(camera.K)[:2], lens.focal_px)
    before, after = scene.at(STEP).to_trimesh(), scene.at(STEP).to_trimesh()
    after.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    w1, w2, w3 = before.bounds.T
    np.testing.assert_allclose(after.bounds.T, [w1, w3, -w2[::-1]], atol=1e-9)
    for name in ("camera#quay", "ferry"):
        w1, w2, w3 = before.graph[name][0][:3, 3]
        np.testing.assert_allclose(after.graph[name][0][:3, 3], [w1, w3, -w2], atol=1e-9)
    path = tmp_path / "moment.glb"
    exported.export(path)
    read = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb", process=False)
    cameras = {f"camera#{camera.name}" for camera in scene.cameras}
    assert set(read.graph.nodes) >= {*scene.occluder_names, *cameras}
    for name in (*scene.occluder_names, *cameras):
        expected, geometry = exported.graph[name]
        np.testing.assert_allclose(read.graph[name][0], expected, rtol=1e-6, atol=1e-6)
        if geometry is not None:
            after = read.geometry[read.graph[name][1]]
            np.testing.assert_allclose(after.vertices, exported.geometry[geometry].vertices, rtol=1e-6, atol=1e-4)
            assert np.array_equal(after.faces, exported.geometry[geometry].faces)


def test_an_absent_vessel_is_left_out_and_a_step_that_the_scene_does_not_have_is_refused(tmp_path):
    boats = {"a": ((9, 3, 2), [[0, 100, 0], [2, 120, 0]]), "b": ((9, 3, 2), [[1, 100, 30], [2, 120, 30]])}
    scene = load_scene(write_scene(tmp_path, boats, steps=2))
    assert [set(scene.at(step).to_trimesh().geometry) for step in (0, 1)] == [{"a"}, {"a", "b"}]
    for step in (-1, 2):
        with pytest.raises(ModsimError, match=f"there is no step {step}; the scene has steps 0 to 1"):
            scene.at(step)
