"""The irregular sea: its spectrum, and how vessels answer it."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from modsim3d.core.errors import InputError
from modsim3d.geometry.camera_poses import vehicle_R_nominal, world_R_vehicle
from modsim3d.scene.reading import load_scene
from modsim3d.world import floating_vessels as floating
from modsim3d.world.floating_vessels import GRAVITY_M_S2, Hull, Passage, Sea, jonswap_sea, jonswap_shape, response
from tests.scenes import camera_keys, write_scene

BOAT = Hull(12.0, 4.0)
HEADINGS = st.floats(-np.pi, np.pi)


def passage(times, heading=0.0, speed=0.0, start=(0.0, 0.0, 0.0)):
    velocity = np.broadcast_to(speed * np.array([np.cos(heading), np.sin(heading), 0.0]), (len(times), 3))
    places = start + times[:, None] * velocity
    return Passage(times, np.arange(len(times)), places, np.full(len(times), heading), velocity)


def one_wave(period_s, direction=0.0, amplitude=1.0):
    return Sea(np.array([2 * np.pi / period_s]), np.array([amplitude]), np.array([0.4]), direction)


def moved(sea, hull, way):
    return floating.FloatingVessels(sea, {"own": hull}).motion("own", way)


def test_the_spectrum_has_the_scale_of_the_recommended_practice_and_four_deviations_are_its_height():
    """DNV-RP-C205, §3.5.5: A = 1 − 0.287 ln γ keeps the energy of γ = 1, ω_p / 5; good to 1 %."""
    for peakedness in (1.0, 2.0, 3.3, 5.0):
        energy, _ = quad(jonswap_shape, 0.05, 30, (0.7, peakedness), points=(0.6, 0.7, 0.8), limit=200)
        assert energy * (1 - 0.287 * np.log(peakedness)) == pytest.approx(0.7 / 5, rel=0.01)
        peak = np.array(0.8)
        assert jonswap_shape(peak, 0.8, peakedness) / jonswap_shape(peak, 0.8, 1.0) == pytest.approx(peakedness)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    np.testing.assert_allclose(floating.NODES, nodes[4:], rtol=0, atol=1e-15)
    np.testing.assert_allclose(floating.WEIGHTS, weights[4:], rtol=0, atol=3e-15)
    # Over 120 seas of ten minutes; the error is that of the mean over seas.
    times = np.arange(0, 600, 0.5)
    places = np.array([[120.0, -40.0, 0.0]]).repeat(len(times), axis=0)
    variances = [np.mean(jonswap_sea(2.5, 8.0, 0.3, seed).elevation_m(times, places) ** 2) for seed in range(120)]
    error = np.std(variances, ddof=1) / np.sqrt(len(variances))
    assert abs(np.mean(variances) - (2.5 / 4) ** 2) < 4 * error
    assert error < 0.02 * (2.5 / 4) ** 2


def test_spectrum_of_the_elevation_is_the_one_asked_for():
    """Energy in frequency bands of a Hann-windowed periodogram, averaged over 150 seas, against the integral."""
    step, length, height, period = 0.5, 2048, 3.0, 9.0
    times, peak = step * np.arange(length), 2 * np.pi / 9.0
    window = np.hanning(length)
    frequencies = 2 * np.pi * np.fft.rfftfreq(length, step)
    power = []
    for seed in range(150):
        elevation = jonswap_sea(height, period, 1.0, seed).elevation_m(times, np.zeros((length, 3)))
        power.append(2 * np.abs(np.fft.rfft(window * elevation)) ** 2 / (length * np.sum(window**2)))
    power, shape = np.array(power), lambda w: float(jonswap_shape(np.array(w), peak))
    scale = (height / 4) ** 2 / quad(shape, 0.1, 10, points=(peak,), limit=200)[0]
    for low, high in ((0.7, 0.85), (0.85, 0.95), (0.95, 1.05), (1.05, 1.2), (1.2, 1.6), (1.6, 2.5), (2.5, 4.5)):
        inside = (frequencies >= low * peak) & (frequencies < high * peak)
        edges = frequencies[inside][[0, -1]] + np.array([-0.5, 0.5]) * frequencies[1]
        asked = scale * quad(shape, *edges, limit=200)[0]
        found = power[:, inside].sum(axis=1)
        error = found.std(ddof=1) / np.sqrt(len(found))
        assert abs(found.mean() - asked) < 4 * error + 0.02 * asked, (low, high)  # 2 %: leakage of the window


@settings(max_examples=40)
@given(HEADINGS, HEADINGS, st.floats(0, 8))
def test_vessel_follows_waves_much_longer_than_itself(heading, direction, speed):
    """60 s waves are 5.6 km long: heave is the elevation, and the deck lies in the surface."""
    sea, times = one_wave(60.0, direction), np.linspace(0, 60, 13)
    way = passage(times, heading, speed)
    motion = moved(sea, BOAT, way)
    height = sea.elevation_m(times, way.positions_m)
    np.testing.assert_allclose(motion.heave_m, height, atol=0.02)
    for body, points in (([1.0, 0, 0], "bow"), ([0, 1.0, 0], "port")):
        side = world_R_vehicle(heading) @ np.array(body)
        rise = sea.elevation_m(times, way.positions_m + side) - height
        deck = (np.swapaxes(vehicle_R_nominal(motion.angles_rad), 1, 2) @ np.array(body))[:, 2]
        np.testing.assert_allclose(deck, rise, atol=0.04 * sea.wave_numbers_rad_m[0], err_msg=points)


def test_wave_ahead_lifts_the_bow_and_wave_to_port_lifts_port():
    crest = Sea(np.array([2 * np.pi / 12]), np.array([1.0]), np.array([-0.5]), 0.0)  # its crest is a bit along w1
    for heading, angle in ((0.0, 1), (-np.pi / 2, 0)):  # towards it; it to port
        motion = moved(crest, BOAT, passage(np.zeros(1), heading))
        assert motion.angles_rad[0, angle] < -0.01
        assert abs(motion.angles_rad[0, 1 - angle]) < 1e-9


@pytest.mark.parametrize(("speed", "relative"), [(0.0, np.pi), (5.0, np.pi), (5.0, 0.0), (14.0, 0.0)])
@pytest.mark.parametrize("period", [3.0, 5.0, 8.0])
def test_heave_and_pitch_amplitudes_are_the_closed_forms_in_head_and_following_seas(speed, relative, period):
    """Jensen, Mansour & Olsen (2004), written out as printed."""
    hull, w = Hull(40.0, 9.0), 2 * np.pi / period
    length, beam, draught = hull.length_m, hull.beam_m, hull.draught_m
    k = w**2 / GRAVITY_M_S2
    froude = speed / np.sqrt(GRAVITY_M_S2 * length)
    alpha = 1 - froude * np.sqrt(k * length) * np.cos(relative)
    effective = abs(k * np.cos(relative))
    a = 2 * np.sin(k * beam * alpha**2 / 2) * np.exp(-k * draught * alpha**2)
    f = np.sqrt((1 - k * draught) ** 2 + (a**2 / (k * beam * alpha**3)) ** 2)
    eta = 1 / np.sqrt((1 - 2 * k * draught * alpha**2) ** 2 + (a**2 / (k * beam * alpha**2)) ** 2)
    kappa, half = np.exp(-effective * draught), effective * length / 2
    heave = eta * kappa * f * np.sin(half) / half
    pitch = eta * kappa * f * 24 / ((effective * length) ** 2 * length) * (np.sin(half) - half * np.cos(half))
    found = response(hull, np.array([w]), np.array([[alpha * w]]), np.array([relative]))
    assert abs(found.heave[0, 0]) == pytest.approx(abs(heave), rel=1e-9)
    assert abs(found.pitch[0, 0]) == pytest.approx(abs(pitch), rel=1e-9)


def test_roll_and_hull_answer_at_their_periods_and_the_seed_decides_the_sea():
    period = BOAT.roll_period_s
    assert period == pytest.approx(2 * (0.373 + 0.069 - 0.00516) * 4 / np.sqrt(0.4))
    w = 2 * np.pi / period * np.linspace(0.5, 1.5, 401)
    slope = w**2 / GRAVITY_M_S2 * np.exp(-(w**2) / GRAVITY_M_S2 * BOAT.draught_m)
    magnified = abs(response(BOAT, w, w[None], np.array([np.pi / 2])).roll[0]) / slope
    assert w[magnified.argmax()] == pytest.approx(2 * np.pi / period, rel=0.05)
    assert magnified.max() == pytest.approx(1 / (2 * floating.ROLL_DAMPING), rel=0.1)
    # The phase falls with time as e^(−i ω_e t), so that a lag is a positive angle where ω_e is positive.
    for encounter in (1.2, -1.2):
        found = response(Hull(10, 4), np.array([1.0]), np.array([[encounter]]), np.array([np.pi / 2]))
        for lag in np.angle([found.heave[0, 0], 1j * found.roll[0, 0]]) * np.sign(encounter):
            assert 0 < lag < np.pi
    # Head seas of 4 s at 6 m/s: met at ω + k U.
    sea, speed = one_wave(4.0), 6.0
    w, k = sea.frequencies_rad_s, sea.wave_numbers_rad_m
    met = w + k * speed
    motion = moved(sea, BOAT, passage(np.linspace(0, 2 * np.pi / met[0], 40, endpoint=False), np.pi, speed))
    answer = response(BOAT, w, met[None], np.array([np.pi]))
    assert np.sqrt(2) * motion.heave_m.std() == pytest.approx(abs(answer.heave[0, 0]), rel=1e-6)
    assert np.sqrt(2) * motion.angles_rad[:, 1].std() == pytest.approx(abs(answer.pitch[0, 0]), rel=1e-6)
    way = passage(np.arange(0, 100, 0.7), 1.1, 4.0)
    sea = jonswap_sea(1.0, 5.0, 0.2, 7)
    whole = moved(sea, BOAT, way)
    for part in (slice(0, 1), slice(40, 43), slice(99, None)):
        piece = moved(sea, BOAT, Passage(*(getattr(way, name)[part] for name in Passage.__annotations__)))
        np.testing.assert_array_equal(piece.heave_m, whole.heave_m[part])
        np.testing.assert_array_equal(piece.angles_rad, whole.angles_rad[part])
    times = np.arange(50.0)
    way = passage(times)
    one, same, other = (jonswap_sea(1.0, 6.0, 0.0, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.phases_rad, same.phases_rad)
    assert (one.elevation_m(times, way.positions_m) != other.elevation_m(times, way.positions_m)).all()
    both = floating.FloatingVessels(one, {"a": BOAT, "b": BOAT})
    np.testing.assert_array_equal(both.motion("a", way).heave_m, both.motion("b", way).heave_m)


@settings(max_examples=40)
@given(HEADINGS, st.floats(0, 15), st.floats(0.5, 400), st.floats(0.2, 60))
def test_no_wave_moves_a_hull_by_much_more_than_itself_but_at_resonance(relative, speed, length, beam):
    w = np.geomspace(0.1, 20, 300)
    encounter = w - w**2 / GRAVITY_M_S2 * speed * np.cos(relative)
    found = response(Hull(length, beam), w, encounter[None], np.array([relative]))
    assert np.isfinite(found.heave).all() and np.isfinite(found.roll).all() and np.isfinite(found.pitch).all()
    assert abs(found.heave).max() < 5


@pytest.mark.parametrize(("relative", "sign"), [(np.pi, 1), (0.0, -1)])
def test_motion_peaks_at_the_frequency_of_encounter(relative, sign):
    """Swell of one frequency, nearly: the peak of the heave is at ω + k U in head seas and at ω − k U in following."""
    speed, period = 5.0, 9.0
    times = 0.5 * np.arange(2048)
    peak = 2 * np.pi / period
    met = peak + sign * peak**2 / GRAVITY_M_S2 * speed
    power = 0
    for seed in range(8):
        motion = moved(jonswap_sea(1.0, period, 0.0, seed, peakedness=10), BOAT, passage(times, relative, speed))
        power = power + np.abs(np.fft.rfft(np.hanning(len(times)) * motion.heave_m)) ** 2
    frequencies = 2 * np.pi * np.fft.rfftfreq(len(times), 0.5)
    assert frequencies[np.convolve(power, np.ones(5), "same").argmax()] == pytest.approx(met, rel=0.06)
    assert abs(met - peak) > 0.2 * peak


SWELL = {"spectrum": "jonswap", "significant_height_m": 1.5, "peak_period_s": 6, "direction_rad": 0.5}


def own_ship_scene(folder, waves):
    """Own ship with a camera, another vessel before it, and a camera ashore."""
    own, other = [[0, 60, -30], [7.5, 60, -10], [30, 50, 60]], [[0, 90, -30], [30, 90, 90]]
    boats = {"own": ([14, 4, 3], own), "other": ([14, 4, 3], other)}
    ashore = camera_keys(pose={"position_m": [0, 0, 10]})
    bow = camera_keys(mount={"vessel": "own", "position_m": [7, 0, 3], "yaw_rad": -1.5})
    return write_scene(folder, boats, 30, cameras={"C0": ashore, "bow": bow}, waves=waves)


def test_vessels_and_their_cameras_heave_together_however_steps_are_split(tmp_path):
    scene, steps = load_scene(own_ship_scene(tmp_path, SWELL)), np.arange(30)
    _, bow = scene.cameras
    sight = scene.sight(bow, steps)
    heave = sight.poses.positions_m[:, 0, 2]
    lever = sight.world_R_vessel[:, 0] @ np.array([7.0, 0, 3])
    np.testing.assert_allclose(sight.camera_poses.positions_m, sight.poses.positions_m[:, 0] + lever, atol=1e-12)
    assert heave.std() > 0.1 and (sight.poses.positions_m[:, 1, 2] == 0).all()  # only own ship is moved
    additive = load_scene(own_ship_scene(tmp_path, {**SWELL, "composition": "additive"})).sight(bow, steps)
    rise = additive.camera_poses.positions_m[:, 2] - additive.poses.positions_m[:, 0, 2]
    np.testing.assert_allclose(rise, 3.0, atol=1e-12)  # the heave and not the lever arm
    everybody = load_scene(own_ship_scene(tmp_path, {**SWELL, "apply_to": "all"}))
    for camera in everybody.cameras:
        whole = everybody.sight(camera, steps)
        assert (whole.poses.positions_m[:, 1, 2] != 0).all()
        np.testing.assert_array_equal(whole.poses.positions_m[:, 0, 2], heave)
        for part in (np.arange(0, 7), np.arange(7, 8), np.arange(8, 30), np.array([3, 11, 29])):
            piece = everybody.sight(camera, part)
            np.testing.assert_array_equal(piece.poses.positions_m, whole.poses.positions_m[part])
            np.testing.assert_array_equal(piece.world_R_vessel, whole.world_R_vessel[part])
            np.testing.assert_array_equal(piece.camera_poses.positions_m, whole.camera_poses.positions_m[part])
    every, own = everybody.motion.at(steps), everybody.own_motion.at(steps)  # where the others stay on calm water
    np.testing.assert_array_equal(own.poses.positions_m[:, 0], every.poses.positions_m[:, 0])
    np.testing.assert_array_equal(own.world_R_vessel[:, 0], every.world_R_vessel[:, 0])
    assert not own.angles_rad[:, 1].any() and every.angles_rad[:, 1].all(axis=0)[:2].all()


def test_a_camera_that_a_vessel_reaches_in_waves_alone_is_refused_and_seas_that_cannot_be_are_named(tmp_path):
    path = own_ship_scene(tmp_path, {**SWELL, "apply_to": "all"})
    data = json.loads(path.read_text())
    data["cameras"]["C0"]["pose"]["position_m"] = [90, -15, 3.2]  # 0.2 m above the other's roof
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"cameras\.C0: is inside vessel 'other' at time "):
        load_scene(path)
    path.write_text(json.dumps({**data, "waves": SWELL}))
    load_scene(path)
    for waves, said in (
        ({**SWELL, "level": "small"}, "exactly one of level"),
        ({"spectrum": "jonswap"}, "needs significant_height_m; spectrum: jonswap needs peak_period_s"),
        ({**SWELL, "significant_height_m": 6}, "break before they are 6 m high: at most 3.75 m"),
        ({**SWELL, "interval_s": 1}, "interval_s goes with level"),
        ({"level": "small", "peakedness": 2}, "peakedness goes with spectrum"),
        ({**SWELL, "spectrum": "bretschneider"}, "jonswap"),
    ):
        with pytest.raises(InputError, match=said):
            load_scene(own_ship_scene(tmp_path, waves))
