"""Names on a map, placed where there is room for them when all else is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from modsim3d.arrays import Array, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation

GAP_PT = 2
"""Between a name and what it names."""
PAST_TIES_PX = 0.001
"""Glyphs lie at 1/64 px. Names at whole pixels would be at ties, which are rounded now up, now down."""
PLACES = np.array(
    [
        *((0.0, 0.0), (0.0, -1.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (1.0, -1.0), (-1.0, -1.0)),
        *((1.0, 1.0), (-1.0, 1.0), (0.0, -2.2), (0.0, 2.2)),
    ]
)
"""Where a name is tried, in sides of what it names: on it, below, above, beside, ..."""


@dataclass(eq=False)
class MapName:
    """The name of a thing on a map.

    Attributes:
        note: Its text.
        vessel: Index of the vessel that has it, None for other things.
        place_m: The middle of the thing, shape (2,); None if the thing is not on the map.
        half_m: Half the size of the thing, shape (2,).
        middle_px: Where the middle of the name was put, in whole pixels, shape (2,); None if there is no room for it.
    """

    note: Annotation
    vessel: int | None
    place_m: Array | None = None
    half_m: Array = field(default_factory=lambda: np.zeros(2))
    middle_px: Array | None = None
    _around_px: Array | None = None

    def extent_px(self) -> Array:
        """The box of the name about its middle, shape (4,); it takes long to find, and stays."""
        if self._around_px is None:
            self.put(np.zeros(2))  # a hidden one has no extent
            self._around_px = np.array(self.note.get_window_extent().extents)
            self.put(None)
        return self._around_px

    def put(self, middle_px: Array | None) -> None:
        """Put the middle of the name at a place on the picture, or hide the name."""
        self.middle_px = middle_px
        self.note.set_visible(middle_px is not None)
        if middle_px is not None:
            points = (middle_px + PAST_TIES_PX) * 72 / self.note.figure.dpi  # which stay in PDF and SVG
            self.note.xy = tuple(points.tolist())


@dataclass(eq=False)
class MapNames:
    """The names on a map.

    Attributes:
        axes: The map, in metres.
        names: The names, those that are placed first in front.
        bodies_m: Outline of what is drawn of each vessel by its index, shape (k, 2) each; names of others keep off it.
    """

    axes: Axes
    names: list[MapName] = field(default_factory=list)
    bodies_m: dict[int, Array] = field(default_factory=dict)

    def add(self, text: str, vessel: int | None = None, **style: Any) -> MapName:
        """Add the name of a thing, of which vessel if it is one; the style is for matplotlib's `annotate`."""
        middle: dict[str, Any] = {"ha": "center", "va": "center", "annotation_clip": False, "zorder": 9}
        places: dict[str, Any] = {"xycoords": "figure points", "xytext": (0, 0), "textcoords": "offset points"}
        note = self.axes.annotate(text, (0, 0), **places, **middle, **style)
        note.set_in_layout(False)  # a name near the edge would otherwise move the map
        self.names.append(MapName(note, vessel))
        return self.names[-1]

    def place(self) -> None:
        """Put each name where it lies on no other and on no other vessel; hide a name without such a place."""
        frame = np.array(self.axes.get_window_extent().extents)
        to_px, gap_px = self.axes.transData.transform, GAP_PT * self.axes.figure.dpi / 72
        metre_px = float(np.ptp(to_px([(0, 0), (1, 0)])[:, 0]))
        owners = np.array(list(self.bodies_m))
        bodies = np.array([shapely.Polygon(to_px(ring)) for ring in self.bodies_m.values()])
        taken = np.empty((0, 4))
        for name in self.names:
            name.put(None)
            if name.place_m is None:
                continue
            here = to_px(name.place_m)
            middles = _middles(here, name.extent_px(), name.half_m * metre_px, gap_px)
            places = middles[:, [0, 1, 0, 1]] + name.extent_px()
            free = _inside(places, frame) & ~_overlapping(places, taken)
            for i in np.flatnonzero(free & _inside(here[[0, 1, 0, 1]][None], frame)).tolist():
                if not shapely.intersects(shapely.box(*places[i]), bodies[owners != name.vessel]).any():
                    name.put(middles[i])
                    taken = np.vstack([taken, places[i]])
                    break


def _middles(thing_px: Array, name_px: Array, half_px: Array, gap_px: float) -> Array:
    """Where the middle of a name may be, in whole pixels, the best place first, shape (n, 2).

    Args:
        thing_px: The middle of what it names, shape (2,).
        name_px: The box of the name about its middle, shape (4,).
        half_px: Half the size of what it names, shape (2,).
        gap_px: Between the two.
    """
    text = (name_px[2:] - name_px[:2]) / 2
    within = not half_px.any() or bool((half_px > text + gap_px).all())
    middles: Array = np.rint(thing_px + (PLACES if within else PLACES[1:]) * (text + half_px + gap_px))
    return middles


def _inside(places: Array, frame: Array) -> Mask:
    """Which boxes, shape (n, 4), lie inside another, shape (4,); shape (n,)."""
    inside: Mask = (frame[:2] <= places[:, :2]).all(axis=1) & (places[:, 2:] <= frame[2:]).all(axis=1)
    return inside


def _overlapping(places: Array, taken: Array) -> Mask:
    """Which boxes, shape (n, 4), overlap one of some others, shape (k, 4); shape (n,)."""
    low, high = places[:, None, :2], places[:, None, 2:]
    overlapping: Mask = ((low < taken[:, 2:]) & (taken[:, :2] < high)).all(axis=2).any(axis=1)
    return overlapping
