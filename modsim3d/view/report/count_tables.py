"""Counts of a run by vessel and by performance state, as rows of tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modsim3d.arrays import Array, Indices, Mask

Rows = list[tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class CountTables:
    """Tables of counts over all steps of a run. A frame is one camera at one step.

    Attributes:
        frame_state: Performance state of each frame, shape (F,).
        vessel: Index of the vessel of each truth row, shape (n,).
        state: Performance state of the frame of each truth row, shape (n,).
        silhouette_px: Area of the silhouette in pixels, shape (n,).
        visible_px: Pixels of it that are seen, NaN where unknown, shape (n,).
        annotated: Whether the row was given to the detector, shape (n,).
        detected: Whether it was detected, shape (n,).
        false_state: Performance state of the frame of each false positive, shape (m,).
        mislabelled: Number of detections with another label than their vessel's.
    """

    frame_state: Indices
    vessel: Indices
    state: Indices
    silhouette_px: Array
    visible_px: Array
    annotated: Mask
    detected: Mask
    false_state: Indices
    mislabelled: int

    @property
    def hidden_in_part(self) -> Mask:
        """Truth rows that are hidden in part, shape (n,)."""
        hidden: Mask = (self.visible_px > 0) & (self.visible_px < self.silhouette_px)
        return hidden

    @property
    def hidden_wholly(self) -> Mask:
        """Truth rows that are hidden wholly, shape (n,)."""
        hidden: Mask = (self.visible_px == 0) & (self.silhouette_px > 0)
        return hidden

    def overall(self) -> Rows:
        """What happened, summed over frames: name, count, and its share."""
        annotated, detected = int(self.annotated.sum()), int((self.annotated & self.detected).sum())
        false = len(self.false_state)
        return [
            ("Frames", str(len(self.frame_state)), ""),
            ("Vessels in frames", str(len(self.vessel)), "summed over frames"),
            ("Partly hidden", str(int(self.hidden_in_part.sum())), share(self.hidden_in_part.sum(), len(self.vessel))),
            ("Wholly hidden", str(int(self.hidden_wholly.sum())), ""),
            ("Annotated", str(annotated), "given to the detector"),
            ("Detected", str(detected), f"{share(detected, annotated)} of annotated"),
            ("Missed", str(annotated - detected), f"{share(annotated - detected, annotated)} of annotated"),
            ("Mislabelled", str(self.mislabelled), f"{share(self.mislabelled, detected)} of detected"),
            ("False positives", str(false), f"{share(false, detected + false)} of all detections"),
        ]

    def by_vessel(self, names: Sequence[str]) -> Rows:
        """For each vessel: frames, those hidden in part and wholly, annotated, detected, missed, miss rate."""
        rows = []
        for index, name in enumerate(names):
            mine = self.vessel == index
            annotated, detected = self.annotated & mine, self.detected & mine
            missed = int(annotated.sum() - detected.sum())
            counts = (mine, self.hidden_in_part & mine, self.hidden_wholly & mine, annotated, detected)
            numbers = [str(int(flags.sum())) for flags in counts]
            rows.append((name, *numbers, str(missed), share(missed, annotated.sum())))
        return rows

    def by_state(self, names: Sequence[str]) -> Rows:
        """For each state: frames, annotated, detected, missed, miss rate, false positives, share of detections."""
        rows = []
        for index, name in enumerate(names):
            mine = self.state == index
            annotated, detected = int((self.annotated & mine).sum()), int((self.detected & mine).sum())
            false, frames = int((self.false_state == index).sum()), int((self.frame_state == index).sum())
            missed = annotated - detected
            numbers = (frames, annotated, detected, missed)
            shares = share(missed, annotated), str(false), share(false, detected + false)
            rows.append((name, *map(str, numbers), *shares))
        return rows


VESSEL_HEADER = ("Vessel", "Frames", "Partly hidden", "Wholly hidden", "Annotated", "Detected", "Missed", "Miss rate")
STATE_HEADER = (
    "Performance state",
    "Frames",
    "Annotated",
    "Detected",
    "Missed",
    "Miss rate",
    "False positives",
    "Share of detections",
)


def share(part: float, whole: float) -> str:
    """A percentage; a dash where there is nothing to have a share of."""
    return f"{part / whole:.1%}" if whole else "–"
