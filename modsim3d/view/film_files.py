"""Films on disk: MP4, GIF, or a PNG for each frame."""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Generator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

from PIL import Image

from modsim3d.errors import ModsimError
from modsim3d.view.gif import TICKS_PER_S, GifWriter, quantised

FORMATS = ("mp4", "gif", "png")
MOST_RATE = {"mp4": 60, "gif": 50, "png": 1_000_000}
"""Pictures a second: what screens show, what browsers show of a GIF; of PNG files, every frame."""
ENCODER_THREADS = 2
"""A fixed number, as the encoder's bytes depend on it."""
KEY_FRAME_S = 2

NO_FFMPEG = (
    "an MP4 needs ffmpeg, which is not here: pip install 'modsim3d[video]'; --format gif and --format png do without"
)


def encoded(picture: Image.Image, kind: str, colours: Image.Image | None) -> bytes:
    """A picture as its film file takes it; done where it was drawn.

    Args:
        picture: To be added.
        kind: Format of the film.
        colours: Palette of a GIF.
    """
    if kind == "gif" and colours is not None:
        return quantised(picture, colours).tobytes()
    if kind == "mp4":
        return picture.tobytes()
    out = io.BytesIO()
    picture.save(out, format="PNG")
    return out.getvalue()


def check_encoder(kind: str) -> None:
    """Say what is missing before anything is drawn.

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


class FilmFile(ABC):
    """A film that is being written; it is in its place when it is complete, and not there if it fails."""

    @abstractmethod
    def add(self, step: int, data: bytes, shown: int) -> None:
        """Add an encoded frame of a step, shown for a number of pictures."""

    @abstractmethod
    def close(self, complete: bool) -> None:
        """Put the film in its place, or remove what there is of it."""

    def __enter__(self) -> FilmFile:
        """It is open already."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete unless something went wrong."""
        self.close(kind is None)


def open_film(
    kind: str, path: Path, size: tuple[int, int], rate: Fraction, colours: Image.Image | None = None
) -> FilmFile:
    """A film file of a format.

    Args:
        kind: One of `FORMATS`.
        path: The file; of PNG files, their folder.
        size: Width and height, even.
        rate: Pictures a second.
        colours: Palette of a GIF.
    """
    if kind == "mp4":
        return _Mp4(path, size, rate)
    if kind == "gif" and colours is not None:
        return _Gif(path, size, rate, colours)
    return _Pngs(path)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.stem}.partial{path.suffix}")


class _Mp4(FilmFile):
    """H.264 in 4:2:0, which every browser plays, with its index in front."""

    def __init__(self, path: Path, size: tuple[int, int], rate: Fraction) -> None:
        import imageio_ffmpeg

        self._path = path
        self._stream: Generator[Any, bytes, None] = imageio_ffmpeg.write_frames(
            str(_partial(path)),
            size,
            fps=rate,
            codec="libx264",
            pix_fmt_in="rgb24",
            pix_fmt_out="yuv420p",
            quality=None,
            macro_block_size=2,  # 16 by default, and then it scales frames whose sides are not multiples of it
            output_params=[
                *("-crf", "20", "-preset", "veryfast", "-threads", str(ENCODER_THREADS)),
                *("-g", str(max(1, round(KEY_FRAME_S * rate)))),
                # Without these players guess the colours' matrix by the film's size.
                *("-vf", "scale=out_color_matrix=bt709:out_range=tv"),
                *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"),
                *("-movflags", "+faststart", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"),
            ],
        )
        self._run(lambda: self._stream.send(None))

    def _run(self, act: Any) -> None:
        try:
            act()
        except (OSError, RuntimeError) as error:
            raise ModsimError(f"{self._path} could not be encoded: {str(error).strip().splitlines()[0]}") from None

    def add(self, step: int, data: bytes, shown: int) -> None:
        for _ in range(shown):
            self._run(lambda: self._stream.send(data))

    def close(self, complete: bool) -> None:
        try:
            self._run(self._stream.close)
            if complete and not _partial(self._path).exists():
                raise ModsimError(f"{self._path} could not be encoded: ffmpeg wrote nothing")
        finally:
            _settle(self._path, complete)


def _settle(path: Path, complete: bool) -> None:
    if complete and _partial(path).exists():
        _partial(path).replace(path)
    else:
        _partial(path).unlink(missing_ok=True)


class _Gif(FilmFile):
    def __init__(self, path: Path, size: tuple[int, int], rate: Fraction, colours: Image.Image) -> None:
        self._path, self._size, self._rate, self._colours = path, size, rate, colours
        self._out = _partial(path).open("wb")
        self._writer = GifWriter(self._out, size, colours)
        self._shown = 0

    def add(self, step: int, data: bytes, shown: int) -> None:
        begin, self._shown = self._shown, self._shown + shown
        # Rounded from the beginning of the film, so that what is lost on one frame is gained on another.
        ticks = round(TICKS_PER_S * self._shown / self._rate) - round(TICKS_PER_S * begin / self._rate)
        self._writer.write(Image.frombytes("L", self._size, data), ticks)

    def close(self, complete: bool) -> None:
        if complete:
            self._writer.close()
        self._out.close()
        _settle(self._path, complete)


class _Pngs(FilmFile):
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("frame_*.png"):
            old.unlink()

    def add(self, step: int, data: bytes, shown: int) -> None:
        (self._folder / f"frame_{step:06d}.png").write_bytes(data)

    def close(self, complete: bool) -> None:
        """The frames that were drawn stay."""
