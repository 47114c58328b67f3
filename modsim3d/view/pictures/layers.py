"""The layers of a picture of a frame, by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Self

from modsim3d.core.errors import ModsimError


@dataclass(frozen=True)
class Layers:
    """The layers that are drawn, the first at the bottom.

    Attributes:
        horizon: A line between sea and sky.
        silhouettes: The visible part of each vessel, filled.
        hatching: The hidden part of each vessel, hatched.
        wires: The edges of each vessel's shoebox.
        points: Its projected corner points.
        full: The box of the whole silhouette, where another one is annotated.
        visible: The box of the visible part, where another one is annotated.
        truth: The annotated box.
        fractions: The visible fraction of a vessel that is hidden in part.
        missed: Annotated vessels without a detection.
        false_positives: Detections that are not the one detection of a vessel.
        detections: Detections of vessels.
        mistakes: Marks of detections of a wrong class or with a bad box.
        tracks: Tracks of a tracker, where there are some: boxes, numbers, and where their centres have been.
        labels: Class and confidence of detections, and the names of missed vessels.
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
    mistakes: bool = False
    tracks: bool = False
    labels: bool = False

    @classmethod
    def of(cls, names: Iterable[str]) -> Layers:
        """Layers by their names.

        Raises:
            ModsimError: One has no such name.
        """
        known = [entry.name for entry in fields(cls)]
        asked = list(names)
        if unknown := [name for name in asked if name not in known]:
            raise ModsimError(f"unknown layer '{', '.join(unknown)}'; known layers: {', '.join(known)}")
        return cls(**dict.fromkeys(asked, True))

    def without(self, *names: str) -> Self:
        """The others of these layers."""
        return replace(self, **dict.fromkeys(names, False))


CORNERS = Layers.of(["horizon", "wires", "points"])
SCENE = Layers.of(["horizon", "silhouettes"])
TRUTH = ("full", "visible", "truth", "fractions", "missed")
DETECTIONS = Layers.of(
    ["horizon", "silhouettes", *TRUTH, "false_positives", "detections", "mistakes", "tracks", "labels"]
)
