"""Numbers of scores as text."""

from __future__ import annotations

from modsim3d.tracking.scores.rules import Rules
from modsim3d.tracking.scores.scoring import Scores

Keys = dict[str, float | int | None]

UNKNOWN = "–"
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


def number(value: float | None, decimals: int = 3) -> str:
    """A score with its decimals; a dash where it is undefined."""
    return UNKNOWN if value is None else f"{value:,.{decimals}f}".replace("-", "−").replace("inf", "∞")


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
        (
            "gap",
            f"after more than {rules.gap_s:g} s outside the image a vessel is a new one; a hidden one is not",
        ),
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
