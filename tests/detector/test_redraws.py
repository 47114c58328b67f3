"""Redrawn box errors, which are drawn for all boxes at once, against one draw at a time from each box's generators."""

from typing import Any

import numpy as np
import pytest

from modsim3d.core.boxes import inside_image, move, sizes
from modsim3d.core.random_streams import Streams, grid_normals
from modsim3d.detector.box_error import BoxErrorSource, TrueBoxes
from modsim3d.detector.draws import BOX_ERROR_REDRAW_STREAMS
from modsim3d.detector.file.reading import parse_detector
from tests.detector import detector_builders as build

STEPS, VESSELS = 40, 25
T = {"law": "student_t", "degrees_of_freedom": 6.0}


def one_at_a_time(source: BoxErrorSource, true: TrueBoxes, row: int) -> np.ndarray:
    """The first draw of a box's own generators that leaves it in the image."""
    targets, frames, streams = true.targets, true.frames, Streams(4)
    vessel, step = targets.vessel_ids[targets.vessel[row]], int(frames.steps[targets.frame[row]])
    widths = BOX_ERROR_REDRAW_STREAMS.widths(source.extra_normals)
    generators = [(streams.generator(purpose, "C0", vessel, step=step), width) for purpose, width in widths.items()]
    box, state = true.boxes_px[[row]], true.state[[row]]
    while True:
        uniforms = np.concatenate([generator.random(width) for generator, width in generators])
        error = source.errors_px(state, sizes(box), grid_normals(uniforms[None]))
        if inside_image(move(box, error), build.IMAGE_PX).all():
            return error[0]


@pytest.mark.parametrize("law", [{}, T], ids=["normal", "student_t"])
def test_all_boxes_at_once_have_the_errors_of_one_at_a_time(law: dict[str, Any]) -> None:
    source = BoxErrorSource.from_model(
        parse_detector(build.one_state_data(box_error=build.box_error(build.MEAN_PX, build.COVARIANCE_PX2) | law))
    )
    low = np.random.default_rng(1).uniform(0, np.array(build.IMAGE_PX) - 4, (STEPS, VESSELS, 2))
    targets = build.make_targets(np.concatenate([low, low + 3], axis=-1))
    frames = build.make_frames(STEPS, first_step=9)
    true = TrueBoxes.of(frames, np.zeros(STEPS, dtype=np.int64), targets)
    latent = np.full((len(targets.frame), 4 + source.extra_normals), -9.0)  # nothing is left of any box
    placed = source.misplace(Streams(4), true, latent)
    assert placed.redrawn.all()
    rows = range(0, STEPS * VESSELS, 7)
    assert np.array_equal(placed.errors_px[rows], [one_at_a_time(source, true, row) for row in rows])
