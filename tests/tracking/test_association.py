"""HOTA, CLEAR and identity scores of hand-made tracks, each worked out by hand; scores of a run's own detections,
associated by where they came from, are TrackEval's of the exported run."""

import sys
import tracemalloc
from dataclasses import replace
from itertools import product
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import trackeval

from modsim3d import RunRows, StoredRun, Tracks
from modsim3d.core.arrays import NOBODY
from modsim3d.core.errors import ModsimError
from modsim3d.formats.writing import mot
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.tracking.scores.association import by_trackeval, sequence
from modsim3d.tracking.scores.scored import Rules, Scored
from modsim3d.tracks.tracks import Similarity
from tests.formats.exported import exported_run
from tests.formats.test_export_mot import scores
from tests.tracking.hand_made import Seen, box, hand_made, rows_of, tracks_of

A, B, FAR = box(0), box(100), box(300)


def values(scored: Scored) -> dict[str, object]:
    return {key: value for part in by_trackeval(scored) for key, value in vars(part).items()}


def check(scored: Scored, **expected: object) -> None:
    found = values(scored)
    assert {key: found[key] for key in expected} == pytest.approx(expected, abs=1e-12)


def test_tracks_that_swap_their_vessels_cost_association_two_switches_and_half_the_identity() -> None:
    truth = [(frame, vessel, place) for frame in range(4) for vessel, place in ((0, A), (1, B))]
    tracks = [(k, 1, (A, B)[k // 2]) for k in range(4)] + [(k, 2, (B, A)[k // 2]) for k in range(4)]
    # 8 matches. Each of the four pairs: TPA = 2, FNA = 2, FPA = 2, so A = 2/6. Both identities switch: MOTA = 1 − 2/8.
    # Identity: the best assignment has 4 boxes right, 4 wrong, 4 missing: 4 / (4 + 2 + 2).
    scored = hand_made(truth, tracks, 4)
    check(scored, hota=sqrt(1 / 3), deta=1, assa=1 / 3, detre=1, detpr=1, assre=0.5, asspr=0.5, loca=1, mota=0.75)
    check(scored, motp=1, id_switches=2, fragmentations=0, true_positives=8, misses=0, false_positives=0)
    check(scored, mostly_tracked=2, partly_tracked=0, mostly_lost=0, idf1=0.5, idp=0.5, idr=0.5)


VESSEL = [(k, 0, A) for k in range(4)]


def test_a_switch_costs_recall_of_association_a_miss_also_detection_and_a_false_track_precision() -> None:
    switch = hand_made(VESSEL, [(k, 1 + k // 2, A) for k in range(4)], 4)
    # Both pairs: TPA = 2, FNA = 2, FPA = 0. Identity: 2 right, 2 wrong, 2 missing.
    check(switch, hota=sqrt(0.5), deta=1, assa=0.5, assre=0.5, asspr=1, mota=0.75, id_switches=1, idf1=0.5, idr=0.5)
    miss = hand_made(VESSEL, [(k, 1, A) for k in (0, 1, 3)], 4)
    # 3 matches, 1 miss. TPA = 3, FNA = 1: A = 3/4. Identity: 3 / (3 + 1/2).
    check(miss, hota=0.75, deta=0.75, assa=0.75, detre=0.75, detpr=1, mota=0.75, misses=1)
    check(miss, idf1=6 / 7, idp=1, idr=0.75, id_switches=0, mostly_tracked=0, partly_tracked=1)
    false = hand_made(VESSEL, [*((k, 1, A) for k in range(4)), (1, 2, FAR), (2, 2, FAR)], 4)
    # 4 matches, 2 false boxes: DetA = 4/6; MOTA = 1 − 2/4; identity: 4 / (4 + 2/2).
    check(false, hota=sqrt(2 / 3), deta=2 / 3, assa=1, detpr=2 / 3, mota=0.5, false_positives=2, idf1=0.8, idp=2 / 3)


def test_a_miss_fragments_a_track_unless_no_track_is_in_the_frame_and_coasting_is_no_false_positive() -> None:
    first = [(k, 1, A) for k in (0, 1, 3)]
    truth = [(k, vessel, place) for k in range(4) for vessel, place in ((0, A), (1, B))]
    for frames_of_other, fragmentations in ((range(4), 1), ((0, 1, 3), 0)):
        tracks = [*first, *((k, 2, B) for k in frames_of_other)]
        check(hand_made(truth, tracks, 4), fragmentations=fragmentations, id_switches=0)
    hidden = [Seen(k, 0, A, visible=float(k != 2)) for k in range(4)]
    for tracks in (first, [*first, (2, 1, A)]):
        check(hand_made(hidden, tracks, 4), hota=1, mota=1, idf1=1, false_positives=0, misses=0, true_positives=3)


def test_a_step_without_vessels_costs_only_what_tracks_say_in_it_and_after_a_gap_an_identity_is_a_new_one() -> None:
    truth, tracks = ([(k, name, A) for k in (0, 1, 3)] for name in (0, 1))
    check(hand_made(truth, tracks, 4), hota=1, mota=1, idf1=1, id_switches=0, fragmentations=0)
    # TP = 3, FP = 1, TPA = 3, FPA = 1; MOTA = 1 − 1/3; identity 3 / (3 + 1/2).
    check(hand_made(truth, [*tracks, (2, 1, A)], 4), hota=0.75, mota=2 / 3, false_positives=1, idf1=6 / 7)
    truth, same_track = ([(k, name, A) for k in (0, 1, 6, 7)] for name in (0, 1))
    check(hand_made(truth, [(k, k // 6, A) for k in (0, 1, 6, 7)], 8), hota=1, mota=1, idf1=1, id_switches=0)
    # The same track on both identities: each TPA = 2, FNA = 0, FPA = 2. Identity: 2 right, 2 wrong, 2 missing.
    split = hand_made(truth, same_track, 8)
    check(split, hota=sqrt(0.5), assa=0.5, assre=1, asspr=0.5, mota=1, id_switches=0, idf1=0.5)
    check(hand_made(truth, same_track, 8, rules=Rules(gap_s=5)), hota=1, mota=1, idf1=1)


def test_cameras_have_tracks_of_their_own() -> None:
    truth = [(frame, 0, A) for frame in range(4)]  # two steps of two cameras
    check(hand_made(truth, [(frame, 1, A) for frame in range(4)], 2, cameras=2), hota=1, mota=1, idf1=1, id_switches=0)
    # One camera without tracks: TP = 2, FN = 2, and A = 1, since the misses are those of another identity.
    blind = hand_made(truth, [(0, 1, A), (2, 1, A)], 2, cameras=2)
    check(blind, hota=sqrt(0.5), deta=0.5, assa=1, mota=0.5, idf1=2 / 3, mostly_tracked=1, mostly_lost=1)
    # Track 2 is nearer in the second frame of camera 0, but track 1 was there before: no switch.
    tracks = [(0, 1, A), (2, 1, box(4)), (2, 2, box(1)), (1, 1, A), (3, 1, A)]
    check(hand_made(truth, tracks, 2, cameras=2), id_switches=0, false_positives=1)


def test_thresholds_that_no_match_reaches_count_for_hota_alone_and_clear_and_identity_use_that_of_the_rules() -> None:
    # 16 of 24 columns in common: IoU = 2/3, reached by the 13 thresholds up to 0.65.
    scored = hand_made([(0, 0, A)], [(0, 1, box(4))], 1)
    check(scored, hota=13 / 19, deta=13 / 19, assa=13 / 19, loca=2 / 3, motp=2 / 3, mota=1)
    assert by_trackeval(scored)[0].hota_by_alpha == pytest.approx((1,) * 13 + (0,) * 6)
    for least, mota, idf1 in ((0.5, 1, 1), (0.51, -1, 0)):
        rules = Rules(similarity=Similarity("centre", 8, least))  # centres 4 px apart: 1 − 4/8
        check(hand_made([(0, 0, A)], [(0, 1, box(4))], 1, rules=rules), mota=mota, idf1=idf1, hota=10 / 19)


def test_what_is_0_divided_by_0_is_none() -> None:
    def unknown(scored: Scored) -> set[str]:
        return {key for key, value in values(scored).items() if value is None}

    ratios = {"hota", "deta", "assa", "detre", "detpr", "assre", "asspr", "loca", "hota_by_alpha", "mota", "motp"}
    assert unknown(hand_made([], [], 2)) == ratios | {"idf1", "idp", "idr"}
    blind = hand_made([(0, 0, A)], [], 2)
    check(blind, hota=0, deta=0, detre=0, mota=0, idf1=0, idr=0, misses=1, mostly_lost=1)
    assert unknown(blind) == {"assa", "detpr", "assre", "asspr", "loca", "motp", "idp"}
    imagined = hand_made([], [(0, 1, A)], 2)
    check(imagined, hota=0, deta=0, detpr=0, idf1=0, idp=0, false_positives=1)
    assert unknown(imagined) == {"assa", "detre", "assre", "asspr", "loca", "mota", "motp", "idr"}


def test_trackeval_prints_nothing_and_without_it_the_error_says_what_to_install(monkeypatch, capsys) -> None:
    values(hand_made([(0, 0, A)], [(0, 1, A)], 1))
    assert capsys.readouterr() == ("", "")
    monkeypatch.setitem(sys.modules, "trackeval", None)
    with pytest.raises(ModsimError, match=r'^scores of tracks need TrackEval: pip install "modsim3d\[trackers\]"$'):
        by_trackeval(hand_made([], [], 1))


def noisy(seed: int, cameras: int = 3, steps: int = 30) -> Scored:
    """Vessels that move and tracks near them, with misses, switches and false boxes."""
    rng = np.random.default_rng(seed)
    truth, tracks = [], []
    for step, camera, vessel in product(range(steps), range(cameras), range(6)):
        frame, place = step * cameras + camera, 25 * vessel + step * (vessel % 3 - 1)
        if rng.random() < 0.9:
            truth.append((frame, vessel, box(place)))
        if rng.random() < 0.8:
            track = vessel + 6 * int(step > 12 + vessel)
            tracks.append((frame, track, box(place + rng.normal(0, 6), rng.normal(0, 3))))
    return hand_made(truth, tracks, steps, cameras=cameras)


@pytest.mark.parametrize("seed", range(3))
def test_all_cameras_as_one_sequence_score_what_trackeval_combines_from_one_each(seed: int) -> None:
    scored, quiet = noisy(seed), {"PRINT_CONFIG": False}
    whole = sequence(scored)
    parts = [sequence(replace(scored, frames=scored.frames[scored.frames % 3 == camera])) for camera in range(3)]
    assert sum(part["num_timesteps"] for part in parts) == whole["num_timesteps"]
    metrics = trackeval.metrics
    for metric in (metrics.HOTA(), metrics.CLEAR(dict(quiet)), metrics.Identity(dict(quiet))):
        combined = metric.combine_sequences({str(k): metric.eval_sequence(part) for k, part in enumerate(parts)})
        found = metric.eval_sequence(whole)
        for name, value in combined.items():
            np.testing.assert_allclose(found[name], value, atol=1e-12, err_msg=name)
    check_the_one_matching_is_that_of_clear(scored)


def check_the_one_matching_is_that_of_clear(scored: Scored) -> None:
    rows, track_rows = scored.pairs
    identities, track = scored.following.truth.identity[rows], scored.following.tracks.identity[track_rows]
    order = np.lexsort((scored.following.truth.frame[rows], identities))
    switches = (np.diff(identities[order]) == 0) & (np.diff(track[order]) != 0)
    _, found, _ = by_trackeval(scored)
    assert found.id_switches > 0 and found.misses > 0 and found.false_positives > 0
    assert (found.true_positives, found.id_switches) == (len(rows), np.count_nonzero(switches))


def test_memory_does_not_grow_with_the_square_of_the_number_of_tracks() -> None:
    """A matrix of all tracks by all tracks would take 72 MB; that of vessels by tracks takes 0.1 MB at a threshold."""
    truth = [(frame, vessel, box(40 * vessel)) for frame in range(20) for vessel in range(4)]
    tracks = [(k % 20, k, box(40 * (k % 5), k / 1000)) for k in range(3000)]
    scored = hand_made(truth, tracks, 20)
    wanted = trackeval.metrics.Identity({"THRESHOLD": 0.5, "PRINT_CONFIG": False}).eval_sequence(sequence(scored))
    tracemalloc.start()
    _, _, found = by_trackeval(scored)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (found.idf1, found.idp, found.idr) == (wanted["IDF1"], wanted["IDP"], wanted["IDR"])
    assert peak < 20e6


def test_the_order_of_rows_changes_nothing() -> None:
    scored = noisy(0)
    truth, tracks = scored.following.truth, scored.following.tracks
    seen = list(zip(truth.frame.tolist(), truth.vessel.tolist(), map(tuple, truth.boxes_px.tolist()), strict=True))
    found = list(zip(tracks.frame.tolist(), tracks.track.tolist(), map(tuple, tracks.boxes_px.tolist()), strict=True))
    again = Scored.of(rows_of(seen[::-1], 30, cameras=3), tracks_of(found[::-1], 3), Rules())
    assert values(again) == values(scored)


def by_provenance(rows: RunRows, coasting: bool = True) -> Tracks:
    """Detections as tracks; they may coast over hidden vessels, and false positives are seven tracks in turn."""
    hidden, false = (rows.numbers("visible_px") == 0) & coasting, rows.detected_row == NOBODY
    track = np.where(false, 100 + np.arange(len(false)) % 7, rows.detection_vessel)
    frame = np.append(rows.detection_frame, rows.truth_frame[hidden])
    track = np.append(track, rows.truth_vessel[hidden])
    boxes_px = np.round(np.concatenate([rows.detection_boxes_px(), rows.boxes_px("full")[hidden]]), 3)
    _, first = np.unique(np.column_stack([frame, track]), axis=0, return_index=True)
    return Tracks.of(len(rows.scene.cameras), frame[first], track[first], boxes_px[first])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return exported_run(tmp_path_factory.mktemp("scored"), mode=2, source="analytic")


def test_the_scores_are_those_of_trackeval_over_the_exported_run(run: StoredRun, tmp_path: Path) -> None:
    rows = RunRows.of(run)
    tracks = by_provenance(rows)
    mot.write(ExportRequest(run, (0, 1)), tmp_path / "mot")
    for camera, name in enumerate(("name-2", "quay.2")):
        here, taken = tracks.take(tracks.camera == camera), rows.frames[rows.frames % 2 == camera]
        corner, size = here.boxes_px[:, :2] + 1, here.boxes_px[:, 2:] - here.boxes_px[:, :2]
        table = np.column_stack([np.searchsorted(taken, here.frame) + 1, here.track + 1, corner, size])
        path = tmp_path / "tracks" / mot.ALL_SET / "tracker" / "data" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = ("{:.0f},{:.0f},{:.12g},{:.12g},{:.12g},{:.12g},1,-1,-1,-1\n".format(*row) for row in table)
        path.write_text("".join(lines))
    scored = Scored.of(rows, tracks, Rules())
    assert scored.following.truth.hidden.any() and not scored.following.counted.all()
    hota, clear, identity = by_trackeval(scored)
    found = hota.hota, clear.mota, identity.idf1
    expected = scores(tmp_path / "mot", tmp_path / "tracks", "all")["COMBINED_SEQ"]
    assert 0.1 < found[0] < 0.9
    assert found == pytest.approx([expected[key] for key in ("HOTA", "MOTA", "IDF1")], abs=1e-12)


def test_the_one_matching_is_that_of_clear_where_no_track_is_on_a_hidden_vessel(run: StoredRun) -> None:
    rows = RunRows.of(run)
    tracks = by_provenance(rows, coasting=False)
    later = tracks.step > 20  # from where on the same vessels have other tracks
    switched = Tracks.of(tracks.cameras, tracks.frame, tracks.track + 50 * later, tracks.boxes_px)
    scored = Scored.of(rows, switched, Rules())
    assert scored.following.counted.all()
    check_the_one_matching_is_that_of_clear(scored)
