"""The rules by which tracks are scored."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from modsim3d.errors import ModsimError
from modsim3d.tracks.similarity import Similarity
from modsim3d.tracks.true_tracks import DEFAULT_GAP_S, TruthName

LARGEST_CUTOFF = 1e6
"""More than any distance in an image, and its tenth power is still a number."""


@dataclass(frozen=True)
class SetDistance:
    """What GOSPA and OSPA charge: the base distance is that of the centres.

    Attributes:
        cutoff: c, in the unit of the distance; a missed vessel and a false track cost c^p / 2 each in GOSPA.
        power: p; with 1 the parts are additive distances.
    """

    cutoff: float = 100.0
    power: float = 1.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ModsimError: One is out of range.
        """
        if not 0 < self.cutoff <= LARGEST_CUTOFF:
            raise ModsimError(f"--gospa-c must be above 0 and at most {LARGEST_CUTOFF:,.0f} (got {self.cutoff:g})")
        if not 1 <= self.power <= 10:
            raise ModsimError(f"--gospa-p must be from 1 to 10 (got {self.power:g})")


@dataclass(frozen=True)
class Rules:
    """The rules by which tracks are scored.

    Attributes:
        truth: What tracks are held against, as in `TrueTracks.of`.
        gap_s: After so long outside the image a vessel that comes back is a new identity.
        similarity: How boxes are compared.
        by_class: Whether only tracks of a vessel's class count for it.
        set_distance: Of GOSPA and OSPA, in pixels.
        cameras: Names of the cameras that are scored, in the order of the scene; all if there are none.
    """

    truth: TruthName = "annotated"
    gap_s: float = DEFAULT_GAP_S
    similarity: Similarity = field(default_factory=Similarity)
    by_class: bool = False
    set_distance: SetDistance = field(default_factory=SetDistance)
    cameras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ModsimError: The gap is out of range.
        """
        if not 0 <= self.gap_s < np.inf:
            raise ModsimError(f"--gap must be 0 or more seconds (got {self.gap_s:g})")
