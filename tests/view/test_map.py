"""The scene from above, alone and in films: geometry first; what maps look like has been looked at."""

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from modsim3d import simulate_frames
from modsim3d.cli import main
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import Mount
from modsim3d.scene.reading import load_scene
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.view import palette
from modsim3d.view.films.renderer import MapFilmRenderer
from modsim3d.view.films.request import PictureRequest
from modsim3d.view.map_marks import RINGS, TRAIL_S, Bearing, BirdsEye, footprint, hull_m, ring_step, view_of
from modsim3d.view.map_picture import Map, map_figure, map_height_px, map_picture
from modsim3d.view.pictures.layers import MAP, PLAN, MapLayers
from modsim3d.view.pictures.plain import Solids
from modsim3d.view.plan_marks import VECTOR_S, _approach
from tests.scenes import INTRINSICS, crossing
from tests.view.test_film import view

ISLAND = [[150, 20], [190, 20], [190, 60], [170, 30], [150, 60]]
BRIDGE = [[240, -60], [244, -60], [244, 60], [240, 60]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    obstacles = {"island": {"polygon_m": ISLAND, "height_m": 12}}
    obstacles["bridge"] = {"polygon_m": BRIDGE, "base_m": 20, "height_m": 2}
    return load_scene(crossing(tmp_path_factory.mktemp("map"), obstacles=obstacles))


@pytest.fixture(scope="module")
def birds_eye(scene):
    return BirdsEye(scene, scene.steps, (0,))


def extent(artist):
    return shapely.box(*artist.get_window_extent().extents)


@pytest.mark.parametrize("step", [0, 9])
def test_a_vessel_is_drawn_where_it_is(birds_eye, step):
    figure = map_figure(birds_eye, step, 1000)
    figure.draw_without_rendering()
    places = birds_eye.scene.poses.poses(step, step + 1).positions_m[0, :, :2]
    picture = np.asarray(map_picture(birds_eye, step, (1000, map_height_px(birds_eye, 1000))))
    for index, (x, y) in enumerate(figure.axes[0].transData.transform(places)):
        around = picture[picture.shape[0] - round(y) - 8 : picture.shape[0] - round(y) + 8, round(x) - 8 : round(x) + 8]
        near = np.abs(around.astype(int) - palette.vessel_colour(index)).max(axis=-1) < 12
        assert near.sum() > 8, birds_eye.scene.vessel_names[index]


@pytest.mark.parametrize(("f1", "f2", "a1"), [(1000.0, 1000.0, 400.0), (700.0, 1000.0, 200.0), (100.0, 100.0, 400.0)])
def test_the_field_of_view_has_the_angle_of_the_intrinsics(scene, f1, f2, a1):
    """From the left edge to the principal point, arctan(a1 / f1), and on to the right one."""
    lens, width = replace(INTRINSICS, principal_point_px=(a1, 300.0), focal_px=(f1, f2)), INTRINSICS.image_size_px[0]
    camera = Camera("C", lens, Mount((30.0, 40.0, 5.0), yaw_rad=0.7))
    at, looks = view_of(replace(scene, cameras=(camera,)), camera, 0)
    np.testing.assert_allclose(at, [30, 40])
    bearings = np.unwrap(np.arctan2(looks[:, 1], looks[:, 0]))
    assert bearings[0] - bearings[-1] == pytest.approx(math.atan(a1 / f1) + math.atan((width - a1) / f1))
    assert bearings[0] == pytest.approx(0.7 + math.atan(a1 / f1))


@given(st.floats(0.01, 1e6))
def test_ring_steps_are_round_and_few(farthest_m):
    step = ring_step(farthest_m / RINGS)
    assert RINGS / 2.5 - 1e-6 < farthest_m / step <= RINGS + 1e-6
    mantissa = step / 10.0 ** math.floor(math.log10(step * (1 + 1e-9)))
    assert min(abs(mantissa - round_one) for round_one in (1, 2, 5, 10)) < 1e-6


def test_names_lie_on_no_other_vessel_or_name_inside_a_map_that_vessels_which_come_and_go_do_not_move():
    scene = load_scene("strait")
    birds_eye, maps = BirdsEye(scene, scene.steps, (0, 1)), []
    for step in (0, 60, 120):
        figure = map_figure(birds_eye, step, 1280)
        figure.draw_without_rendering()
        axes, rotations = figure.axes[0], scene.motion.at(np.array([step])).world_R_vessel[0]
        maps.append(extent(axes))
        assert not extent(figure.legends[0]).intersects(maps[-1])
        poses = scene.poses.poses(step, step + 1)
        hulls = {
            vessel.name: shapely.Polygon(axes.transData.transform(hull_m(vessel, rotations[i]) + place))
            for i, (vessel, place) in enumerate(zip(scene.vessels, poses.positions_m[0, :, :2], strict=True))
            if poses.present[0, i]
        }
        known = {*hulls, *(obstacle.name for obstacle in scene.obstacles)}
        names = {text.get_text(): extent(text) for text in axes.texts if text.get_visible()}
        names = {text: box for text, box in names.items() if text in known}
        assert names.keys() > hulls.keys() and all(maps[-1].contains(names[name]) for name in hulls)
        assert all(one.intersection(other).area == 0 for one, other in combinations(names.values(), 2))
        for of, box in names.items():
            assert not any(hull.intersects(box) for name, hull in hulls.items() if name != of), (step, of)
    assert maps == maps[:1] * 3


@pytest.fixture(scope="module")
def crowd():
    """A map of fifty vessels, of which many lie side by side."""
    scene = load_scene("benchmarks/dense.yaml", steps=60)
    drawn = Map(BirdsEye(scene, scene.steps, (0,)), 1280)
    drawn.show(59)
    return drawn


def test_each_vessel_of_a_crowd_is_named_beside_it_or_with_a_line_to_it_and_the_key_explains_headings(crowd):
    sheet, dpi = crowd.sheet, crowd.figure.dpi
    names = [name for name in sheet.names.names if name.vessel is not None and name.middle_px is not None]
    assert len(names) >= 0.98 * len(sheet.birds_eye.scene.vessels)
    bodies = {i: shapely.Polygon(sheet.axes.transData.transform(ring)) for i, ring in sheet.names.bodies_m.items()}
    boxes, ended = {name.vessel: extent(name.note) for name in names}, set()
    for line in (shapely.LineString(line * dpi / 72) for line in sheet.names.leaders.get_segments()):
        (vessel,) = (i for i, box in boxes.items() if box.distance(shapely.Point(line.coords[0])) < 0.1)
        assert bodies[vessel].distance(shapely.Point(line.coords[-1])) < 0.1
        assert not any(box.intersects(line) for i, box in boxes.items() if i != vessel)
        ended.add(vessel)
    assert ended
    for vessel, box in boxes.items():
        assert vessel in ended or box.distance(bodies[vessel]) < box.length / 4
        assert not any(box.intersects(body) for i, body in bodies.items() if i != vessel)
        assert not any(box.intersection(other).area for i, other in boxes.items() if i != vessel)
    said = {text.get_text() for text in crowd.figure.legends[0].get_texts()}
    assert {"vessel at its size, with a tick ahead", "small vessel, with its heading"} <= said


def test_no_name_lies_on_a_camera_and_what_is_far_does_not_make_the_map_larger(scene):
    (camera,) = scene.cameras
    drawn = Map(BirdsEye(scene, scene.steps, (0,)), 900)
    drawn.show(6)
    place_m = drawn.sheet.axes.transData.inverted().transform
    for name in [name for name in drawn.sheet.names.names if name.vessel is not None and name.middle_px is not None]:
        under = replace(camera, name="under", mount=Mount((*place_m(name.middle_px).tolist(), 5.0)))
        both = Map(BirdsEye(replace(scene, cameras=(camera, under)), scene.steps, (0, 1)), 900)
        both.show(6)
        dot = shapely.Point(both.sheet.axes.transData.transform(under.mount.position_m[:2]))
        notes = [each.note for each in both.sheet.names.names if each.middle_px is not None]
        boxes = {note.get_text(): extent(note) for note in notes}
        assert {"under", name.note.get_text()} <= set(boxes)
        assert not any(box.intersects(dot) for box in boxes.values())
    usual = BirdsEye(scene, scene.steps, (0,)).extent_m
    assert usual[0] < 0 < usual[1] and usual[2] < -60 and usual[3] > 60  # the camera ashore, and the bridge
    (camera,), (island, _) = scene.cameras, scene.obstacles
    far = replace(camera, mount=Mount((-9000.0, 0.0, 50.0)))
    coast = replace(island, solids=tuple((solid, 200 * vertices) for solid, vertices in island.solids))
    birds_eye = BirdsEye(replace(scene, cameras=(far,), obstacles=(coast,)), scene.steps, (0,))
    x0, x1, y0, y1 = birds_eye.extent_m
    assert x1 - x0 < 1.2 * (usual[1] - usual[0])
    tracks = birds_eye.tracks_m[np.isfinite(birds_eye.tracks_m).all(axis=-1)]
    assert ((tracks > (x0, y0)) & (tracks < (x1, y1))).all()
    drawn = Map(birds_eye, 800)
    drawn.show(3)
    (name,) = (name for name in drawn.sheet.names.names if name.note.get_text().startswith(far.name))
    assert name.note.get_text() == f"{far.name}, {x0 + 9000:.0f} m away" and name.middle_px is not None
    near = replace(camera, mount=Mount((-1500.0, 0.0, 50.0)))
    assert BirdsEye(replace(scene, cameras=(near,)), scene.steps, (0,)).extent_m[0] < -1500


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_map_is_written_as_its_ending_says_the_same_bytes_each_time(monkeypatch, run, tmp_path, ending):
    files = [tmp_path / f"{name}.{ending}" for name in ("a", "b")]
    for file in files:
        assert view(monkeypatch, "map", run, 6, "--out", file, "--width", 640) == 0
    assert sorted(tmp_path.iterdir()) == files and files[0].read_bytes() == files[1].read_bytes()
    if ending == "png":
        assert read(files[0]).width == 640
    elif ending == "svg":
        assert ET.parse(files[0]).getroot().tag.endswith("svg")
    else:
        assert files[0].read_bytes().startswith(b"%PDF")


def test_maps_are_imported_without_matplotlib_and_the_extra_is_named(monkeypatch, call, run, tmp_path):
    monkeypatch.chdir(tmp_path)
    script = "import sys\nsys.modules['matplotlib'] = None\nimport modsim3d.view.map_picture"
    subprocess.run([sys.executable, "-c", script], check=True)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for command, *options in (("map", "--out", "m.png"), ("film", "--kind", "map", "--out", "m.gif")):
        status, said = call("view", command, run, *options)
        assert status == main.BAD_INPUT and "pip install 'modsim3d[view]'" in said


def read(path):
    with Image.open(path) as written:
        return written.convert("RGB")


def picture(monkeypatch, run, out, *arguments):
    assert view(monkeypatch, "frame", run, "5", "--width", 400, "--crop", "none", "--out", out, *arguments) == 0
    return np.asarray(read(out)).astype(int)


def test_without_opengl_scenes_are_plain_and_shaded_ones_refused(monkeypatch, capsys, run, tmp_path):
    monkeypatch.setattr("modsim3d.render.context._open_here", None)  # another test's context must not serve here
    monkeypatch.setattr("modsim3d.render.context.library_found", lambda backend: False)
    plain = picture(monkeypatch, run, tmp_path / "a.png", "--kind", "scene")
    assert tuple(plain[40, 390]) == palette.SKY
    options = ("--kind", "scene", "--look", "shaded", "--out", tmp_path / "b.mp4")
    assert view(monkeypatch, "film", run, *options) == main.BAD_INPUT
    said = capsys.readouterr().err
    assert "libosmesa6" in said and "--look plain" in said


@pytest.fixture(scope="module", params=["simulation_1", "strait", "simulation_2"])
def filmed(request):
    """A camera ashore, one of two on board, and all on board."""
    scene = load_scene(request.param, steps=120)
    return BirdsEye(scene, 120, tuple(range(len(scene.cameras))), PLAN)


def test_a_frame_is_the_map_drawn_whole(filmed):
    size = 800, map_height_px(filmed, 800)
    film = MapFilmRenderer(filmed, size)
    frames = [np.asarray(film.picture(step)) for step in (119, 0)]
    for step, frame in zip((119, 0), frames, strict=True):
        np.testing.assert_array_equal(frame, np.asarray(map_picture(filmed, step, size)))
    assert (frames[0] != frames[1]).any()


def test_circles_are_whole_and_a_closest_approach_is_that_of_straight_courses():
    birds_eye = BirdsEye(load_scene("simulation_1", steps=5), 5, (0,))
    circles, tracks = birds_eye.circles_m, birds_eye.tracks_m
    assert len(circles) == 5
    for circle, track in zip(circles, np.moveaxis(tracks, 1, 0), strict=True):
        radius = np.linalg.norm(circle - (1000, 1000), axis=1)
        np.testing.assert_allclose(np.linalg.norm(track - (1000, 1000), axis=1), radius[0])
        np.testing.assert_allclose(radius, radius[0])
    here, velocities = np.array([[0.0, 0.0], [1000.0, 60.0]]), np.array([[5.0, 0.0], [-5.0, 0.0]])
    distance_m, after_s, then = _approach(here, velocities)
    assert (distance_m, after_s) == pytest.approx((60, 100)) and then.tolist() == [[500, 0], [500, 60]]
    assert _approach(here, -velocities)[1] == pytest.approx(-100)  # was before
    maps = [map_figure(BirdsEye(load_scene("strait"), 300, (0,), MAP), step, 1600).axes[0].texts for step in (60, 130)]
    assert [sum("CPA" in text.get_text() for text in texts if text.get_visible()) for texts in maps] == [3, 3]


def test_hulls_and_obstacles_have_their_size_and_the_bearing_of_a_box_points_at_its_vessel(scene):
    for vessel in scene.vessels:
        ring = hull_m(vessel, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))  # heading along w2
        assert np.ptp(ring, axis=0) == pytest.approx((vessel.beam_m, vessel.length_m))
    island, bridge = (footprint(obstacle) for obstacle in scene.obstacles)
    assert island.symmetric_difference(shapely.Polygon(ISLAND)).area == pytest.approx(0, abs=1e-6)
    assert bridge.area == pytest.approx(480)
    (camera,), whole = scene.cameras, 0
    for frame in simulate_frames(scene):
        poses = scene.poses.poses(frame.step, frame.step + 1).positions_m[0]
        for box_px, vessel in zip(frame.truth.full_boxes_px, frame.truth.vessels, strict=True):
            if box_px[0] > 1 and box_px[2] < camera.intrinsics.image_size_px[0] - 1:  # seen from end to end
                bearing = Bearing.of(Solids.at(scene, camera, frame.step), box_px, palette.ALARM)
                away = poses[scene.vessel_names.index(vessel), :2] - bearing.at_m
                off = math.acos(min(bearing.direction @ away / np.hypot(*away), 1.0))
                assert off < (box_px[2] - box_px[0]) / 2000 + 1e-3  # of the half angle, at a focal length of 1000 px
                whole += 1
    assert whole > 5


def test_tracks_in_the_world_lie_where_they_are_in_the_colour_of_the_vessel_that_is_near(scene):
    steps, times_s = scene.steps, scene.times_s(0, scene.steps)
    places = scene.poses.poses(0, steps).positions_m[:, 0, :2]
    at_m = np.concatenate(
        [places + np.array([0, 30]), places + np.array([0, 70])]
    )  # of one within 50 m of her, and of one that is not
    velocity_m_s = np.where(np.arange(2 * steps)[:, None] < steps, [2.0, 1.0], np.nan)
    covariance = np.where(np.arange(2 * steps)[:, None, None] < steps, [[25.0, 0.0], [0.0, 100.0]], np.nan)
    track = np.repeat([0, 1], steps)
    tracks = WorldTracks.of("t", track, ("A7", "B"), np.tile(times_s, 2), at_m, velocity_m_s, covariance)
    figure = map_figure(BirdsEye(scene, steps, (0,), PLAN, tracks), 5, 900)
    axes, (left, _, right, _) = figure.axes[0], extent(figure.legends[0]).bounds
    assert 0 <= left < right <= 900 and extent(axes.title).bounds[3] < figure.bbox.height
    lines = dict(zip(axes.get_legend_handles_labels()[1], axes.get_legend_handles_labels()[0], strict=True))
    crosses = lines["track in the world"]
    colours = [palette.unit_rgb(palette.vessel_colour(0)), palette.unit_rgb(palette.ALARM)]
    np.testing.assert_allclose([np.nanmean(each, axis=0) for each in crosses.get_segments()], at_m[[5, steps + 5]])
    np.testing.assert_allclose(crosses.get_colors()[:, :3], colours)
    known, unknown = lines["95 % by a track's covariance"].get_segments()
    assert np.ptp(known, axis=0) == pytest.approx(2 * math.sqrt(5.991) * np.array([5, 10]), rel=1e-3)
    assert np.ptp(unknown, axis=0).tolist() == [0, 0]
    trail = lines[f"last {TRAIL_S:g} s of a track"].get_segments()[0]
    np.testing.assert_allclose(trail, at_m[:6])
    vector = lines["speed vector of a track"].get_segments()[0]
    np.testing.assert_allclose(np.diff(vector, axis=0), [[2 * VECTOR_S, VECTOR_S]])
    assert figure.legends[0].legend_handles[list(lines).index("track in the world")].get_marker() == "x"
    assert {"#A7", "#B"} <= {text.get_text() for text in axes.texts if text.get_visible()}
    labels = map_figure(BirdsEye(scene, steps, (0,), MAP, tracks), 5, 900).axes[0].get_legend_handles_labels()[1]
    assert "track in the world" not in labels


def test_a_file_of_tracks_in_the_world_is_drawn_on_maps_and_plans_alone(call, run, tmp_path):
    (tmp_path / "world.csv").write_text("track,time_s,w1_m,w2_m\nT1,0.5,250,12\nT1,0.6,250,12\nT2,0.5,90,0\n")
    given = "--tracks", tmp_path / "world.csv"
    with_tracks, without = tmp_path / "map.png", tmp_path / "without.png"
    status, said = call("view", "map", run, "5", *given, "--out", with_tracks)
    assert status == 0 and "Tracks of world: 2 tracks in the world." in said
    assert call("view", "map", run, "5", "--layers", "vectors,cpa,detections", "--out", without)[0] == 0
    assert with_tracks.read_bytes() != without.read_bytes()
    assert call("view", "frame", run, "5", *given, "--kind", "plan", "--out", tmp_path / "plan.png")[0] == 0
    status, said = call("view", "frame", run, "5", *given, "--out", tmp_path / "none.png")
    assert status == main.BAD_INPUT and "tracks in the world, which maps show: --kind map or plan" in said
    status, said = call("view", "map", run, "5", *given, "--threshold", "0.4", "--out", tmp_path / "none.png")
    assert status == main.BAD_INPUT and "are for tracks in the images" in said
    assert not (tmp_path / "none.png").exists()


def test_layers_are_drawn_on_request_rings_count_in_their_unit_and_a_scene_on_the_earth_has_north(birds_eye):
    with pytest.raises(ModsimError, match=r"unknown layer 'wires'; known layers: vectors, cpa, .*cables"):
        MapLayers.of(["nm", "wires"])
    assert not PictureRequest("map", ("tracks",)).map_layers.tracks  # without tracks, no key explains them
    for names, unit in (((), "m"), (("nm", "vectors"), "nm"), (("cables",), "cables")):
        axes = map_figure(replace(birds_eye, layers=MapLayers.of(names)), 5, 900).axes[0]
        radii = [text.get_text() for text in axes.texts if text.get_text().endswith(f" {unit}")]
        assert radii and ("speed vector, 6 min" in axes.get_legend_handles_labels()[1]) == ("vectors" in names)
    metres = [float(radius.split()[0]) * 185.2 for radius in radii]
    assert max(metres) < np.hypot(*np.ptp(np.reshape(birds_eye.extent_m, (2, 2)), axis=1))
    for origin in (None, (56.0, 12.6)):
        axes = map_figure(replace(birds_eye, scene=replace(birds_eye.scene, origin=origin)), 5, 900).axes[0]
        north = "N" in {text.get_text() for text in axes.texts}, "north" in axes.get_ylabel()
        assert north == (origin is not None,) * 2


def test_scenes_are_shaded_unless_plain_is_asked_for_maps_are_one_and_plans_have_both(monkeypatch, run, tmp_path):
    asked = {"scene": ("--kind", "scene"), "boxes": ()}
    asked |= {f"{look} scene": ("--kind", "scene", "--look", look) for look in ("shaded", "plain")}
    asked |= {look: ("--look", look) for look in ("plain", "shaded", "night")}
    kinds = {name: picture(monkeypatch, run, tmp_path / f"{name}.png", *options) for name, options in asked.items()}
    np.testing.assert_array_equal(kinds["scene"], kinds["shaded scene"])
    np.testing.assert_array_equal(kinds["boxes"], kinds["plain"])
    corner = (40, 390)  # below the line at the top, in the sky
    assert tuple(kinds["plain scene"][corner]) == tuple(kinds["boxes"][corner]) == palette.SKY
    np.testing.assert_array_equal(kinds["scene"][corner], kinds["shaded"][corner])
    assert tuple(kinds["scene"][corner]) != palette.SKY and kinds["night"][corner].sum() < 150
    options = ("--kind", "map", "--end", 1, "--format", "png", "--width", 320, "--out", tmp_path / "frames")
    assert view(monkeypatch, "film", run, *options) == 0
    one, other = (np.asarray(read(path)) for path in sorted((tmp_path / "frames").iterdir()))
    assert one.shape == other.shape and (one != other).any()
    pictures = {}
    for name, options in {"plan": ("--kind", "plan"), "bare": ("--kind", "plan", "--layers", "nm")}.items():
        pictures[name] = picture(monkeypatch, run, tmp_path / f"{name}.png", *options)
    half = pictures["plan"].shape[1] // 2
    assert pictures["plan"].shape == pictures["bare"].shape
    differ = (pictures["plan"] != pictures["bare"]).any(axis=(0, 2))
    assert differ[half:].any() and not differ[:half].any()


def test_what_is_seen_is_in_the_field_of_view_and_an_absent_vessel_is_not_drawn(birds_eye):
    scene = birds_eye.scene
    at, looks = view_of(scene, scene.cameras[0], 5)
    wedge = shapely.Polygon([at, *(at + 1e4 * looks)])
    outlines = scene.sight(scene.cameras[0], np.array([5])).outlines()
    seen = {scene.occluder_names[index] for index in outlines.occluder.tolist()}
    places = dict(zip(scene.vessel_names, scene.poses.poses(5, 6).positions_m[0, :, :2], strict=True))
    assert {name for name, place in places.items() if wedge.contains(shapely.Point(place))} <= seen
    present = birds_eye.scene.poses.poses(0, birds_eye.steps).present
    (step, *_), (gone, *_) = np.nonzero(~present)
    film = MapFilmRenderer(birds_eye, (640, map_height_px(birds_eye, 640)))
    film.picture(int(step))
    shown = {name.vessel for name in film.map.sheet.names.names if name.middle_px is not None}
    assert int(gone) not in shown and shown >= set(np.flatnonzero(present[step]).tolist())
