"""Silhouettes as closed lines, the order in which they are painted, and who is at each pixel of a page."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

from modsim3d import Window, load_scene, open_run, run_scene
from modsim3d.geometry.camera import Distortion
from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.io.input_files import data_folder
from modsim3d.truth.outlines import Outlines, outline
from modsim3d.truth.silhouettes import in_image, silhouette_polygons
from modsim3d.view import palette
from modsim3d.view.pictures.plain import Solids, open_id_renderer
from modsim3d.view.report.overview import PartMotion
from modsim3d.view.report.report import REPORT_FILE, write_report
from modsim3d.view.report.silhouette_edges import contours, silhouette_edges, tidy_at_border
from modsim3d.view.report.silhouettes import OutlineStore, Shapes, in_front, outline_numbers, painting_order, shapes
from modsim3d.world.bodies import vessel_bodies
from modsim3d.world.vessels import Solid
from tests.scenes import INTRINSICS, outlines_of, random_places, vessel

NONE = np.empty(0, dtype=np.int64)
PLACES = st.integers(0, 12)
TRIANGLE = st.lists(st.tuples(PLACES, PLACES), min_size=3, max_size=3)


def twice_area(corners):
    (ax, ay), (bx, by), (cx, cy) = corners
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def edges_of(triangles):
    """Edges from corner to corner, shape (3T, 2, 2)."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2, 2)


def windings(ends_px, points):
    """How often directed edges (e, 2, 2) wind around each point (n, 2), by crossings of a ray to the right."""
    (x0, y0), (x1, y1) = ends_px[:, 0].T, ends_px[:, 1].T
    x, y = points[:, None, 0], points[:, None, 1]
    upwards, downwards = (y0 <= y) & (y1 > y), (y1 <= y) & (y0 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = x0 + (y - y0) / (y1 - y0) * (x1 - x0) > x
    return ((upwards & right).astype(int) - (downwards & right)).sum(axis=1)


@given(st.lists(TRIANGLE, min_size=1, max_size=8), st.data())
@settings(max_examples=100)
def test_lines_wind_around_each_point_as_often_as_triangles_cover_it(triangles, data):
    oriented = [each if twice_area(each) > 0 else each[::-1] for each in triangles if twice_area(each)]
    edges = edges_of(np.array(oriented, dtype=np.int64).reshape(-1, 3, 2))
    of_edge = np.repeat(data.draw(st.lists(st.integers(0, 1), min_size=len(oriented), max_size=len(oriented))), 3)
    found = contours(of_edge.astype(np.int64), edges)
    assert np.all(np.diff(found.shape) >= 0)
    rings = np.split(found.corners, np.cumsum(found.count)[:-1])
    around = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])
    of_corner = np.repeat(found.shape, found.count)
    point = np.add([data.draw(st.tuples(PLACES, PLACES))], (0.3713, 0.6171))  # on no line between whole numbers
    for shape in (0, 1):
        assert windings(around[of_corner == shape], point) == windings(edges[of_edge == shape], point)


@pytest.mark.parametrize("seed", range(4))
def test_what_planes_say_of_who_is_in_front_holds_at_depths_that_do_not_overlap(monkeypatch, seed):
    outlines = outlines_of(random_places(np.random.default_rng(seed), 40))
    fast = set(zip(*(rows.tolist() for rows in in_front(outlines, 40, NONE)), strict=True))
    (depths_m,) = (part.vertices_camera[..., 2] for part in outlines.parts)
    everywhere = np.zeros(len(outlines)), np.full(len(outlines), np.inf)
    monkeypatch.setattr(Outlines, "depths_m", lambda outlines: everywhere)
    slow = set(zip(*(rows.tolist() for rows in in_front(outlines, 40, NONE)), strict=True))
    assert len(slow) > 10 and slow <= fast
    assert all(depths_m[hider].max() <= depths_m[hidden].min() for hidden, hider in fast - slow)


def drawn_shapes(*drawn: tuple[int, list[list[tuple[int, int]]]]) -> Shapes:
    """Shapes as (occluder, lines), each in a frame of its own."""
    lines, owners = [line for _, some in drawn for line in some], np.array([occluder for occluder, _ in drawn])
    lines_of, corners_of = np.array([len(some) for _, some in drawn]), np.array([len(line) for line in lines])
    corners = np.array([corner for line in lines for corner in line], dtype=np.uint16)
    return Shapes(np.arange(len(drawn)), owners, lines_of, corners_of, corners)


def test_nearer_shapes_come_later_truth_decides_where_solids_meet_and_frames_stay_apart():
    near, far = (vessel("near"), (60.0, 0.0), 0.3), (vessel("far", 40.0), (120.0, 5.0), 0.3)
    drawn = shapes(outlines_of([near, far]), INTRINSICS, 0.1, 2, NONE)
    assert (drawn.occluder.tolist(), drawn.lines.tolist()) == ([1, 0], [1, 1])
    assert all(4 <= count <= 6 for count in drawn.count)
    # A boat before the stern of a long ship, whose centre is nearer.
    outlines = outlines_of([(vessel("ship", 300.0, 30.0), (300.0, 0.0), 1.2), (vessel("boat"), (305.0, 82.4), 0.0)])
    assert outlines.depth_m[0] < outlines.depth_m[1]
    assert [rows.tolist() for rows in in_front(outlines, 2, NONE)] == [[0], [1]]
    both = [(vessel("a", 20.0), (60.0, 0.0), 0.0), (vessel("b", 20.0), (61.0, 1.0), 0.7)]
    first_behind, second_behind = 0 * 2 + 1, 1 * 2 + 0  # keys: hidden * vessels + hider
    for truth, pairs in (
        ([], [[], []]),
        ([first_behind], [[0], [1]]),
        ([second_behind], [[1], [0]]),
        ([first_behind, second_behind], [[], []]),
    ):
        found = in_front(outlines_of(both), 2, np.array(truth, dtype=np.int64))
        assert [part.tolist() for part in found] == pairs
    # At each of three steps one vessel, in another place.
    vessels = [vessel("a"), vessel("b")]
    positions = np.array([[[60.0, 0, 0], [80, 0, 0]], [[70, 5, 0], [90, 5, 0]], [[80, -9, 0], [60, -9, 0]]])
    present = np.array([[True, False], [True, True], [False, True]])
    bodies = vessel_bodies(vessels, present, positions, world_R_vehicle(np.zeros((3, 2))))
    outlines = outline(INTRINSICS, poses_ashore(Mount((0.0, 0.0, 10.0)), 3), bodies)
    drawn = shapes(outlines, INTRINSICS, 0.1, 2, NONE)
    assert list(zip(drawn.frame, drawn.occluder, strict=True)) == [(0, 0), (1, 1), (1, 0), (2, 1)]


@given(st.randoms(use_true_random=False), st.integers(1, 12))
@settings(max_examples=60)
def test_whoever_hides_another_is_painted_after_it(random, count):
    front_to_back = list(range(count))
    random.shuffle(front_to_back)
    pairs = [(back, front) for i, front in enumerate(front_to_back) for back in front_to_back[i + 1 :]]
    chosen = random.sample(pairs, k=len(pairs) // 2)
    depths = np.array([random.uniform(1, 100) for _ in range(count)])  # of the centres, which may mislead
    occluders = np.array([random.randrange(4) for _ in range(count)])
    hidden, hider = np.array(chosen, dtype=np.int64).reshape(-1, 2).T
    order = painting_order(np.zeros(count, dtype=np.int64), depths, occluders, hidden, hider)
    assert sorted(order) == list(range(count))
    place = np.argsort(order)
    assert np.all(place[hidden] < place[hider])


def test_farther_ones_are_painted_first_pieces_of_one_occluder_together_and_a_ring_once_each():
    """Where nobody hides anybody; frames stay in order."""
    frame, depth_m, occluder = np.array([0, 0, 0, 2, 2]), np.array([5.0, 9.0, 7.0, 1.0, 2.0]), np.arange(5)
    np.testing.assert_array_equal(painting_order(frame, depth_m, occluder, NONE, NONE), [1, 2, 0, 4, 3])
    frame, depth_m, occluder = np.zeros(4, dtype=np.int64), np.array([9.0, 7.0, 5.0, 3.0]), np.array([1, 0, 1, 0])
    assert occluder[painting_order(frame, depth_m, occluder, NONE, NONE)].tolist() == [1, 1, 0, 0]
    between = painting_order(frame, depth_m, occluder, np.array([0, 1]), np.array([1, 2]))
    assert occluder[between].tolist() in ([1, 0, 1, 0], [1, 0, 0, 1])
    place = np.argsort(between)
    assert place[0] < place[1] < place[2]
    ring = np.array([0, 1, 2])  # of vessels that hide each other
    assert sorted(painting_order(0 * ring, np.array([3.0, 2.0, 1.0]), ring, ring, np.roll(ring, 1))) == [0, 1, 2]


STEPS = np.array([0, 190])
POINTS, CLEAR_PX = 300, 0.3


@pytest.fixture(scope="module")
def strait():
    return load_scene("strait")


def torn(part):
    solid = part.solid
    return replace(part, solid=Solid(solid.vertices, solid.faces[len(solid.faces) // 3 :], convex=False, closed=False))


# The camera, where it begins to see (160 m and 60 m cut vessels that are seen), its lens, and whether meshes are torn.
CASES = [(0, 0.1, None, False), (0, 160.0, None, False), (0, 160.0, None, True)]
CASES += [(1, 60.0, Distortion(k1=-0.12, k2=0.03), False)]


@pytest.mark.parametrize("camera, near_clip_m, lens, is_torn", CASES)
def test_edges_wind_around_what_the_faces_cover_and_around_nothing_else(strait, camera, near_clip_m, lens, is_torn):
    before = strait.cameras[camera]
    intrinsics = replace(before.intrinsics, near_clip_m=near_clip_m, distortion=lens)
    outlines = strait.sight(replace(before, intrinsics=intrinsics), STEPS).outlines(measured=False)
    if is_torn:
        outlines = replace(outlines, parts=tuple(torn(part) for part in outlines.parts))
    edges = silhouette_edges(outlines, intrinsics)
    boxes_px = edges.boxes_px(len(outlines))
    size, rng, cuts = np.array(intrinsics.image_size_px), np.random.default_rng(0), []
    assert edges.ends_px.min() >= 0 and np.all(edges.ends_px <= size)
    for part in outlines.parts:
        crosses = outlines.crosses_near[part.rows]
        whole = silhouette_polygons(intrinsics.pinhole, part.vertices_camera, part.vertices_px, crosses, part.solid)
        for row, covered in zip(part.rows, in_image(whole, intrinsics), strict=True):
            if covered.area < 20:
                continue
            low, high = np.array(covered.bounds).reshape(2, 2)
            assert np.all(boxes_px[row, :2] < low + CLEAR_PX) and np.all(boxes_px[row, 2:] > high - CLEAR_PX)
            if np.all(low > 0) and np.all(high < size):
                np.testing.assert_allclose(boxes_px[row], covered.bounds, atol=CLEAR_PX)
            points = rng.uniform(np.maximum(low - 5, 0), np.minimum(high + 5, size), (POINTS, 2))
            clear = shapely.distance(covered.boundary, shapely.points(points)) > CLEAR_PX
            found = windings(edges.ends_px[edges.row == row], points)
            assert len(set(np.sign(found)) - {0}) == 1
            np.testing.assert_array_equal((found != 0)[clear], shapely.contains_xy(covered, points)[clear])
            cuts.append(outlines.crosses_near[row])
    assert len(cuts) > 10 and any(cuts)


def test_shared_edges_have_one_line_ways_to_and_fro_none_and_what_stays_is_stored_once():
    triangles = np.array([[(0, 0), (4, 0), (4, 4)], [(0, 0), (4, 4), (0, 4)]])
    found, none = (contours(np.zeros(3 * n, dtype=np.int64), edges_of(triangles[:n])) for n in (2, 0))
    assert found.count.tolist() == [4]
    assert {tuple(corner) for corner in found.corners.tolist()} == {(0, 0), (4, 0), (4, 4), (0, 4)}
    assert len(none.shape) == len(none.count) == len(none.corners) == 0
    there = [[(0, 0), (4, 3)], [(4, 3), (0, 9)], [(0, 9), (0, 2)], [(0, 2), (0, 7)], [(0, 7), (0, 0)]]
    shape, ends = tidy_at_border(np.array([3] * 5), np.array(there), (20, 20))
    assert shape.tolist() == [3, 3, 3]
    edges = {tuple(map(tuple, edge)) for edge in ends.tolist()}
    assert edges == {((0, 0), (4, 3)), ((4, 3), (0, 9)), ((0, 9), (0, 0))}
    _, ends = tidy_at_border(np.array([0, 0]), np.array([[(5, 20), (9, 20)], [(9, 20), (5, 20)]]), (20, 20))
    assert len(ends) == 0
    square, moved = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 0), (5, 0), (5, 4), (1, 4)]
    split = [square[:3], [(9, 9), (8, 8), (7, 9)]]
    order = (0, [square]), (1, [square]), (0, [square]), (0, [moved]), (1, [square]), (1, split), (1, split)
    some = drawn_shapes(*order)
    number, new = outline_numbers(some, np.zeros(7, dtype=np.int64))
    assert number.tolist() == [0, 1, 0, 2, 1, 3, 3]
    assert new.tolist() == [True, True, False, True, False, True, False]
    other_camera = np.array([0, 0, 1, 1, 1, 1, 1])
    assert outline_numbers(some, other_camera)[1].tolist() == [True, True, True, True, True, True, False]
    store = OutlineStore()
    assert store.numbers(some).tolist() == [0, 0, 0, 1, 0, 2, 2]
    assert store.numbers(drawn_shapes((5, [moved]), (5, [moved, square]))).tolist() == [1, 3]
    assert len(store.shapes()) == 4


def test_poses_of_a_part_are_those_of_each_camera_on_its_own(strait):
    some, others = np.array([3, 5, 8]), np.array([4, 5])
    motion = PartMotion(strait, [some, others])
    for steps in (some, others):
        alone = strait.motion.at(steps)
        np.testing.assert_array_equal(motion.at(steps).world_R_vessel, alone.world_R_vessel)
        np.testing.assert_array_equal(motion.at(steps).poses.positions_m, alone.poses.positions_m)


DATA = Path(__file__).parents[2] / "data"
STRAIT_STEPS = 6
EDGE_PX = 5  # pixels are compared that have one owner around them so far: smooth edges have mixed colours


@pytest.fixture(scope="module")
def crowded_strait(tmp_path_factory):
    """The strait, with a bay around one vessel, a gate before another, and a lens that bends."""
    folder = tmp_path_factory.mktemp("strait")
    scene = yaml.safe_load((DATA / "crowded_strait.yaml").read_text(encoding="utf-8"))
    scene["steps"] = STRAIT_STEPS
    scene["poses"]["tracks"]["kayak"] = [[0, 100, -30], [150, 400, -30]]
    bay = [[60, -60], [140, -60], [140, -20], [125, -20], [125, -45], [75, -45], [75, -25], [60, -25]]
    scene["obstacles"]["bay"] = {"polygon_m": bay, "height_m": 2}
    arch = {"position_m": [230, 20, 0], "size_m": [40, 2, 25], "heading_rad": 0.7, "mesh": {"file": "gate.obj"}}
    torn = {"position_m": [200, -40, 0], "size_m": [30, 2, 18], "heading_rad": 1.9, "mesh": {"file": "torn.obj"}}
    scene["obstacles"] |= {"gate": arch, "torn": torn}
    scene["cameras"]["quay"]["distortion"] = {"k1": -0.12, "k2": 0.03}
    scene["detector"] = str(data_folder("scenes") / "detectors" / "thesis.yaml")
    (folder / "gate.obj").write_text(_gate(), encoding="utf-8")
    (folder / "torn.obj").write_text("\n".join(_gate().splitlines()[:-2]), encoding="utf-8")  # not watertight
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    run_scene(load_scene(str(folder / "scene.yaml")), folder / "run")
    run = open_run(folder / "run")
    write_report(run)
    return run


def _gate() -> str:
    """A frame with a hole in it, one metre of each side wide and deep."""
    outer, inner = [(-0.5, 0), (0.5, 0), (0.5, 1), (-0.5, 1)], [(-0.3, 0.2), (0.3, 0.2), (0.3, 0.7), (-0.3, 0.7)]
    lines = [f"v {x} {y} {z}" for y in (-0.5, 0.5) for x, z in outer + inner]
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        front, back = (1 + i, 1 + j, 5 + j, 5 + i), (9 + i, 13 + i, 13 + j, 9 + j)
        outside, inside = (1 + j, 1 + i, 9 + i, 9 + j), (5 + i, 5 + j, 13 + j, 13 + i)
        lines += ["f " + " ".join(map(str, face)) for face in (front, back, outside, inside)]
    return "\n".join(lines) + "\n"


def owners_buffer(scene, camera, step):
    """Owner + 1 at each pixel; zero where nothing is."""
    window = Window(0, 0, 1, scene.cameras[camera].intrinsics.image_size_px)
    with open_id_renderer(scene) as id_renderer:
        return Solids.at(scene, scene.cameras[camera], step).ids(window, id_renderer).astype(np.int64)


def page_picture(browser, camera, index):
    """What the page paints, as large as the camera's image, shape (rows, columns, 3)."""
    browser.run(f"""(() => {{
        const {{ recording }} = player, [width, height] = recording.facts.cameras[{camera}].size;
        const canvas = Object.assign(document.createElement('canvas'), {{ width, height, id: 'painted' }});
        const picture = new player.picture.constructor(canvas);
        Object.assign(picture, {{ ratio: 1, view: {{ x: 0, y: 0, width }} }});
        const frame = {{ shapes: recording.shapes({index}, {camera}), truths: [], detections: [] }};
        picture.draw(recording, {index}, {camera}, {{ silhouettes: true }}, frame);
        document.body.append(canvas);
    }})()""")
    return browser.pixels("painted")[..., :3]


@pytest.mark.parametrize(("camera", "step"), [(0, 1), (0, STRAIT_STEPS - 1), (1, STRAIT_STEPS - 1)])
def test_every_pixel_is_its_owners_as_in_the_id_buffer(browser, crowded_strait, camera, step):
    scene = crowded_strait.scene
    browser.open(crowded_strait.folder / REPORT_FILE)
    picture, ids = page_picture(browser, camera, step), owners_buffer(scene, camera, step)
    assert picture.shape[:2] == ids.shape
    vessels, obstacles = range(len(scene.vessels)), range(len(scene.obstacles))
    colours = [
        *(palette.darker(palette.vessel_colour(i, scene.own_ships)) for i in vessels),
        *(palette.obstacle_colour(i, scene.obstacles[i].name) for i in obstacles),
    ]
    inside = (ids > 0) & (minimum_filter(ids, EDGE_PX) == maximum_filter(ids, EDGE_PX))
    off = np.abs(picture[inside].astype(int) - np.array(colours)[ids[inside] - 1]).max(axis=1)
    # A mast that meets no pixel centre is not in the buffer, and dims a pixel of the page a little.
    assert np.mean(off > 8) < 1e-4
    # Where the buffer has nobody there is sea or sky.
    nobody = maximum_filter(ids, EDGE_PX) == 0
    sea_or_sky = np.all(picture == palette.SEA, axis=2) | np.all(picture == palette.SKY, axis=2)
    horizon = minimum_filter(sea_or_sky, EDGE_PX) | ~nobody
    assert np.mean(horizon | sea_or_sky) > 0.995 and len(np.unique(ids[inside])) > 5
    if (camera, step) == (0, 1):  # own bow, a vessel in a bay, and a hole with something behind it are there
        shown = {["", *scene.occluder_names][owner] for owner in np.unique(ids).tolist()}
        assert {"own", "obstacle:bay", "obstacle:gate", "obstacle:torn", "kayak", "ferry"} <= shown
