"""What scores say, in one or two sentences that are made of the numbers and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modsim3d.display import counted
from modsim3d.tracking.report.numbers import Keys, percent

LEAST_OCCLUSIONS = 3
"""Fewer occlusions of a length say nothing about it."""


@dataclass(frozen=True)
class LengthBin:
    """Occlusions of a range of lengths.

    Attributes:
        name: The range in words, such as `3 to 10 s`.
        occlusions: How many there are of a vessel that was followed before.
        survived: How many of them ended with the vessel followed by the same track.
    """

    name: str
    occlusions: int
    survived: int


@dataclass(frozen=True)
class TrackerOutcome:
    """What the sentence about one tracker is made of.

    Attributes:
        name: The tracker.
        keys: Its scores.
        lengths: Occlusions by length.
    """

    name: str
    keys: Keys
    lengths: tuple[LengthBin, ...]


def conclusion(trackers: Sequence[TrackerOutcome], reference: Keys) -> str:
    """The outcome.

    Args:
        trackers: At least one, the best first.
        reference: The scores of the smoothed oracle-association reference.
    """
    best = trackers[0]
    if not _expected(best.keys):
        return _nothing_expected(trackers)
    if not any(each.keys["true_positives"] for each in trackers):
        return _nothing_followed(trackers)
    followed = percent((best.keys["true_positives"] or 0) / _expected(best.keys))
    first = f"{_subject(trackers)} vessels for {followed} of the time that it should{_beside(best.keys, reference)}."
    return " ".join([first, *_losses(best.lengths)])


def _subject(trackers: Sequence[TrackerOutcome]) -> str:
    best = trackers[0]
    if len(trackers) == 1:
        return f"{best.name} follows"
    level = [each.name for each in trackers if each.keys["hota"] == best.keys["hota"]]
    if len(level) == 1:
        return f"{best.name} has the highest HOTA of {len(trackers)} trackers: it follows"
    names = f"{', '.join(level[:-1])} and {level[-1]}"
    highest = "" if len(level) == len(trackers) else f", the highest of {len(trackers)} trackers"
    return f"{names} have the same HOTA{highest}: {best.name} follows"


def _beside(keys: Keys, reference: Keys) -> str:
    """HOTA, and that of the reference."""
    ours, theirs = keys["hota"], reference["hota"]
    if ours is None:
        return ""
    if theirs is None:
        return f" (HOTA {ours:.2f})"
    if round(ours, 2) > round(theirs, 2):
        return f" (HOTA {ours:.2f}, above the {theirs:.2f} of the same detections with perfect association)"
    return f" (HOTA {ours:.2f}; the same detections with perfect association reach {theirs:.2f})"


def _losses(lengths: Sequence[LengthBin]) -> list[str]:
    """Where vessels are lost: the length of occlusion of which the smallest share is survived."""
    every, survived = sum(each.occlusions for each in lengths), sum(each.survived for each in lengths)
    if not every:
        return ["No vessel that it followed went into an occlusion and came out of it."]
    if survived == every:
        return [f"It keeps its vessel through {'the only occlusion' if every == 1 else f'all {every} occlusions'}."]
    many = [each for each in lengths if each.occlusions >= LEAST_OCCLUSIONS]
    if len(many) < 2:
        return [f"It keeps its vessel through {survived} of {counted(every, 'occlusion')}."]
    worst = min(many, key=lambda each: each.survived / each.occlusions)
    return [
        f"Among occlusions it does worst in those {worst.name}: {worst.survived} of {worst.occlusions} are survived."
    ]


def _nothing_expected(trackers: Sequence[TrackerOutcome]) -> str:
    said = "There is no vessel to follow in this run"
    false = _false(trackers[0].keys)
    if len(trackers) > 1:
        return f"{said}: its tracks can only be false."
    return f"{said}, and {trackers[0].name} {f'reports {_boxes(false)}, all false' if false else 'has no track'}."


def _nothing_followed(trackers: Sequence[TrackerOutcome]) -> str:
    missed = f"{_boxes(_expected(trackers[0].keys))} of vessels should be followed"
    if len(trackers) > 1:
        return f"None of the {len(trackers)} trackers follows a vessel; {missed}."
    false = _false(trackers[0].keys)
    has = "no track counts"
    if false:
        has = f"all of its {_boxes(false)} are false" if false > 1 else "its only box is false"
    return f"{trackers[0].name} follows no vessel: {has}, and {missed}."


def _expected(keys: Keys) -> int:
    """Number of boxes of vessels that are to be followed."""
    return int((keys["true_positives"] or 0) + (keys["misses"] or 0))


def _false(keys: Keys) -> int:
    return int(keys["false_positives"] or 0)


def _boxes(count: int) -> str:
    return counted(count, "box", "boxes")
