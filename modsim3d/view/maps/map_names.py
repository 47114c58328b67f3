"""Names on a map, placed where there is room for them when all else is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from modsim3d.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

GAP_PT = 2
"""Between a name and what it names."""
PLACES = (
    *((0.0, 0.0), (0.0, -1.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (1.0, -1.0), (-1.0, -1.0)),
    *((1.0, 1.0), (-1.0, 1.0), (0.0, -2.2), (0.0, 2.2)),
)
"""Where a name is tried, in sides of what it names: on it, below, above, beside, ..."""


@dataclass(eq=False)
class MapNames:
    """The names on a map.

    Attributes:
        axes: The map, in metres.
        bodies_m: Outline of what is drawn of each vessel by its index, shape (k, 2) each; names of others keep off it.
    """

    axes: Axes
    bodies_m: dict[int, Array] = field(default_factory=dict)
    _waiting: list[tuple[Annotation, Array, int | None]] = field(default_factory=list)

    def add(self, text: str, place_m: Array, half_m: Array, vessel: int | None = None, **style: Any) -> None:
        """Add the name of a thing, of which vessel if it is one; names added first are placed first.

        The thing's middle and half its size have the shape (2,). The style is for matplotlib's `annotate`.
        """
        middle: dict[str, Any] = {"xytext": (0, 0), "textcoords": "offset points", "ha": "center", "va": "center"}
        note = self.axes.annotate(text, (place_m[0], place_m[1]), zorder=9, **middle, **style)
        self._waiting.append((note, half_m, vessel))

    def place(self) -> None:
        """Move each name so that none lies on another or on another vessel; leave out a name without such a place."""
        point_px, frame = self.axes.figure.dpi / 72, self.axes.get_window_extent()
        to_px = self.axes.transData.transform
        metre_px = float(np.ptp(to_px([(0, 0), (1, 0)])[:, 0]))
        bodies = {vessel: shapely.Polygon(to_px(ring)) for vessel, ring in self.bodies_m.items()}
        taken: list[Bbox] = []
        for note, half_m, vessel in self._waiting:
            box = note.get_window_extent()
            others = [body for owner, body in bodies.items() if owner != vessel]
            moves = _moves(box, frame, half_m * metre_px, GAP_PT * point_px)
            free = (move for move in moves if _is_free(box.translated(*move), frame, others, taken))
            move = next(free, None)
            if move is None:
                note.remove()
            else:
                note.set_position((move[0] / point_px, move[1] / point_px))
                taken.append(box.translated(*move))


def _moves(name: Bbox, frame: Bbox, half_px: Array, gap_px: float) -> list[tuple[float, float]]:
    """How a name may move from the middle of what it names, in pixels, the best place first; none outside the map."""
    if not frame.contains((name.x0 + name.x1) / 2, (name.y0 + name.y1) / 2):
        return []
    text = np.array([name.width, name.height]) / 2
    within = not half_px.any() or bool((half_px > text + gap_px).all())
    x, y = (np.array(PLACES if within else PLACES[1:]) * (text + half_px + gap_px)).T.tolist()
    return list(zip(x, y, strict=True))


def _is_free(place: Bbox, frame: Bbox, bodies: list[shapely.Polygon], taken: list[Bbox]) -> bool:
    """Whether a name may stand there: inside the map, on no other name and on no other vessel."""
    inside = frame.x0 <= place.x0 and place.x1 <= frame.x1 and frame.y0 <= place.y0 and place.y1 <= frame.y1
    if not inside or any(place.overlaps(other) for other in taken):
        return False
    return not shapely.intersects(shapely.box(*place.extents), bodies).any()
