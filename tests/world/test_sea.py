"""Waves: the irregular sea and the source's second-order process, and what they do to vessels and cameras."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import lfilter

from modsim3d.core.errors import InputError
from modsim3d.geometry.camera_poses import Mount, camera_R_parent, poses_on_board, vehicle_R_nominal, world_R_vehicle
from modsim3d.runs.files.table_columns import OWN_SHIP_SCHEMA
from modsim3d.scene.keys import ImuKeys, WavesKeys
from modsim3d.scene.reading import load_scene
from modsim3d.world import floating_vessels as floating
from modsim3d.world.floating_vessels import GRAVITY_M_S2, Hull, Passage, Sea, jonswap_sea, jonswap_shape, response
from modsim3d.world.second_order_waves import LEVELS, SMALL_SIGMA_RAD, Axis, SecondOrderWaves, level_axes, second_order
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


FIGURE_7_13 = Axis(a=0.99, b=0.99, sigma_rad=1e-4)


def second_order_variance(axis, steps):
    """Variance of x'(t) from a zero start, for a = b: σ² Σ_{k=0}^{t−1} ((k + 1) aᵏ)². Each e reaches x' through the
    convolution of the two processes' impulse responses, Σ aʲ bᵏ⁻ʲ = (k + 1) aᵏ."""
    k = np.arange(steps)
    return float(axis.sigma_rad**2 * np.sum(((k + 1) * axis.a**k) ** 2))


def long_run_deviation(axis):
    """Standard deviation of x' in the long run, for a = b: σ √((1 + a²) / (1 − a²)³)."""
    a2 = axis.a**2
    return axis.sigma_rad * np.sqrt((1 + a2) / (1 - a2) ** 3)


def waves(axis=FIGURE_7_13, seed=0, interval_s=None):
    return SecondOrderWaves((axis, axis, axis), seed, interval_s)


def angles(motion, steps, vessel="own", step_s=0.1):
    number = np.arange(steps)
    return motion.angles(vessel, step_s * number, number)


def test_the_process_is_the_recursion_of_the_source_with_the_variance_of_figure_7_13():
    """Jessen & Mohr (2023), eq. 7.23, 7.24, written out as a loop."""
    noise, axis = np.random.default_rng(1).normal(size=500), Axis(0.97, 0.9, 1.0)
    x, y = 0.3, -0.2
    expected = []
    for e in noise:
        x = axis.a * x + e
        y = axis.b * y + x
        expected.append(y)
    found, state = second_order(noise, axis, (0.3, -0.2))
    np.testing.assert_allclose([*found, *state], [*expected, x, y], rtol=1e-12)
    first, _ = lfilter([1.0], [1.0, -axis.a], noise, zi=[axis.a * 0.3])
    second, _ = lfilter([1.0], [1.0, -axis.b], first, zi=[axis.b * -0.2])
    np.testing.assert_array_equal(found, second)
    assert state == (first[-1], second[-1])
    # Var x'(t) = σ² Σ ((k + 1) aᵏ)²: 1.65° at t = 100 and 2.87° in the long run; 1500 independent vessels.
    assert np.degrees(np.sqrt(second_order_variance(FIGURE_7_13, 100))) == pytest.approx(1.65, abs=0.005)
    assert np.degrees(long_run_deviation(FIGURE_7_13)) == pytest.approx(2.87, abs=0.005)
    motion = waves()
    both = [motion.angles(f"v{i}", np.zeros(2), np.array([100, 2000])) for i in range(500)]
    at_100, long_run = np.concatenate(both, axis=1)
    asked = second_order_variance(FIGURE_7_13, 100), long_run_deviation(FIGURE_7_13) ** 2
    for sample, variance in zip((at_100, long_run), asked, strict=True):
        standard_error = variance * np.sqrt(2 / len(sample))
        assert abs(np.mean(sample**2) - variance) < 4 * standard_error
        assert abs(sample.mean()) < 4 * np.sqrt(variance / len(sample))


def test_start_values_and_axes_are_kept_apart_and_angles_are_linear_between_intervals():
    found = angles(waves(Axis(start_rad=(0.001, 0.02))), 3)[:, 0]
    np.testing.assert_allclose(found, [0.02, 0.99 * 0.02 + 0.99 * 0.001, 0.99**2 * 0.02 + 2 * 0.99**2 * 0.001])
    whole = angles(waves(), 9000)
    motion = waves()
    for steps in (np.arange(5000, 5100), np.arange(10), np.arange(8990, 9000)):
        np.testing.assert_array_equal(motion.angles("own", 0.1 * steps, steps), whole[steps])
    motion = waves()
    own, other = angles(motion, 500), angles(motion, 500, "other")
    assert abs(np.corrcoef(np.diff(own[:, 0]), np.diff(other[:, 0]))[0, 1]) < 0.9
    assert (own != other)[1:].all()
    assert (own[1:, 0] != own[1:, 1]).all()
    assert (angles(waves(seed=1), 500) != own)[1:].all()
    np.testing.assert_array_equal(angles(waves(), 500), own)
    every_step = angles(waves(), 20)
    stretched = waves(interval_s=0.3)
    found = stretched.angles("own", np.arange(0, 58) * 0.1, np.arange(58))
    np.testing.assert_allclose(found[::3], every_step[:20], atol=1e-12)
    np.testing.assert_allclose(found[1], (2 * every_step[0] + every_step[1]) / 3, atol=1e-12)
    assert [axis.sigma_rad for axis in level_axes("small")] == list(SMALL_SIGMA_RAD)  # Table 9.8
    np.testing.assert_allclose([axis.sigma_rad for axis in level_axes("large")], [2e-4, 1.2e-4, 6e-5])  # Table 9.12
    assert sorted(LEVELS.values()) == list(LEVELS.values())


def test_angles_have_their_signs_and_cameras_and_their_vessels_roll_in_all_pictures(tmp_path):
    rolled, pitched, yawed = (vehicle_R_nominal(0.1 * np.eye(3)[i]).T for i in range(3))
    bow, port, up = range(3)
    assert rolled[up, port] < -0.09 and pitched[up, bow] < -0.09 and yawed[port, bow] > 0.09
    # Port sinks, so the camera looks down: its optical axis dips by the roll. The additive rule rolls it instead.
    abeam = Mount((0.0, 0.0, 10.0), yaw_rad=np.pi / 2, vessel="own")
    rolled, added = (board(abeam, (0.1, 0.0, 0.0), rule) for rule in ("rigid", "additive"))
    np.testing.assert_allclose(rolled.camera_R_world[0], camera_R_parent(0, 0.1, np.pi / 2 + 0.7), atol=1e-12)
    np.testing.assert_allclose(added.camera_R_world[0], camera_R_parent(0.1, 0, np.pi / 2 + 0.7), atol=1e-12)
    to_port = 10 * np.sin(0.1) * np.array([-np.sin(0.7), np.cos(0.7)])
    np.testing.assert_allclose(rolled.positions_m[0], [100 + to_port[0], 50 + to_port[1], 10 * np.cos(0.1)])
    np.testing.assert_allclose(added.positions_m[0], [100, 50, 10])
    turned = Mount((4.0, 2.0, 1.0), 0.01, 0.02, 0.3, "own")
    rigid, added = (board(turned, (0, 0, 0), rule) for rule in ("rigid", "additive"))  # without waves, the heading
    np.testing.assert_allclose(rigid.camera_R_world, added.camera_R_world, atol=1e-12)
    np.testing.assert_allclose(rigid.positions_m, added.positions_m, atol=1e-12)
    # The heading adds to the yaw (Jessen & Mohr (2023), eq. 7.20).
    np.testing.assert_allclose(rigid.camera_R_world[0], camera_R_parent(0.01, 0.02, 0.3 + 0.7), atol=1e-12)
    np.testing.assert_allclose(rigid.positions_m[0], world_R_vehicle(0.7) @ [4, 2, 1] + [100, 50, 0])
    boats = {"own": ([20, 6, 5], [[0, 100, -5], [20, 100, 5]]), "idle": ([9, 3, 2], [])}
    places = {"pose": {"position_m": [0, 0, 10]}}, {"mount": {"vessel": "own", "position_m": [10, 0, 5]}}
    cameras = {name: camera_keys(**place) for name, place in zip(("C0", "bow"), places, strict=True)}
    waves = {"roll": {"sigma_rad": 0, "start_rad": [0, 0.3]}}
    scene = load_scene(write_scene(tmp_path, boats, 12, cameras=cameras, waves=waves))
    ashore, bow = (scene.sight(camera, np.arange(3)).world_R_vessel[:, 0, :, 2] for camera in scene.cameras)
    np.testing.assert_allclose(ashore[0], [-np.sin(0.3), 0, np.cos(0.3)], atol=1e-12)  # along w2: port is −w1
    np.testing.assert_array_equal(bow, ashore)
    motion, other = (load_scene("simulation_2", steps=40).motion for _ in range(2))
    steps, later = np.array([3, 5]), np.array([5, 7])
    first = motion.at(steps)
    assert motion.at(steps.copy()) is first
    second = motion.at(later)
    np.testing.assert_array_equal(second.world_R_vessel, other.at(later).world_R_vessel)
    np.testing.assert_array_equal(second.poses.positions_m[0], first.poses.positions_m[1])
    with pytest.raises(ValueError, match="read-only"):
        second.poses.positions_m[0] = 0


def board(mount, waves_rad, composition="rigid"):
    return poses_on_board(mount, np.array([[100.0, 50.0, 0.0]]), np.array([0.7]), np.array([waves_rad]), composition)


@settings(max_examples=50)
@given(st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3), st.floats(-0.03, 0.03))
def test_rules_agree_for_a_forward_camera_at_small_angles(small, pitch):
    forward = Mount((0.0, 0.0, 0.0), pitch_rad=pitch, vessel="own")
    rigid, added = board(forward, small), board(forward, small, "additive")
    between = rigid.camera_R_world[0] @ added.camera_R_world[0].T
    angle = np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))
    assert angle <= 4 * max(map(abs, (*small, pitch))) ** 2 + 1e-7  # of second order


PAGE = (Path(__file__).resolve().parents[2] / "docs" / "waves.md").read_text(encoding="utf-8")
KEYS = {"waves": WavesKeys, "imu": ImuKeys}


def named(table: str) -> set[str]:
    """The code words in the first column of the table whose head begins so."""
    rows = PAGE[PAGE.index(table) :].split("\n\n")[0].splitlines()[2:]
    return {name for row in rows for name in re.findall(r"`([a-z0-9_]+)`", row.split("|")[1])}


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL))
def test_examples_are_valid(text):
    ((key, value),) = yaml.safe_load(text.replace("e-5", "e-05")).items()
    KEYS[key].model_validate(value)


def test_tables_name_every_key_and_every_column_of_own_ship():
    assert named("| Key | Unit | Default | Goes with") == set(WavesKeys.model_fields)
    assert named("| Key | Unit | Default | Meaning") == set(ImuKeys.model_fields)
    between = {"measured_q_rad_s", "measured_f2_m_s2"}  # inside the dots
    assert named("| Column | Unit | Meaning") | between == set(OWN_SHIP_SCHEMA.names)
