"""GIF films, written frame by frame with Pillow's encoder: memory holds two pictures.

imageio's plugins either keep all frames in memory until the last one is there, or choose colours of their own. Measured
by `python -m benchmarks.gif_writers` with 200 frames of 640 × 490 px of Simulation 1, Pillow 13.0 and imageio 2.38:

| Writer | Processor time | File | Memory for frames | Pixels of another colour |
|---|---|---|---|---|
| this one | 0.5 s | 768 kB | 2 MB | 0 % |
| imageio, `pillow`, with the film's palette | 1.0 s | 931 kB | 130 MB | 0 % |
| imageio, `pillow` | 4.5 s | 1254 kB | 306 MB | 13 % |
| imageio, `GIF-PIL` | 3.7 s | 1849 kB | 5 MB | 13 % |
| imageio, `FFMPEG`, with the film's palette | 0.8 s | 774 kB | 55 MB | 12 % |
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import itemgetter
from typing import IO

from PIL import Image, ImageChops
from PIL.GifImagePlugin import getdata, getheader

from modsim3d.view import palette

TICKS_PER_S = 100
"""A GIF counts in hundredths of a second."""
LONGEST_TICKS = 0xFFFF
"""The longest that a GIF can show a picture; one that lasts longer is stored again."""
UNCHANGED = 255
"""Palette index of a pixel that stays as it was in the picture before."""
KEEP = 1
"""Disposal method of a frame that the next one is drawn over."""


def film_palette(samples: Sequence[Image.Image]) -> Image.Image:
    """Choose 255 colours for a film: those that everything is drawn with, and the most frequent ones of some frames.

    All frames share one palette, so that what stands still keeps the same index. A picture of one pixel holds it.
    """
    exact = [palette.PAPER, palette.INK, palette.SEA, palette.SKY, palette.TRUTH, palette.ALARM, palette.HORIZON]
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
    A frame is palette indices as grey levels (mode L), and how long it is shown, in ticks. There is at least one.
    """
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
        for ticks in _storable(sum(ticks for _, ticks in group)):
            options = {"duration": ticks * 1000 // TICKS_PER_S, "disposal": KEEP, "transparency": UNCHANGED}
            out.writelines(getdata(changed.crop(box), box[:2], **options))
        before = picture
    out.write(b";")


def _storable(ticks: int) -> list[int]:
    """A duration as parts that a GIF can hold."""
    whole, rest = divmod(ticks, LONGEST_TICKS)
    return [LONGEST_TICKS] * whole + [rest] * (rest > 0)
