"""Films on disk: MP4 through ffmpeg, GIF and PNG through Pillow."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from PIL import Image

from modsim3d.errors import ModsimError
from modsim3d.outputs.placing import put_folder_in_place, put_in_place
from modsim3d.view.films.gif import TICKS_PER_S, quantised, write_gif

FORMATS = ("mp4", "gif", "png")
MOST_RATE = {"mp4": 60, "gif": 50, "png": 1_000_000}
"""Pictures a second: what screens show, what browsers show of a GIF; of PNG files, every frame."""
ENCODER_THREADS = 2
"""A fixed number, as the encoder's bytes depend on it."""
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
        out = io.BytesIO()
        picture.save(out, format="PNG")
        return cls(step, picture.size, out.getvalue())


Frames = Iterable[tuple[EncodedFrame, int]]
"""Frames in order of step, and for how many pictures in a row each is shown."""


def check_encoder(kind: str) -> None:
    """Check that a film can be encoded, before anything is drawn.

    Raises:
        ModsimError: There is no ffmpeg for an MP4.
    """
    if kind != "mp4":
        return
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise ModsimError(NO_FFMPEG) from None


def write_film(kind: str, path: Path, frames: Frames, rate: Fraction, colours: Image.Image | None = None) -> None:
    """Write a film while its frames are drawn.

    Args:
        kind: One of `FORMATS`.
        path: The file; for PNG, the folder of the files.
        frames: Pictures; each is drawn when those before it are written.
        rate: Pictures a second.
        colours: Holds the palette of a GIF.

    Raises:
        ModsimError: An MP4 could not be encoded.
    """
    if kind == "png":
        _write_pngs(path, frames)
        return
    with put_in_place(path) as partial:
        if kind == "gif" and colours is not None:
            _write_gif(partial, frames, rate, colours)
        else:
            _write_mp4(path, partial, frames, rate)
        if not partial.exists() or not partial.stat().st_size:
            raise ModsimError(f"{path} could not be encoded: ffmpeg wrote nothing")


def _write_mp4(path: Path, partial: Path, frames: Frames, rate: Fraction) -> None:
    """H.264 in 4:2:0, which every browser plays, with its index in front.

    The encoder starts with the first frame. By then the workers run, which must not hold its pipe open.
    """
    encoder: subprocess.Popen[bytes] | None = None
    with TemporaryFile() as said, ExitStack() as running:
        for frame, repeats in frames:
            if encoder is None:
                command = _ffmpeg_command(frame.size, rate, partial)
                # In a group of its own, so that Ctrl-C reaches this process alone.
                encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said, process_group=0)
                running.callback(_end, encoder)
            for _ in range(repeats):
                _send(encoder, frame.data, path, partial, said)
        if encoder is not None:
            _end_of_film(encoder, path, partial, said)


def _ffmpeg_command(size: tuple[int, int], rate: Fraction, out: Path) -> list[str]:
    import imageio_ffmpeg

    return [
        *(imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-f", "rawvideo", "-vcodec", "rawvideo"),
        *("-s", f"{size[0]}x{size[1]}", "-pix_fmt", "rgb24", "-r", str(rate), "-i", "-", "-an"),
        *("-vcodec", "libx264", "-pix_fmt", "yuv420p", "-v", "warning"),
        *("-crf", "20", "-preset", "veryfast", "-threads", str(ENCODER_THREADS)),
        *("-g", str(max(1, round(KEY_FRAME_S * rate)))),
        # Without these players guess the colours' matrix by the film's size.
        *("-vf", "scale=out_color_matrix=bt709:out_range=tv"),
        *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"),
        *("-movflags", "+faststart", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"),
        str(out),
    ]


def _send(encoder: subprocess.Popen[bytes], data: bytes, path: Path, partial: Path, said: IO[bytes]) -> None:
    assert encoder.stdin is not None
    try:
        encoder.stdin.write(data)
    except BrokenPipeError:
        _end_of_film(encoder, path, partial, said)
        raise ModsimError(f"{path} could not be encoded: ffmpeg ended before the film did") from None


def _end_of_film(encoder: subprocess.Popen[bytes], path: Path, partial: Path, said: IO[bytes]) -> None:
    """Wait until the film is complete; what ffmpeg says is repeated only where it failed."""
    assert encoder.stdin is not None
    with suppress(BrokenPipeError):
        encoder.stdin.close()
    status = encoder.wait()
    said.seek(0)
    lines = said.read().decode(errors="replace").strip().splitlines()
    if status or any("Error" in line for line in lines):
        reason = lines[-1].replace(str(partial), str(path)) if lines else f"ffmpeg ended with exit status {status}"
        raise ModsimError(f"{path} could not be encoded: {reason}")


def _end(encoder: subprocess.Popen[bytes]) -> None:
    """Leave no encoder behind, whatever went wrong."""
    encoder.kill()
    encoder.wait()
    if encoder.stdin is not None:
        with suppress(BrokenPipeError):
            encoder.stdin.close()


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


def _write_pngs(folder: Path, frames: Frames) -> None:
    with put_folder_in_place(folder, "frame_*.png") as partial:
        for frame, _ in frames:
            (partial / f"frame_{frame.step:06d}.png").write_bytes(frame.data)
