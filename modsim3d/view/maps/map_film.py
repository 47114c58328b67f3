"""Maps one after another, fast: what does not move is drawn once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, groupby
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from modsim3d.arrays import Array, Indices
from modsim3d.view.maps.birds_eye import BirdsEye
from modsim3d.view.maps.map_names import MapName
from modsim3d.view.maps.map_picture import Map

if TYPE_CHECKING:
    from matplotlib.artist import Artist

Pixels = NDArray[np.uint8]
Part = tuple[slice, slice]
BESIDE_PX = 4
"""A name may colour pixels so far outside its box."""


class MapFilmRenderer:
    """Draws a map at one step after another, as `map_picture` does but for rounding.

    The artists lie in layers, of which every second one stays as it is. The lowest is a picture to draw on; a higher
    one is kept as the pixels that it covers, which are blended with what moves below them.

    Attributes:
        map: The map, at the step of the last picture.
    """

    def __init__(self, birds_eye: BirdsEye, size: tuple[int, int]) -> None:
        """Draw all that stays, at a width and height in pixels."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.map = Map(birds_eye, *size)
        self.map.show(0)
        canvas = FigureCanvasAgg(self.map.figure)
        self._renderer = canvas.get_renderer()
        self._pixels: Pixels = np.asarray(canvas.buffer_rgba())  # shares the renderer's memory
        layers = _layers(self.map)
        names = self.map.sheet.names.names
        for artist in (*chain(*layers), *(name.note for name in names)):
            artist.set_animated(True)  # the figure leaves them out
        canvas.draw()
        self._ground = self._pixels.copy()
        moving = set(self.map.sheet.moving)
        self._layers = [layer if layer[0] in moving else self._cover(layer) for layer in layers]
        self._names = [(name, self._stamp(name)) for name in names]

    def picture(self, step: int) -> Image.Image:
        """The map at a step."""
        self.map.show(step)
        self._pixels[:] = self._ground
        for layer in self._layers:
            if isinstance(layer, _Cover):
                layer.blend(self._pixels)
            else:
                self._draw(layer)
        for name, stamp in self._names:
            if name.middle_px is not None:
                stamp.blend(self._pixels, self._at(name.middle_px))
        height, width = self._pixels.shape[:2]
        return Image.frombytes("RGB", (width, height), self._pixels.tobytes(), "raw", "RGBX")

    def _draw(self, artists: list[Artist]) -> None:
        for artist in artists:
            artist.draw(self._renderer)

    def _at(self, place_px: Array) -> Indices:
        """Row and column of a whole place on the picture, whose rows count from below."""
        return np.array([len(self._pixels) - place_px[1], place_px[0]], dtype=np.int64)

    def _stamp(self, name: MapName) -> _Cover:
        """A name, drawn once; its pixels count from its middle."""
        x0, y0, x1, y1 = name.extent_px().tolist()
        name.put(np.ceil([BESIDE_PX - x0, BESIDE_PX - y0]))  # as low and as far to the left as it can be
        assert name.middle_px is not None
        middle = self._at(name.middle_px)
        part = np.s_[middle[0] - math.ceil(y1) - BESIDE_PX :, : middle[1] + math.ceil(x1) + BESIDE_PX]
        return self._cover([name.note], part, middle)

    def _cover(self, artists: list[Artist], part: Part = np.s_[:, :], origin: Indices | None = None) -> _Cover:
        """What some artists cover in a part of the picture; its pixels count from one of the picture's."""
        black, white = (self._on(artists, part, ground) for ground in (0, 255))
        covered = np.nonzero((black != 0).any(axis=2) | (white != 255).any(axis=2))
        kept = (white[covered] - np.float32(black[covered])) / np.float32(255)
        first = np.array([axis.start or 0 for axis in part], dtype=np.int64)
        places: Indices = np.array(covered) + first[:, None] - (0 if origin is None else origin[:, None])
        return _Cover(places, kept, black[covered] + np.float32(0.5))

    def _on(self, artists: list[Artist], part: Part, ground: int) -> Pixels:
        """The colours of a part of the picture when artists are drawn on one grey level."""
        self._pixels[part] = (ground, ground, ground, 255)
        self._draw(artists)
        return self._pixels[part][..., :3].copy()


@dataclass(frozen=True, eq=False)
class _Cover:
    """The pixels that some artists cover.

    Attributes:
        places: Their rows and columns, shape (2, n).
        kept: The share of each colour that shows through, shape (n, 3).
        added: The colour that is added, and a half, so that the result is rounded, shape (n, 3).
    """

    places: Indices
    kept: NDArray[np.float32]
    added: NDArray[np.float32]

    def blend(self, pixels: Pixels, origin: Indices | None = None) -> None:
        """Lay them over an opaque picture, shape (h, w, 4), where they count from one of its pixels, shape (2,)."""
        rows, columns = self.places if origin is None else self.places + origin[:, None]
        where = rows * pixels.shape[1] + columns
        flat = pixels.reshape(-1, 4)
        flat[where, :3] = flat[where, :3] * self.kept + self.added


def _layers(drawn: Map) -> list[list[Artist]]:
    """The artists from the lowest that moves upwards, in layers that either move or stay, in turn."""
    axes, moving = drawn.sheet.axes, set(drawn.sheet.moving)
    title = axes.title  # it lies outside the map, so that it may be drawn at any time
    apart = {axes.patch, title, *(name.note for name in drawn.sheet.names.names)}
    inside = [artist for artist in axes.get_children() if artist not in apart]
    layers = [list(layer) for _, layer in groupby(sorted(inside, key=attrgetter("zorder")), moving.__contains__)]
    return [*(layers if layers[0][0] in moving else layers[1:]), [title]]
