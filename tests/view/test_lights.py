"""Lights by night: which ones each kind and size of vessel shows to each bearing, where they are and how far seen."""

import math
from collections import defaultdict

import numpy as np
import pytest

from modsim3d import Window, load_scene
from modsim3d.geometry.kinematics import KNOT_M_S, NAUTICAL_MILE_M
from modsim3d.scene.parts import mesh_name
from modsim3d.view import lights
from modsim3d.view.lights import THRESHOLD_LUX, Colour, Kind, Lantern, Sector, ground_speeds, lanterns, lights_towards
from modsim3d.view.pictures.plain import Solids
from modsim3d.view.shaded_picture import draw_lights
from modsim3d.world.vessels import Vessel
from tests.scenes import crossing, write_scene

W, R, G = "white", "red", "green"
BEARINGS = (0, 45, 90, 112.4, 112.6, 135, 180, -135, -112.6, -112.4, -90, -45)  # from ahead, those to port first


def around(ahead, port, abaft, starboard):
    """Colours at each of the bearings, given those of four sectors; each from the highest light down."""
    return [ahead, *[port] * 3, *[abaft] * 5, *[starboard] * 3]


def vessel(length_m, *, shape="", label="Vessel", name="one", air_draft_m=None):
    return Vessel(name, label, length_m, 0.2 * length_m, air_draft_m or 0.4 * length_m, shape=shape)


SHIP = around([W, W, R, G], [W, W, R], [W], [W, W, G])
MOTOR = around([W, R, G], [W, R], [W], [W, G])
TORCH = around([W], [W], [W], [W])
TRICOLOUR = around([R, G], [R], [W], [G])
TRAWL = around([G, W, R, G], [G, W, R], [G, W, W], [G, W, G])
NETS = around([R, W, R, G], [R, W, R], [R, W, W], [R, W, G])
LONG_TRAWL = around([W, G, W, R, G], [W, G, W, R], [G, W, W], [W, G, W, G])
CASES = {
    "container ship": (vessel(180, shape="container_ship"), 12, SHIP),
    "ferry of 50 m": (vessel(50, shape="ferry"), 12, SHIP),
    "ferry of 49.9 m": (vessel(49.9, shape="ferry"), 12, MOTOR),
    "fishing vessel that does not fish": (vessel(20, shape="fishing_vessel"), 3, MOTOR),
    "a vessel of 12 m that nothing is known of": (vessel(12), 6, MOTOR),
    "motorboat": (vessel(8.5, shape="motorboat"), 20, MOTOR),
    "dinghy, fast": (vessel(6.9, shape="motorboat"), 7.1, MOTOR),
    "dinghy, slow": (vessel(6.9, shape="motorboat"), 6.9, TORCH),
    "dinghy of a scene with one step": (vessel(6.9, shape="motorboat"), math.nan, TORCH),
    "sailing boat": (vessel(11, shape="sailboat", air_draft_m=16), 4, TRICOLOUR),
    "sailing boat of 20 m": (vessel(20, shape="sailboat", air_draft_m=26), 4, around([R, G], [R], [W], [G])),
    "sailing dinghy": (vessel(6.5, shape="sailboat"), 4, TORCH),
    "kayak": (vessel(4.8, shape="kayak"), 2, TORCH),
    "kayak that drifts": (vessel(4.8, shape="kayak"), 0.1, TORCH),
    "trawler, trawling": (vessel(24, shape="fishing_vessel", label="trawling"), 3, TRAWL),
    "trawler of 60 m, trawling": (vessel(60, label="trawling"), 3, LONG_TRAWL),
    "trawler, its trawl on the ground": (vessel(24, label="trawling"), 0.1, around(*[[G, W]] * 4)),
    "with nets": (vessel(24, name="netting_3"), 3, NETS),
    "at anchor": (vessel(40, shape="ferry"), 0.4, TORCH),
    "yacht at anchor": (vessel(11, shape="sailboat"), 0.0, TORCH),
    "ship at anchor": (vessel(180), 0.4, around(*[[W, W]] * 4)),
}


def test_lights_by_bearing_none_of_which_is_outside_the_vessel():
    for case, (one, knots, wanted) in CASES.items():
        carried = lanterns(one, knots * KNOT_M_S)
        for bearing, colours in zip(BEARINGS, wanted, strict=True):
            seen = [light for light in carried if light.sector.holds(bearing)]
            found = [light.colour.name.lower() for light in sorted(seen, key=lambda light: -light.place[2])]
            assert found == colours, (case, bearing)
        for light in (light for knots in (0.1, 8) for light in lanterns(one, knots * KNOT_M_S)):
            assert (np.abs(light.place[:2]) <= 0.5).all() and 0 < light.place[2] <= 1, case


KINDS = [
    ("", "Vessel", "219000001", Kind.POWER),
    ("sailboat", "boat", "motorboat", Kind.SAIL),  # the mesh is what one sees
    ("motorboat", "sailboat", "a", Kind.POWER),
    ("my_sloop", "Vessel", "a", Kind.SAIL),
    ("", "Sailing", "a", Kind.SAIL),  # a label of `modsim3d ais --labels type`
    ("", "Fishing", "a", Kind.POWER),
    ("", "Vessel", "yacht3", Kind.SAIL),
    ("", "MotorYacht", "a", Kind.POWER),
    ("kayak", "boat", "kayak", Kind.OARS),
    ("", "HighSpeed", "assailant", Kind.POWER),
    ("sailing_ship", "ship", "a", Kind.SAIL),
    ("", "MotorSailer", "a", Kind.POWER),
    ("container_ship", "sailboat", "a", Kind.POWER),
]


def test_kind_of_a_vessel_by_mesh_label_or_name_and_intensity_and_ranges_by_the_rules():
    for shape, label, name, kind in KINDS:
        assert lights.kind_of(vessel(10, shape=shape, label=label, name=name)) is kind, (shape, label, name)
    assert mesh_name("sailboat") == mesh_name("meshes/sailboat.glb") == "sailboat"
    assert mesh_name({"file": "hulls/my_sloop.stl", "forward": "+x"}) == "my_sloop"
    # The table of COLREG, Annex I, section 8, and Rule 22; at its range a light is the faintest that is seen.
    for miles, candela in {1: 0.9, 2: 4.3, 3: 12, 4: 27, 5: 52, 6: 94}.items():
        light = Lantern("stern", Colour.WHITE, Sector.STERN, miles, (0, 0, 0))
        assert light.intensity_cd == pytest.approx(candela, rel=0.06)
        assert light.illuminance_lux(miles * NAUTICAL_MILE_M) == pytest.approx(THRESHOLD_LUX)
    for length_m, expected in ((50, (6, 3, 3)), (49, (5, 2, 2)), (20, (5, 2, 2)), (19, (3, 2, 2))):
        ranges = {light.name: light.range_nm for light in lanterns(vessel(length_m), 8 * KNOT_M_S)}
        assert (ranges["masthead"], ranges["port side"], ranges["stern"]) == expected, length_m
    small = {light.name: light.range_nm for light in lanterns(vessel(11), 8 * KNOT_M_S)}
    assert small == {"all-round": 2, "port side": 1, "starboard side": 1}


@pytest.fixture(scope="module")
def strait():
    return load_scene("strait", steps=111)


def placed(one):
    """Places of lights in metres from the vessel's origin, by name; of several masthead lights the fore one first."""
    found = defaultdict(list)
    for light in lanterns(one, 8 * KNOT_M_S):
        found[light.name].append(np.array(light.place) * one.extents_m)
    return found


def test_places_of_the_lights_of_ships_trawlers_and_sailing_boats_and_of_the_strait_by_night(strait):
    """Annex I, sections 2 and 3, for the shipped meshes and for boxes of many sizes."""
    boxes = [vessel(length, air_draft_m=height) for length in (50, 90, 180, 300) for height in (20.0, 45.0)]
    ships = [one for one in strait.vessels if one.length_m >= 50]
    assert len(ships) == 2
    for one in ships + boxes:
        (fore, after), (side,) = (placed(one)[name] for name in ("masthead", "port side"))
        assert fore[0] >= 0.25 * one.length_m  # in the foremost quarter
        assert fore[0] - after[0] >= min(one.length_m / 2, 100) - 1e-9 and after[2] - fore[2] >= 4.5 - 1e-9
        deck = min(0.25 * one.air_draft_m, 0.1 * one.length_m)
        assert fore[2] - deck >= min(max(6, one.beam_m), 12) - 1e-9 or fore[2] == pytest.approx(one.air_draft_m - 4.5)
        assert side[2] - deck <= 0.75 * (fore[2] - deck) and side[0] <= fore[0] and after[0] >= -one.length_m / 2
    # Annex I, sections 2 i and 2 j: 2 m between the upper two, and at least twice that down to the sidelights.
    for length_m in (24, 60, 90):
        found = placed(vessel(length_m, label="trawling"))
        (upper,), (lower,), (side,) = (found[name] for name in ("upper", "lower", "port side"))
        assert upper[2] - lower[2] == pytest.approx(2) and lower[2] - side[2] >= 4 - 1e-9, length_m
    shipped = {one.name: one for one in strait.vessels}
    for one in (shipped["trawler"], vessel(20), vessel(49)):
        assert placed(one)["masthead"][0][0] > 0
    places = np.array([light.place for light in lanterns(shipped["sailboat"], 4 * KNOT_M_S)])
    assert np.ptp(places, axis=0).max() == 0 and places[0, 2] == pytest.approx(1)
    assert places[0, 0] == pytest.approx(0.7 / 11, abs=0.01)  # where script/make_meshes puts the mast
    # The moment of docs/looks.png, from the bow camera.
    solids, shown = Solids.at(strait, strait.cameras[0], 110), defaultdict(list)
    for light in lights_towards(solids.sight, ground_speeds(strait, 110)):
        shown[strait.vessel_names[light.vessel]].append(light.lantern.name)
    assert shown == {
        "ferry": ["masthead", "masthead", "starboard side"],
        "container_ship": ["masthead", "masthead", "port side"],
        "sailboat": ["stern"],
        "yacht": ["starboard side"],
        "motorboat": ["all-round", "port side"],
        "trawler": ["masthead", "port side"],
        "kayak": ["torch"],
        "barge": ["stern"],
    }


def ship_before_the_camera(folder, heading_deg, place_m):
    ahead = 50 * np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    way = [[0, *place_m], [10, *(place_m + ahead).tolist()]]
    scene = load_scene(write_scene(folder, {"ship": ([200, 30, 40], way)}, 12))
    return [light.lantern for light in lights_towards(scene.sight(scene.cameras[0], np.array([0])), np.array([5.0]))]


def scene_with(folder, wall_at_m, heading_deg=90.0, steps=12):
    """A boat 250 m ahead of the camera on w1, and a wall before or behind it."""
    step = 100 * np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    tracks = {"boat": [[0, 250, 0], [100, 250 + step[0], step[1]]]}
    ring = [[wall_at_m, -40], [wall_at_m + 2, -40], [wall_at_m + 2, 40], [wall_at_m, 40]]
    obstacles = {"wall": {"polygon_m": ring, "height_m": 30}}
    return load_scene(crossing(folder, steps, poses={"tracks": tracks}, obstacles=obstacles))


@pytest.mark.parametrize(("wall_at_m", "hidden"), [(200, True), (290, False)])
def test_a_wall_hides_a_light_behind_it_and_its_own_hull_does_not(tmp_path, wall_at_m, hidden):
    scene = scene_with(tmp_path, wall_at_m, heading_deg=180.0)
    solids, speeds = Solids.at(scene, scene.cameras[0], 0), ground_speeds(scene, 0)
    shown = list(lights_towards(solids.sight, speeds))
    assert len(shown) == 3
    for light in shown:
        seen = solids.sight.camera_poses.to_camera(light.place_m[None, None])[0]
        (place_px,), inverse_depth = solids.intrinsics.project(seen), solids.intrinsics.near_clip_m / seen[0, 2]
        assert lights.is_hidden(solids, light.vessel, place_px, inverse_depth) is hidden
    draw_lights(rgb := np.zeros((600, 800, 3), np.float32), solids, Window.whole((800, 600), 800), speeds, 0.0)
    assert (rgb.max() == 0) == hidden


@pytest.mark.parametrize(("heading_deg", "side"), [(90, Colour.RED), (-90, Colour.GREEN)])
def test_lights_are_drawn_where_they_are_in_their_colours(tmp_path, heading_deg, side):
    scene = scene_with(tmp_path, 900, heading_deg)
    solids, window = Solids.at(scene, scene.cameras[0], 0), Window.whole((800, 600), 1600)
    rgb, speeds = np.zeros((1200, 1600, 3), np.float32), ground_speeds(scene, 0)
    draw_lights(rgb, solids, window, speeds, 0.0)
    for light, colour in zip(lights_towards(solids.sight, speeds), (Colour.WHITE, side), strict=True):
        seen = solids.sight.camera_poses.to_camera(light.place_m[None, None])[0]
        x, y = window.to_picture(solids.intrinsics.project(seen))[0].astype(int)
        shares = rgb[y, x] / rgb[y, x].max()
        np.testing.assert_allclose(shares, np.array(colour.value) / max(colour.value), atol=0.25)
        assert 0.5 < rgb[y, x].max() < 1.8
    hazy = np.zeros_like(rgb)
    draw_lights(hazy, solids, window, speeds, 3.912 / 300)
    assert 0 < hazy.sum() < 0.6 * rgb.sum() and 0.3 < hazy.max() < 0.8 * rgb.max()


def test_a_ship_right_ahead_shows_both_sides_and_a_yacht_side_by_side_mirrored_in_the_sea(tmp_path):
    shown = [{each.name for each in ship_before_the_camera(tmp_path, 180.0, (250, aside))} for aside in (0, 40, -40)]
    assert shown[0] == {"masthead", "port side", "starboard side"}  # at half the beam from either sidelight
    assert shown[1:] == [{"masthead", "port side"}, {"masthead", "starboard side"}]
    # Abeam of the middle of a long ship one is abaft the beam of her forward masthead light, which is far ahead.
    (after,) = [each for each in ship_before_the_camera(tmp_path, 90.0, (60, 0)) if each.name == "masthead"]
    assert after.place[0] < 0
    # COLREG, Rule 25 b; a yellow light is that of a tow (Rule 24).
    scene = load_scene(write_scene(tmp_path, {"yacht": ([11, 3.5, 16], [[0, 280, 0], [10, 250, 0]])}, 3))
    solids, rgb = Solids.at(scene, scene.cameras[0], 0), np.zeros((600, 800, 3), np.float32)
    draw_lights(rgb, solids, Window.whole((800, 600), 800), np.full(len(scene.vessels), 3.0), 0.0)
    red, green = (rgb[..., one] > 2.5 * rgb[..., other] for one, other in ((0, 1), (1, 0)))
    bright = rgb.max(axis=-1) > 0.2
    assert (bright & red).any() and (bright & green).any() and not (bright & ~red & ~green).any()
    columns, rows = ([np.nonzero(bright & each)[axis].mean() for each in (green, red)] for axis in (1, 0))
    assert columns[0] < 400 < columns[1] and abs(rows[0] - rows[1]) < 1  # her port side is to the right
    mirrored = np.nonzero((rgb.max(axis=-1) > 0.05)[320:])[0]
    assert len(mirrored) > 10


def test_fog_and_distance_weaken_lights_and_speed_is_unknown_of_absent_vessels_and_single_steps(tmp_path):
    scene = scene_with(tmp_path, 900)
    sight, speeds = scene.sight(scene.cameras[0], np.array([0])), ground_speeds(scene, 0)
    clear, mist = ({light.lantern.name: light.decades for light in lights_towards(sight, speeds, extinction)}
                   for extinction in (0.0, 3.912 / 500))  # fmt: skip
    assert set(clear) == set(mist)
    for name in clear:
        assert clear[name] - mist[name] == pytest.approx(3.912 / 500 * 250 / math.log(10), rel=0.03)
    assert not list(lights_towards(sight, speeds, 3.912 / 50))
    np.testing.assert_allclose(ground_speeds(scene_with(tmp_path, 900), 3), [1.0, np.nan, np.nan])
    assert np.isnan(ground_speeds(scene_with(tmp_path, 900, steps=1), 0)).all()
