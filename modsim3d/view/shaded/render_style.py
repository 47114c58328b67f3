"""How a scene is to look: plain, or shaded in weather and by night."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modsim3d.errors import ModsimError

CONTRAST = 0.02
"""The visibility is the distance at which a black thing keeps this contrast against the sky."""


@dataclass(frozen=True)
class RenderStyle:
    """How a scene is drawn.

    Attributes:
        shaded: Whether it is drawn in light and shade, by pyrender.
        visibility_m: Meteorological visibility; clear air if None. Shaded pictures only.
        night: Whether it is dark. Shaded pictures only.
    """

    shaded: bool = False
    visibility_m: float | None = None
    night: bool = False

    def __post_init__(self) -> None:
        """Check what the user gave."""
        if self.visibility_m is not None and not (0 < self.visibility_m < math.inf):
            given = f"--visibility {self.visibility_m:g}"
            raise ModsimError(f"{given}: give a positive distance in metres, such as 800 for fog")
        if not self.shaded and (self.visibility_m is not None or self.night):
            option = "--night" if self.night else "--visibility"
            raise ModsimError(f"{option} works in shaded pictures only: leave out --look plain")

    @property
    def extinction_per_m(self) -> float:
        """Share of the light that a metre of air takes: −ln 0.02 / V = 3.912 / V (Koschmieder, 1924)."""
        return 0.0 if self.visibility_m is None else -math.log(CONTRAST) / self.visibility_m

    @property
    def caption(self) -> str:
        """A line for the picture, so that nobody takes weather for a part of the simulation."""
        fog = [] if self.visibility_m is None else [f"visibility {self.visibility_m:,.0f} m"]
        weather = fog + (["night"] if self.night else [])
        return f"illustration: {', '.join(weather)}; not part of truth or detections" if weather else ""


PLAIN_STYLE = RenderStyle()
