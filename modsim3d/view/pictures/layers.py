"""What may be drawn of a frame, by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

from modsim3d.errors import ModsimError


@dataclass(frozen=True)
class Layers:
    """Which layers are drawn, the first at the bottom.

    Attributes:
        horizon: A line between sea and sky.
        silhouettes: What is seen of each vessel, filled.
        hatching: What is hidden of each vessel, hatched.
        wires: The edges of each vessel's shoebox.
        points: Its projected corner points.
        full: The box of the whole silhouette, where another one is annotated.
        visible: The box of what is seen, where another one is annotated.
        truth: The annotated box.
        fractions: How much of a vessel is seen, if not all.
        missed: Annotated vessels without a detection.
        false_positives: Detections without a vessel.
        detections: Detections of vessels.
        labels: Their class and confidence.
    """

    horizon: bool = False
    silhouettes: bool = False
    hatching: bool = False
    wires: bool = False
    points: bool = False
    full: bool = False
    visible: bool = False
    truth: bool = False
    fractions: bool = False
    missed: bool = False
    false_positives: bool = False
    detections: bool = False
    labels: bool = False

    @classmethod
    def of(cls, names: Iterable[str]) -> Layers:
        """Layers by their names.

        Raises:
            ModsimError: One has no such name.
        """
        known = [entry.name for entry in fields(cls)]
        asked = list(names)
        unknown = [name for name in asked if name not in known]
        if unknown:
            raise ModsimError(f"unknown layer '{', '.join(unknown)}'; known layers: {', '.join(known)}")
        return replace(cls(), **dict.fromkeys(asked, True))


CORNERS = Layers.of(["horizon", "wires", "points"])
SCENE = Layers.of(["horizon", "silhouettes"])
DETECTIONS = Layers(
    horizon=True,
    silhouettes=True,
    full=True,
    visible=True,
    truth=True,
    fractions=True,
    missed=True,
    false_positives=True,
    detections=True,
    labels=True,
)
