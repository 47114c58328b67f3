"""A camera by each form of its lens, and one that sees a circle of vessels (Jessen & Mohr (2023), Appendix B)."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d import InputError, camera_placement, load_scene
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.scene import Scene
from tests.scenes import write_scene

SIZE = {"image_size_px": [640, 480]}
K = [[800, 0, 310], [0, 790, 230], [0, 0, 1]]
NUMBERS = ", ".join(str(number) for row in K for number in row)
OPENCV = f"""%YAML:1.0
---
calibration_time: "Tue 02 Jun 2026 10:11:12"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {NUMBERS} ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -1.0e-01, 2.e-02, 1.0e-03, -2.0e-03, 0. ]
"""
CAMERA_INFO = f"""image_width: 640
image_height: 480
camera_name: bow
camera_matrix: {{rows: 3, cols: 3, data: [{NUMBERS}]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0]}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
"""
MESSAGE = f"height: 480\nwidth: 640\ndistortion_model: plumb_bob\nD: [-.1, .02, .001, -.002, 0]\nK: [{NUMBERS}]\n---\n"
KALIBR = """bow:
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [800, 790, 310, 230]
  resolution: [640, 480]
"""
KALIBR += KALIBR.replace("bow", "stern").replace("790", "400")
MATRIX = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": [n for row in K for n in row]}
SOLVED = {"rows": 1, "cols": 5, "data": [-0.1, 0.02, 0.001, -0.002, 0.0]}
JSON = {"image_width": 640, "image_height": 480, "camera_matrix": MATRIX, "distortion_coefficients": SOLVED}
FILES = {"opencv": OPENCV, "ros": CAMERA_INFO, "message": MESSAGE, "kalibr": KALIBR, "json": json.dumps(JSON, indent=1)}
FILES |= {
    f"python {key}": OPENCV.replace("distortion_coefficients", key) for key in ("dist_coeffs", "dist", "distCoeffs")
}


def scene_with(folder: Path, lens: dict[str, Any], place: dict[str, Any] | None = None, **options: Any) -> Scene:
    """A boat of 10 × 4 × 3 m, 100 m ahead of a camera that is 5 m up at w1 = 0 and w2 = 0."""
    cameras = {"bow": {**lens, "pose": {"position_m": [0, 0, 5], **(place or {})}}}
    boats = {"boat": ([10, 4, 3], [[0, 100, 0], [9, 100.001, 0]])}
    annotation = {"mode": 0, "source": "analytic"}
    return load_scene(write_scene(folder, boats, 1, cameras=cameras, annotation=annotation), **options)


def box_of(scene: Scene) -> list[float]:
    box: list[float] = truth_block(scene, 0, 1, None).full_boxes_px[0].tolist()
    return box


@pytest.mark.parametrize("name", FILES)
def test_a_calibration_file_of_each_program_is_that_camera_and_its_copy_needs_no_file(tmp_path, name: str) -> None:
    """A point 100 m ahead, 20 m to starboard and 5 m down: x = 0.2, y = 0.05, r² = 0.0425."""
    file = tmp_path / ("solved.json" if name == "json" else "solved.yaml")
    file.write_text(FILES[name])
    scene = scene_with(tmp_path, {"calibration": file.name})
    r2, x, y = 0.0425, 0.2, 0.05
    radial = 1 - 0.1 * r2 + 0.02 * r2**2
    across = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    down = y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y
    by_hand = [310.5 + 800 * across, 230.5 + 790 * down]
    np.testing.assert_allclose(scene.cameras[0].intrinsics.project([20, 5, 100]), by_hand, atol=1e-9)
    assert scene.cameras[0].intrinsics.image_size_px == (640, 480) and file in scene.copy.read
    copy = scene.copy.write(tmp_path / "copy")
    file.unlink()
    again = load_scene(copy)
    assert (again.cameras, again.sha256) == (scene.cameras, scene.sha256)


def test_a_box_is_where_a_hand_calculation_has_it_and_degrees_are_radians(tmp_path):
    """The near side is at 95 m, 2 m to either side, 5 m down at the water; the far edge of the top is at 105 m and 2 m
    down. OpenCV counts from the centre of the first pixel, so 310 is 310.5 pixels from the edge of the image."""
    view = {"hfov_deg": 2 * math.degrees(math.atan(0.4))}  # 320 / 800
    tall = {"vfov_deg": 2 * math.degrees(math.atan(0.3))}  # 240 / 800
    for lens, (fx, fy), (x, y) in (
        ({"K": K}, (800, 790), (310.5, 230.5)),
        ({"focal_px": [800, 790], "principal_point_px": None}, (800, 790), (320, 240)),
        ({"focal_px": [800, 790], "principal_point_px": [310, 230]}, (800, 790), (310, 230)),
        ({"focal_length_m": 0.008, "pixel_size_m": [1e-5, 1e-5]}, (800, 800), (320, 240)),
        (view, (800, 800), (320, 240)),
        (tall, (800, 800), (320, 240)),
    ):
        by_hand = [x - fx * 2 / 95, y + fy * 2 / 105, x + fx * 2 / 95, y + fy * 5 / 95]
        np.testing.assert_allclose(box_of(scene_with(tmp_path, {**SIZE, **lens})), by_hand, atol=1e-3)
    for degrees in (5.0, 60.0, 90.0, 120.0):
        scene = scene_with(tmp_path, {**SIZE, "hfov_deg": degrees, "principal_point_px": [250, 240]})
        f, _ = scene.cameras[0].intrinsics.focal_px
        assert math.degrees(math.atan(250 / f) + math.atan(390 / f)) == pytest.approx(degrees)
    file = {**SIZE, "focal_length_m": 0.008, "pixel_size_m": [1e-5, 1e-5], "principal_point_px": [320, 240]}
    plain = scene_with(tmp_path, file, {"yaw_rad": 0.1, "pitch_rad": 0.2})
    turned = scene_with(tmp_path, file, {"yaw_deg": math.degrees(0.1), "pitch_deg": math.degrees(0.2)})
    assert turned.cameras[0].mount.pitch_rad == pytest.approx(0.2) == plain.cameras[0].mount.pitch_rad
    assert turned.cameras[0].mount.yaw_rad == pytest.approx(0.1)
    assert plain.copy.document["cameras"]["bow"]["focal_length_m"] == 0.008
    settings = {"cameras.bow.hfov_deg": 60, "cameras.bow.pose.pitch_deg": 9, "cameras.bow.pose.roll_deg": 180}
    (camera,) = scene_with(tmp_path, file, {"yaw_rad": 0.1, "pitch_rad": 0.2}, settings=settings).cameras
    assert camera.intrinsics.focal_px == pytest.approx((320 * math.sqrt(3),) * 2)
    mount = camera.mount
    assert (mount.roll_rad, mount.pitch_rad, mount.yaw_rad) == pytest.approx((math.pi, math.radians(9), 0.1))
    (camera,) = scene_with(tmp_path, file, settings={"cameras.bow.K": K}).cameras
    assert camera.intrinsics.principal_point_px == (310.5, 230.5)
    with pytest.raises(InputError, match=r"settings\[.cameras\.bow\.skew.\]: does not go with K: leave one of them"):
        scene_with(tmp_path, {**SIZE, "K": K}, settings={"cameras.bow.skew": 2})


WRONG: tuple[tuple[dict[str, Any], str], ...] = (
    ({}, "cameras.bow: give its lens by one of focal_length_m, focal_px, hfov_deg, vfov_deg, K, calibration"),
    ({"hfov_deg": 60, "vfov_deg": 40}, "cameras.bow.vfov_deg: beside hfov_deg, which gives the lens too"),
    ({"focal_length_m": 0.01}, "cameras.bow.pixel_size_m: missing"),
    ({"hfov_deg": 60, "pixel_size_m": [1e-5, 1e-5]}, "cameras.bow.pixel_size_m: does not go with hfov_deg"),
    ({"K": K, "skew": 1}, "cameras.bow.skew: does not go with K: leave one of them out"),
    ({"hfov_deg": 60, "image_size_px": None}, "cameras.bow.image_size_px: missing"),
    ({"K": [list(row) for row in zip(*K, strict=True)]}, "is not upper triangular with the last row 0 0 1: the rows"),
    ({"K": [*K[:2], [0, 0, 2]]}, "is not upper triangular with the last row 0 0 1"),
    ({"K": [[0, 0, 310], *K[1:]]}, "cameras.bow.K: has the focal lengths 0 and 790 px, which must be above 0"),
    ({"K": K, "image_size_px": [480, 640]}, "is in the middle of 640 × 480, not of 480 × 640: swap width and height"),
    ({"focal_px": [9, 9], "principal_point_px": [700, 9]}, "the principal point (700, 9) is outside the image of 640"),
    ({"calibration": "nowhere.yaml"}, "cameras.bow.calibration: nowhere.yaml: no such file"),
)


@pytest.mark.parametrize(("lens", "said"), WRONG, ids=[said[:60] for _, said in WRONG])
def test_what_a_camera_cannot_have_is_named_with_its_key_and_a_remedy(tmp_path: Path, lens, said: str) -> None:
    with pytest.raises(InputError) as caught:
        scene_with(tmp_path, {**SIZE, **lens})
    (problem,) = caught.value.problems
    assert said in problem


def test_an_angle_in_both_units_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pose\.pitch_deg: beside pitch_rad: leave one of them out"):
        scene_with(tmp_path, {**SIZE, "K": K}, {"pitch_deg": 1, "pitch_rad": 0.02})


WRONG_FILES: tuple[tuple[str, str, str, str, dict[str, Any]], ...] = (
    ("opencv", "image_width: 640", "", "image_size_px: missing, and solved.yaml has none either", {}),
    ("opencv", "", "", "[320, 240] is not the size in solved.yaml, [640, 480]", {"image_size_px": [320, 240]}),
    ("opencv", "", "", "cameras.bow.distortion: does not go with calibration", {"distortion": {"k1": 0.1}}),
    ("opencv", "calibration_time", "fisheye_model: 1\nx", "fisheye_model: 1 is not read: only a pinhole's", {}),
    ("opencv", ", 0. ]", ", 0., 0.1, 0., 0. ]", "more than k1, k2, p1, p2, k3, and not all of the others are 0", {}),
    ("opencv", "-1.0e-01, 2.e-02, ", "", "distortion_coefficients: 0, 4, 5, 8", {}),
    ("ros", "plumb_bob", "equidistant", "distortion_model: 'equidistant' is not known: only plumb_bob, radtan", {}),
    ("message", f"[{NUMBERS}]", "[0, 0, 0, 0, 0, 0, 0, 0, 0]", "k: has the focal lengths 0 and 0 px", {}),
    ("kalibr", "pinhole", "omni", "camera_model: 'omni' is not known: only pinhole is", {}),
    ("kalibr", "bow", "port", "has the cameras port, stern: call the scene's camera as one of them ('bow')", {}),
    ("json", "camera_matrix", "intrinsic", "has neither camera_matrix (OpenCV, ROS), K (a camera_info message)", {}),
)


@pytest.mark.parametrize(
    ("name", "old", "new", "said", "beside"), WRONG_FILES, ids=[row[3][:50] for row in WRONG_FILES]
)
def test_a_calibration_that_is_no_such_camera_is_refused(tmp_path: Path, name, old, new, said, beside) -> None:
    (tmp_path / "solved.yaml").write_text(FILES[name].replace(old, new))
    with pytest.raises(InputError) as caught:
        scene_with(tmp_path, {"calibration": "solved.yaml", **beside})
    (problem,) = caught.value.problems
    assert said in problem and problem.startswith("cameras.bow.")


LEGACY = {"focal_length_m": 0.05, "sensor_width_m": 0.036}
LENS = Intrinsics.from_lens(0.05, (1e-5, 1e-5), (1800, 1200), (3600, 2400))


def columns(pose, centre=(1000, 1000), radius=500, intrinsics=LENS):
    """Columns at which the border of the circle appears."""
    around = np.linspace(0, 2 * np.pi, 7201)
    border = np.stack([centre[0] + radius * np.cos(around), centre[1] + radius * np.sin(around), 0 * around], axis=-1)
    return intrinsics.project(poses_ashore(Mount(**pose), 1).to_camera(border[None])[0])[:, 0]


@given(
    centre=st.tuples(st.floats(-5e3, 5e3), st.floats(-5e3, 5e3)),
    radius=st.floats(5, 2000),
    height=st.floats(0.5, 300),
    view=st.floats(0.2, 2.5),
)
def test_whole_circle_is_seen_across_the_image_and_its_centre_in_the_middle(centre, radius, height, view):
    lens = {"focal_length_m": 0.01, "sensor_width_m": 0.02 * math.tan(view / 2)}
    focal_px = 1000 / math.tan(view / 2)
    intrinsics = Intrinsics((focal_px, focal_px), (1000, 1000), (2000, 2000))
    pose = camera_placement(centre, radius, height_m=height, **lens)
    seen = columns(pose, centre, radius, intrinsics)
    assert -1e-3 <= seen.min() <= seen.max() <= 2000 + 1e-3
    middle = poses_ashore(Mount(**pose), 1).to_camera(np.array([[[*centre, 0.0]]]))[0, 0]
    np.testing.assert_allclose(intrinsics.project(middle), (1000, 1000), atol=1e-3)


def test_sides_of_the_view_touch_or_cut_the_circle_and_pitch_of_table_9_5_is_that_of_eq_b_3():
    seen = columns(camera_placement((1000, 1000), 500, height_m=1e-3, **LEGACY))
    assert (seen.min(), seen.max()) == pytest.approx((0, 3600), abs=1e-2)
    pose = camera_placement((1000, 1000), 500, height_m=20, whole=False, **LEGACY)
    assert pose["position_m"] == pytest.approx([1000 + 500 / 0.36, 1000, 20])
    seen = columns(pose)
    assert seen.min() < -100 and seen.max() > 3700
    assert 500 / math.tan(2 * 2 * math.atan(0.36)) < 100 < 500
    pose = camera_placement((1000, 1000), 520, height_m=20, whole=False, **LEGACY)
    assert pose["position_m"][0] == pytest.approx(2444, abs=0.5)
    assert math.atan(20 / pose["position_m"][0]) == pytest.approx(0.008, abs=5e-4)
    assert pose["pitch_rad"] == pytest.approx(0.0138, abs=5e-5)
    with pytest.raises(InputError) as wrong:
        camera_placement((math.nan, 0), -5, height_m=0, **LEGACY)
    lengths = tuple(f"{name} is not a length above 0" for name in ("radius_m: -5", "height_m: 0"))
    assert wrong.value.problems == (*lengths, "centre_m: nan is not finite")
