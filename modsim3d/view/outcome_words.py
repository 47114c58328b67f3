"""Words for a detection, and for the detector, in pictures and recordings."""

from __future__ import annotations

from modsim3d.runs.counts import Outcome, detected_rows, frame_outcomes
from modsim3d.runs.frames import Frame

NAMES = {
    Outcome.FALSE_POSITIVE: "false alarm",
    Outcome.MISLABELLED: "wrong class",
    Outcome.BELOW_HALF_IOU: "IoU below 0.5",
    Outcome.OFF_VESSEL: "off its vessel",
}


WEATHER = "weather is not drawn"
"""States are named after weather that pictures do not have: sea and sky look the same in all of them."""


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
