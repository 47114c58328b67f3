"""The sentence of a score says what the numbers say, at the edges too."""

from modsim3d.core.text import number
from modsim3d.tracking.score_page import survived_of
from modsim3d.tracking.score_text import LengthBin, TrackerOutcome, conclusion, percent
from modsim3d.tracking.scores.breakdown import Bin

Numbers = dict[str, float | int | None]
SHORT, LONG = LengthBin("of 0 to 1 s", 10, 9), LengthBin("longer than 10 s", 9, 2)


def keys(hota: float | None, followed: int = 71, missed: int = 29, false: int = 0) -> Numbers:
    return {"hota": hota, "true_positives": followed, "misses": missed, "false_positives": false}


def told(name: str, lengths: tuple[LengthBin, ...] = (), **scores: float | None) -> TrackerOutcome:
    return TrackerOutcome(name, keys(**{"hota": 0.52, **scores}), lengths)  # type: ignore[arg-type]


REFERENCE = keys(0.78)


NOTHING = {"hota": 0.0, "followed": 0}
SAID = [
    ([told("sort"), told("slow", hota=0.4), told("slower", hota=None)], REFERENCE,
     "sort has the highest HOTA of 3 trackers: it follows vessels for 71 % of the time"),
    ([told("a"), told("b"), told("c", hota=0.1)], REFERENCE,
     "a and b have the same HOTA, the highest of 3 trackers: a follows vessels"),
    ([told("a"), told("b")], REFERENCE, "a and b have the same HOTA: a follows vessels"),
    ([told("sort")], keys(None), "sort follows vessels for 71 % of the time that it should (HOTA 0.52)."),
    ([told("sort", missed=40, **NOTHING)], REFERENCE,
     "sort follows no vessel: no track counts, and 40 boxes of vessels should be followed."),
    ([told("sort", **NOTHING)] * 2, REFERENCE, "None of the 2 trackers follows a vessel;"),
    ([told("sort", missed=1, false=1, **NOTHING)], REFERENCE,
     "sort follows no vessel: its only box is false, and 1 box of vessels should be followed."),
    ([told("sort", missed=1, false=7, **NOTHING)], REFERENCE,
     "sort follows no vessel: all of its 7 boxes are false, and 1 box of vessels should be followed."),
]  # fmt: skip
"""Trackers, the reference, and how the sentence begins."""


def test_the_sentence_begins_with_what_is_worth_knowing() -> None:
    for trackers, reference, beginning in SAID:
        assert conclusion(trackers, reference).startswith(beginning)


def test_one_tracker_is_told_with_the_reference_and_what_it_loses_most() -> None:
    assert conclusion([told("sort", (SHORT, LONG))], REFERENCE) == (
        "sort follows vessels for 71 % of the time that it should (HOTA 0.52; the same detections with perfect "
        "association reach 0.78). Among occlusions it does worst in those longer than 10 s: 2 of 9 are survived."
    )
    above = conclusion([told("sort", hota=0.8)], REFERENCE)
    assert "(HOTA 0.80, above the 0.78 of the same detections with perfect association)" in above
    assert "reach" not in above


def test_without_vessels_nothing_could_be_followed() -> None:
    empty = keys(None, 0, 0)
    said = conclusion([TrackerOutcome("sort", empty, ())], empty)
    assert said == "There is no vessel to follow in this run, and sort has no track."
    said = conclusion([TrackerOutcome("sort", keys(0.0, 0, 0, 3), ())], empty)
    assert said == "There is no vessel to follow in this run, and sort reports 3 boxes, all false."
    assert "can only be false" in conclusion([TrackerOutcome("sort", empty, ()), TrackerOutcome("b", empty, ())], empty)


def lengths(*counts: tuple[int, int]) -> tuple[LengthBin, ...]:
    return tuple(LengthBin(f"of {k} s", all_of_them, survived) for k, (all_of_them, survived) in enumerate(counts))


def test_occlusions_are_told_as_far_as_there_are_enough() -> None:
    for bins, said in (
        ((), "No vessel that it followed went into an occlusion and came out of it."),
        (lengths((0, 0)), "No vessel that it followed went into an occlusion and came out of it."),
        (lengths((1, 1)), "It keeps its vessel through the only occlusion."),
        (lengths((1, 0)), "It keeps its vessel through 0 of 1 occlusion."),
        (lengths((2, 2), (3, 3)), "It keeps its vessel through all 5 occlusions."),
        (lengths((2, 1), (9, 3)), "It keeps its vessel through 4 of 11 occlusions."),
    ):
        assert conclusion([told("sort", bins)], REFERENCE).endswith(said)


def test_a_share_is_0_or_100_percent_only_if_it_is_and_survived_occlusions_are_a_number_of_those_judged() -> None:
    said = [percent(share) for share in (0.0, 0.001, 0.5, 0.999, 1.0, None)]
    assert said == ["0 %", "under 1 %", "50 %", "over 99 %", "100 %", "–"]
    assert [number(-0.25, 2), number(None), number(1234.0, 0)] == ["−0.25", "–", "1,234"]
    counts = ({"occlusions": 5, "judged": 3, "survived": 2 / 3}, {"occlusions": 5, "judged": 0}, {})
    assert [survived_of(Bin("3 to 10", 40, 0.5, 0.4, **each)) for each in counts] == ["2 of 3", "–", ""]
