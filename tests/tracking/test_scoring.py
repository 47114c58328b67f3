"""All scores together: their keys, and those by state, camera and class; intervals of means; the sentence of a score
says what the numbers say, at the edges too."""

import json
from dataclasses import fields
from math import sqrt

import numpy as np
import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.core.text import number
from modsim3d.tracking.detector_seeds import Spread
from modsim3d.tracking.score_page import survived_of
from modsim3d.tracking.score_text import LengthBin, TrackerOutcome, conclusion, percent
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.scored import Rules
from modsim3d.tracking.scores.scoring import Scores, SubsetScores, score_tracks
from tests.tracking.hand_made import LABELS, Seen, box, rows_of, tracks_of

A, B = box(0), box(100)
BY_CLASS = Rules(by_class=True)


def scores_of(truth, tracks, steps: int, rules: Rules | None = None, **kinds: object) -> Scores:
    cameras = kinds.get("cameras", 1)
    return score_tracks(rows_of(truth, steps, **kinds), tracks_of(tracks, cameras), rules or Rules())


@pytest.fixture(scope="module")
def miss_in_haze() -> Scores:
    """A vessel in two clear frames and in two in haze; it is missed in the last."""
    truth, tracks = [(k, 0, A) for k in range(4)], [(k, 1, A) for k in range(3)]
    return scores_of(truth, tracks, 4, states=[0, 0, 1, 1])


def test_every_key_is_that_of_one_part(miss_in_haze: Scores) -> None:
    keys = [field.name for part in miss_in_haze.parts for field in fields(part)]
    assert len(keys) == len(set(keys)) and [*miss_in_haze.flat()] == keys
    named = {"hota", "deta", "assa", "mota", "idf1", "id_switches", "gospa", "ospa", "siap_completeness", "rmse_px"}
    assert named | {"established_share", "hidden_followed", "occlusions_survived"} <= set(keys)
    assert set(miss_in_haze.as_json()) == set(keys) | {"by_state", "by_camera", "breakdown", "each_occlusion"}


def test_a_state_has_the_scores_of_its_frames_only(miss_in_haze: Scores) -> None:
    assert miss_in_haze.flat()["hota"] == pytest.approx(0.75)  # DetA = 3/4, A = 3/4
    perfect = SubsetScores(frames=2, vessel_frames=2, hota=1, deta=1, assa=1, mota=1, idf1=1)
    half = SubsetScores(frames=2, vessel_frames=2, hota=0.5, deta=0.5, assa=0.5, mota=0.5, idf1=2 / 3)
    assert [*miss_in_haze.by_state] == ["clear", "haze"]
    for name, expected in (("clear", perfect), ("haze", half)):
        assert vars(miss_in_haze.by_state[name]) == pytest.approx(vars(expected), abs=1e-12)


def test_a_camera_has_the_scores_of_its_frames_only_and_what_is_not_scored_counts_in_no_subset() -> None:
    found = scores_of([(k, 0, A) for k in range(4)], [(0, 1, A), (2, 1, A)], 2, cameras=2).by_camera
    assert found == {"C0": SubsetScores(2, 2, 1, 1, 1, 1, 1), "C1": SubsetScores(2, 2, 0, 0, None, 0, 0)}
    truth = [Seen(0, 0, A), Seen(1, 0, A, visible=0)]
    found = scores_of(truth, [(0, 1, A), (1, 1, A)], 2, states=[0, 1]).by_state
    assert found == {"clear": SubsetScores(1, 1, 1, 1, 1, 1, 1), "haze": SubsetScores(1, 0, *(None,) * 5)}


def test_by_class_each_label_has_its_own_matching_and_the_others_stay_of_all_classes() -> None:
    # Vessel 0 has label 0, vessel 2 label 1; the tracker takes both for label 0, and has a box of label 0 too much.
    truth = [(k, vessel, place) for k in range(2) for vessel, place in ((0, A), (2, B))]
    tracks = [(k, track, place, 0) for k in range(2) for track, place in ((1, A), (2, B))]
    found = scores_of(truth, tracks, 2, BY_CLASS)
    assert found.flat() == scores_of(truth, tracks, 2).flat() and found.flat()["hota"] == 1
    first, second = (found.by_class[name].flat() for name in LABELS[:2])
    assert [*found.by_class] == [*LABELS[:2]]  # nothing has the third
    # Label 0: 2 matches and 2 false boxes, so DetA = 2/4, A = 1, MOTA = 1 − 2/2. Label 1: 2 misses.
    assert (first["hota"], first["mota"], first["false_positives"]) == pytest.approx((sqrt(0.5), 0, 2))
    assert (second["hota"], second["mota"], second["misses"]) == (0, 0, 2)
    assert found.as_json()["by_class"] == {LABELS[0]: first, LABELS[1]: second}


def test_a_track_without_a_label_is_refused_by_class() -> None:
    tracks = [(0, 1, A, 0), (0, 2, B), (1, 1, A, 0)]
    said = r"^--by class needs a label .* 1 of 3 rows have none: score without it$"
    with pytest.raises(ModsimError, match=said):
        scores_of([(0, 0, A)], tracks, 2, BY_CLASS)
    assert scores_of([(0, 0, A)], tracks, 2).by_class == {}


def test_the_json_is_made_of_what_json_knows_and_of_runs_without_vessels_or_tracks_too(miss_in_haze: Scores) -> None:
    found = miss_in_haze.as_json() | {"hota_by_alpha": list(miss_in_haze.flat()["hota_by_alpha"])}
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    for truth, tracks in (([], []), ([(0, 0, A)], []), ([], [(0, 1, A, 0)])):
        found = scores_of(truth, tracks, 2, BY_CLASS).as_json()
        assert json.loads(json.dumps(found, allow_nan=False)).keys() == found.keys()
        assert [*found.get("by_class", {})] == [LABELS[0]] * (len(truth) + len(tracks)), (truth, tracks)


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


def test_half_an_interval_is_the_quantile_of_students_t_times_the_standard_error() -> None:
    """Tables have 12.7062 for 1, 4.30265 for 2 and 2.77645 for 4 degrees of freedom at 97.5 %."""
    half = 2.77645 * (2.5 / 5) ** 0.5
    assert Spread((0.0, 2.0)).interval == pytest.approx((1 - 12.7062, 1 + 12.7062), rel=1e-5)
    assert Spread(tuple(range(5))).interval == pytest.approx((2 - half, 2 + half), abs=1e-5)
    spread = Spread((1.0, None, 2.0, 3.0))
    assert (spread.mean, spread.deviation) == (2.0, 1.0)
    assert spread.interval == pytest.approx((2 - 4.30265 / 3**0.5, 2 + 4.30265 / 3**0.5), abs=1e-5)
    assert Spread((1.0, 3.0)).deviation == pytest.approx(2**0.5)


def test_one_value_and_equal_and_infinite_values_have_no_interval() -> None:
    """A share of 1 in ten runs says nothing of how far the next one may be off."""
    for values in ((), (3.0,), (None,), (1.0,) * 19, (0.1 + 0.2, 0.3, 0.3), (0.5, 0.5), (1.0, np.inf)):
        assert Spread(values).interval is None, values
    assert (Spread((None,)).mean, Spread((1.0,)).deviation) == (None, None)
    spread = Spread((1.0, np.inf, None))
    assert (spread.mean, spread.deviation) == (np.inf, None) and number(spread.mean, 1) == "∞"
