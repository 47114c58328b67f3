"""Names on a map, placed where there is room for them when all else is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import intersections

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.text import Annotation

GAP_PT = 2  # between a name and what it names
PAST_TIES_PX = 0.001  # glyphs lie at 1/64 px; at whole pixels names would be at ties, rounded now up, now down
_SIDES = ((0.0, 0.0), (0.0, -1.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0))
PLACES = np.array([*_SIDES, (1.0, -1.0), (-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""Where a name is tried, in sides of what it names: on it, below, above, beside, ..."""

LEADER, HALO, HALO_PT = "#4d4d4d", "#eef3f6", 1.6
"""Colours of the line from a name to its thing and of the edge around letters, and the width of that edge."""
Shapes = NDArray[np.object_]
_AWAY = np.array([1.2, 2.2, 3.4, 5.0, 7.0, 9.5, 13.0, 17.0, 22.0, 28.0, 36.0, 46.0])  # tries, in half heights of a text
_ANGLES_RAD = np.linspace(0, 2 * np.pi, 24, endpoint=False)
_ROUND = np.column_stack([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)])


@dataclass(eq=False)
class MapName:
    """The name of a thing on a map."""

    note: Annotation
    vessel: int | None  # index of the vessel that has it, None for other things
    place_m: Array | None = None  # the middle of the thing, shape (2,); None if the thing is not on the map
    half_m: Array = field(default_factory=lambda: np.zeros(2))  # half the size of the thing, shape (2,)
    end_m: Array | None = None  # where the line of a name farther off ends, shape (2,); at the thing if None
    short: str = ""  # text where there is no room for the whole one
    middle_px: Array | None = None  # of the name as placed, in whole pixels, shape (2,); None without room for it
    _around_px: Array | None = None

    def extent_px(self) -> Array:
        """The box of the name about its middle, shape (4,); it takes long to find, and stays."""
        if self._around_px is None:
            self.put(np.zeros(2))  # a hidden one has no extent
            self._around_px = np.array(self.note.get_window_extent().extents)
            self.put(None)
        return self._around_px

    def show(self, text: str, place_m: Array, short: str = "") -> None:
        """Name a place, shape (2,), with another text, and a short one where there is no room."""
        if text != self.note.get_text():
            self.note.set_text(text)
            self._around_px = None
        self.place_m, self.short = place_m, short

    def put(self, middle_px: Array | None) -> None:
        """Put the middle of the name at a place on the picture, or hide the name."""
        self.middle_px = middle_px
        self.note.set_visible(middle_px is not None)
        if middle_px is not None:
            points = (middle_px + PAST_TIES_PX) * 72 / self.note.figure.dpi  # which stay in PDF and SVG
            self.note.xy = tuple(points.tolist())


@dataclass(eq=False)
class MapNames:
    """The names on a map in metres; names keep off what is drawn of other vessels, and lie on no camera."""

    axes: Axes
    names: list[MapName] = field(default_factory=list)  # those that are placed first in front
    bodies_m: dict[int, Array] = field(default_factory=dict)  # outline of each vessel by its index, shape (k, 2)
    ticks_m: dict[int, Array] = field(default_factory=dict)  # heading tick of each vessel that has one, shape (2, 2)
    trails_m: dict[int, Array] = field(default_factory=dict)  # the last part of each vessel's track, shape (n, 2)
    dots_m: dict[int, Array] = field(default_factory=dict)  # the cameras, shape (2,)
    leaders: LineCollection = field(init=False)  # the lines from names to what they name

    def __post_init__(self) -> None:
        """Put the lines on the map, where `place` finds them."""
        from matplotlib.collections import LineCollection
        from matplotlib.transforms import Affine2D

        points = Affine2D().scale(1 / 72) + self.axes.figure.dpi_scale_trans  # which stay in PDF and SVG
        self.leaders = LineCollection([], colors=LEADER, linewidths=0.6, zorder=8.5, transform=points)
        self.axes.add_collection(self.leaders, autolim=False)

    def clear(self) -> None:
        """Forget where vessels and cameras were."""
        for drawn in (self.bodies_m, self.ticks_m, self.trails_m, self.dots_m):
            drawn.clear()

    def add(self, text: str, vessel: int | None = None, **style: Any) -> MapName:
        """Add the name of a thing, of which vessel if it is one; the style is for matplotlib's `annotate`."""
        from matplotlib.patheffects import withStroke

        middle: dict[str, Any] = {"ha": "center", "va": "center", "annotation_clip": False, "zorder": 9}
        places: dict[str, Any] = {"xycoords": "figure points", "xytext": (0, 0), "textcoords": "offset points"}
        note = self.axes.annotate(text, (0, 0), **places, **middle, **style)
        note.set_path_effects([withStroke(linewidth=HALO_PT, foreground=HALO)])
        note.set_in_layout(False)  # a name near the edge would otherwise move the map
        self.names.append(MapName(note, vessel))
        return self.names[-1]

    def place(self) -> None:
        """Put each name beside its thing, or farther off with a line to it; hide a name without room for it.
        A name lies on no other, on no other vessel, on no heading tick and on no camera. Where it can, it lies on no
        track's last part."""
        page = _Page.of(self)
        later = []
        for name in self.names:
            name.put(None)
            if name.place_m is None or not _inside(page.to_px(name.place_m)[[0, 1, 0, 1]][None], page.frame).any():
                continue
            middles = _middles(page.to_px(name.place_m), name.extent_px(), name.half_m * page.metre_px, page.gap_px)
            if not page.put(name, middles, avoid_lines=True):
                later.append(name)
        lines = []
        for name in later:
            if not (line := page.put_away(name)) and name.short and name.place_m is not None:
                name.show(name.short, name.place_m)
                line = page.put_away(name)
            lines += line
        self.leaders.set_segments([line * 72 / self.axes.figure.dpi for line in lines])


@dataclass(eq=False)
class _Page:
    """A map in pixels, on which names are placed one after another."""

    frame: Array  # the box of the map, shape (4,)
    to_px: Any  # places in metres as pixels
    metre_px: float
    gap_px: float  # between a name and what it names
    owners: Indices  # index of the vessel of each body, shape (b,)
    bodies: Shapes  # outlines of the vessels, shape (b,)
    ticks: Shapes
    trails: Shapes
    dots: Shapes
    taken: Array = field(default_factory=lambda: np.empty((0, 4)))  # boxes of the names placed, shape (k, 4)
    leaders: list[Any] = field(default_factory=list)

    @classmethod
    def of(cls, names: MapNames) -> _Page:
        to_px = names.axes.transData.transform
        return cls(
            np.array(names.axes.get_window_extent().extents),
            to_px,
            float(np.ptp(to_px([(0, 0), (1, 0)])[:, 0])),
            GAP_PT * names.axes.figure.dpi / 72,
            np.array(list(names.bodies_m)),
            _drawn(shapely.Polygon, names.bodies_m, to_px),
            _drawn(shapely.LineString, names.ticks_m, to_px),
            _drawn(shapely.LineString, names.trails_m, to_px),
            _drawn(shapely.Point, names.dots_m, to_px),
        )

    def put(self, name: MapName, middles: Array, *, avoid_lines: bool) -> bool:
        """Put a name at the first free one of some places, shape (n, 2), or leave it hidden."""
        free = self._free(name, middles)
        if not len(free):
            return False
        if avoid_lines:
            boxes = shapely.box(*(middles[free][:, [0, 1, 0, 1]] + name.extent_px()).T)
            clear = ~_met(boxes, self.trails)
            free = free[clear] if clear.any() else free
        self._take(name, middles[free[0]])
        return True

    def put_away(self, name: MapName) -> list[Array]:
        """Put a name farther off its thing, and give the line between them, shape (2, 2); none if it is hidden."""
        assert name.place_m is not None
        here, text = self.to_px(name.place_m), np.ptp(name.extent_px().reshape(2, 2), axis=0) / 2
        steps = _AWAY[:, None, None] * text[1] * _ROUND + np.sign(_ROUND.round(6)) * text
        middles = np.rint(here + steps).reshape(-1, 2)
        free = self._free(name, middles)
        boxes = shapely.box(*(middles[free][:, [0, 1, 0, 1]] + name.extent_px()).T)
        body = self.bodies[self.owners == name.vessel]
        end = shapely.Point(here if name.end_m is None else self.to_px(name.end_m))
        lines = shapely.shortest_line(boxes, body[0] if len(body) else end)
        names, others = _met(lines, shapely.box(*self.taken.T)), self.bodies[self.owners != name.vessel]
        crossed = _met(lines, np.array([*self.leaders, *others])) | _met(boxes, np.array(self.leaders))
        for allowed in (~names & ~crossed, ~names):
            if allowed.any():
                first = int(np.argmax(allowed))
                self._take(name, middles[free[first]])
                self.leaders.append(lines[first])
                return [shapely.get_coordinates(lines[first])]
        return []

    def _free(self, name: MapName, middles: Array) -> Indices:
        """Indices of the places, shape (n, 2), that are free for a name, in their order."""
        places = middles[:, [0, 1, 0, 1]] + name.extent_px()
        apart = (intersections(places[:, None], self.taken) == 0).all(axis=1)
        free: Indices = np.flatnonzero(_inside(places, self.frame) & apart)
        things = np.concatenate([self.bodies[self.owners != name.vessel], self.ticks, self.dots])
        return free[~_met(shapely.box(*places[free].T), things)]

    def _take(self, name: MapName, middle: Array) -> None:
        name.put(middle)
        self.taken = np.vstack([self.taken, middle[[0, 1, 0, 1]] + name.extent_px()])


def _drawn(kind: Callable[[Array], Any], things_m: dict[int, Array], to_px: Callable[[Array], Array]) -> Shapes:
    return np.array([kind(to_px(points)) for points in things_m.values()], dtype=object)


def _met(shapes: Shapes, others: Shapes) -> Mask:
    """Mask of the shapes, shape (n,), that meet one of some others, shape (k,); shape (n,)."""
    met: Mask = shapely.intersects(shapes[:, None], others).any(axis=1)
    return met


def _middles(thing_px: Array, name_px: Array, half_px: Array, gap_px: float) -> Array:
    """Places for the middle of a name, in whole pixels, the best first, shape (n, 2). `thing_px` and `half_px` are the
    middle and half the size of what it names, shape (2,), `name_px` is the box of the name about its middle, (4,)."""
    text = (name_px[2:] - name_px[:2]) / 2
    within = not half_px.any() or bool((half_px > text + gap_px).all())
    return np.rint(thing_px + (PLACES if within else PLACES[1:]) * (text + half_px + gap_px))


def _inside(places: Array, frame: Array) -> Mask:
    """Mask of the boxes, shape (n, 4), that lie inside another, shape (4,); shape (n,)."""
    inside: Mask = np.all((frame[:2] <= places[:, :2]) & (places[:, 2:] <= frame[2:]), axis=1)
    return inside
