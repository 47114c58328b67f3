"""GIF films, written frame by frame: memory holds one picture, and only what has changed is stored."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from typing import IO

from PIL import Image, ImageChops

from modsim3d.view import palette

TICKS_PER_S = 100
"""A GIF counts in hundredths of a second."""


def film_palette(samples: Sequence[Image.Image]) -> Image.Image:
    """A palette picture of 256 colours: those that everything is drawn with, and those that samples have most.

    One palette for all frames keeps what stands still the same pixels.
    """
    exact = [palette.PAPER, palette.INK, palette.SEA, palette.SKY, palette.TRUTH, palette.ALARM, palette.HORIZON]
    exact += [palette.vessel_colour(i) for i in range(3 * len(palette.VESSELS))]
    width, height = max(p.width for p in samples), sum(p.height for p in samples)
    stack, y = Image.new("RGB", (width, height)), 0
    for sample in samples:
        stack.paste(sample, (0, y))
        y += sample.height
    adapted = stack.quantize(256 - len(exact), dither=Image.Dither.NONE).getpalette() or []
    colours = [channel for colour in exact for channel in colour] + adapted
    holder = Image.new("P", (1, 1))
    holder.putpalette((colours + [0] * 768)[:768])
    return holder


def quantised(picture: Image.Image, colours: Image.Image) -> Image.Image:
    """A picture in the film's palette."""
    return picture.quantize(palette=colours, dither=Image.Dither.NONE)


class GifWriter:
    """Writes pictures to a stream (GIF 89a); they are given as indices into one palette, in grey levels."""

    def __init__(self, out: IO[bytes], size: tuple[int, int], colours: Image.Image) -> None:
        """Write the header: size, palette, and that the film begins again when it ends."""
        self._out = out
        self._before: Image.Image | None = None
        self._waiting: tuple[bytes, int] | None = None
        table = bytes((colours.getpalette() or [])[:768]).ljust(768, b"\0")
        out.write(b"GIF89a" + struct.pack("<HHBBB", *size, 0xF7, 0, 0) + table)
        out.write(b"\x21\xff\x0bNETSCAPE2.0\x03\x01" + struct.pack("<HB", 0, 0))

    def write(self, picture: Image.Image, ticks: int) -> None:
        """Show a picture for some hundredths of a second."""
        before, self._before = self._before, picture
        changed: tuple[int, int, int, int] | None = (0, 0, *picture.size)
        if before is not None:
            changed = ImageChops.difference(before, picture).getbbox()
        if changed is None and self._waiting is not None:
            self._waiting = self._waiting[0], self._waiting[1] + ticks
            return
        self._flush()
        x, y, right, bottom = changed or (0, 0, 1, 1)
        part = picture.crop((x, y, right, bottom))
        descriptor = struct.pack("<BHHHHB", 0x2C, x, y, part.width, part.height, 0)
        self._waiting = descriptor + _coded(part), ticks

    def _flush(self) -> None:
        if self._waiting is None:
            return
        coded, ticks = self._waiting
        while ticks > 0:  # longer than a GIF can say: shown again
            shown = min(ticks, 0xFFFF)
            self._out.write(struct.pack("<BBBBHBB", 0x21, 0xF9, 4, 0x04, shown, 0, 0) + coded)
            ticks -= shown
        self._waiting = None

    def close(self) -> None:
        """Write the last picture and the end."""
        self._flush()
        self._out.write(b"\x3b")


def _coded(picture: Image.Image) -> bytes:
    """The coded pixels of a picture: taken from a GIF of it alone, after its descriptor."""
    alone = io.BytesIO()
    picture.save(alone, format="GIF", optimize=False, interlace=0)
    data = alone.getvalue()
    flags = data[10]
    at = 13 + (3 << (flags & 7) + 1 if flags & 0x80 else 0)
    while data[at] == 0x21:  # extensions: skip their blocks
        at += 2
        while data[at]:
            at += data[at] + 1
        at += 1
    local = data[at + 9]
    return data[at + 10 + (3 << (local & 7) + 1 if local & 0x80 else 0) : -1]
