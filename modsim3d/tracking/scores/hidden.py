"""What tracks do while other things hide all of a vessel: neither right nor wrong, so it is reported apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.runs.files.columns import NOBODY
from modsim3d.tracking.scores.histories import Histories
from modsim3d.tracking.scores.scored import Scored


@dataclass(frozen=True)
class Hidden:
    """Tracks on vessels that are wholly hidden, against the box of the whole vessel.

    Attributes:
        hidden_vessel_frames: Number of frames of vessels of which no pixel is visible.
        hidden_followed: Share of them in which a track follows the vessel.
        hidden_same_track: Share of them in which that is the track that last followed it before it was hidden.
    """

    hidden_vessel_frames: int
    hidden_followed: float | None
    hidden_same_track: float | None


def hidden(scored: Scored) -> Hidden:
    """Recall and identity on rows that are wholly hidden."""
    histories = Histories.of(scored)
    chosen = histories.hidden & histories.counted
    count = int(np.count_nonzero(chosen))
    if not count:
        return Hidden(0, None, None)
    before = histories.last_before(histories.followed & ~histories.hidden)
    earlier = np.append(histories.track, NOBODY)[before]
    followed = histories.followed[chosen]
    same = followed & (histories.track == earlier)[chosen]
    return Hidden(count, float(np.mean(followed)), float(np.mean(same)))
