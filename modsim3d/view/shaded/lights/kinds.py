"""What kind of vessel the rules take a vessel for, by words in its mesh's name, its label and its ID."""

from __future__ import annotations

import re
from enum import Enum, auto

from modsim3d.vessels.vessel import Vessel


class Kind(Enum):
    """Kinds of vessels that have rules of their own."""

    POWER = auto()
    SAIL = auto()
    OARS = auto()
    TRAWLING = auto()
    FISHING = auto()


ACTIVITIES = {Kind.TRAWLING: {"trawling"}, Kind.FISHING: {"netting", "longlining"}}
"""Words for what a vessel does. A ship type, such as trawler or fishing vessel, does not say that she fishes."""
BUILDS = (
    (Kind.POWER, {"motor", "motorboat", "motoryacht", "motorsailer", "power", "powerboat", "speedboat"}),
    (Kind.OARS, {"kayak", "canoe", "rowing", "rowboat", "paddle", "paddleboard"}),
    (Kind.SAIL, {"sail", "sails", "sailing", "sailboat", "sailer", "yacht", "ketch", "sloop", "schooner", "yawl"}),
    (Kind.POWER, {"ship", "ferry", "tug", "cargo", "tanker", "barge"}),
)
"""Words for what a vessel is. If a text has several, the first line that has one of them counts."""


def kind_of(vessel: Vessel) -> Kind:
    """The kind of a vessel: what it does, else what it is by its mesh, its label or its ID, else power-driven."""
    texts = [_words(text) for text in (vessel.shape, vessel.label, vessel.name)]
    for kind, words in ACTIVITIES.items():
        if any(words & text for text in texts):
            return kind
    for text in texts:
        for kind, words in BUILDS:
            if words & text:
                return kind
    return Kind.POWER


def _words(text: str) -> set[str]:
    """The words of a text in small letters; `SailingYacht_2` has two."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)}
