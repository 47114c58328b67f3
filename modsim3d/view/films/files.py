"""Films on disk: MP4 through ffmpeg by imageio, PNG, GIF by `gif`."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from PIL import Image, ImageChops
from PIL.GifImagePlugin import getdata, getheader

from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import encoded, put_folder_in_place, put_in_place
from modsim3d.view import palette

# ---- GIF films, written frame by frame with Pillow's encoder ----

TICKS_PER_S = 100  # a GIF counts in hundredths of a second
MAX_TICKS = 0xFFFF  # the longest that a GIF can show a picture; one that lasts longer is stored again
UNCHANGED = 255  # palette index of a pixel that stays as it was in the picture before
KEEP = 1  # disposal method of a frame that the next one is drawn over


def film_palette(samples: Sequence[Image.Image]) -> Image.Image:
    """Choose 255 colours for a film: those that everything is drawn with, and the most frequent ones of some frames.
    All frames share one palette, so that what stands still keeps the same index. A picture of one pixel holds it."""
    names = ("PAPER", "INK", "SEA", "SKY", "TRUTH", "ALARM", "HORIZON", "OWN")
    exact = [getattr(palette, name) for name in names]
    exact += [palette.vessel_colour(i) for i in range(3 * len(palette.VESSELS))]
    width, height = max(p.width for p in samples), sum(p.height for p in samples)
    stack, y = Image.new("RGB", (width, height)), 0
    for sample in samples:
        stack.paste(sample, (0, y))
        y += sample.height
    adapted = stack.quantize(UNCHANGED - len(exact), dither=Image.Dither.NONE).getpalette() or []
    colours = [channel for colour in exact for channel in colour] + adapted
    holder = Image.new("P", (1, 1))
    # Places that no colour takes hold the first one again, whose own index is the one that is found.
    holder.putpalette((colours[: 3 * UNCHANGED] + 256 * colours[:3])[:768])
    return holder


def quantised(picture: Image.Image, colours: Image.Image) -> Image.Image:
    """A picture in a film's palette."""
    return picture.quantize(palette=colours, dither=Image.Dither.NONE)


def write_gif(out: IO[bytes], colours: Image.Image, frames: Iterable[tuple[Image.Image, int]]) -> None:
    """Write an endless GIF 89a.
    Only the pixels that differ from the frame before are stored; a frame without any makes the one before last longer.
    A frame is palette indices as grey levels (mode L), and how long it is shown, in ticks. There is at least one."""
    before: Image.Image | None = None
    for picture, group in groupby(frames, key=itemgetter(0)):
        box, changed = (0, 0, *picture.size), picture
        if before is None:
            blank = Image.new("P", picture.size)
            blank.putpalette(colours.getpalette() or [])
            out.writelines(getheader(blank, info={"loop": 0})[0])
        else:
            difference = ImageChops.difference(before, picture)
            box, changed = difference.getbbox() or box, picture.copy()
            changed.paste(UNCHANGED, mask=difference.point([255, *(0,) * 255], "1"))
        whole, rest = divmod(sum(ticks for _, ticks in group), MAX_TICKS)
        for ticks in [MAX_TICKS] * whole + [rest] * (rest > 0):
            options = {"duration": ticks * 1000 // TICKS_PER_S, "disposal": KEEP, "transparency": UNCHANGED}
            out.writelines(getdata(changed.crop(box), box[:2], **options))
        before = picture
    out.write(b";")


FORMATS = ("mp4", "gif", "png")
MAX_RATE = {"mp4": 60, "gif": 50, "png": 1_000_000}
"""Pictures a second: what screens show, what browsers show of a GIF; of PNG files, every frame."""
ENCODER_THREADS = 2  # fixed, as the encoder's bytes depend on it
KEY_FRAME_S = 2
NO_FFMPEG = "MP4 films need ffmpeg: pip install 'modsim3d[video]'; --format gif and --format png do not need it"


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """The picture of a step for a film: RGB values for MP4, palette indices for GIF (row by row), a file for PNG."""

    step: int
    size: tuple[int, int]
    data: bytes

    @classmethod
    def of(cls, step: int, picture: Image.Image, kind: str, colours: Image.Image | None) -> EncodedFrame:
        """Encode a picture in RGB for a film of one of `FORMATS`; `colours` holds the palette of a GIF."""
        if kind == "gif" and colours is not None:
            return cls(step, picture.size, quantised(picture, colours).tobytes())
        if kind == "mp4":
            return cls(step, picture.size, picture.tobytes())
        return cls(step, picture.size, encoded(picture))


Frames = Iterable[tuple[EncodedFrame, int]]  # in order of step, and for how many pictures in a row each is shown


def check_encoder(kind: str) -> None:
    """Raise ModsimError, before anything is drawn, if a film is an MP4 and there is no ffmpeg."""
    if kind != "mp4":
        return
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise ModsimError(NO_FFMPEG) from None


def write_film(kind: str, path: Path, frames: Frames, rate: Fraction, colours: Image.Image | None = None) -> None:
    """Write a film of one of `FORMATS` into a file, PNG files into a folder, at a number of pictures a second, while
    its frames are drawn: each when those before it are written. `colours` holds the palette of a GIF.
    Raises ModsimError if an MP4 could not be encoded."""
    if kind == "png":
        with put_folder_in_place(path, "frame_*.png") as partial:
            for frame, _ in frames:
                (partial / f"frame_{frame.step:06d}.png").write_bytes(frame.data)
        return
    with put_in_place(path) as partial:
        if kind == "gif" and colours is not None:
            _write_gif(partial, frames, rate, colours)
        else:
            _write_mp4(path, partial, frames, rate)


def _write_mp4(path: Path, partial: Path, frames: Frames, rate: Fraction) -> None:
    """H.264 in 4:2:0, which every browser plays, with its index in front, by imageio's FFMPEG plugin.
    The encoder starts with the first frame. By then the workers run, which must not hold its pipe open. The plugin does
    not look at the exit status of the encoder, so that the pictures of the finished film are counted."""
    import imageio.v2
    import imageio_ffmpeg

    logging.getLogger("imageio_ffmpeg").setLevel(logging.ERROR)  # what it warns of is an error here
    sent = 0
    with TemporaryFile() as errors:
        with imageio.v2.get_writer(partial, format="FFMPEG", **_ffmpeg_options(rate)) as encoder:
            for frame, repeats in frames:
                picture = np.frombuffer(frame.data, dtype=np.uint8).reshape(frame.size[1], frame.size[0], 3)
                for _ in range(repeats):
                    try:
                        with _errors_into(errors) if sent == 0 else nullcontext():
                            encoder.append_data(picture)
                    except OSError:
                        raise _failure(path, partial, errors, "ffmpeg ended before the film did") from None
                    sent += 1
        try:
            written, _ = imageio_ffmpeg.count_frames_and_secs(str(partial))
        except RuntimeError:
            written = 0
        errors.seek(0)
        if written != sent or b"Error" in errors.read():
            raise _failure(path, partial, errors, f"it has {written} of {sent} pictures")


def _ffmpeg_options(rate: Fraction) -> dict[str, Any]:
    of_ffmpeg = ["-crf", "20", "-preset", "veryfast", "-threads", str(ENCODER_THREADS)]
    of_ffmpeg += ["-g", str(max(1, round(KEY_FRAME_S * rate)))]
    # Without these players guess the colours' matrix by the film's size.
    of_ffmpeg += ["-vf", "scale=out_color_matrix=bt709:out_range=tv"]
    of_ffmpeg += ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"]
    of_ffmpeg += ["-movflags", "+faststart", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    plugin = {"fps": rate, "codec": "libx264", "macro_block_size": 1, "ffmpeg_log_level": "warning"}
    return {**plugin, "output_params": of_ffmpeg}


@contextmanager
def _errors_into(file: IO[bytes]) -> Iterator[None]:
    """Give a process that starts now a file as its standard error, for which the plugin has no option."""
    stderr = os.dup(2)
    os.dup2(file.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def _failure(path: Path, partial: Path, errors: IO[bytes], otherwise: str) -> ModsimError:
    """The last thing that ffmpeg said about a film, or another reason if it said nothing."""
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    reason = lines[-1].replace(str(partial), str(path)) if lines else otherwise
    return ModsimError(f"{path} could not be encoded: {reason}")


def _write_gif(path: Path, frames: Frames, rate: Fraction, colours: Image.Image) -> None:
    def timed() -> Iterator[tuple[Image.Image, int]]:
        shown = 0
        for frame, repeats in frames:
            begin, shown = shown, shown + repeats
            # Rounded from the beginning of the film, so that what is lost on one frame is gained on another.
            ticks = round(TICKS_PER_S * shown / rate) - round(TICKS_PER_S * begin / rate)
            yield Image.frombytes("L", frame.size, frame.data), ticks

    with path.open("wb") as out:
        write_gif(out, colours, timed())
