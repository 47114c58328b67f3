"""Bearing, inverse range and position of boxes: one by one, by Monte Carlo, and the campaign's stored result."""

import json
from collections.abc import Iterable
from dataclasses import fields, replace
from itertools import product
from typing import Any

import numpy as np
import pytest

import modsim3d
from benchmarks.campaigns.positions import OUT, SCENES, SEEDS, look_at, page, position_law, problems
from modsim3d import ModsimError, Scene
from modsim3d.core.arrays import Array
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.file.reading import parse_detector
from modsim3d.geometry.camera_poses import heading_of, poses_on_board
from modsim3d.runs import locating
from modsim3d.runs.locating import MAX_RANGE_ERROR, Locations, locate, state_shares
from modsim3d.scene.cameras import own_ships_at
from tests.scenes import camera_keys

STEPS = 30
COVARIANCE = [[30.0, 5, 6, 0], [5, 9, 0, -6], [6, 0, 40, 8], [0, -6, 8, 20]]
OTHER_COVARIANCE = [[60.0, 0, -6, 0], [0, 16, 0, 4], [-6, 0, 90, 0], [0, 4, 0, 50]]
LENS = camera_keys(1280, 800)


def detector(**box_error: Any) -> dict[str, Any]:
    """A detector with two states of different errors, which misses a fifth in one and half in the other."""
    laws = {"clear": ([1, 2, -3, 4], COVARIANCE, 0.8), "haze": ([-4, 5, 2, -2], OTHER_COVARIANCE, 0.5)}
    return {
        "labels": ["Boat", "Ship"], "confidence_threshold": 0.2, "initial_state": "clear",
        "transition_matrix": [[0.9, 0.3], [0.1, 0.7]], "false_positives": {"model": "calibrated"},
        "states": {
            name: {
                "confusion": [[share, 0], [0, share], [1 - share, 1 - share]],
                "false_positive_labels": [0.5, 0.5],
                "false_discovery_rate": 0.2,
                "box_error": {"unit": "px", "mean": mean, "covariance": covariance, **box_error},
                "confidence": {"mean": 0.6, "std": 0.1},
            }
            for name, (mean, covariance, share) in laws.items()
        },
    }  # fmt: skip


def position_scene(**keys: Any) -> Scene:
    """The scene; keys of the scene file replace its own."""
    steps = np.arange(STEPS, dtype=float)
    positions, headings = np.zeros((STEPS, 3, 2)), np.zeros((STEPS, 3))
    positions[:, 0, 0], headings[:, 0] = 4 * steps, 0.2
    positions[:, 1] = np.stack([300 + 2 * steps, 40 + 0 * steps], axis=1)
    positions[:, 2] = [400, 20]
    mount = {"vessel": "flagship", "position_m": [8, 1, 7], "roll_rad": 0.1, "pitch_rad": 0.05, "yaw_rad": 0.1}
    attitude = {"attitude_noise_rad": 0.004, "attitude_bias_rad": 0.003}
    data: dict[str, Any] = {
        "seed": 3,
        "vessels": {
            "flagship": {"length_m": 20, "beam_m": 6, "air_draft_m": 6, "label": "Boat"},
            "mermaid": {"length_m": 12, "beam_m": 4, "air_draft_m": 5, "label": "Boat"},
            "leviathan": {"length_m": 80, "beam_m": 12, "air_draft_m": 20, "label": "Ship"},
        },
        "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 0.5},
        "cameras": {
            "bow": {**LENS, "distortion": {"k1": -0.1, "k2": 0.02, "p1": 0.001}, "mount": mount},
            "shore": {**LENS, "pose": {"position_m": [-50, 30, 20], "pitch_rad": 0.05}},
        },
        "waves": {"spectrum": "jonswap", "significant_height_m": 1.0, "peak_period_s": 5.0, "direction_rad": 1.0},
        "imu": {**attitude, "heading_noise_rad": 0.01, "heading_bias_rad": 0.005},
        "annotation": {"source": "analytic"}, "detector": detector(),
    }  # fmt: skip
    return Scene.from_dict(data | keys)


BOXES = np.array([[600.0, 380, 660, 430], [100, 420, 180, 470], [900, 350, 1200, 600], [500, 340, 530, 400]])
EXACT = {"covariance": np.zeros((4, 4)).tolist()}
NO_ERRORS = detector(mean=[0, 0, 0, 0], **EXACT)
INSIDE = 1.959964  # 95 % of a normal number
DRAWS, FEW_DRAWS = 20_000, 6_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return position_scene()


@pytest.fixture(scope="module")
def sharp() -> Scene:
    """The scene with a detector without errors and a perfect inertial unit."""
    return position_scene(detector=NO_ERRORS, imu={})


def box_with(box: Array, errors: Array) -> Array:
    """Boxes with errors of centre, width and height, shape (..., 4)."""
    centre, size = errors[..., :2], errors[..., 2:]
    return box + np.concatenate([centre - size / 2, centre + size / 2], axis=-1)


def one_by_one(scene: Scene, camera: str, step: int, box: Array) -> tuple[float, float, Array]:
    """Bearing of the centre, and inverse range and place of the foot, by solving for the point of the sea."""
    index = [each.name for each in scene.cameras].index(camera)
    pose = scene.at(step).sights[index].camera_poses
    rotation, centre = pose.camera_R_world[0], pose.positions_m[0]
    lens = scene.cameras[index].intrinsics
    middle, foot = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2], [(box[0] + box[2]) / 2, box[3]]
    ray, down = (rotation.T @ lens.unproject(point, 1.0) for point in (middle, foot))
    away = -centre[2] / down[2] * down
    bearing, inverse = float(heading_of(ray)), float(np.sign(-down[2]) / np.hypot(*away[:2]))
    return bearing, inverse, centre[:2] + np.array([np.cos(bearing), np.sin(bearing)]) / inverse


@pytest.mark.parametrize("camera", ["bow", "shore"])
def test_boxes_without_errors_are_where_their_rays_meet_the_sea(sharp: Scene, camera: str) -> None:
    steps = np.array([3, 17, 0, 29])
    found = locate(sharp, camera, steps, BOXES)
    for row, (step, box) in enumerate(zip(steps.tolist(), BOXES, strict=True)):
        bearing, inverse, place = one_by_one(sharp, camera, step, box)
        assert found.bearing_rad[row] == pytest.approx(bearing, abs=1e-9)
        assert found.inverse_range_per_m[row] == pytest.approx(inverse, rel=1e-9)
        assert found.bearing_std_rad[row] == found.inverse_range_std_per_m[row] == 0
        if inverse > 0:
            np.testing.assert_allclose(found.positions_m[row], place)
            np.testing.assert_allclose(found.position_covariances_m2[row], 0, atol=1e-12)
        else:
            assert np.isnan(found.positions_m[row]).all()


@pytest.mark.parametrize(("unit", "mean", "atol_rad", "atol_per_m"), [
    ("px", [4.0, -3, 10, 6], 0, 0), ("relative", [0.02, -0.01, 0.05, 0.03], 1e-4, 2e-5)
])  # fmt: skip
def test_the_mean_error_is_taken_out(sharp, unit, mean, atol_rad, atol_per_m):
    """A relative one to first order: the true size is the detected one less its mean error."""
    biased = position_scene(detector=detector(unit=unit, mean=mean, **EXACT), imu={})
    errors = np.array(mean) * (1 if unit == "px" else np.tile(BOXES[:, 2:] - BOXES[:, :2], 2))
    expected, found = locate(sharp, "shore", 0, BOXES), locate(biased, "shore", 0, box_with(BOXES, errors))
    np.testing.assert_allclose(found.bearing_rad, expected.bearing_rad, atol=atol_rad)
    np.testing.assert_allclose(found.inverse_range_per_m, expected.inverse_range_per_m, atol=atol_per_m)


def test_shares_of_states_are_those_of_the_long_run_and_errors_of_centre_and_foot_those_of_the_mixture(scene):
    model = parse_detector(detector())
    # 0.1 p = 0.3 (1 − p): three quarters of the time clear, in which 0.8 are seen and not 0.5
    np.testing.assert_allclose(state_shares(model), np.array([0.75 * 0.8, 0.25 * 0.5]) / (0.75 * 0.8 + 0.25 * 0.5))
    stuck = parse_detector(detector() | {"transition_matrix": [[1, 0], [0, 1]]})
    np.testing.assert_allclose(state_shares(stuck), [1, 0])
    periodic = parse_detector(detector() | {"transition_matrix": [[0, 1], [1, 0]]})
    np.testing.assert_allclose(state_shares(periodic), [0.8 / 1.3, 0.5 / 1.3])
    drawn = drawn_errors(scene, DRAWS) @ locating.FOOT_OF_ERRORS.T
    law = locating.foot_errors(scene.detector, BOXES[:1])
    std = np.sqrt(np.diag(law.covariances[0]))
    np.testing.assert_allclose((drawn.mean(axis=0) - law.means[0]) / std, 0, atol=4 / np.sqrt(DRAWS))
    whitened = (np.cov(drawn.T) - law.covariances[0]) / (std[:, None] * std)
    np.testing.assert_allclose(whitened, 0, atol=4 * np.sqrt(3 / DRAWS))  # of a kurtosis below 4


def drawn_errors(scene: Scene, count: int) -> Array:
    """Box errors of states drawn in their shares, shape (count, 4)."""
    rng, source = np.random.default_rng(5), BoxErrorSource.from_model(scene.detector)
    states = rng.choice(len(scene.detector.states), count, p=state_shares(scene.detector))
    return source.errors_px(states, np.full((count, 2), 50.0), rng.standard_normal((count, 4)))


@pytest.mark.parametrize(("camera", "attitude"), [("bow", "measured"), ("bow", "true"), ("shore", "measured")])
@pytest.mark.parametrize("sea", ["flat", "curved"])
def test_covariances_are_those_of_drawn_errors(scene: Scene, sea: str, camera: str, attitude: Any) -> None:
    """Boxes with drawn errors, seen from poses with drawn errors of the attitude, through a distorted lens."""
    curved, box = replace(scene, sea=sea), BOXES[0] + [0, 60, 0, 60]
    boxes = box_with(box, drawn_errors(curved, FEW_DRAWS))
    exact = replace(curved, detector=parse_detector(NO_ERRORS))
    drawn = replace(exact, imu=curved.imu if attitude == "measured" else type(curved.imu)())
    on_board = attitude == "measured" and camera == "bow"
    seeds = 30 if on_board else 1  # of the inertial unit: one for every draw would be slow
    views = [locate(replace(drawn, seed=seed), camera, 7, boxes[seed::seeds]) for seed in range(seeds)]
    place = locate(curved, camera, 7, box[None], attitude)
    stated = np.array([place.bearing_std_rad[0], place.inverse_range_std_per_m[0]])
    seen = np.cov(np.concatenate([(view.bearing_rad, view.inverse_range_per_m) for view in views], axis=1))
    tolerance = 4 * np.sqrt(2 / (seeds if on_board else FEW_DRAWS))
    np.testing.assert_allclose(np.sqrt(np.diag(seen)) / stated, 1, atol=tolerance / 2 + 0.01)
    assert abs((seen[0, 1] - place.covariance_rad_per_m[0]) / stated.prod()) < tolerance + 0.01


def test_a_heading_error_turns_bearings_and_nothing_else(scene: Scene) -> None:
    """The unit's errors at a step are those in the table of own ship's motion."""
    calm = position_scene(waves=None, detector=NO_ERRORS, imu={"heading_noise_rad": 0.02, "heading_bias_rad": 0.01})
    measured, true = (locate(calm, "bow", 5, BOXES, attitude) for attitude in ("measured", "true"))
    own = own_ships_at(calm, 5, 6)
    error = own.measured_attitudes_rad[0, 0, 2] - own.headings_rad[0, 0]
    assert abs(error) > 1e-3
    np.testing.assert_allclose(measured.bearing_rad - true.bearing_rad, error, atol=1e-9)
    np.testing.assert_allclose(measured.inverse_range_per_m, true.inverse_range_per_m, rtol=1e-9)
    np.testing.assert_allclose(measured.bearing_std_rad, np.hypot(0.02, 0.01), rtol=1e-6)
    np.testing.assert_allclose(measured.inverse_range_std_per_m, 0, atol=1e-12)


@pytest.mark.parametrize("composition", ["rigid", "additive"])
def test_poses_from_a_perfect_unit_are_the_true_ones(composition: str) -> None:
    still = position_scene(waves={"level": "huge", "composition": composition}, imu={})
    camera, steps = still.cameras[0], np.arange(STEPS)
    true, measured = (locating.Viewpoints.of(still, camera, steps, measured=known).poses() for known in (False, True))
    np.testing.assert_array_equal(true.camera_R_world, measured.camera_R_world)
    np.testing.assert_array_equal(true.positions_m, measured.positions_m)
    if composition == "rigid":  # a tracker can work the pose out from the table
        own = own_ships_at(still, 0, STEPS)
        roll, pitch, heading = own.measured_attitudes_rad[:, 0].T
        turns = np.stack([roll, pitch, 0 * roll], axis=-1)
        rebuilt = poses_on_board(camera.mount, own.positions_m[:, 0], heading, turns)
        np.testing.assert_allclose(rebuilt.camera_R_world, true.camera_R_world, atol=1e-12)
        np.testing.assert_allclose(rebuilt.positions_m, true.positions_m, atol=1e-9)


def with_shore_mount(scene: Scene, **angles: float) -> Scene:
    """The scene with the camera ashore alone, turned."""
    (shore,) = (camera for camera in scene.cameras if camera.name == "shore")
    return replace(scene, cameras=(replace(shore, mount=replace(shore.mount, **angles)),))


def test_bearings_about_half_a_turn_have_the_same_variance_and_a_cut_box_no_middle_or_no_foot(scene):
    """They jump from π to −π there; derivatives must not."""
    boxes = np.array([620.0, 370, 660, 430]) + np.linspace(-0.6, 0.6, 13)[:, None] * [1, 0, 1, 0]
    ahead, behind = (locate(each, "shore", 0, boxes) for each in (scene, with_shore_mount(scene, yaw_rad=np.pi)))
    assert (np.abs(behind.bearing_rad) > 3.1).all() and len({*np.sign(behind.bearing_rad)}) == 2
    np.testing.assert_allclose(behind.bearing_std_rad, ahead.bearing_std_rad, rtol=1e-6)
    np.testing.assert_allclose(behind.covariance_rad_per_m, ahead.covariance_rad_per_m, rtol=1e-3, atol=1e-12)
    boxes = np.array([[0.0, 400, 60, 460], [1200, 400, 1280, 460], [600, 700, 700, 800], [600, 0, 700, 450.0]])
    found = locate(scene, "shore", 0, boxes)
    columns = found.bearing_rad, found.bearing_std_rad, found.inverse_range_per_m, found.covariance_rad_per_m
    expected = [[True, True, False, False]] * 2 + [[False, False, True, False], [True, True, True, False]]
    assert np.isnan(columns).tolist() == expected and np.isnan(found.positions_m[:3]).all()


@pytest.mark.parametrize("side", [0, 2, 3])
def test_the_error_of_the_box_of_a_cut_vessel_does_not_make_it_whole(scene: Scene, side: int) -> None:
    """The true box ends at the image's edge; detected ones end anywhere around it, and then are cut there."""
    width, height = scene.cameras[1].intrinsics.image_size_px
    cut, whole = np.array([600.0, 400, 700, 480]), np.array([600.0, 400, 700, 480])
    edge = {0: 0, 2: width, 3: height}[side]
    cut[side], cut[side - 2] = edge, edge - np.sign(side - 1) * 100
    law, draws = scene.detector.states[0].box_error, np.random.default_rng(5)
    errors = draws.multivariate_normal(law.mean, law.covariance, FEW_DRAWS)
    given = []
    for box in (cut, whole):
        found = locate(scene, "shore", 0, np.clip(box_with(box, errors), 0, [width, height, width, height]))
        given.append(np.isfinite(found.inverse_range_per_m if side == 3 else found.bearing_rad).mean())
    assert given[0] < 0.01 and given[1] == 1


@pytest.mark.parametrize("roll_deg", [0, 44, -44, 46, -90, 180])
def test_boxes_of_a_camera_on_its_side_have_a_bearing_and_no_foot(scene: Scene, roll_deg: float) -> None:
    rolled = with_shore_mount(scene, roll_rad=np.deg2rad(roll_deg))
    found, given = locate(rolled, "shore", 0, np.array([[600.0, 420, 660, 480]])), abs(roll_deg) < 45
    assert np.isfinite(found.bearing_rad).all() and np.isfinite(found.bearing_std_rad).all()
    assert np.isfinite(found.inverse_range_per_m).all() == np.isfinite(found.inverse_range_std_per_m).all() == given
    assert given or np.isnan(found.positions_m).all()


@pytest.mark.parametrize("sea", ["flat", "curved"])
def test_a_position_is_given_where_the_share_of_the_error_is_small(scene: Scene, sea: str) -> None:
    bottom = np.arange(300.0, 790, 2)
    boxes = np.stack([0 * bottom + 600, bottom - 40, 0 * bottom + 660, bottom], axis=-1)
    found = locate(replace(scene, sea=sea), "shore", 0, boxes)
    share = found.inverse_range_std_per_m / found.inverse_range_per_m
    np.testing.assert_array_equal(np.isfinite(found.positions_m[:, 0]), (share > 0) & (share <= MAX_RANGE_ERROR))
    given = np.isfinite(found.positions_m[:, 0])
    assert given.any() and not given.all() and (found.inverse_range_per_m < 0).any()
    assert (np.linalg.eigvalsh(found.position_covariances_m2[given]) > 0).all()
    away = found.positions_m[given] - [-50, 30]
    np.testing.assert_allclose(1 / np.hypot(*away.T), found.inverse_range_per_m[given])
    np.testing.assert_allclose(heading_of(away), found.bearing_rad[given], atol=1e-12)


def test_first_order_ellipses_hold_where_they_are_given_and_rows_do_not_depend_on_each_other(scene):
    """Normal errors of the foot: what the threshold promises, and what it spares a tracker."""
    errors, exact, tails = drawn_errors(scene, DRAWS), position_scene(detector=NO_ERRORS), {}
    for bottom in (760.0, 362.0):  # a position is given, and not
        box = np.array([600.0, bottom - 40, 660, bottom])
        truth, found = locate(exact, "shore", 0, box[None]), locate(scene, "shore", 0, box_with(box, errors))
        inverse, estimate = truth.inverse_range_per_m[0], found.inverse_range_per_m
        assert (found.inverse_range_std_per_m[0] / inverse < MAX_RANGE_ERROR) == (bottom == 760)
        error = (1 / estimate - 1 / inverse) * estimate**2 / found.inverse_range_std_per_m
        error[estimate <= 0] = np.inf
        tails[bottom] = np.mean(error < -INSIDE), np.mean(error > INSIDE)
    assert abs(sum(tails[760.0]) - 0.05) < 0.01 and tails[362.0][0] > 2 * 0.025 > 0.01 > tails[362.0][1]
    steps = np.array([3, 17, 3, 29])
    whole = locate(scene, "bow", steps, BOXES)
    for row, step in enumerate(steps.tolist()):
        alone = locate(scene, "bow", step, BOXES[row : row + 1])
        for each in fields(Locations):
            together, one = getattr(whole, each.name)[row], getattr(alone, each.name)[0]
            np.testing.assert_allclose(together, one, rtol=1e-9, atol=1e-15, err_msg=each.name)
    assert len(whole) == 4 and len(locate(scene, "bow", 0, np.empty((0, 4)))) == 0
    assert locate(scene, "bow", 0, np.empty((0, 4))).position_covariances_m2.shape == (0, 2, 2)


def test_what_cannot_be_located_is_said(scene: Scene) -> None:
    for change, said in (
        ({"camera": "stern"}, "there is no camera 'stern'"),
        ({"step": STEPS}, f"there is no step {STEPS}; the scene has steps 0 to {STEPS - 1}"),
        ({"step": -1}, "there is no step -1"),
        ({"step": 0.5}, "step: one whole number is needed"),
        ({"step": [0, 1]}, "step: one whole number is needed, or 4"),
        ({"boxes_px": [1, 2, 3, 4]}, r"boxes_px: boxes of shape \(n, 4\) are needed \(got \(4,\)\)"),
        ({"attitude": "guessed"}, "attitude: 'guessed' is neither 'true' nor 'measured'"),
    ):
        with pytest.raises(ModsimError, match=said):
            modsim3d.locate(scene, **{"camera": "bow", "step": 0, "boxes_px": BOXES, **change})
    with pytest.raises(TypeError, match="scene: a Scene is needed"):
        modsim3d.locate("strait", "bow", 0, BOXES)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def stored() -> dict[str, Any]:
    return json.loads((OUT / "positions.json").read_text(encoding="utf-8"))


def test_the_stored_result_is_complete_and_within_bounds_and_so_is_a_small_campaign(stored):
    assert problems(stored["rows"]) == [] and stored["seeds"] == SEEDS and stored["most_range_error"] == MAX_RANGE_ERROR
    seen = {(row["scene"], row["sea"], row["attitude"], row["errors"]) for row in stored["rows"]}
    assert {name for name, *_ in seen} == set(SCENES) and len(SCENES) == 5
    for name in SCENES:
        attitudes = {attitude for scene, _, attitude, _ in seen if scene == name}
        assert attitudes in ({"ashore"}, {"true", "measured"})
        assert set(product([name], ("flat", "curved"), attitudes, (1.0, 0.2))) <= seen
    assert (OUT / "positions.md").read_text(encoding="utf-8") == page(stored)
    row = stored["rows"][0]
    for change in ({"mean": 0.3}, {"std": 1.2}, {"inside": 0.9}):
        assert len(problems([row | {"bearing": row["bearing"] | change}])) == 1
    assert len(problems([row | {"given": 5000, "inside_given": 0.9}])) == 1
    # Where no position is given it would be wrong, as in Simulation 1 with the thesis's errors.
    (row,) = (row for row in stored["rows"] if (row["scene"], row["sea"], row["errors"]) == ("simulation_1", "flat", 1))
    assert row["given"] == 0 and row["inside_others"] < 0.92
    for name in SCENES:
        rows = [row for row in stored["rows"] if row["scene"] == name and row["given"] >= 1000]
        assert rows, name
        for row in rows:
            assert row["inside_given"] > row["inside_others"] - 0.02, (name, row["sea"], row["errors"])
    row = look_at("strait", "curved", "measured", 1.0, 20, 4)
    for key in ("bearing", "inverse_range"):
        assert row[key]["n"] > 300
        assert abs(row[key]["mean"]) < 0.9 and 0.5 < row[key]["std"] < 1.5 and row[key]["inside"] > 0.85, row[key]
    # The error over its stated deviation is −z (1 + ε z): its mean is −ε.
    for row in position_law(100_000):
        if row["share"] <= 0.15:  # beyond, some inverse ranges are negative
            assert row["mean"] == pytest.approx(-row["share"], abs=0.02) and row["short"] > 0.025 > row["far"]


@pytest.mark.parametrize(("errors", "column"), [(1.0, 1), (0.2, 2)])
def test_the_page_has_the_numbers_of_the_stored_result(stored: dict[str, Any], errors: float, column: int) -> None:
    lines = (OUT.parent / "positions.md").read_text(encoding="utf-8").splitlines()
    start = next(at for at, line in enumerate(lines) if line.startswith("| | Own detector"))
    cells = [line.split(" | ")[column].removesuffix(" |") for line in lines[start + 2 : start + 7]]
    rows = [row for row in stored["rows"] if row["errors"] == errors]
    pairs = [row[key] for row in rows for key in ("bearing", "inverse_range")]
    means, given = [pair["mean"] for pair in pairs], [row["inside_given"] for row in rows if row["given"]]
    expected = [
        _percents(row["bearing"]["inside"] for row in rows),
        _percents(row["inverse_range"]["inside"] for row in rows),
        f"{min(means):+.2f} to {max(means):+.2f}".replace("-", "−"),
        _percents(given),
        _percents(row["inside_others"] for row in rows),
    ]
    assert [cell[: len(text)] for cell, text in zip(cells, expected, strict=True)] == expected
    if errors == 1.0:
        assert {row["scene"] for row in rows if row["given"]} == {"strait"}
        offsets = {line.split(" | ")[0].strip("| "): line.split(" | ")[1] for line in lines if line.count(" | ") == 2}
        for row in (row for row in rows if row["sea"] == "flat"):
            name = row["scene"].replace("simulation_", "Simulation ")
            assert offsets[name] == f"{row['centre_beyond_foot_m']:.1f} m"


def _percents(values: Iterable[float]) -> str:
    known = sorted(100 * value for value in values)
    return f"{known[0]:.1f} to {known[-1]:.1f} %"
