"""pyrender's SEG image as the third witness of which vessel a pixel shows.
pyrender draws boxes of its own making (trimesh) with its own camera, matrices and shaders, in single precision, with a
24-bit depth buffer and eight-bit colours; the ID pass is given triangles in pixels.
Edges shared by two triangles: OpenGL's fill rule gives a pixel whose centre lies exactly on such an edge to one of the
two and never to both or neither, so the diagonal of a face loses no pixel and doubles none, in either renderer. What
may differ is a pixel whose centre is so near a silhouette's edge that single precision, or rounding corners to
1/256 px, puts it on the other side."""

import os
import subprocess
import sys

import numpy as np
import pytest
import shapely

from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.render.id_pass import Region
from modsim3d.truth.analytic import ROUNDING_PX, image_silhouettes
from modsim3d.truth.buffer_drawing import triangles_of
from tests.scenes import CAMERA_HEIGHT_M, INTRINSICS, cyclic_beams, outlines_at, random_places, vessel

WHOLE = Region(0, 0, *INTRINSICS.image_size_px)
CV_TO_GL = np.diag([1.0, -1.0, -1.0])
LEVEL = Mount((0.0, 0.0, CAMERA_HEIGHT_M))
RANDOM = range(8)


def scenes():
    """Boxes and a camera, by name."""
    wall, boat = vessel("wall", 1, 10, 10), vessel("boat", 2, 4, 4)
    beams, from_above = cyclic_beams()
    corner_on = [(vessel("a", 20, 10, 4), (90.3, 3.1, 0.0), 0.6), (vessel("b", 8, 3, 9), (60.2, -2.7, 0.0), 2.1)]
    ship = (vessel("ship", 210, 8, 15), (198.0, 10.4, 0.0), -0.196)
    found = {
        # 100 × 100 px, corners on whole pixels: the diagonal between its triangles meets 100 pixel centres.
        "face": ([(wall, (100.5, 0.0, 0.0), 0.0)], LEVEL),
        "side by side": ([(wall, (100.5, 5.0, 0.0), 0.0), (wall, (100.5, -5.0, 0.0), 0.0)], LEVEL),
        "one before the other": ([(wall, (200.5, 1.0, 0.0), 0.0), (wall, (100.5, -4.0, 0.0), 0.0)], LEVEL),
        "corner on": (corner_on, LEVEL),
        "long ship and boat": ([ship, (boat, (220.0, -2.0, 0.0), 0.0)], LEVEL),
        "cyclic beams": (beams, from_above),
    }
    for seed in RANDOM:
        places = random_places(np.random.default_rng(seed), 20, far_m=1500)
        found[f"random {seed}"] = ([(v, (*place, 0.0), heading) for v, place, heading in places], LEVEL)
    return found


def seg_image(pyrender, trimesh, boxes, mount):
    """Vessel index + 1 at each pixel, as pyrender draws it."""
    scene = pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[1, 1, 1])
    camera_pose, pose = np.eye(4), poses_ashore(mount, 1)
    camera_pose[:3, :3] = pose.camera_R_world[0].T @ CV_TO_GL
    camera_pose[:3, 3] = pose.positions_m[0]
    camera = pyrender.IntrinsicsCamera(*INTRINSICS.focal_px, *INTRINSICS.principal_point_px, znear=1.0, zfar=4000)
    scene.add(camera, pose=camera_pose)
    colours = {}
    for number, (ship, place, heading) in enumerate(boxes, start=1):
        box_pose = np.eye(4)
        box_pose[:3, :3] = world_R_vehicle(heading)
        box_pose[:3, 3] = np.add(place, [0, 0, ship.air_draft_m / 2])
        mesh = pyrender.Mesh.from_trimesh(trimesh.creation.box(extents=ship.extents_m), smooth=False)
        colours[scene.add(mesh, pose=box_pose)] = (number >> 16 & 255, number >> 8 & 255, number & 255)
    drawer = pyrender.OffscreenRenderer(*INTRINSICS.image_size_px)
    colour = drawer.render(scene, flags=pyrender.RenderFlags.SEG, seg_node_map=colours)[0].astype(np.uint32)
    drawer.delete()
    return colour[..., 0] << 16 | colour[..., 1] << 8 | colour[..., 2]


def write_seg_images(file):
    """Draw all scenes with pyrender, in a process that has no other OpenGL context."""
    from modsim3d.render.shaded_pass import import_pyrender

    pyrender = import_pyrender()
    import trimesh

    np.savez(file, **{name: seg_image(pyrender, trimesh, *scene) for name, scene in scenes().items()})


@pytest.fixture(scope="module")
def seg_images(tmp_path_factory):
    file = tmp_path_factory.mktemp("seg") / "seg.npz"
    script = f"from tests.render.test_pyrender_witness import write_seg_images; write_seg_images({str(file)!r})"
    environment = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(file) as images:
        return dict(images)


def id_image(renderer, name, faces=None):
    """Vessel index + 1 at each pixel, as the ID pass draws it; of some triangles only, on request."""
    boxes, mount = scenes()[name]
    outlines = outlines_at(boxes, INTRINSICS, mount)
    triangles = triangles_of(outlines, INTRINSICS)
    some = slice(None) if faces is None else faces
    ids = outlines.occluder[triangles.row] + 1
    return renderer.draw(triangles.corners_px[some], triangles.inverse_depth[some], ids[some], WHOLE)


@pytest.mark.parametrize("name", [name for name in scenes() if not name.startswith("random")])
def test_id_pass_equals_the_seg_image_pixel_for_pixel_and_faces_have_every_pixel_of_them(renderer, seg_images, name):
    """The face is in columns 350–450 and rows 300–400; the two side by side meet at column 400."""
    image, alone, two = id_image(renderer, name), *np.zeros((2, 600, 800), dtype=int)
    alone[300:400, 350:450] = two[300:400, 300:400] = 1
    two[300:400, 400:500] = 2
    assert (image > 0).sum() > 1000
    np.testing.assert_array_equal(image, {"face": alone, "side by side": two}.get(name, image))
    np.testing.assert_array_equal(image, seg_images[name])


def test_seg_images_differ_only_within_rounding_and_a_shared_edge_belongs_to_one_triangle(renderer, seg_images):
    outlines = outlines_at(scenes()["face"][0])
    inverse_depth = triangles_of(outlines, INTRINSICS).inverse_depth
    front = np.flatnonzero((inverse_depth == inverse_depth.max()).all(axis=1))
    one, two = (id_image(renderer, "face", [triangle]) == 1 for triangle in front)
    assert len(front) == 2 and one.sum() + two.sum() == 100 * 100 and not (one & two).any()
    diagonal = np.eye(100, dtype=bool)
    shares = [part[300:400, 350:450][corner].sum() for part in (one, two) for corner in (diagonal, diagonal[::-1])]
    assert 100 in shares  # one of them has the whole diagonal
    differing = shown = 0
    for name in (f"random {seed}" for seed in RANDOM):
        image = id_image(renderer, name)
        rows, columns = np.nonzero(image != seg_images[name])
        silhouettes = image_silhouettes(outlines_at(scenes()[name][0]), INTRINSICS)
        edges = shapely.union_all(shapely.boundary(silhouettes))
        assert (shapely.distance(edges, shapely.points(columns + 0.5, rows + 0.5)) <= ROUNDING_PX).all()
        differing, shown = differing + len(rows), shown + len(np.unique(image)) - 1
    assert shown > 50 and differing <= 5  # of 3.8 million; measured: 1
