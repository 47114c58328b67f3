"""Pictures and GIF films as they are written, read back with other eyes: by Pillow."""

import io
from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageSequence

from modsim3d.io.atomic_write import encoded
from modsim3d.view import palette
from modsim3d.view.films.files import UNCHANGED, film_palette, quantised, write_gif


def test_the_pixels_of_a_png_are_those_of_the_picture_and_a_jpeg_has_the_quality_that_is_asked_for():
    sizes, rng = ((1, 1), (3, 2), (2, 4), (641, 77)), np.random.default_rng(0)
    for mode, size, optimize in product(("RGB", "1", "L"), sizes, (False, True)):
        picture = Image.fromarray(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)).convert(mode)
        with Image.open(io.BytesIO(encoded(picture, optimize=optimize))) as read:
            assert (read.format, read.mode, read.size) == ("PNG", mode, size)
            np.testing.assert_array_equal(np.asarray(read), np.asarray(picture))
    picture = Image.linear_gradient("L").convert("RGB")
    small, large = (encoded(picture, ".jpg", quality=quality) for quality in (30, 95))
    assert len(small) < len(large)
    with Image.open(io.BytesIO(large)) as read:
        assert (read.format, read.size) == ("JPEG", picture.size)
        assert np.abs(np.asarray(read).astype(int) - np.asarray(picture)).mean() < 1


def written(frames, ticks, colours):
    out = io.BytesIO()
    write_gif(out, colours, zip(map(Image.fromarray, frames), ticks, strict=True))
    return Image.open(io.BytesIO(out.getvalue()))


def grey():
    holder = Image.new("P", (1, 1))
    holder.putpalette([level for level in range(256) for _ in range(3)])
    return holder


def shown(film):
    """The frames of a film, and how long all of them last."""
    frames, total = [], 0
    for frame in ImageSequence.Iterator(film):
        frames.append(np.asarray(frame.convert("L")))
        total += frame.info["duration"]
    return frames, total


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_what_is_read_is_what_was_written(seed, count):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 40, 2)
    frames = [rng.integers(0, UNCHANGED, (height, width), dtype=np.uint8)]
    for _ in range(count - 1):  # like films, most of a frame is that of the one before
        frame = frames[-1].copy()
        frame[rng.integers(0, height) :, : rng.integers(0, width + 1)] = rng.integers(0, UNCHANGED)
        frames.append(frame)
    ticks = rng.integers(2, 30, count).tolist()
    read, total = shown(written(frames, ticks, grey()))
    distinct = [frame for i, frame in enumerate(frames) if i == 0 or not np.array_equal(frame, frames[i - 1])]
    np.testing.assert_array_equal(read, distinct)
    assert total == 10 * sum(ticks)


def test_colours_of_vessels_are_kept_exactly_and_no_pixel_takes_the_place_of_unchanged_ones():
    picture, rng = Image.new("RGB", (60, 40), palette.SEA), np.random.default_rng(0)
    colours = film_palette([picture])
    for i, colour in enumerate([*palette.VESSELS, palette.ALARM, palette.TRUTH]):
        picture.paste(colour, (5 * i, 0, 5 * i + 5, 5))
    np.testing.assert_array_equal(np.asarray(quantised(picture, colours).convert("RGB")), np.asarray(picture))
    for pictures in ([Image.new("RGB", (8, 8))], [Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8))]):
        colours = film_palette(pictures)
        for picture in (*pictures, Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8))):
            assert np.asarray(quantised(picture, colours)).max() < UNCHANGED


def test_only_what_changes_is_stored_as_it_comes_and_a_frame_may_last_longer_than_a_gif_can_say():
    rng, out, lengths = np.random.default_rng(0), io.BytesIO(), []
    frames = [rng.integers(0, UNCHANGED, (200, 200), dtype=np.uint8)]
    for row in range(10):  # far apart, so that the box around them is the whole picture
        frames.append(frames[-1].copy())
        frames[-1][(row, -1 - row), :] = row
    first, all_of_them = (len(written(part, [5] * len(part), grey()).fp.getvalue()) for part in (frames[:1], frames))
    assert all_of_them < 1.5 * first

    def coming():
        for level in range(5):
            lengths.append(out.tell())
            yield Image.new("L", (50, 50), level), 5

    write_gif(out, grey(), coming())
    assert sorted(set(lengths[1:])) == lengths[1:]
    two = [np.full((2, 2), level, dtype=np.uint8) for level in (0, 1)]
    assert shown(written(two, [200_000, 5], grey()))[1] == 10 * 200_005
