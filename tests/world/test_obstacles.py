"""Obstacles hide vessels, get no box and are named; the basin of Simulations 2 and 3, whose agents never touch."""

import gzip
import json
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from modsim3d.core.errors import InputError
from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion_order import order_of
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from modsim3d.verify.sources.compare import compare_sources
from modsim3d.world.bodies import Obstacle, extruded
from modsim3d.world.poses.agents import AgentsKeys, drive_agents
from modsim3d.world.vessels import Vessel
from tests.scenes import INTRINSICS, outlines_of, pixel_masks, random_scene, rectangles, vessel, write_scene
from tests.truth.test_regions_against_full import assert_same

SQUARE = [[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]]


def random_polygon(rng, centre, radius):
    """A star-shaped polygon of 3 to 12 corners, as often convex as not."""
    corners = int(rng.integers(3, 13))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) / corners
    reach = radius * rng.uniform(0.2, 1.0, corners)
    polygon = np.asarray(centre) + reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if rng.random() < 0.5:
        polygon = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(polygon)))[:-1]
    return polygon


def random_harbour(seed):
    """Vessels and obstacles that don't touch, before a camera of any kind."""
    rng = np.random.default_rng(seed)
    places, intrinsics, mount = random_scene(rng)
    hulls = [shapely.Point(place).buffer(np.hypot(ship.length_m, ship.beam_m) / 2) for ship, place, _ in places]
    obstacles, taken = [], shapely.union_all(hulls)
    for i in range(60):
        distance, bearing = np.exp(rng.uniform(np.log(5), np.log(300))), rng.uniform(-np.pi, np.pi)
        centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
        polygon = random_polygon(rng, centre, distance * rng.uniform(0.05, 0.6))
        shape = shapely.Polygon(polygon)
        if shape.is_valid and not shape.intersects(taken) and shape.distance(shapely.Point(0, 0)) > 0.5:
            taken = taken.union(shape)
            base = float(rng.choice([0.0, rng.uniform(0, 20)]))
            obstacles.append(Obstacle(f"o{i}", extruded(polygon, base, float(rng.uniform(0.5, 30)))))
    return places, obstacles, intrinsics, mount


@pytest.mark.parametrize("seed", range(24))
def test_pixels_and_geometry_agree_behind_obstacles(renderer, seed):
    places, obstacles, intrinsics, mount = random_harbour(seed)
    outlines = outlines_of(places, intrinsics, mount, obstacles)
    rendered = rendered_occlusion(outlines, intrinsics, renderer)
    masks = lambda row: pixel_masks(outlines, intrinsics, renderer, row)  # noqa: E731
    found = compare_with_analytic(outlines, intrinsics, rendered, masks)
    assert len(found.full) == outlines.boxed.sum()
    assert (found.worst < Agreement.INTERSECTING).all()
    exact = analytic_occlusion(outlines, intrinsics)
    for row in np.flatnonzero(outlines.boxed):
        drawn, cut = dict(rendered.occluders[row]), dict(exact.occluders[row])
        for occluder in drawn.keys() | cut.keys():
            # Of a part with perimeter p, pixels differ from the area by less than a few times p.
            area = cut.get(occluder, 0.0)
            assert abs(drawn.get(occluder, 0.0) - area) < 40 + 20 * np.sqrt(area) + 0.05 * area


@pytest.mark.parametrize(("seed", "supersample"), [*((seed, 1) for seed in range(40, 56)), (5063, 3), (5069, 3)])
def test_drawing_regions_gives_the_truth_of_drawing_everything(renderer, seed, supersample):
    places, obstacles, intrinsics, mount = random_harbour(seed)
    outlines = outlines_of(places, intrinsics, mount, obstacles)
    boxed, scene = np.flatnonzero(outlines.boxed), (outlines, intrinsics, renderer, supersample)
    assert_same(*(draw(*scene).take(boxed) for draw in (rendered_occlusion, full_frame_occlusion)))


def test_prisms_fill_their_polygon_a_vessel_is_seen_below_a_bridge_and_overlaps_count_once(renderer):
    star = np.array([[0, 0], [10, 1], [12, 9], [6, 4], [1, 8]], dtype=float)
    for ring in (star, star[::-1]):
        solids = extruded(ring, 2.0, 3.0)
        footprints = [shapely.convex_hull(shapely.multipoints(vertices[:, :2])) for _, vertices in solids]
        together = shapely.union_all(footprints, grid_size=1e-9)
        assert shapely.symmetric_difference(together, shapely.Polygon(star)).area < 1e-6
        assert sum(shapely.area(footprints)) == pytest.approx(shapely.Polygon(star).area)
        for solid, vertices in solids:
            assert {vertices[:, 2].min(), vertices[:, 2].max()} == {2.0, 5.0}
            a, b, c = np.moveaxis(vertices[solid.faces], 1, 0)
            volume = np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6  # positive: faces run outwards
            assert volume == pytest.approx(3.0 * shapely.convex_hull(shapely.multipoints(vertices[:, :2])).area)
    ship = vessel("ship", 10, 10, 30)  # as wide as the pillars are apart; 30 m high
    bridge = Obstacle("bridge", extruded(np.array([[90, -200], [95, -200], [95, 200], [90, 200.0]]), 15, 5))
    outlines = outlines_of([(ship, (120.0, 0.0), 0.0)], obstacles=[bridge])
    seen = rendered_occlusion(outlines, INTRINSICS, renderer).take(np.flatnonzero(outlines.boxed))
    assert 0 < seen.visible_px[0] < seen.silhouette_px[0]
    assert seen.occluders == (((1, seen.silhouette_px[0] - seen.visible_px[0]),),)
    # The deck hides a stripe: above and below it the ship is seen, so its visible box is its full box.
    np.testing.assert_array_equal(seen.visible_boxes_px, seen.full_boxes_px)
    quay, pier = [[80, -15], [90, -15], [90, 5], [80, 5.0]], [[85, -5], [95, -5], [95, 15], [85, 15.0]]
    quays = [Obstacle(name, extruded(np.array(at), 0, 6)) for name, at in (("quay", quay), ("pier", pier))]
    outlines = outlines_of([(vessel("ship", 10, 40, 12), (120.0, 0.0), 0.0)], obstacles=quays)
    seen = analytic_occlusion(outlines, INTRINSICS).take(np.flatnonzero(outlines.boxed))
    hidden = dict(seen.occluders[0])
    assert hidden.keys() == {1, 2}
    assert sum(hidden.values()) == pytest.approx(seen.silhouette_px[0] - seen.visible_px[0])


def test_coast_of_many_corners_is_put_in_order_with_vessels_and_not_with_itself(renderer):
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    reach = 30 + 5 * np.cos(40 * angles)
    coast = np.array([150, 0]) + reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    island = Obstacle("island", extruded(coast, 0, 8))
    assert len(island.solids) > 300
    outlines = outlines_of([(vessel("ship", 100, 15, 20), (220.0, 30.0), 1.5)], obstacles=[island])
    order = order_of(outlines)
    assert outlines.boxed[np.stack([order.first, order.second])].any(axis=0).all()
    both = analytic_occlusion(outlines, INTRINSICS), rendered_occlusion(outlines, INTRINSICS, renderer)
    exact, drawn = (truth.take(np.flatnonzero(outlines.boxed)) for truth in both)
    assert 0.1 < drawn.visible_px[0] / drawn.silhouette_px[0] < 0.9
    ((hider, px),) = exact.occluders[0]
    assert (hider, px) == (1, pytest.approx(exact.silhouette_px[0] - exact.visible_px[0]))
    assert px == pytest.approx(drawn.occluders[0][0][1], rel=0.02)


def scene_with(folder, obstacles):
    boats = {"boat": ([10, 4, 3], [[0, 200, -20], [10, 200, 20]])}
    return load_scene(write_scene(folder, boats, 6, obstacles=obstacles))


def test_a_hidden_vessel_names_the_obstacle_and_a_wrong_obstacle_is_one_clear_error(tmp_path):
    wall = {"polygon_m": [[100, -50], [110, -50], [110, 50], [100, 50]], "height_m": 40}
    scene = scene_with(tmp_path, {"quay": wall})
    rendered, analytic, ruled = (
        next(simulate_frames(replace(scene, annotation=replace(scene.annotation, source=source)))).truth
        for source in ("rendered", "analytic", "rectangles")
    )
    assert (rendered.vessels, rendered.visible_px.tolist()) == (("boat",), [0])
    assert list(rendered.occluded_by[0]) == list(analytic.occluded_by[0]) == ["obstacle:quay"]
    assert ruled.visible_fraction.tolist() == [1.0]  # the thesis's rule knows of vessels only
    for keys, said in (
        ({"height_m": 3}, "give either polygon_m with height_m, or mesh with size_m"),
        ({"polygon_m": SQUARE}, "height_m: missing"),
        ({"polygon_m": SQUARE[:2], "height_m": 3}, r"a polygon needs three corners or more \(got 2\)"),
        ({"polygon_m": [SQUARE[i] for i in (0, 2, 1, 3)], "height_m": 3}, "must not cross"),
        ({"polygon_m": [[0, 50], [1, 50], [2, 50]], "height_m": 3}, "must not cross or lie on each other"),
        ({"polygon_m": SQUARE, "height_m": 0}, "must be above 0"),
        ({"polygon_m": SQUARE, "height_m": 3, "heading_rad": 1}, "heading_rad: not for a polygon"),
    ):
        with pytest.raises(InputError, match=rf"obstacles\.quay.*{said}"):
            scene_with(tmp_path, {"quay": keys})
    with pytest.raises(InputError, match=r"cameras\.C0: is inside obstacle 'quay' at time 0\.0 s"):
        scene_with(tmp_path, {"quay": {"polygon_m": SQUARE, "height_m": 12}})
    scene_with(tmp_path, {"quay": {"polygon_m": SQUARE, "height_m": 9.9}})  # the camera is on top


ROOT = Path(__file__).resolve().parents[2]
BASIN = data_folder("scenes") / "basin"


@pytest.fixture(scope="module")
def scene():
    return load_scene("simulation_2")


def hulls_of(poses):
    return rectangles(poses.positions_m[..., :2], poses.headings_rad, (8.0, 4.0))


def closest_m(hulls):
    first, second = np.triu_indices(hulls.shape[1], 1)
    return shapely.distance(hulls[:, first], hulls[:, second]).min()


def test_the_basin_is_what_its_agents_drive_who_never_touch_in_a_crowd_either(scene):
    hulls = hulls_of(scene.poses.poses(0, scene.steps))
    assert hulls.shape == (5000, 6)
    assert closest_m(hulls) > 0.5
    assert shapely.within(hulls, shapely.box(0, 0, 150, 70)).all()
    poses = scene.poses.poses(0, scene.steps)
    step = np.diff(poses.positions_m[..., :2], axis=0)
    assert (np.linalg.norm(step, axis=-1).sum(axis=0) > 400).all()  # in 500 s
    assert (np.abs(np.diff(poses.headings_rad, axis=0)).sum(axis=0) > 4 * np.pi).all()
    ahead = np.stack([np.cos(poses.headings_rad), np.sin(poses.headings_rad)], -1)[:-1]
    assert ((step * ahead).sum(-1) > -0.01).all()  # never astern
    make = SimpleNamespace(**runpy.run_path(str(ROOT / "script" / "make_basin")))
    driven = drive_agents(make.VESSELS, 200, make.TIME_STEP_S, make.BASIN, make.SEED).recorded
    shipped = scene.poses.poses(0, 200)
    np.testing.assert_allclose(shipped.positions_m, driven.positions_m, atol=6e-4)
    np.testing.assert_allclose(shipped.headings_rad, driven.headings_rad, atol=6e-6)
    boats = [Vessel(f"v{i}", "Vessel", 8, 4, 1) for i in range(30)]
    keys = AgentsKeys(size_m=(80, 50))
    paths = [drive_agents(boats[:3], 30, 0.1, keys, seed).recorded.positions_m for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert (paths[0] != paths[2]).any()
    assert closest_m(hulls_of(drive_agents(boats[:7], 150, 0.1, AgentsKeys(size_m=(60, 40)), 4).recorded)) > 0
    with pytest.raises(InputError, match="no free place for vessel"):
        drive_agents(boats, 1, 0.1, AgentsKeys(size_m=(20, 20)), 0)


def test_simulations_2_and_3_follow_their_tables_and_files_and_cameras_share_a_vessel_that_rolls(scene):
    assert (scene.steps, scene.timestamps(0, 3)) == (5000, ("0.0", "0.1", "0.2"))
    (camera,) = scene.cameras
    np.testing.assert_allclose(camera.intrinsics.focal_px, (2370, 0.0237 / 0.83e-5))
    assert (camera.mount.vessel, camera.mount.position_m) == ("vehicle1", (4, 0, 1))
    assert camera.mount.pitch_rad == pytest.approx(np.pi / 200)
    poses = json.loads(gzip.decompress((BASIN / "poses.json.gz").read_bytes()))
    assert list(poses)[:2] == ["0.0", "0.1"]
    assert set(poses["0.0"]) == {f"vehicle{i}" for i in range(1, 7)}
    assert set(poses["0.0"]["vehicle1"]) == {"center_position_m", "heading_rad"}
    assert (BASIN / "poses.json.gz").stat().st_size < 1_000_000
    scene, steps = load_scene("simulation_3", steps=300), np.arange(0, 300, 7)
    left, right = scene.cameras
    assert left.mount.vessel == right.mount.vessel == "vehicle1"
    assert left.mount.yaw_rad == -right.mount.yaw_rad == pytest.approx(np.pi / 8)
    half_view = np.degrees(np.arctan(1232 / left.intrinsics.focal_px[0]))
    assert (2 * half_view, 2 * (half_view - 22.5)) == pytest.approx((55, 10), abs=0.1)
    port, starboard = (scene.sight(camera, steps).camera_poses for camera in scene.cameras)
    between = port.camera_R_world @ np.swapaxes(starboard.camera_R_world, 1, 2)
    np.testing.assert_allclose(between, np.broadcast_to(between[0], between.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(port.positions_m - starboard.positions_m, axis=1), 4.0)


@pytest.mark.parametrize("name", ["simulation_2", "simulation_3"])
def test_rendered_and_analytic_truth_agree_in_the_basin(renderer, name):
    figures = compare_sources(load_scene(name, steps=1500, mode=2), renderer, every=15).figures
    assert figures.vessel_frames > 50 and figures.occluded > 0 and figures.unexplained == 0


def test_waves_of_all_vessels_turn_their_boxes():
    turned = []
    for apply_to in ("ownship", "all"):
        scene = load_scene("simulation_2", steps=300, settings={"waves.level": "huge", "waves.apply_to": apply_to})
        turned.append(scene.sight(scene.cameras[0], np.array([100, 200])).world_R_vessel)
    assert (turned[0][:, 0, 2, :2] != 0).all()  # own ship, in anybody's picture
    assert (turned[0][:, 1:, 2, :2] == 0).all()  # upright
    assert (turned[1][..., 2, :2] != 0).all()
