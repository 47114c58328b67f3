"""The horizon in an image, as files and options say it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import UNKNOWN, half_plane, read_horizon, with_horizon, written_horizon
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from tests.formats.labelled_sets import images, random_set


@given(roll=st.floats(-1.2, 1.2), below=st.floats(-2000, 2000), width=st.floats(100, 4000))
def test_a_horizon_that_is_written_is_read_back(roll, below, width):
    sea = np.array([np.sin(roll), np.cos(roll), -below])
    again = np.array(read_horizon(written_horizon(sea.tolist(), width), width))
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, 500, 1], [width, 500, 1]])
    np.testing.assert_allclose(corners @ again * np.cos(roll), corners @ sea, atol=1e-3)


def test_a_row_two_rows_and_two_points_are_the_same_line_and_what_is_no_horizon_is_none():
    lines = [read_horizon(value, 640.0) for value in (300, [300, 300], [0, 300, 10, 300])]
    assert lines == [tuple(half_plane(300, []))] * 3
    a, b, c = read_horizon([200, 264], 640.0)
    assert [a * x + b * y + c for x, y in ((0, 200), (320, 232), (640, 264))] == pytest.approx([0, 0, 0])
    assert b > 0  # the sea is below
    for value in ("300", True, [], [1, 2, 3], [5, 1, 5, 9], [1, None], 1e8, [float("nan")] * 2):
        assert read_horizon(value, 640.0) is None, value
    for sea in (UNKNOWN, (0.0, 0.0, 1.0), (1.0, 0.0, -300.0), (0.0, -1.0, 300.0)):  # the sea is below no line
        assert written_horizon(sea, 640.0) is None, sea


def test_images_that_say_their_horizon_keep_it():
    labelled = random_set(0, image_count=2)
    labelled = replace(labelled, images=images(2, half_planes=np.array([UNKNOWN, (0.0, 1.0, -50.0)])))
    assert with_horizon(labelled, None) is labelled
    found = with_horizon(labelled, (200.0,)).images.half_planes
    np.testing.assert_array_equal(found, [[0, 1, -200], [0, 1, -50]])
    with pytest.raises(InputError, match="lies below images of 600 × 600 px"):
        with_horizon(labelled, (700.0,))


def test_files_without_a_horizon_take_that_of_the_option(tmp_path):
    files = tmp_path / "gt.txt", tmp_path / "det.txt"
    for path, line in zip(files, ("1,3,10,20,30,40,1,1,0.5\n", "1,-1,12,20,30,40,0.9\n"), strict=True):
        path.write_text(line)
    options = ReadOptions(image_size_px=(640, 480), frame_rate_hz=5, horizon=(0, 200, 640, 264))
    np.testing.assert_allclose(read_pair("day", *files, options).images.half_planes, [[-0.1, 1, -200]])
    assert np.isnan(read_pair("day", *files, replace(options, horizon=None)).images.half_planes).all()
