"""The scores that are compared, and how far simulated ones may lie from real ones: fixed before any film was scored."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Score:
    """A score of a tracker on a film.

    Attributes:
        key: Its key in the results.
        title: What pages call it.
        share: Margin as a share of the real mean; 0 where it is a number.
        least: Margin, or the least one where it is also a share of the real mean.
        decimals: Of its values on pages.
        larger_is_better: Whether a larger one is better; None where neither is.
    """

    key: str
    title: str
    share: float
    least: float
    decimals: int
    larger_is_better: bool | None

    def margin(self, real_mean: float) -> float:
        """The margin around a real mean."""
        return max(self.least, self.share * abs(real_mean))


SCORES = (
    Score("hota", "HOTA", 0, 0.02, 3, True),
    Score("deta", "DetA", 0, 0.02, 3, True),
    Score("assa", "AssA", 0, 0.02, 3, True),
    Score("idf1", "IDF1", 0, 0.02, 3, True),
    Score("mota", "MOTA", 0, 0.04, 3, True),
    Score("gospa", "GOSPA, px", 0.05, 0, 1, False),
    Score("id_switches", "ID switches", 0.1, 0.5, 1, False),
    Score("tracks", "tracks", 0.1, 0.5, 1, None),
    Score("track_s", "mean length of a track, s", 0.1, 0, 2, None),
    Score("false_tracks", "false tracks", 0.1, 0.5, 1, False),
)
BY_KEY = {score.key: score for score in SCORES}

REASONS = (
    ("HOTA, DetA, AssA, IDF1", "0.02", "differences between published trackers that a reader would act on are larger"),
    ("MOTA", "0.04", "a missed box and a false one cost it one each, so it moves about twice as far as DetA"),
    ("GOSPA", "5 % of the real mean", "its unit is a pixel and its size depends on the number of vessels"),
    (
        "ID switches, tracks, false tracks",
        "10 % of the real mean, at least 0.5 a film",
        "they are small counts: one more or less in every second film changes no decision",
    ),
    ("mean length of a track", "10 % of the real mean", "it follows from the number of tracks"),
)
"""Scores, their margin, and why it is that, for the page."""
