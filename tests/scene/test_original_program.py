"""Two frames of Simulation 1 as the thesis's authors published them, beside ours of the same poses.
`tests/data/modsim/simulation_1.csv` names source and licence. The camera was not published with them. Two unknowns, its
distance and its pitch, were fitted to the forty numbers. The program places its camera by Appendix B with a radius of
530 m, 2472.2222 m from the world's origin, and rounds its rotation matrix to five decimals: computed in this way, the
forty numbers agree to 1e-11 px, so that rounding is all that the fitted camera does not repeat."""

from pathlib import Path

import numpy as np
import pytest

from modsim3d import Scene, camera_placement
from modsim3d.runs.pipeline import open_renderer, truth_block
from tests.scenes import camera_keys

FITTED = {"position_m": [2472.2256, 1000, 20], "pitch_rad": 0.00809004, "yaw_rad": np.pi}
FILE = Path(__file__).parents[1] / "data" / "modsim" / "simulation_1.csv"
ROWS = np.genfromtxt(FILE, delimiter=",", names=True, skip_header=3, dtype=None, encoding="utf-8")
ROWS = ROWS.reshape(2, 5)  # steps, vessels
CENTRES = np.stack([ROWS["x"], ROWS["y"]], axis=-1)
SIZES = np.stack([ROWS["width"], ROWS["height"]], axis=-1)
PUBLISHED_PX = np.concatenate([CENTRES - SIZES / 2, CENTRES + SIZES / 2], axis=-1)


def annotated(source):
    """Corners of the annotated boxes of both steps in mode 0, shape (2, 5, 4)."""
    camera = camera_keys(3600, 2400, focal_length_m=0.05, pose=FITTED)
    sizes = ("length_m", "beam_m", "air_draft_m")
    vessels = {str(row["vessel"]): {"label": "Vessel", **{size: float(row[size]) for size in sizes}} for row in ROWS[0]}
    positions = np.stack([ROWS["w1_m"], ROWS["w2_m"]], axis=-1)
    poses = {"positions_m": positions, "headings_rad": ROWS["heading_rad"], "time_step_s": 1.4}
    data = {"vessels": vessels, "poses": poses, "cameras": {"C0": camera}, "detector": "thesis"}
    scene = Scene.from_dict(data | {"annotation": {"mode": 0, "source": source}})
    with open_renderer(scene) as renderer:
        truth = truth_block(scene, 0, 2, renderer)
    assert truth.annotated.all()
    assert (truth.step * 5 + truth.vessel).tolist() == list(range(10))
    return truth.full_boxes_px.reshape(2, 5, 4)


def test_projected_boxes_equal_the_published_annotations_to_0_0006_px_and_boxes_of_pixels_to_a_pixel():
    low, high = np.split(annotated("analytic"), 2, axis=-1)
    np.testing.assert_allclose((low + high) / 2, CENTRES, rtol=0, atol=6e-4)
    np.testing.assert_allclose(high - low, SIZES, rtol=0, atol=6e-4)
    np.testing.assert_allclose(annotated("rendered"), PUBLISHED_PX, rtol=0, atol=1)


def test_program_places_its_camera_by_appendix_b_and_aims_at_the_origin_of_the_world():
    pose = camera_placement((1000, 1000), 530, height_m=20, focal_length_m=0.05, sensor_width_m=0.036, whole=False)
    assert pose["position_m"] == pytest.approx(FITTED["position_m"], abs=4e-3)
    assert np.arctan(20 / pose["position_m"][0]) == pytest.approx(FITTED["pitch_rad"], abs=4e-7)
    assert pose["pitch_rad"] == pytest.approx(np.arctan(20 / 1472.2222), abs=1e-9)  # at the centre of the circle
