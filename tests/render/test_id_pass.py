"""What the ID pass draws, against half-planes and distances, and against pyrender's SEG image: the third witness of
which vessel a pixel shows.
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
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, distance, points

from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.render.context import library_found
from modsim3d.render.id_pass import PlainIds, Region, Sheet
from modsim3d.truth.analytic import ROUNDING_PX, image_silhouettes
from modsim3d.truth.buffer_drawing import triangles_of
from modsim3d.truth.rendered import rendered_occlusion
from tests.scenes import CAMERA_HEIGHT_M, INTRINSICS, cyclic_beams, outlines_at, outlines_of, random_places, vessel

WHOLE = Region(0, 0, 800, 600)


def draw(renderer, triangles, ids, region=WHOLE, depth=0.5):
    corners = np.array(triangles, dtype=float)
    return renderer.draw(corners, np.full(corners.shape[:2], depth), np.array(ids), region)


def test_a_pixel_is_hit_exactly_if_its_centre_is_and_ids_beyond_sixteen_bits_come_back(renderer):
    """A right triangle whose edges pass between pixel centres, against the half-planes themselves."""
    image = draw(renderer, [[[10.2, 10.3], [60.7, 10.3], [10.2, 45.9]]], [7], Region(0, 0, 80, 60))
    x, y = np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5)
    inside = (x > 10.2) & (y > 10.3) & ((x - 10.2) / 50.5 + (y - 10.3) / 35.6 < 1)
    np.testing.assert_array_equal(image == 7, inside)
    for drawer in (renderer, PlainIds()):
        drawn = drawer.draw(np.empty((0, 3, 2)), np.empty((0, 3)), np.empty(0, dtype=int), Region(0, 0, 5, 4))
        np.testing.assert_array_equal(drawn, np.zeros((4, 5)))
    assert draw(renderer, [[[0, 0], [8, 0], [0, 8]]], [4], Region(3, 3, 0, 7)).shape == (7, 0)
    for number in (1, 255, 256, 65_535, 65_536, 2**24 - 1):
        image = draw(renderer, [[[0, 0], [100, 0], [0, 100]]], [number], Region(0, 0, 8, 8))
        assert np.unique(image).tolist() == [number]
    draw(renderer, [[[0, 0], [800, 0], [0, 600]]], [3])
    assert np.unique(draw(renderer, [[[0, 0], [8, 0], [0, 8]]], [4])).tolist() == [0, 4]
    lens = Intrinsics((20000.0, 20000.0), (400.0, 300.0), (800, 600))
    front, back = vessel("front", 10, 30, 20), vessel("back", 10, 30, 20)
    boat = vessel("boat", 2, 0.1, 9.99)
    outlines = outlines_of([(back, (5011.0, 0.0), 0.0), (front, (5000.0, 0.0), 0.0), (boat, (5.0, 0.06), 0.0)], lens)
    occlusion = rendered_occlusion(outlines, lens, renderer)
    share = dict(zip(outlines.occluder.tolist(), occlusion.visible_px / occlusion.silhouette_px, strict=True))
    # The front one, 1 m nearer and of one size, leaves at most a rim of the back one.
    assert share[0] < 0.02 and share[1] > 0.5 and share[2] == 1


@pytest.mark.parametrize(("size", "reach"), [((800, 600), 300), ((3600, 64), 2048), ((12000, 64), 2048)])
def test_region_holds_the_pixels_of_the_whole_image_also_of_a_wide_one(renderer, size, reach):
    """Corners lie up to 2048 px outside the image, as they come from clipping."""
    rng = np.random.default_rng(1)
    corners = rng.uniform(-reach, np.add(size, reach), (60, 3, 2))
    depth, ids = rng.uniform(0.01, 1, (60, 3)), np.arange(1, 61)
    whole = renderer.draw(corners, depth, ids, Region(0, 0, *size))
    for _ in range(25):
        x, y = rng.integers(0, np.array(size) * 7 // 8).tolist()
        region = Region(x, y, *rng.integers(1, (size[0] - x, size[1] - y)).tolist())
        part = renderer.draw(corners, depth, ids, region)
        np.testing.assert_array_equal(part, whole[y : y + region.height, x : x + region.width])


def test_regions_drawn_side_by_side_hold_the_pixels_of_each_alone(renderer):
    rng, counts = np.random.default_rng(3), np.array([30, 25, 0, 40])
    regions = [Region(40, 10, 90, 50), Region(300, 200, 30, 80), Region(0, 0, 20, 20), Region(500, 90, 100, 33)]
    places = np.array([[0, 0], [95, 5], [130, 0], [90, 90]])
    corners = rng.uniform(-300, 1100, (95, 3, 2))  # most reach beyond their region, over the others' places
    depth, ids = rng.uniform(0.01, 1, (95, 3)), np.arange(1, 96)
    sheet = renderer.draw_sheet(corners, depth, ids, counts, Sheet(regions, places, (200, 130)))
    expected = np.zeros((130, 200), dtype=np.uint32)
    for region, (x, y), first, stop in zip(regions, places, np.cumsum(counts) - counts, np.cumsum(counts), strict=True):
        some = slice(first, stop)
        alone = renderer.draw(corners[some], depth[some], ids[some], region)
        expected[y : y + region.height, x : x + region.width] = alone
    assert len(np.unique(expected)) > 6
    np.testing.assert_array_equal(sheet, expected)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-50, 900), min_size=4, max_size=4))
def test_region_around_a_box_holds_every_pixel_it_touches_inside_the_image(sides):
    box = np.array([min(sides[:2]), min(sides[2:]), max(sides[:2]), max(sides[2:])])
    region = Region.around(box, (800, 600), margin_px=0)
    for least, most, first, side in ((0, 2, region.x, region.width), (1, 3, region.y, region.height)):
        pixels = np.arange((800, 600)[least])
        assert set(pixels[(pixels + 1 > box[least]) & (pixels < box[most])]) <= set(range(first, first + side))


DRAWS = """
import sys, numpy as np
from tests.scenes import *
from modsim3d.truth.buffer_drawing import triangles_of
from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer, Region
with open_context() as context:
    renderer = IdRenderer(context)
    print(context.description, file=sys.stderr)
    for seed in range(12):
        outlines = outlines_of(random_places(np.random.default_rng(seed), 25))
        t = triangles_of(outlines, INTRINSICS)
        image = renderer.draw(t.corners_px, t.inverse_depth, outlines.occluder[t.row] + 1, Region(0, 0, 800, 600))
        sys.stdout.buffer.write(image.tobytes())
"""


def id_images(backend: str) -> bytes:
    environment = {**os.environ, "MODSIM3D_GL": backend}
    environment.pop("PYOPENGL_PLATFORM", None)
    done = subprocess.run([sys.executable, "-c", DRAWS], capture_output=True, env=environment, check=False)
    assert done.returncode == 0 and backend in done.stderr.decode(), done.stderr.decode()
    return done.stdout


def test_osmesa_and_egl_give_the_same_id_images():
    """With EGL alone where there is no OSMesa: Mesa 25.1 and later have none."""
    egl, *osmesa = (id_images(backend) for backend in ("egl", *(["osmesa"] if library_found("osmesa") else [])))
    assert len(egl) == 12 * 800 * 600 * 4 and len(np.unique(np.frombuffer(egl, dtype=np.uint32))) > 15
    assert all(image == egl for image in osmesa)


OPENS_AGAIN = """
import numpy as np
from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer, Region
corners = np.array([[[0.0, 0], [9, 0], [0, 9]]])
for _ in range(3):
    with open_context() as context:
        assert IdRenderer(context).draw(corners, np.ones((1, 3)), np.array([5]), Region(0, 0, 4, 4)).max() == 5
"""


def test_context_can_be_opened_again_after_it_was_closed():
    assert subprocess.run([sys.executable, "-c", OPENS_AGAIN], check=False).returncode == 0


def test_depth_beyond_the_edge_of_a_triangle_is_that_of_its_nearest_corner(renderer):
    """Rounded corners reach a pixel centre 1/2000 px beside a triangle that is seen almost edge-on."""
    thin = [[10.5005, 5.0], [10.5030, 5.0], [10.5005, 25.0]]
    corners = np.array([thin, [[0.0, 0.0], [80.0, 0.0], [0.0, 80.0]]])
    depths = np.array([[0.2, 0.3, 0.2], [0.19, 0.19, 0.19]])  # at the centre, the plane of the first is at 0.18
    image = renderer.draw(corners, depths, np.array([1, 2]), Region(0, 0, 40, 40))
    assert (image == 1).sum() > 5


@pytest.mark.parametrize("region", [WHOLE, Region(37, 11, 50, 40)])
def test_of_triangles_in_one_plane_the_first_is_in_front(renderer, region):
    rng = np.random.default_rng(4)
    corners = rng.uniform(-100, 700, (12, 3, 2))
    depths = 0.1 + corners @ [2e-4, 3e-4] + 1e-12 * rng.uniform(-1, 1, (12, 3))
    shown = renderer.draw(corners, depths, np.arange(1, 13), region)
    first = np.zeros_like(shown)
    for i in reversed(range(12)):
        first[renderer.draw(corners[i : i + 1], depths[i : i + 1], np.ones(1, dtype=int), region) > 0] = i + 1
    np.testing.assert_array_equal(shown, first)


@pytest.mark.parametrize("seed", range(4))
def test_ids_differ_from_the_renderers_only_on_edges(renderer, seed):
    outlines = outlines_of(random_places(np.random.default_rng(seed), 12, far_m=400.0))
    triangles = triangles_of(outlines, INTRINSICS)
    arguments = (triangles.corners_px, triangles.inverse_depth, outlines.occluder[triangles.row] + 1)
    region = Region(100, 50, 600, 500)
    drawn, plain = (drawer.draw(*arguments, region) for drawer in (renderer, PlainIds()))
    rows, columns = np.nonzero(drawn != plain)
    assert (drawn > 0).any() and len(rows) < 1e-3 * drawn.size
    edges = [LineString(c[[i, i - 1]]) for c in triangles.corners_px for i in range(3)]
    for x, y in zip(columns + region.x + 0.5, rows + region.y + 0.5, strict=True):
        assert distance(edges, points(x, y)).min() < 1 / 64


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
    script = f"from tests.render.test_id_pass import write_seg_images; write_seg_images({str(file)!r})"
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
