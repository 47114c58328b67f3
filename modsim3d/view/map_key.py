"""The key of a map: symbols for what the lines and areas of matplotlib do not show by themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.legend_handler import HandlerBase
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from modsim3d.core.arrays import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist

BOX_PT = (11.0, 5.0)  # length and beam of a hull in the key
ARROW_PT = 11.0  # length of an arrowhead in the key


class HullSymbol(HandlerBase):
    """A hull with the tick before its bow."""

    def create_artists(self, _: Any, handle: Any, *place: Any) -> list[Artist]:
        """The hull in the colours of its handle, and the tick."""
        x, y, width, height, _, transform = place
        (length, beam), left, middle = BOX_PT, -x + 2, -y + height / 2
        hull = Rectangle((left, middle - beam / 2), length, beam, transform=transform)
        _coloured(hull, handle)
        ends = [left + length, width - x]
        return [Line2D(ends, [middle, middle], color="black", lw=1.0, transform=transform), hull]


class ArrowSymbol(HandlerBase):
    """An arrowhead to the right."""

    def __init__(self, shape: Array) -> None:
        """An arrowhead of a shape whose length is 1, shape (n, 2)."""
        super().__init__()
        self._shape = shape

    def create_artists(self, _: Any, handle: Any, *place: Any) -> list[Artist]:
        """The arrowhead in the colours of its handle."""
        x, y, width, height, _, transform = place
        middle = np.array([-x + width / 2, -y + height / 2])
        arrow = Polygon(middle + ARROW_PT * self._shape, transform=transform)
        _coloured(arrow, handle)
        return [arrow]


def _coloured(patch: Polygon | Rectangle, handle: Any) -> None:
    patch.set_facecolor(handle.get_facecolor())
    patch.set_edgecolor(handle.get_edgecolor())
    patch.set_linewidth(handle.get_linewidth())
