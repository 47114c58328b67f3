"""Looks: a shaded picture shows the weather of the detector's state, says which, and changes no data."""
# ruff: noqa: F811 (fixtures of another file)

import re
from dataclasses import replace

import numpy as np
import pytest

from modsim3d import InputError, Window, load_scene
from modsim3d.runs.run import run_scene
from modsim3d.scene.keys import usual_look
from modsim3d.scene.reading import shipped_scenes
from modsim3d.view.pictures.layers import WEATHER
from modsim3d.view.sea_and_sky import palette_of, wave_slopes
from modsim3d.view.shaded_picture import _lamps
from tests.view.test_shaded import DAYLIGHT, painted, scene, shaded, solids  # noqa: F401

FOLLOWS = replace(DAYLIGHT, by_state=True)
NO_WEATHER = ("excellent", "real_world", "no_fog")  # averages over weathers, and a name with a strange word
LOOKS = {"bad": {"visibility_m": 500.0, "dusk": True}}


def in_state(scene, state):
    return replace(FOLLOWS.in_state(scene, state), caption="")


@pytest.mark.parametrize(
    ("state", "caption"),
    [
        ("clear", "clear"),
        ("haze", "haze, 3,000 m"),
        ("foggy_cloudy", "overcast, fog, 800 m"),
        ("night_clear", "night, clear"),
        ("evening_cloudy_rain", "dusk, rain, visibility 4,000 m"),
        ("stormy_clouds", "overcast, waves 1.2 m"),
        ("noon_clear_experiment_2", "clear"),
    ],
)
def test_a_picture_says_which_weather_of_a_shipped_state_it_shows(scene, state, caption):
    assert FOLLOWS.in_state(scene, state).caption == f"drawn as: {caption}"


def test_a_picture_says_where_the_weather_of_a_state_is_not_drawn(scene):
    assert [FOLLOWS.in_state(scene, state).caption for state in NO_WEATHER] == [WEATHER] * len(NO_WEATHER)
    assert DAYLIGHT.in_state(scene, "night_clear") is DAYLIGHT  # which somebody asked for


def test_fog_takes_the_contrast_of_a_far_vessel_by_koschmieders_law(renderer, shaded, scene, solids):
    """Koschmieder (1924): C = C0 e^(−3.912 d / V) against the air, here at the middle of each vessel's pixels."""
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


def test_each_weather_looks_as_it_should(shaded, scene, solids):
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


def test_drawn_waves_are_those_that_lift_the_vessels():
    """The slope along the waves' way against differences of the elevation, where no wave is too short to be shown."""
    sea, position_m, time_s = load_scene("strait", steps=2).waves.sea, np.array([30.0, -20.0, 5.0]), 7.3
    long = replace(sea, amplitudes_m=np.where(sea.wave_numbers_rad_m < 1.0, sea.amplitudes_m, 0))
    way = np.array([np.cos(sea.direction_rad), np.sin(sea.direction_rad)])
    along = np.arange(-120.0, 120.0, 15.0)
    ends = [position_m[:2] + np.outer(along + shift, way) for shift in (-0.005, 0.005)]
    low, high = (long.elevation_m(np.full(len(along), time_s), end) for end in ends)
    slopes = wave_slopes(long, time_s, position_m)[0, (along / 0.25).astype(int) + 512]
    np.testing.assert_allclose(slopes, (high - low) / 0.01, atol=0.05 * slopes.std())


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


@pytest.mark.parametrize(
    ("looks", "problem"),
    [
        ({"hase": {}}, "looks.hase: no state 'hase' (did you mean 'haze'?)"),
        ({"haze": {"visibilty_m": 5}}, "looks.haze.visibilty_m: unknown key (did you mean 'visibility_m'?)"),
        ({"haze": {"visibility_m": 0}}, "looks.haze.visibility_m: must be above 0 (got 0)"),
        ({"haze": {"rain": 1}}, "looks.haze.rain: true or false is needed (got 1)"),
        ({"haze": {"dusk": True, "night": True}}, "looks.haze.night: it is dusk or night, not both"),
    ],
)
def test_a_wrong_look_is_refused(looks, problem):
    with pytest.raises(InputError) as error:
        load_scene("strait", settings={"looks": looks})
    assert problem in re.sub(r"settings\[.([\w.]+).\]", r"\1", str(error.value))


def test_every_state_of_shipped_scenes_has_a_look_or_is_an_average_over_weathers():
    states = {state.name for name in shipped_scenes() for state in load_scene(name, steps=2).detector.states}
    assert {state for state in states if usual_look(state) is None} == {"excellent", "good", "bad", "terrible"}


def test_foam_lies_on_the_sea_and_grows_with_the_speed(renderer, shaded, scene, solids):
    shown = [painted(shaded, solids, 800, speeds_m_s=np.full(len(scene.vessels), speed)) for speed in (0.2, 2.0, 8.0)]
    whiter = [(picture - shown[0]).sum(axis=-1) for picture in shown]
    assert 0 == whiter[0].max() < 0.2 * whiter[1].sum() < 0.1 * whiter[2].sum()
    assert (whiter[2][solids.ids(Window.whole((800, 600), 800), renderer) > 0] == 0).mean() > 0.97  # but for edges
    assert not whiter[2][:250].any()
