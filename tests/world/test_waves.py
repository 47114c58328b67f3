"""Waves: the source's second-order process, cameras on vessels that they turn, and the examples of docs/waves.md."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from modsim3d.geometry.camera_poses import Mount, camera_R_parent, poses_on_board, vehicle_R_nominal, world_R_vehicle
from modsim3d.runs.files.table_columns import OWN_SHIP_SCHEMA
from modsim3d.scene.keys import ImuKeys, WavesKeys
from modsim3d.scene.reading import load_scene
from modsim3d.world.second_order_waves import LEVELS, SMALL_SIGMA_RAD, Axis, SecondOrderWaves, level_axes, second_order
from tests.scenes import camera_keys, write_scene

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
