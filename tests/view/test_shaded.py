"""Shaded pictures: outlines as in the ID buffer, properties of light, and the weather of the detector's state."""

import gc
import json
import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely

from modsim3d import InputError, ModsimError, Window, load_scene
from modsim3d.render.context import open_context
from modsim3d.render.shaded_pass import Lamp, LitFaces, ShadedRenderer, lit_colours
from modsim3d.runs.run import run_scene
from modsim3d.scene.keys import usual_look
from modsim3d.scene.reading import shipped_scenes
from modsim3d.truth.analytic import ROUNDING_PX
from modsim3d.view import palette, shaded_picture
from modsim3d.view.pictures.layers import WEATHER
from modsim3d.view.pictures.plain import Solids
from modsim3d.view.sea_and_sky import Rays, RenderStyle, fogged, palette_of, wave_slopes
from modsim3d.view.shaded_picture import ShadedPictureRenderer, _lamps
from tests.scenes import crossing

DAYLIGHT = RenderStyle(shaded=True)
ROLLED = {"position_m": [0, 0, 20], "roll_rad": 0.15, "pitch_rad": 0.05, "yaw_rad": -0.03}
CAMERAS = {
    "plain": {},
    "skew, pixels that are not square, roll": {"pixel_size_m": [1e-5, 0.7e-5], "skew": 60.0, "pose": ROLLED},
    "lens": {"distortion": {"k1": -0.15, "k2": 0.03, "p1": 0.001}},
}


def scene_with(folder, keys=None):
    """The crossing with a ferry for a ship, an island, and other keys of its camera."""
    island = {"polygon_m": [[300, 20], [380, 10], [350, 90]], "height_m": 12}
    path = crossing(folder, obstacles={"island": island})
    scene = json.loads(path.read_text())
    scene["cameras"]["C0"].update(keys or {})
    scene["vessels"]["ship"]["mesh"] = "ferry"
    path.write_text(json.dumps(scene))
    return load_scene(path)


@pytest.fixture(scope="module")
def shaded(renderer):
    """In the same context as the ID pass."""
    with open_context() as context:
        shaded = ShadedRenderer(context)
        yield shaded
        shaded.close()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return scene_with(tmp_path_factory.mktemp("shaded"))


def painted(shaded, solids, width=640, style=DAYLIGHT, **options):
    painter, window = ShadedPictureRenderer(shaded, style), Window.whole((800, 600), width)
    return np.asarray(painter.picture(solids, window, **options)).astype(int)


@pytest.fixture(scope="module")
def solids(scene):
    return Solids.at(scene, scene.cameras[0], 3)


def vessel_pixels(painter, solids, window, monkeypatch):
    """Where the picture changes with the colour of everything that stands in it."""
    pictures = []
    monkeypatch.setattr(shaded_picture, "REFLECTION", 0.0)
    for colour in ((0, 0, 0), (255, 255, 255)):
        monkeypatch.setattr(shaded_picture, "occluder_colour", lambda occluder, solids, colour=colour: colour)
        pictures.append(np.asarray(painter.picture(solids, window, samples=1)))
    return (pictures[1] != pictures[0]).any(axis=-1)


@pytest.mark.parametrize(("name", "width"), [*((name, 800) for name in CAMERAS), ("plain", 500)])
def test_outline_equals_the_id_buffer(renderer, shaded, tmp_path, monkeypatch, name, width):
    scene = scene_with(tmp_path, CAMERAS[name])
    solids = Solids.at(scene, scene.cameras[0], 5)
    window = Window.whole((800, 600), width)
    ids = solids.ids(window, renderer)
    drawn = vessel_pixels(ShadedPictureRenderer(shaded, DAYLIGHT), solids, window, monkeypatch)
    assert (ids > 0).sum() > 1000
    rows, columns = np.nonzero(drawn != (ids > 0))
    corners = window.to_picture(solids.triangles.corners_px)
    edges = shapely.linestrings(np.stack([corners, np.roll(corners, -1, 1)], 2).reshape(-1, 2, 2))
    away = shapely.distance(shapely.multilinestrings(edges), shapely.points(columns + 0.5, rows + 0.5))
    assert (away <= ROUNDING_PX).all() and len(rows) <= 3


MATRIX = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])


def test_calm_seas_are_drawn_and_programs_compiled_once(shaded, monkeypatch, scene):
    """Two cameras with the same optics, the first of them on board."""
    from OpenGL import contextdata

    strait, drawn = load_scene("strait", steps=4), []
    ashore, on_board = (next(c for c in strait.cameras if (c.mount.vessel is None) == fixed) for fixed in (True, False))
    ashore = replace(ashore, intrinsics=on_board.intrinsics)
    seen = shaded_picture.Backdrop
    monkeypatch.setattr(shaded_picture, "Backdrop", lambda *given: drawn.append(given) or seen(*given))
    window, pictures = Window.whole(on_board.intrinsics.image_size_px, 160), {None: [], 0.0: []}
    for height_m, shown in pictures.items():
        used = ShadedPictureRenderer(shaded, replace(DAYLIGHT, significant_height_m=height_m))
        for step in range(4):
            used.picture(Solids.at(strait, on_board, step), window)
            shown.append(np.asarray(used.picture(Solids.at(strait, ashore, step), window))[-20:])
    assert len(drawn) == 2 * (4 + 1)
    moving, calm = ([(one != shown[0]).mean() for one in shown[1:]] for shown in pictures.values())
    assert min(moving) > 0.3 and max(calm) == 0
    solids, window = Solids.at(scene, scene.cameras[0], 3), Window.whole((800, 600), 160)
    used, compiled = ShadedPictureRenderer(shaded, DAYLIGHT), []
    used.picture(solids, window)
    contexts, program = len(contextdata.storedPointers), sys.modules["pyrender.shader_program"].ShaderProgram
    begin = program.__init__
    monkeypatch.setattr(program, "__init__", lambda *given, **named: compiled.append(given) or begin(*given, **named))
    for _ in range(3):
        used.picture(solids, window)
    assert not compiled and len(contextdata.storedPointers) == contexts


def test_each_vessel_shows_where_its_id_is_in_its_hue_and_the_id_pass_goes_on(renderer, shaded, solids):
    """Every vessel in a colour of its own, without lamps: who is in front is who has the pixel."""
    window = Window.whole((800, 600), 800)
    ids = solids.ids(window, renderer)
    own = np.linspace(0, 1, 7)[solids.occluders[solids.triangles.row] + 1]
    faces = replace(shaded_picture.lit_faces(solids), colours=np.column_stack([own, own, own]), shade=None)
    matrix, near = solids.intrinsics.matrix, solids.intrinsics.near_clip_m
    lit = shaded.draw(faces, matrix, near, (800, 600), [], (1.0, 1.0, 1.0))
    assert len(np.unique(ids)) >= 4 and (np.rint(lit.colour[..., 0] / 255 * 6) != ids).sum() <= 3
    np.testing.assert_array_equal(solids.ids(window, renderer), ids)  # and the ID pass is not disturbed
    picture, ids = painted(shaded, solids, 800), solids.ids(Window.whole((800, 600), 800), renderer)
    colours = {value: np.array(palette.vessel_colour(value - 1), float) for value in (1, 2, 3)}
    colours = {value: colour for value, colour in colours.items() if (ids == value).sum() > 50}
    assert len(colours) >= 2
    for value in colours:
        mean = picture[ids == value].mean(axis=0)
        assert value == max(colours, key=lambda other: mean @ colours[other] / np.linalg.norm(colours[other]))
    window = Window.whole((800, 600), 400)
    before = solids.ids(window, renderer)
    for close in (True, False):
        shaded = ShadedRenderer(renderer.context)
        ShadedPictureRenderer(shaded, DAYLIGHT).picture(solids, window)
        if close:
            shaded.close()
        del shaded
        gc.collect()
        np.testing.assert_array_equal(solids.ids(window, renderer), before)


def test_sky_is_above_the_sea_through_a_lens_too_and_a_used_painter_draws_the_same(shaded, solids, scene, tmp_path):
    picture = painted(shaded, solids)
    nobody = replace(solids, outlines=solids.outlines.take(np.array([], dtype=np.int64)))
    assert picture.shape == painted(shaded, nobody).shape == (480, 640, 3)
    a, b, c = solids.sea_half_plane
    horizon = round(-(a * 400 + c) / b * 0.8)
    assert picture[horizon - 30, 5].sum() > picture[horizon + 30, 5].sum() + 100
    high, deep = picture[3, 320], picture[-3, 320]
    assert np.abs(high - 255 * np.array(palette_of(DAYLIGHT).zenith)).max() < 90
    assert deep.sum() < 0.6 * high.sum() and deep[2] > deep[0]
    # Only the rows that were drawn on are restored.
    pictures, used = [], ShadedPictureRenderer(shaded, DAYLIGHT)
    moved = scene_with(tmp_path, {"pose": {"position_m": [0, 0, 20], "pitch_rad": 0.1}})
    for of, step in ((scene, 3), (scene, 5), (scene, 0), (scene, 3), (moved, 3), (moved, 3)):
        solids, window = Solids.at(of, of.cameras[0], step), Window.whole((800, 600), 320)
        pictures.append(np.asarray(used.picture(solids, window)))
        np.testing.assert_array_equal(pictures[-1], painted(shaded, solids, 320))
    assert (pictures[-3] != pictures[-2]).any()
    scene = scene_with(tmp_path, {**CAMERAS["lens"], "pose": {"position_m": [0, 0, 20], "pitch_rad": -0.1}})
    solids = Solids.at(scene, scene.cameras[0], 0)
    rays = Rays.of(solids.intrinsics, Window.whole((800, 600), 800)).camera
    exact = solids.intrinsics.unproject(np.array([[20.5, 30.5], [400.5, 300.5], [780.5, 580.5]]), np.ones(3))
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    np.testing.assert_allclose(rays[[30, 300, 580], [20, 400, 780]], exact, atol=2e-5)


def test_fog_leaves_two_percent_of_contrast_and_a_face_reflects_by_lamberts_law(shaded):
    corners, found = np.array([[[-50.0, -50.0, 500.0], [50.0, -50.0, 500.0], [0.0, 50.0, 500.0]]]), []
    for normal in ((0, 0, -1), (0.6, 0, -0.8), (1, 0, 0)):
        faces = LitFaces(corners, np.array([normal], dtype=float), np.full((1, 3), 0.5))
        lamp = Lamp((0.0, 0.0, -1.0), (1, 1, 1), 2.0)
        lit = shaded.draw(faces, MATRIX, 0.1, (100, 100), [lamp], (0.1, 0.1, 0.1))
        assert lit.depth_m[lit.drawn] == pytest.approx(500, rel=1e-4)
        assert lit.drawn[48, 50] and not lit.drawn[10, 10]
        found.append(int(lit.colour[48, 50, 0]))
    assert found[0] > found[1] > found[2] > 0
    normals = np.array([[0.0, 0.0, -1.0], [0.0, -0.6, -0.8], [0.0, 0.0, 1.0]])
    faces = LitFaces(np.zeros((3, 3, 3)), normals, np.array([[1.0, 1.0, 1.0], [1.0, 0.5, 0.0], [1.0, 1.0, 1.0]]))
    lamp, ambient = Lamp((0.0, 0.0, -2.0), (1.0, 0.5, 0.25), 0.9 * np.pi), (0.05, 0.05, 0.05)
    light = lit_colours(faces, [lamp], ambient) ** 2.2
    np.testing.assert_allclose(light[0], (0.95, 0.5, 0.275))
    np.testing.assert_allclose(light[1], (0.77, 0.5**2.2 * 0.41, 0.0))
    np.testing.assert_allclose(light[2], 0.05)  # turned away: the light from everywhere is left
    # Koschmieder (1924); WMO takes 0.05 for the optical range, 0.02 gives 3.912 / V.
    style = RenderStyle(shaded=True, visibility_m=800.0)
    assert style.extinction_per_m == pytest.approx(3.912 / 800, rel=1e-4)
    air, at_visibility = (fogged(np.zeros((1, 3)), np.array([away_m]), style) for away_m in (1e9, 800.0))
    np.testing.assert_allclose((air - at_visibility) / air, 0.02, rtol=1e-4)
    np.testing.assert_array_equal(fogged(np.ones((1, 3)), np.array([0.0]), style), 1)
    for value in (0.0, -5.0, math.inf, math.nan):
        with pytest.raises(ModsimError, match="look fog"):
            RenderStyle(shaded=True, visibility_m=value)


FOLLOWS = replace(DAYLIGHT, by_state=True)
NO_WEATHER = ("excellent", "real_world", "no_fog")  # averages over weathers, and a name with a strange word
LOOKS = {"bad": {"visibility_m": 500.0, "dusk": True}}


def in_state(scene, state):
    return replace(FOLLOWS.in_state(scene, state), caption="")


@pytest.mark.parametrize(("state", "caption"), [
    ("clear", "clear"),
    ("haze", "haze, 3,000 m"),
    ("foggy_cloudy", "overcast, fog, 800 m"),
    ("night_clear", "night, clear"),
    ("evening_cloudy_rain", "dusk, rain, visibility 4,000 m"),
    ("stormy_clouds", "overcast, waves 1.2 m"),
    ("noon_clear_experiment_2", "clear"),
])  # fmt: skip
def test_a_picture_says_which_weather_of_a_shipped_state_it_shows(scene, state, caption):
    assert FOLLOWS.in_state(scene, state).caption == f"drawn as: {caption}"


def test_each_weather_looks_as_it_should_and_pictures_say_where_it_is_not_drawn(scene, shaded, solids):
    assert [FOLLOWS.in_state(scene, state).caption for state in NO_WEATHER] == [WEATHER] * len(NO_WEATHER)
    assert DAYLIGHT.in_state(scene, "night_clear") is DAYLIGHT  # which somebody asked for
    names = ("noon_clear", "noon_cloudy", "noon_cloudy_rain", "evening_clear", "night_clear", "night_cloudy")
    shown = {name: painted(shaded, solids, 400, in_state(scene, name)).astype(float) for name in names}
    light = [shown[name].mean() for name in ("noon_clear", "evening_clear", "night_clear", "night_cloudy")]
    assert light[1] < 0.62 * light[0] and light[2] < 0.62 * light[1] and light[3] < light[2]
    blue, grey = (np.ptp(shown[name][:150], axis=-1).mean() for name in ("noon_clear", "noon_cloudy"))
    assert grey < 0.35 * blue
    dry = replace(in_state(scene, "noon_cloudy_rain"), rain=False, overcast=True)
    streaks = (np.abs(shown["noon_cloudy_rain"] - painted(shaded, solids, 400, dry)) > 4).any(axis=-1).mean()
    assert 0.002 < streaks < 0.1
    strongest = {name: max(lamp.strength for lamp in _lamps(np.eye(3), in_state(scene, name))[0]) for name in names}
    assert strongest["noon_clear"] > 2 * strongest["noon_cloudy"] and strongest["night_clear"] < 0.4


def test_looks_change_no_truth_and_a_detector_in_place_of_the_scenes_leaves_its_looks_behind(tmp_path):
    given = load_scene("simulation_1", steps=2, settings={"looks": LOOKS})
    plain = load_scene("simulation_1", steps=2)
    assert given.look_of("bad").dusk and plain.look_of("bad") is None
    assert given.copy.truth_sha256() == plain.copy.truth_sha256() and "looks" not in plain.copy.document
    assert load_scene(given.copy.write(tmp_path)).looks == given.looks
    folders = [run_scene(each, tmp_path / f"{len(each.looks)}").folder for each in (given, plain)]
    files = {file.name for file in folders[0].iterdir()} - {"run.json", "run.log", "scene"}
    same = {name for name in files if (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()}
    assert files == same and "truth.parquet" in files
    foggy = load_scene(tmp_path / "simulation_1.json", state="foggy_cloudy", state_from="conditions")
    again = load_scene(foggy.copy.write(tmp_path / "again"))
    assert again.looks == foggy.looks == {} and again.look_of("foggy_cloudy").visibility_m == 800


@pytest.mark.parametrize(("looks", "problem"), [
    ({"hase": {}}, "looks.hase: no state 'hase' (did you mean 'haze'?)"),
    ({"haze": {"visibilty_m": 5}}, "looks.haze.visibilty_m: unknown key (did you mean 'visibility_m'?)"),
    ({"haze": {"visibility_m": 0}}, "looks.haze.visibility_m: must be above 0 (got 0)"),
    ({"haze": {"rain": 1}}, "looks.haze.rain: true or false is needed (got 1)"),
    ({"haze": {"dusk": True, "night": True}}, "looks.haze.night: it is dusk or night, not both"),
])  # fmt: skip
def test_a_wrong_look_is_refused(looks, problem):
    with pytest.raises(InputError) as error:
        load_scene("strait", settings={"looks": looks})
    assert problem in re.sub(r"settings\[.([\w.]+).\]", r"\1", str(error.value))


def test_drawn_waves_lift_the_vessels_and_every_shipped_state_has_a_look_or_is_an_average():
    """The slope along the waves' way against differences of the elevation, where no wave is too short to be shown."""
    sea, position_m, time_s = load_scene("strait", steps=2).waves.sea, np.array([30.0, -20.0, 5.0]), 7.3
    long = replace(sea, amplitudes_m=np.where(sea.wave_numbers_rad_m < 1.0, sea.amplitudes_m, 0))
    way = np.array([np.cos(sea.direction_rad), np.sin(sea.direction_rad)])
    along = np.arange(-120.0, 120.0, 15.0)
    ends = [position_m[:2] + np.outer(along + shift, way) for shift in (-0.005, 0.005)]
    low, high = (long.elevation_m(np.full(len(along), time_s), end) for end in ends)
    slopes = wave_slopes(long, time_s, position_m)[0, (along / 0.25).astype(int) + 512]
    np.testing.assert_allclose(slopes, (high - low) / 0.01, atol=0.05 * slopes.std())
    states = {state.name for name in shipped_scenes() for state in load_scene(name, steps=2).detector.states}
    assert {state for state in states if usual_look(state) is None} == {"excellent", "good", "bad", "terrible"}


def test_fog_hides_what_is_far_by_koschmieders_law_night_darkens_and_foam_grows(renderer, shaded, scene, solids):
    foggy, dark = RenderStyle(shaded=True, visibility_m=100.0), RenderStyle(shaded=True, night=True)
    speeds = np.ones(len(scene.vessels))
    clear, fog, night = (painted(shaded, solids, 400, style, speeds_m_s=speeds) for style in (DAYLIGHT, foggy, dark))
    ids = solids.ids(Window.whole((800, 600), 400), renderer)
    far = ids == len(scene.vessels) + 1  # the island, 300 m away
    assert far.sum() > 20 and np.ptp(fog[far].mean(axis=-1)) < 6 and clear[far].mean() < fog[far].mean() - 30
    assert night.mean() < 0.35 * clear.mean()
    # Koschmieder (1924): C = C0 e^(−3.912 d / V) against the air, here at the middle of each vessel's pixels.
    air, visibility_m = 255 * np.array(palette_of(DAYLIGHT).fog), 500.0
    clear, fog = (painted(shaded, solids, 800, style) for style in (DAYLIGHT, replace(DAYLIGHT, visibility_m=500.0)))
    ids, tried = solids.ids(Window.whole((800, 600), 800), renderer), 0
    for index in range(len(scene.vessels)):
        rows, columns = np.nonzero(ids == index + 1)
        away_m = np.linalg.norm(solids.sight.poses.positions_m[0, index] - solids.sight.camera_poses.positions_m[0])
        half_m = scene.vessels[index].extents_m[:2].max() / 2
        if len(rows) < 50:
            continue
        bright = [(picture[rows, columns] - air).sum(axis=-1) for picture in (clear, fog)]
        strong = np.abs(bright[0]) > 150
        left = np.median(bright[1][strong] / bright[0][strong])
        least, most = (np.exp(-3.912 * metres / visibility_m) for metres in (away_m + half_m, away_m - half_m))
        assert least - 0.02 < left < most + 0.02
        tried += 1
    assert tried >= 2
    shown = [painted(shaded, solids, 800, speeds_m_s=np.full(len(scene.vessels), speed)) for speed in (0.2, 2.0, 8.0)]
    whiter = [(picture - shown[0]).sum(axis=-1) for picture in shown]
    assert 0 == whiter[0].max() < 0.2 * whiter[1].sum() < 0.1 * whiter[2].sum()
    assert (whiter[2][solids.ids(Window.whole((800, 600), 800), renderer) > 0] == 0).mean() > 0.97  # but for edges
    assert not whiter[2][:250].any()
