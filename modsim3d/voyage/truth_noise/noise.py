"""How well AIS tells where a vessel is, where it heads and how large it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.ais.scene_folder import REPORT
from modsim3d.arrays import Array
from modsim3d.inputs.strict_json import load_json
from modsim3d.scene.scene import Scene
from modsim3d.vessels.vessel import Vessel

POSITION_M = 10.0
"""Standard deviation of each coordinate of a position: receivers without correction say that they are good to 10 m."""
POSITION_S = 300.0
"""How long its error lasts: that of a GNSS receiver changes over minutes, with satellites and ionosphere."""
PARAMETERS = ("east", "north", "heading", "length", "beam", "air draft", "antenna along", "antenna across")
"""What the truth of a box depends on, in metres and radians."""
SLOW, CONSTANT = slice(0, 3), slice(3, 8)
"""Those whose errors change over minutes, and those that a vessel keeps."""
_REPORTED_DEG, _FROM_COURSE_DEG, _UNKNOWN_DEG = 1.0, 6.0, 45.0
"""A heading as it is sent; course or bearing in its place, off by leeway and current; none at all."""
_ROUNDED_M = float(np.sqrt(2 / 12))
"""A length is the sum of two distances, each rounded to a metre."""
_TYPICAL = 0.3
"""Spread of a dimension within a ship type, as a share: "100 to 180 m" and "10 to 14 m" in the table of types."""
_ANTENNA = 0.23
"""Spread of the antenna's place where it is taken to be the middle of the hull, as a share: it may be anywhere on four
fifths of it."""
_SAME_M = 1e-9


@dataclass(frozen=True, eq=False)
class TruthNoise:
    """Standard deviations of the errors of truth.

    Attributes:
        std: Of the `PARAMETERS` of each vessel, shape (V, 8).
        position_s: Correlation time of errors of position and heading.
        reasons: What is uncertain besides positions → number of vessels.
    """

    std: Array
    position_s: float
    reasons: Mapping[str, int]

    @classmethod
    def of(cls, scene: Scene, position_m: float = POSITION_M, position_s: float = POSITION_S) -> TruthNoise:
        """That of a scene. Of one that `modsim3d ais` made, its report says what was missing; of others only positions.

        Args:
            scene: The scene.
            position_m: Standard deviation of each coordinate of a position.
            position_s: Correlation time of its error.

        Raises:
            InputError: The report beside the scene cannot be read.
        """
        file = scene.path.parent / REPORT
        content = load_json(file, "report") if file.is_file() else {}
        entries = content.get("vessels", {}) if isinstance(content, dict) else {}
        std, reasons = np.zeros((len(scene.vessels), len(PARAMETERS))), dict[str, int]()
        std[:, :2] = position_m
        for row, vessel in enumerate(scene.vessels):
            entry = entries.get(vessel.name)
            if isinstance(entry, dict):
                std[row, 2] = _heading_rad(entry)
                std[row, CONSTANT], missing = _dimensions(vessel, entry)
                for name in missing:
                    reasons[name] = reasons.get(name, 0) + 1
        return cls(std, position_s, reasons)

    @property
    def position_m(self) -> float:
        """Standard deviation of each coordinate of a position."""
        return float(self.std[0, 0])


def _heading_rad(entry: Mapping[str, Any]) -> float:
    """Spread of the errors of a vessel's headings, by how many of them were sent."""
    replaced = entry.get("replaced", {})
    messages = max(float(entry.get("messages", 1)), 1.0)
    filled = sum(replaced.get(f"heading_{name}", 0) for name in ("from_course", "from_bearing", "held"))
    unknown, filled = replaced.get("heading_unknown", 0) / messages, filled / messages
    sent = max(1 - filled - unknown, 0.0)
    degrees = np.sqrt(sent * _REPORTED_DEG**2 + filled * _FROM_COURSE_DEG**2 + unknown * _UNKNOWN_DEG**2)
    return float(np.radians(degrees))


def _dimensions(vessel: Vessel, entry: Mapping[str, Any]) -> tuple[Array, list[str]]:
    """Spread of length, beam, air draft and the antenna's place, shape (5,), and which of them were typical ones.

    What a user has changed in the scene since is taken to be known.
    """
    std, missing = np.zeros(5), []
    for place, name in enumerate(("length", "beam", "air_draft")):
        value = float(getattr(vessel, f"{name}_m"))
        if abs(float(entry.get(f"{name}_m", np.nan)) - value) > _SAME_M:
            continue
        typical = name in entry.get("defaults", ())
        std[place] = _TYPICAL * value if typical else _ROUNDED_M
        missing += [name.replace("_", " ")] if typical else []
    if "antenna" in entry.get("defaults", ()):
        std[3:] = _ANTENNA * vessel.length_m, _ANTENNA * vessel.beam_m
        missing.append("antenna's place")
    return std, missing
