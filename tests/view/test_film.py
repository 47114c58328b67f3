"""Films of a run and pictures as they are written, read back with other eyes, and how long each frame is shown."""

import io
import re
import shutil
import struct
import subprocess
import sys
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageSequence

from modsim3d import load_scene, open_run, run_scene
from modsim3d.io.atomic_write import encoded
from modsim3d.runs.selection import select
from modsim3d.view import palette
from modsim3d.view.films.files import UNCHANGED, film_palette, quantised, write_gif
from modsim3d.view.films.plan import KINDS, MIN_RATE, FilmLayout, Timetable, crop_to_vessels
from modsim3d.view.films.request import PictureRequest
from modsim3d.view.pictures import id_buffer
from tests.command_line import call
from tests.scenes import camera_keys, crossing


def gif_of(frames, ticks, colours):
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
    read, total = shown(gif_of(frames, ticks, grey()))
    distinct = [frame for i, frame in enumerate(frames) if i == 0 or not np.array_equal(frame, frames[i - 1])]
    np.testing.assert_array_equal(read, distinct)
    assert total == 10 * sum(ticks)


def test_pictures_are_those_read_again_colours_stay_and_a_gif_stores_only_what_changes():
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
    picture, rng = Image.new("RGB", (60, 40), palette.SEA), np.random.default_rng(0)
    colours = film_palette([picture])
    for i, colour in enumerate([*palette.VESSELS, palette.ALARM, palette.TRUTH]):
        picture.paste(colour, (5 * i, 0, 5 * i + 5, 5))
    np.testing.assert_array_equal(np.asarray(quantised(picture, colours).convert("RGB")), np.asarray(picture))
    for pictures in ([Image.new("RGB", (8, 8))], [Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8))]):
        colours = film_palette(pictures)
        for picture in (*pictures, Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8))):
            assert np.asarray(quantised(picture, colours)).max() < UNCHANGED
    rng, out, lengths = np.random.default_rng(0), io.BytesIO(), []
    frames = [rng.integers(0, UNCHANGED, (200, 200), dtype=np.uint8)]
    for row in range(10):  # far apart, so that the box around them is the whole picture
        frames.append(frames[-1].copy())
        frames[-1][(row, -1 - row), :] = row
    first, all_of_them = (len(gif_of(part, [5] * len(part), grey()).fp.getvalue()) for part in (frames[:1], frames))
    assert all_of_them < 1.5 * first

    def coming():
        for level in range(5):
            lengths.append(out.tell())
            yield Image.new("L", (50, 50), level), 5

    write_gif(out, grey(), coming())
    assert sorted(set(lengths[1:])) == lengths[1:]
    two = [np.full((2, 2), level, dtype=np.uint8) for level in (0, 1)]
    assert shown(gif_of(two, [200_000, 5], grey()))[1] == 10 * 200_005


STEPS = 12


def view(monkeypatch, *arguments):
    return call(monkeypatch, "view", *arguments)


def probe(path):
    """What ffmpeg says of a film's only stream, and its pictures."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    (stream,) = re.findall(r"Stream #0:0.*: Video: (.*)", done.stderr.decode().partition("Output #0")[0])
    width, height = (int(side) for side in re.search(r", (\d+)x(\d+)", stream).groups())
    return stream, np.frombuffer(done.stdout, dtype=np.uint8).reshape(-1, height, width, 3)


def atoms(path):
    """Names of an MP4's outermost atoms, in their order (ISO/IEC 14496-12)."""
    data, at, names = path.read_bytes(), 0, []
    while at < len(data):
        size, name = struct.unpack(">I4s", data[at : at + 8])
        names.append(name.decode())
        at += size or len(data)
    return names


@pytest.mark.parametrize("width", [162, 480])
def test_mp4_plays_in_every_browser(monkeypatch, run, tmp_path, width):
    out = tmp_path / "film.mp4"
    assert view(monkeypatch, "film", run, "--kind", "detections", "--end", 5, "--width", width, "--out", out) == 0
    stream, pictures = probe(out)
    assert stream.startswith("h264") and "yuv420p" in stream
    assert pictures.shape[2] == width and pictures.shape[1] % 2 == 0  # 162 is no multiple of 16
    assert " 5 fps" in stream and len(pictures) == 5 * 6  # a step a second: each is shown five times
    assert atoms(out).index("moov") < atoms(out).index("mdat")
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_films_are_the_same_bytes_whatever_the_workers(prepared, run, tmp_path, kind):
    """In a process without threads, as a user's is: its workers are forks."""
    options = ("--kind", "all", "--every", "3", "--width", "240")
    films = [tmp_path / f"{workers}.{kind}" for workers in ("1", "2")]
    for film in films:
        command = (prepared, "view", "film", run, *options, "--workers", film.stem, "--out", film)
        subprocess.run(command, check=True, capture_output=True, timeout=240)
    assert films[0].read_bytes() == films[1].read_bytes()


def test_colours_survive_pngs_are_the_single_pictures_and_a_gif_needs_no_ffmpeg(monkeypatch, run, tmp_path):
    options = ("--kind", "ids", "--width", 960, "--crop", "none")
    assert view(monkeypatch, "film", run, *options, "--end", 1, "--out", tmp_path / "a.mp4") == 0
    assert view(monkeypatch, "frame", run, 0, *options, "--out", tmp_path / "a.png") == 0
    stream, pictures = probe(tmp_path / "a.mp4")
    assert "bt709" in stream
    still = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    assert np.abs(pictures[0].astype(int) - still).mean() < 2
    for colour in (id_buffer.SEA, id_buffer.SKY, palette.VESSELS[2]):  # the ship's
        here = (still == colour).all(axis=-1)
        assert here.sum() > 5000 and np.abs(np.median(pictures[0][here], axis=0) - colour).max() <= 4
    options = ("--kind", "detections", "--width", 320, "--crop", "none")
    assert view(monkeypatch, "film", run, *options, "--format", "png", "--every", 5, "--out", tmp_path / "film") == 0
    names = sorted(path.name for path in (tmp_path / "film").iterdir())
    assert names == [f"frame_{step:06d}.png" for step in (0, 5, 10)]
    assert view(monkeypatch, "frame", run, 5, *options, "--out", tmp_path / "five.png") == 0
    assert (tmp_path / "five.png").read_bytes() == (tmp_path / "film" / "frame_000005.png").read_bytes()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    out = tmp_path / "film.gif"
    options = ("--kind", "ids", "--width", 320, "--start", 2, "--end", 9, "--every", 2, "--speed", 2)
    assert view(monkeypatch, "film", run, *options, "--out", out) == 0
    with Image.open(out) as film:
        assert film.size[0] == 320
        assert shown(film)[1] == 4000  # steps 2, 4, 6 and 8 stand for two seconds each, at twice the speed


def test_cameras_stand_side_by_side_without_what_shows_no_vessel_on_request(monkeypatch, tmp_path, capsys):
    aside, two_cameras = {"position_m": [0, 0, 10], "yaw_rad": 1.5}, tmp_path / "run"  # nothing is aside
    cameras = {"C0": camera_keys(pose={"position_m": [0, 0, 10]})}
    cameras["left"] = camera_keys(pose=aside, image_size_px=[400, 301])
    run_scene(load_scene(crossing(tmp_path, STEPS, cameras=cameras)), two_cameras)
    options = ("--kind", "scene", "--out")
    assert view(monkeypatch, "frame", two_cameras, 0, *options, tmp_path / "both.png") == 0
    alone = ("--camera", "left", "--width", 1000, *options, tmp_path / "left.png")
    assert view(monkeypatch, "frame", two_cameras, 0, *alone) == 0
    with Image.open(tmp_path / "both.png") as both, Image.open(tmp_path / "left.png") as left:
        assert (both.width, left.width) == (1920, 1000) and both.height % 2 == left.height % 2 == 0
        assert abs(left.height - 1000 * 301 / 400) < 120
    arguments = ("film", two_cameras, "--kind", "scene", "--only-with-vessels", "--format", "png", "--width", 320)
    assert view(monkeypatch, *arguments, "--out", tmp_path / "both") == 0
    assert 0 < len(list((tmp_path / "both").iterdir())) <= STEPS
    assert view(monkeypatch, *arguments, "--camera", "left", "--out", tmp_path / "left") == 2
    assert "no vessel is in an image of left" in capsys.readouterr().err


def test_a_step_and_its_time_give_the_same_picture_and_a_crop_the_same_pixels_larger(monkeypatch, run, tmp_path):
    moved = shutil.copytree(run, tmp_path / "moved")
    for number, (folder, text) in enumerate(((run, "7"), (run, "7.0"), (run, "7s"), (moved, "7"))):
        options = ("--kind", "all", "--width", 640, "--out", tmp_path / f"{number}.png")
        assert view(monkeypatch, "frame", folder, text, *options) == 0
    assert len({path.read_bytes() for path in tmp_path.glob("*.png")}) == 1
    frame = ("frame", run, 3, "--kind", "scene", "--width")
    assert view(monkeypatch, *frame, 800, "--crop", "200,150,600,450", "--out", tmp_path / "crop.png") == 0
    assert view(monkeypatch, *frame, 1600, "--out", tmp_path / "all.png") == 0
    part, whole = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in ("crop", "all"))
    head = [FilmLayout(width, 1, (1.0,), (), insets=width == 800).head_px for width in (800, 1600)]
    assert np.abs(part[head[0] : head[0] + 600] - whole[head[1] + 300 : head[1] + 900, 400:1200]).mean() < 1.0


def test_titles_of_several_panels_stand_above_them_and_cover_nothing():
    layout = FilmLayout(400, 2, (2.0, 2.0, 2.0), ())
    panels = [Image.new("RGB", size, (1, 2, 3)) for size in layout.panel_sizes]
    sheet = np.asarray(layout.compose(["head"], ["a title that is far too long for a panel of this width"] * 3, panels))
    covered = (sheet == (1, 2, 3)).all(axis=2)
    assert covered.sum() == sum(width * height for width, height in layout.panel_sizes)
    above = sheet[layout.head_px : layout.head_px + layout.title_px]
    assert (above[:, : layout.panel_width] < 128).any() and (above[:, layout.panel_width + 4 :] < 128).any()
    assert FilmLayout(400, 1, (2.0,), ()).title_px == 0


def test_crop_to_vessels_keeps_every_box_in_sight(run):
    chosen = select(open_run(run), (0,))
    ((x0, y0, x1, y1),) = crop_to_vessels(chosen)
    assert 0 <= x0 < x1 <= 800 and 0 <= y0 < y1 <= 600
    assert 4 / 3 - 1e-9 <= (x1 - x0) / (y1 - y0) <= 3.2 + 1e-9
    for (frame,) in (of_step.frames for of_step in chosen.step_frames()):
        for box in frame.truth.full_boxes_px:
            assert x0 <= box[0] and y0 <= box[1] and box[2] <= x1 + 1e-9 and box[3] <= y1 + 1e-9
    cropped = {kind for kind in (*KINDS, "all") if PictureRequest(kind).plan(chosen).crops_px == ((x0, y0, x1, y1),)}
    assert cropped == {"detections", "ids", "all"}
    assert not any(PictureRequest(kind, crop="none").plan(chosen).crops_px for kind in cropped)


def test_the_contact_sheet_can_be_drawn_again_and_a_damaged_table_is_one_error(monkeypatch, capsys, run, tmp_path):
    sheets = []
    for options, status in (((), 0), ((), 2), (("--overwrite",), 0)):
        assert view(monkeypatch, "sheet", run, *options) == status
        sheets.append((run / "contact_sheet.png").read_bytes())
    assert len(set(sheets)) == 1
    table = shutil.copytree(run, tmp_path / "damaged") / "truth.parquet"
    table.write_bytes(table.read_bytes()[:-100])
    assert view(monkeypatch, "sheet", table.parent, "--overwrite") == 2
    assert "truth.parquet has " in capsys.readouterr().err


MAX_RATE = 60
PACES = [(0.2, 1, 5, 1), (0.1, 1, 10, 1), (0.1, 4, 40, 1), (0.5, 1, 6, 3), (1, 1, 5, 5), (10, 1, 5, 50), (10, 10, 5, 5)]


def test_even_steps_give_every_frame_its_time_and_a_film_that_is_too_fast_leaves_frames_out():
    for step_s, speed, rate, each in PACES:
        table = Timetable.of(np.full(30, step_s), speed, MAX_RATE)
        assert table.rate == rate and set(table.repeats.tolist()) == {each}, (step_s, speed)
        assert table.duration_s == pytest.approx(30 * step_s / speed)
    table = Timetable.of(np.full(1000, 0.01), 1.0, MAX_RATE)
    assert table.rate == MAX_RATE and set(table.repeats.tolist()) == {0, 1}
    assert table.duration_s == pytest.approx(10.0, abs=1 / MAX_RATE)
    assert Timetable.of(np.array([3600.0, 3600.0]), 1.0, MAX_RATE).rate >= MIN_RATE


@given(st.lists(st.floats(0.01, 20.0), min_size=1, max_size=40), st.floats(0.1, 20.0), st.sampled_from([25, 50, 60]))
def test_whatever_the_steps_each_frame_is_shown_when_it_is_due(durations, speed, most):
    table = Timetable.of(np.array(durations), speed, most)
    assert table.rate <= most
    due = np.cumsum(durations) / speed
    ends = np.cumsum(table.repeats) / float(table.rate)
    # Half a picture, and what rounding the rate to a fraction with a small denominator does to a long film.
    assert np.all(np.abs(due - ends) <= 1.0 / float(table.rate) + 0.001 * due) and table.repeats.sum() >= 1
