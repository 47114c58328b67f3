"""The layers of a picture of a frame, by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Self

from modsim3d.core.errors import ModsimError
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import Frame, detected_rows


@dataclass(frozen=True)
class NamedLayers:
    """Layers that are drawn or not, by name: the fields of a dataclass."""

    @classmethod
    def of(cls, names: Iterable[str]) -> Self:
        """Layers by their names; raises ModsimError if one has no such name."""
        layers, asked = [entry.name for entry in fields(cls)], list(names)
        if unknown := [name for name in asked if name not in layers]:
            raise ModsimError(f"unknown layer '{', '.join(unknown)}'; known layers: {', '.join(layers)}")
        return cls(**dict.fromkeys(asked, True))

    def without(self, *names: str) -> Self:
        """The others of these layers."""
        return replace(self, **dict.fromkeys(names, False))


@dataclass(frozen=True)
class Layers(NamedLayers):
    """The layers that are drawn, the first at the bottom."""

    horizon: bool = False  # a line between sea and sky
    silhouettes: bool = False  # the visible part of each vessel, filled
    hatching: bool = False  # the hidden part of each vessel, hatched
    wires: bool = False  # the edges of each vessel's shoebox
    points: bool = False  # its projected corner points
    full: bool = False  # the box of the whole silhouette, where another one is annotated
    visible: bool = False  # the box of the visible part, where another one is annotated
    truth: bool = False  # the annotated box
    fractions: bool = False  # the visible fraction of a vessel that is hidden in part
    missed: bool = False  # annotated vessels without a detection
    false_positives: bool = False  # detections that are not the one detection of a vessel
    detections: bool = False  # of vessels
    mistakes: bool = False  # marks of detections of a wrong class or with a bad box
    tracks: bool = False  # of a tracker, where there are some: boxes, numbers, and where their centres have been
    numbers: bool = False  # of vessels, as in the legend
    labels: bool = False  # class and confidence of detections, and the names of missed vessels


@dataclass(frozen=True)
class MapLayers(NamedLayers):
    """Layers that are drawn on a map beside what is there."""

    vectors: bool = False  # where each vessel is after six minutes at her course and speed
    cpa: bool = False  # closest points of approach to own ship within these six minutes
    detections: bool = False  # bearings of the detections from the cameras
    tracks: bool = False  # bearings of the tracks of a tracker, where there are some, and their numbers
    nm: bool = False  # range rings in nautical miles
    cables: bool = False  # range rings in cables, a tenth of a nautical mile


CORNERS = Layers.of(["horizon", "wires", "points"])
SCENE = Layers.of(["horizon", "silhouettes"])
TRUTH = ("full", "visible", "truth", "fractions", "missed")
NO_LAYERS = MapLayers()
MAP, PLAN = MapLayers.of(["vectors", "cpa"]), MapLayers.of(["vectors", "cpa", "detections", "tracks"])
DETECTIONS = Layers.of(
    ["horizon", "silhouettes", *TRUTH, "false_positives", "detections", "mistakes", "tracks", "labels"]
)

NAMES = {
    Outcome.FALSE_POSITIVE: "false positive",
    Outcome.MISLABELLED: "wrong class",
    Outcome.BELOW_HALF_IOU: "IoU below 0.5",
    Outcome.OFF_VESSEL: "off its vessel",
}

WEATHER = "weather is not drawn"  # states are named after it, but sea and sky look the same in all of them


def is_a(label: str) -> str:
    """Words for a wrongly labelled vessel: `is a ferry`."""
    return f"is {'an' if label.lower().startswith(tuple('aeiou')) else 'a'} {label}"


def fate(frame: Frame, vessel: str) -> str:
    """Fate of an annotated vessel in a frame: missed, or detected, and what is wrong with the detection."""
    if not frame.truth.detected[frame.truth.vessels.index(vessel)]:
        return "missed"
    rows = [None if row is None else frame.truth.vessels[row] for row in detected_rows(frame)]
    if vessel not in rows:
        return "detected, in one box with another"
    index = rows.index(vessel)
    outcome, label = frame_outcomes(frame)[index], frame.detections.labels[index]
    words = [f"detected as {label}" if outcome & Outcome.MISLABELLED else "detected"]
    if outcome & Outcome.OFF_VESSEL:
        words.append("by a box off the vessel")
    elif outcome & Outcome.BELOW_HALF_IOU:
        words.append("with IoU below 0.5")
    return " ".join(words)
