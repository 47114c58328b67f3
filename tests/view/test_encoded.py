"""Pictures as imageio writes them, read back by Pillow."""

import io

import numpy as np
import pytest
from PIL import Image

from modsim3d.io.atomic_write import encoded


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (2, 4), (641, 77)])
@pytest.mark.parametrize("mode", ["RGB", "1", "L"])
def test_the_pixels_of_a_png_are_those_of_the_picture(mode, size):
    values = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    picture = Image.fromarray(values).convert(mode)
    for optimize in (False, True):
        with Image.open(io.BytesIO(encoded(picture, optimize=optimize))) as read:
            assert (read.format, read.mode, read.size) == ("PNG", mode, size)
            np.testing.assert_array_equal(np.asarray(read), np.asarray(picture))


def test_a_jpeg_has_the_quality_that_is_asked_for():
    picture = Image.linear_gradient("L").convert("RGB")
    small, large = (encoded(picture, ".jpg", quality=quality) for quality in (30, 95))
    assert len(small) < len(large)
    with Image.open(io.BytesIO(large)) as read:
        assert (read.format, read.size) == ("JPEG", picture.size)
        assert np.abs(np.asarray(read).astype(int) - np.asarray(picture)).mean() < 1
