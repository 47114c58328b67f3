"""Own ship's motion and its inertial unit, against motions whose rates and forces are known."""

import json
from dataclasses import fields, replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from modsim3d import InputError, load_scene, open_run, run_scene
from modsim3d.core.arrays import Array
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.runs.files.overwrite import listed_file
from modsim3d.runs.files.table_columns import MEASURED_ATTITUDE
from modsim3d.scene.cameras import own_ships_at, true_attitudes
from modsim3d.world.floating_vessels import GRAVITY_M_S2, Motion
from modsim3d.world.poses.base import generated_timestamps
from modsim3d.world.poses.circular import CircularMotion
from modsim3d.world.vessel_motion import Imu, Waves
from tests.scenes import camera_keys, write_scene

STEPS, STEP_S = 120, 0.05
TIMES_S = STEP_S * np.arange(STEPS)
UNITS = {"rate_{}_rad_s": 0.02, "acceleration_{}_m_s2": 0.3, "attitude_{}_rad": 0.01, "heading_{}_rad": 0.03}
"""Keys of the unit's noise and bias, and the values that are tried."""
UP = [0.0, 0.0, GRAVITY_M_S2]


class Swinging:
    """Harmonic motion that is the same wherever a vessel is: amplitudes of heave, roll, pitch and yaw."""

    needs_velocity = False

    def __init__(self, heave=0.0, roll=0.0, pitch=0.0, yaw=0.0, rate=1.3):
        self.amplitudes, self.rate = np.array([heave, roll, pitch, yaw]), rate

    def motion(self, vessel, passage):
        swing = np.sin(self.rate * passage.times_s)[:, None] * self.amplitudes
        return Motion(swing[:, 0], swing[:, 1:])


@pytest.fixture
def scene(tmp_path):
    """Own ship at rest in a calm sea."""
    still = {"own": {"center_position_m": [3.0, -2.0, 0.0], "heading_rad": 0.4}}
    (tmp_path / "poses.json").write_text(json.dumps(dict.fromkeys(generated_timestamps(STEPS, STEP_S), still)))
    on_board = {"vessel": "own", "position_m": [7, 0, 3]}
    cameras = {"C0": camera_keys(pose={"position_m": [0, 0, 10]}), "bow": camera_keys(mount=on_board)}
    keys = {"poses": {"file": "poses.json"}, "annotation": {"source": "analytic"}, "cameras": cameras}
    boats = {"own": ([14, 4, 3], []), "other": ([9, 3, 2], [])}
    return load_scene(write_scene(tmp_path, boats, STEPS, time_step_s=None, **keys))


def on_a_circle(scene, radius=40.0, rate=0.2):
    """The scene with its vessels on a circle about the origin."""
    times = generated_timestamps(STEPS, STEP_S)
    return replace(scene, poses=CircularMotion(times, (0.0, 0.0), np.full(2, radius), np.full(2, rate), np.zeros(2)))


def own_ship(scene):
    return own_ships_at(scene, 0, STEPS)


def errors(own):
    """Errors of the rates, forces and attitudes of one own ship in `UNITS`, shape (steps, 9)."""
    true = own.rates_rad_s, own.forces_m_s2, true_attitudes(own.headings_rad, own.angles_rad)
    measured = own.measured_rates_rad_s, own.measured_forces_m_s2, own.measured_attitudes_rad
    off = np.concatenate([np.subtract(*both)[:, 0] for both in zip(measured, true, strict=True)], axis=1)
    return off / np.repeat([*UNITS.values()], [3, 3, 2, 1])


def test_motions_are_felt_with_their_signs_and_rates_carry_the_attitude_and_errors_have_the_asked_spread(scene):
    """Integrated as a strapdown navigator would: R(t + h) = R(t) exp(ω h), with the mean of two rates."""
    rough = replace(on_a_circle(scene), waves=Waves(Swinging(roll=0.3, pitch=0.1, yaw=0.05)))
    rates = own_ship(rough).rates_rad_s[:, 0]
    attitude: Array = rough.motion.at(np.arange(STEPS)).world_R_vessel[:, 0]
    turn = Rotation.from_matrix(attitude[1])
    for step in range(1, STEPS - 2):
        turn = turn * Rotation.from_rotvec(STEP_S * (rates[step] + rates[step + 1]) / 2)
    assert (turn.inv() * Rotation.from_matrix(attitude[STEPS - 2])).magnitude() < 2e-3
    imu = Imu((1.0, 2.0, 3.0), *np.arange(1, 9) / 50)
    noisy = replace(on_a_circle(scene), waves=Waves(Swinging(0.2, 0.3, 0.1)), imu=imu)
    whole = own_ship(noisy)
    for first, stop in ((0, 1), (1, 2), (0, 2), (57, 80), (STEPS - 2, STEPS - 1), (STEPS - 1, STEPS)):
        part = own_ships_at(noisy, first, stop)
        for name in (field.name for field in fields(whole) if field.name != "vessels"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[first:stop], err_msg=name)
    rough = replace(on_a_circle(scene), waves=Waves(Swinging(0.2, 0.3, 0.1, 0.05)))
    perfect, inclined = own_ship(rough), own_ship(replace(rough, imu=Imu(attitude_noise_rad=1, heading_noise_rad=1)))
    assert not errors(perfect).any()
    headings = perfect.headings_rad + perfect.angles_rad[..., 2]
    np.testing.assert_array_equal(perfect.measured_attitudes_rad[..., 2], headings)
    for name in ("measured_rates_rad_s", "measured_forces_m_s2", "angles_rad"):
        np.testing.assert_array_equal(getattr(inclined, name), getattr(perfect, name))
    noise, bias = (Imu(**{key.format(kind): unit for key, unit in UNITS.items()}) for kind in ("noise", "bias"))
    for error in np.split(errors(own_ship(replace(rough, imu=noise))), 3, axis=1):
        assert abs(error.mean()) < 4 / np.sqrt(error.size) and abs(np.mean(error**2) - 1) < 4 * np.sqrt(2 / error.size)
        assert abs(np.corrcoef(error[:-1].ravel(), error[1:].ravel())[0, 1]) < 4 / np.sqrt(error.size)
    biases = np.empty((200, 9))
    for seed in range(200):
        error = errors(own_ships_at(replace(scene, imu=bias, seed=seed), 0, 3))
        np.testing.assert_allclose(error, np.broadcast_to(error[0], error.shape), atol=3e-12)
        biases[seed] = error[0]
    np.testing.assert_allclose(np.mean(biases**2, axis=0), 1, atol=4 * np.sqrt(2 / 200))
    assert abs(np.mean(biases[:, :6] ** 2) - 1) < 4 * np.sqrt(2 / 1200)
    np.testing.assert_allclose(Imu(attitude_noise_rad=3, attitude_bias_rad=4).attitude_std_rad, [5, 5, 0])
    own = own_ship(scene)
    np.testing.assert_allclose(own.forces_m_s2, np.broadcast_to(UP, (STEPS, 1, 3)), atol=1e-12)
    np.testing.assert_array_equal(own.rates_rad_s, 0)
    np.testing.assert_array_equal(own.positions_m[:, 0], np.tile([3.0, -2.0, 0.0], (STEPS, 1)))
    np.testing.assert_array_equal(own.measured_forces_m_s2, own.forces_m_s2)
    # v² / r to port when it turns to port, to starboard otherwise; r = ± v / radius.
    for rate in (0.2, -0.2):
        own, speed = own_ship(on_a_circle(scene, 40.0, rate)), abs(rate) * 40.0
        # Its heading is along its way, and not in its wave angles.
        ahead, way = world_R_vehicle(own.headings_rad[:, 0])[:, :, 0], np.diff(own.positions_m[:, 0], axis=0)
        assert ((way * ahead[:-1]).sum(-1) > 0.999 * np.linalg.norm(way, axis=1)).all() and not own.angles_rad.any()
        np.testing.assert_allclose(own.rates_rad_s[:, 0], np.tile([0, 0, rate], (STEPS, 1)), atol=1e-12)
        expected = [0, np.sign(rate) * speed**2 / 40.0, GRAVITY_M_S2]
        np.testing.assert_allclose(own.forces_m_s2[1:-1, 0], np.tile(expected, (STEPS - 2, 1)), rtol=1e-4, atol=1e-6)
    # 3 m to port of a vessel that turns to port is 3 m nearer the centre.
    moved = replace(on_a_circle(scene), imu=Imu((0.0, 3.0, 2.0)))
    np.testing.assert_allclose(own_ship(moved).forces_m_s2[5, 0, 1], 0.2**2 * 37.0, rtol=1e-4)
    rate = 1.3
    sine, cosine = np.sin(rate * TIMES_S), np.cos(rate * TIMES_S)
    lifted = own_ship(replace(scene, waves=Waves(Swinging(heave=0.5))))
    expected = GRAVITY_M_S2 - 0.5 * rate**2 * sine
    np.testing.assert_allclose(lifted.forces_m_s2[1:-1, 0, 2], expected[1:-1], atol=1e-3)
    np.testing.assert_allclose(lifted.positions_m[:, 0, 2], 0.5 * sine)
    mast = own_ship(replace(scene, waves=Waves(Swinging(roll=0.2)), imu=Imu((0.0, 0.0, 10.0))))
    roll, turned = 0.2 * sine, 0.2 * rate * cosine
    across = 10 * 0.2 * -(rate**2) * sine - GRAVITY_M_S2 * np.sin(roll)  # its top goes to port with positive roll
    np.testing.assert_allclose(mast.forces_m_s2[1:-1, 0, 1], across[1:-1], atol=5e-3)
    inward = GRAVITY_M_S2 * np.cos(roll) - 10 * turned**2
    np.testing.assert_allclose(mast.forces_m_s2[1:-1, 0, 2], inward[1:-1], atol=5e-3)
    # Port down is left-handed about v1: p = −d roll / dt.
    amplitude, rate = 0.2, 1.3
    own = own_ship(replace(scene, waves=Waves(Swinging(roll=amplitude))))
    p = -amplitude * rate * np.cos(rate * TIMES_S)
    np.testing.assert_allclose(own.rates_rad_s[1:-1, 0, 0], p[1:-1], atol=1e-3 * rate * amplitude)
    np.testing.assert_allclose(own.rates_rad_s[:, 0, 1:], 0, atol=1e-12)
    roll = amplitude * np.sin(rate * TIMES_S)
    # Up, in body axes, leans away from the port side that is down.
    expected = GRAVITY_M_S2 * np.stack([0 * roll, -np.sin(roll), np.cos(roll)], axis=-1)
    np.testing.assert_allclose(own.forces_m_s2[:, 0], expected, atol=1e-9)
    expected = 0.1 * 1.3 * np.cos(1.3 * TIMES_S)
    for name, axis in (("pitch", 1), ("yaw", 2)):
        own = own_ship(replace(scene, waves=Waves(Swinging(**{name: 0.1}))))
        np.testing.assert_allclose(own.rates_rad_s[1:-1, 0, axis], expected[1:-1], atol=2e-4)
        np.testing.assert_allclose(np.delete(own.rates_rad_s[:, 0], axis, axis=1), 0, atol=1e-12)


def test_a_table_from_before_is_read_and_a_unit_without_an_own_ship_and_unknown_keys_are_errors(tmp_path, scene):
    run_scene(replace(scene, waves=Waves(Swinging(0.2, 0.3, 0.1, 0.05))), tmp_path / "run")
    path = tmp_path / "run" / "ownship.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(list(MEASURED_ATTITUDE)), path)
    data = json.loads((tmp_path / "run" / "run.json").read_text())
    data["files"]["ownship.parquet"] = listed_file(path)
    (tmp_path / "run" / "run.json").write_text(json.dumps(data))
    again = open_run(tmp_path / "run").table("ownship")
    assert again.column_names == table.column_names
    for name in table.column_names:
        assert again[name].equals(table[name]), name
    path = write_scene(tmp_path, {"boat": ([9, 3, 2], [[0, 50, 0], [9, 60, 0]])}, 3)
    data = json.loads(path.read_text())
    for imu, said in (
        ({"rate_noise_rad_s": 0.1}, "imu: no camera is mounted on a vessel"),
        ({"rate_noise": 0.1}, "imu.rate_noise: unknown key"),
        ({"rate_noise_rad_s": -1}, "imu.rate_noise_rad_s"),
        ({"heading_noise_rad": -0.1}, "imu.heading_noise_rad"),
        ({"attitude_rad": 0.1}, "imu.attitude_rad: unknown key"),
    ):
        path.write_text(json.dumps({**data, "imu": imu}))
        with pytest.raises(InputError, match=said):
            load_scene(path)


def test_a_run_has_a_row_for_each_step_and_own_ship_and_the_same_bytes_however_split(tmp_path, scene, monkeypatch):
    rough = replace(scene, waves=Waves(Swinging(0.2, 0.3)), imu=Imu(rate_noise_rad_s=0.01))
    run_scene(rough, tmp_path / "run")
    table, own = pq.read_table(tmp_path / "run" / "ownship.parquet"), own_ship(rough)
    assert table["vessel"].to_pylist() == ["own"] * STEPS
    assert table["timestamp"].to_pylist() == list(scene.timestamps(0, STEPS))
    columns = {
        "w3_m": own.positions_m[:, 0, 2],
        "roll_rad": own.angles_rad[:, 0, 0],
        "measured_p_rad_s": own.measured_rates_rad_s[:, 0, 0],
        "f3_m_s2": own.forces_m_s2[:, 0, 2],
    }
    for name, expected in columns.items():
        np.testing.assert_array_equal(table[name], expected, err_msg=name)
    run_scene(replace(scene, cameras=scene.cameras[:1]), tmp_path / "ashore")
    assert not (tmp_path / "ashore" / "ownship.parquet").exists()
    short = load_scene(tmp_path / "scene.yaml", steps=30)
    rough = replace(short, waves=Waves(Swinging(0.2, 0.3)), imu=Imu(rate_noise_rad_s=0.01, rate_bias_rad_s=0.1))
    written = []
    for steps in (1, 7, 30):
        monkeypatch.setattr("modsim3d.runs.pipeline.block_steps", lambda scene, steps=steps: steps)
        run_scene(rough, tmp_path / str(steps))
        written.append((tmp_path / str(steps) / "ownship.parquet").read_bytes())
    assert written[0] == written[1] == written[2]
    monkeypatch.undo()
    ashore, bow = scene.cameras
    second = replace(bow, name="second", mount=replace(bow.mount, vessel="other"))
    annotation = replace(scene.annotation, allow_camera_inside=True)
    both = replace(on_a_circle(scene), cameras=(ashore, bow, second), annotation=annotation)
    assert both.own_ships == (0, 1)
    run_scene(both, tmp_path / "both")
    table = pq.read_table(tmp_path / "both" / "ownship.parquet")
    assert table["vessel"].to_pylist()[:4] == ["own", "other"] * 2 and table["step"].to_pylist()[:4] == [0, 0, 1, 1]
