"""Scores in words: percentages, rules and the outcome."""

from collections.abc import Sequence
from dataclasses import dataclass

from modsim3d.core.text import UNKNOWN, counted
from modsim3d.tracking.scores.scored_run import Rules
from modsim3d.tracking.scores.scoring import Scores

Keys = dict[str, float | int | None]

COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("HOTA", "hota", 3),
    ("DetA", "deta", 3),
    ("AssA", "assa", 3),
    ("MOTA", "mota", 3),
    ("IDF1", "idf1", 3),
    ("ID switches", "id_switches", 0),
    ("GOSPA, px", "gospa", 1),
)
"""Header, key and decimals of the scores in a line of the table."""


def keys_of(scores: Scores) -> Keys:
    """The scores that are one number each, by their keys."""
    return {key: value for key, value in scores.flat().items() if not isinstance(value, tuple)}


def percent(share: float | None) -> str:
    """A share in whole percent, where 0 % means none and 100 % all."""
    if share is None:
        return UNKNOWN
    rounded = round(100 * share)
    if rounded == 0 and share > 0:
        return "under 1 %"
    if rounded == 100 and share < 1:
        return "over 99 %"
    return f"{rounded} %"


def rules_in_words(rules: Rules) -> list[tuple[str, str]]:
    """The rules that scores were taken by, each with its name."""
    similarity, distance = rules.similarity, rules.set_distance
    truth = {
        "annotated": "the vessels that the detector was given; all others in the image count neither way",
        "full": "all vessels in the image with the box of the whole vessel; wholly hidden ones count neither way",
    }
    classes = "a track may follow a vessel of any class"
    cameras = [("cameras", f"only {', '.join(rules.cameras)}")] if rules.cameras else []
    return [
        *cameras,
        ("similarity", f"{similarity}; a track follows a vessel from {similarity.least:g} on"),
        ("truth", f"{rules.truth}: {truth[rules.truth]}"),
        ("gap", f"after more than {rules.gap_s:g} s outside the image a vessel is a new one; a hidden one is not"),
        ("GOSPA", f"c = {distance.cutoff:g} px, p = {distance.power:g}, α = 2, distance of the centres"),
        ("class", f"{classes}; each class by itself too" if rules.by_class else classes),
    ]


MEANINGS = {
    "HOTA": "√(detection accuracy · association accuracy), the mean over 19 thresholds of similarity; 0 to 1",
    "DetA": "detection accuracy: matches over matches, misses and false positives together",
    "AssA": "association accuracy: how much of a vessel's and of its track's boxes belong together",
    "MOTA": "1 − (misses + false positives + ID switches) over boxes to follow; below 0 with more errors than boxes",
    "IDF1": "share of boxes with the right identity, where each vessel may have one track only",
    "ID switches": "how often a vessel is followed by another track than before",
    "GOSPA": "error of position in a frame, with a price for each missed vessel and each false track; 0 is best",
    "occlusions survived": "the track of the second before an occlusion is the first on the vessel in the 2 s after it",
}
"""What the scores of the table mean, each in a line."""


MIN_OCCLUSIONS = 3  # fewer occlusions of a length say nothing about it


@dataclass(frozen=True)
class LengthBin:
    """Occlusions of a range of lengths, of vessels that were followed before."""

    name: str  # the range in words, such as `3 to 10 s`
    occlusions: int
    survived: int  # those that ended with the vessel followed by the same track


@dataclass(frozen=True)
class TrackerOutcome:
    """Parts of the sentence about one tracker."""

    name: str
    keys: Keys  # its scores
    lengths: tuple[LengthBin, ...]  # occlusions by length


def conclusion(trackers: Sequence[TrackerOutcome], reference: Keys) -> str:
    """The outcome of at least one tracker, the best first, beside the scores of the better reference."""
    best = trackers[0]
    if not _expected(best.keys):
        return _nothing_expected(trackers)
    if not any(tracker.keys["true_positives"] for tracker in trackers):
        return _nothing_followed(trackers)
    followed = percent((best.keys["true_positives"] or 0) / _expected(best.keys))
    first = f"{_subject(trackers)} vessels for {followed} of the time that it should{_beside(best.keys, reference)}."
    return " ".join([first, *_losses(best.lengths)])


def _subject(trackers: Sequence[TrackerOutcome]) -> str:
    best = trackers[0]
    if len(trackers) == 1:
        return f"{best.name} follows"
    level = [tracker.name for tracker in trackers if tracker.keys["hota"] == best.keys["hota"]]
    if len(level) == 1:
        return f"{best.name} has the highest HOTA of {len(trackers)} trackers: it follows"
    names = f"{', '.join(level[:-1])} and {level[-1]}"
    highest = "" if len(level) == len(trackers) else f", the highest of {len(trackers)} trackers"
    return f"{names} have the same HOTA{highest}: {best.name} follows"


def _beside(keys: Keys, reference: Keys) -> str:
    hota, perfect = keys["hota"], reference["hota"]
    if hota is None:
        return ""
    if perfect is None:
        return f" (HOTA {hota:.2f})"
    if round(hota, 2) > round(perfect, 2):
        return f" (HOTA {hota:.2f}, above the {perfect:.2f} of the same detections with perfect association)"
    return f" (HOTA {hota:.2f}; the same detections with perfect association reach {perfect:.2f})"


def _losses(lengths: Sequence[LengthBin]) -> list[str]:
    """Places where vessels are lost: the length of occlusion of which the smallest share is survived."""
    every, survived = sum(length.occlusions for length in lengths), sum(length.survived for length in lengths)
    if not every:
        return ["No vessel that it followed went into an occlusion and came out of it."]
    if survived == every:
        return [f"It keeps its vessel through {'the only occlusion' if every == 1 else f'all {every} occlusions'}."]
    many = [length for length in lengths if length.occlusions >= MIN_OCCLUSIONS]
    if len(many) < 2:
        return [f"It keeps its vessel through {survived} of {counted(every, 'occlusion')}."]
    worst = min(many, key=lambda length: length.survived / length.occlusions)
    return [
        f"Among occlusions it does worst in those {worst.name}: {worst.survived} of {worst.occlusions} are survived."
    ]


def _nothing_expected(trackers: Sequence[TrackerOutcome]) -> str:
    sentence = "There is no vessel to follow in this run"
    false = _false(trackers[0].keys)
    if len(trackers) > 1:
        return f"{sentence}: its tracks can only be false."
    return f"{sentence}, and {trackers[0].name} {f'reports {_boxes(false)}, all false' if false else 'has no track'}."


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
