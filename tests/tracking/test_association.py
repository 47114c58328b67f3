"""HOTA, CLEAR and identity scores by hand and as TrackEval has them; the reference tracker and its Kalman filter."""

import sys
import tracemalloc
from dataclasses import replace
from itertools import product
from math import sqrt

import numpy as np
import pytest
import trackeval

from modsim3d import RunRows, StoredRun, Tracks
from modsim3d.core.arrays import NOBODY
from modsim3d.core.boxes import centres, corner_form
from modsim3d.core.errors import ModsimError
from modsim3d.formats.writing import mot
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.tracking.kalman import MotionEstimates
from modsim3d.tracking.scores.association import by_trackeval, sequence
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame
from modsim3d.tracking.trackers.reference import ReferenceTracker
from modsim3d.tracks.tracks import Similarity
from tests.formats.exported import exported_run
from tests.formats.test_exports import scores
from tests.tracking.hand_made import Seen, box, hand_made, rows_of, tracks_of

A, B, FAR = box(0), box(100), box(300)


def values(scored: ScoredRun) -> dict[str, object]:
    return {key: value for part in by_trackeval(scored) for key, value in vars(part).items()}


def check(scored: ScoredRun, **expected: object) -> None:
    found = values(scored)
    assert {key: found[key] for key in expected} == pytest.approx(expected, abs=1e-12)


def test_tracks_that_swap_their_vessels_and_switches_misses_and_false_tracks_cost_what_they_should():
    truth = [(frame, vessel, place) for frame in range(4) for vessel, place in ((0, A), (1, B))]
    tracks = [(k, 1, (A, B)[k // 2]) for k in range(4)] + [(k, 2, (B, A)[k // 2]) for k in range(4)]
    # 8 matches. Each of the four pairs: TPA = 2, FNA = 2, FPA = 2, so A = 2/6. Both identities switch: MOTA = 1 − 2/8.
    # Identity: the best assignment has 4 boxes right, 4 wrong, 4 missing: 4 / (4 + 2 + 2).
    scored = hand_made(truth, tracks, 4)
    check(scored, hota=sqrt(1 / 3), deta=1, assa=1 / 3, detre=1, detpr=1, assre=0.5, asspr=0.5, loca=1, mota=0.75)
    check(scored, motp=1, id_switches=2, fragmentations=0, true_positives=8, misses=0, false_positives=0)
    check(scored, mostly_tracked=2, partly_tracked=0, mostly_lost=0, idf1=0.5, idp=0.5, idr=0.5)
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


VESSEL = [(k, 0, A) for k in range(4)]


def test_a_miss_fragments_a_track_unless_none_is_there_and_after_a_gap_an_identity_is_a_new_one():
    first = [(k, 1, A) for k in (0, 1, 3)]
    truth = [(k, vessel, place) for k in range(4) for vessel, place in ((0, A), (1, B))]
    for frames_of_other, fragmentations in ((range(4), 1), ((0, 1, 3), 0)):
        tracks = [*first, *((k, 2, B) for k in frames_of_other)]
        check(hand_made(truth, tracks, 4), fragmentations=fragmentations, id_switches=0)
    hidden = [Seen(k, 0, A, visible=float(k != 2)) for k in range(4)]
    for tracks in (first, [*first, (2, 1, A)]):
        check(hand_made(hidden, tracks, 4), hota=1, mota=1, idf1=1, false_positives=0, misses=0, true_positives=3)
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


def test_cameras_have_tracks_of_their_own_and_thresholds_without_a_match_count_for_hota_alone():
    truth = [(frame, 0, A) for frame in range(4)]  # two steps of two cameras
    check(hand_made(truth, [(frame, 1, A) for frame in range(4)], 2, cameras=2), hota=1, mota=1, idf1=1, id_switches=0)
    # One camera without tracks: TP = 2, FN = 2, and A = 1, since the misses are those of another identity.
    blind = hand_made(truth, [(0, 1, A), (2, 1, A)], 2, cameras=2)
    check(blind, hota=sqrt(0.5), deta=0.5, assa=1, mota=0.5, idf1=2 / 3, mostly_tracked=1, mostly_lost=1)
    # Track 2 is nearer in the second frame of camera 0, but track 1 was there before: no switch.
    tracks = [(0, 1, A), (2, 1, box(4)), (2, 2, box(1)), (1, 1, A), (3, 1, A)]
    check(hand_made(truth, tracks, 2, cameras=2), id_switches=0, false_positives=1)
    # 16 of 24 columns in common: IoU = 2/3, reached by the 13 thresholds up to 0.65.
    scored = hand_made([(0, 0, A)], [(0, 1, box(4))], 1)
    check(scored, hota=13 / 19, deta=13 / 19, assa=13 / 19, loca=2 / 3, motp=2 / 3, mota=1)
    assert by_trackeval(scored)[0].hota_by_alpha == pytest.approx((1,) * 13 + (0,) * 6)
    for least, mota, idf1 in ((0.5, 1, 1), (0.51, -1, 0)):
        rules = Rules(similarity=Similarity("centre", 8, least))  # centres 4 px apart: 1 − 4/8
        check(hand_made([(0, 0, A)], [(0, 1, box(4))], 1, rules=rules), mota=mota, idf1=idf1, hota=10 / 19)


def test_what_is_0_divided_by_0_is_none() -> None:
    def unknown(scored: ScoredRun) -> set[str]:
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


def noisy(seed: int, cameras: int = 3, steps: int = 30) -> ScoredRun:
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


def check_the_one_matching_is_that_of_clear(scored: ScoredRun) -> None:
    rows, track_rows = scored.pairs
    identities, track = scored.following.truth.identity[rows], scored.following.tracks.identity[track_rows]
    order = np.lexsort((scored.following.truth.frame[rows], identities))
    switches = (np.diff(identities[order]) == 0) & (np.diff(track[order]) != 0)
    _, found, _ = by_trackeval(scored)
    assert found.id_switches > 0 and found.misses > 0 and found.false_positives > 0
    assert (found.true_positives, found.id_switches) == (len(rows), np.count_nonzero(switches))


def test_memory_does_not_grow_with_the_square_of_the_tracks_and_the_order_of_rows_changes_nothing():
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
    scored = noisy(0)
    truth, tracks = scored.following.truth, scored.following.tracks
    seen = list(zip(truth.frame.tolist(), truth.vessel.tolist(), map(tuple, truth.boxes_px.tolist()), strict=True))
    found = list(zip(tracks.frame.tolist(), tracks.track.tolist(), map(tuple, tracks.boxes_px.tolist()), strict=True))
    again = ScoredRun.of(rows_of(seen[::-1], 30, cameras=3), tracks_of(found[::-1], 3), Rules())
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


def test_the_scores_are_those_of_trackeval_over_the_exported_run_and_the_matching_that_of_clear(run, tmp_path):
    rows = RunRows.of(run)
    tracks = by_provenance(rows, coasting=False)
    later = tracks.step > 20  # from where on the same vessels have other tracks
    switched = Tracks.of(tracks.cameras, tracks.frame, tracks.track + 50 * later, tracks.boxes_px)
    scored = ScoredRun.of(rows, switched, Rules())
    assert scored.following.counted.all()
    check_the_one_matching_is_that_of_clear(scored)
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
    scored = ScoredRun.of(rows, tracks, Rules())
    assert scored.following.truth.hidden.any() and not scored.following.counted.all()
    hota, clear, identity = by_trackeval(scored)
    found = hota.hota, clear.mota, identity.idf1
    expected = scores(tmp_path / "mot", tmp_path / "tracks", "all")["COMBINED_SEQ"]
    assert 0.1 < found[0] < 0.9
    assert found == pytest.approx([expected[key] for key in ("HOTA", "MOTA", "IDF1")], abs=1e-12)


CAMERA = CameraFacts("C0", (4000, 3000), 10.0, ("boat", "ship"))
TRACKER = ReferenceTracker(
    **{"noise_share": 0.0, "noise_x_px": 2.0, "noise_y_px": 2.0, "velocity_change_px_s": 1.0, "first_speed_px_s": 30.0},
    **{"gate_probability": 0.9999, "start_confidence": 0.4, "confirm_hits": 2, "lost_s": 1.0, "coast_s": 0.5},
)


def sensed(time_s, places, *, size=(40.0, 20.0), confidence=0.8, label=0):
    """A frame with boxes of one size around places."""
    count = len(places)
    boxes = np.column_stack([np.reshape(places, (count, 2)), np.tile(size, (count, 1))])
    return SensedFrame(time_s, corner_form(boxes), np.full(count, label), np.full(count, confidence))


def straight(times_s, starts, velocities):
    starts, velocities = np.array(starts, dtype=float), np.array(velocities, dtype=float)
    return [sensed(float(time_s), starts + velocities * time_s) for time_s in times_s]


def one_vessel(count):
    """Ten frames a second of a vessel that begins at 100, 200 and makes 30 px/s to the right."""
    return straight(np.arange(count) / 10, [[100, 200]], [[30, 0]])


def followed(frames, **settings):
    return list(TRACKER.model_copy(update=settings).follow(frames, CAMERA))


def numbers(answers):
    return [sorted(answer.track.tolist()) for answer in answers]


def without(frames, *missing):
    return [sensed(frame.time_s, []) if index in missing else frame for index, frame in enumerate(frames)]


def test_two_frames_are_those_of_the_hand_and_a_track_is_reported_from_its_last_confirming_detection_on():
    # A centre at 100, 104 one second later: predicted 100 with variance 4 + 30 ** 2 + 1 / 3, measured with variance 4.
    answer = followed(straight([0.0, 1.0], [[100, 200]], [[4, 0]]))[1]
    before = 4 + 900 + 1 / 3
    gain = before / (before + 4)
    np.testing.assert_allclose(centres(answer.boxes_px), [[100 + gain * 4, 200]])
    np.testing.assert_allclose(answer.covariance_px2, [np.eye(2) * before * 4 / (before + 4)])
    assert answer.track.tolist() == [0]
    frames = one_vessel(6)
    assert numbers(followed(frames, confirm_hits=3)) == [[], [], [0], [0], [0], [0]]
    assert numbers(followed(without(frames, 1), confirm_hits=3)) == [[], [], [], [0], [0], [0]]
    assert numbers(followed(without(frames, 1, 2), confirm_hits=3)) == [[], [], [], [], [], [1]]


def test_crossing_vessels_keep_their_tracks_and_the_likeliest_pairs_in_the_gates_are_taken():
    answers = followed(straight(np.arange(40) / 10, [[100, 200], [500, 220]], [[100, 0], [-100, 0]]))[1:]
    for track in range(2):
        first, last = (answers[index].boxes_px[answers[index].track == track] for index in (0, -1))
        assert len(first) == len(last) == 1
        assert abs(abs(centres(last)[0, 0] - centres(first)[0, 0]) - 380) < 5
    assert numbers(answers) == [[0, 1]] * 39
    frames = straight(np.arange(10) / 10, [[100, 200], [112, 200]], [[30, 0], [30, 0]])
    last = followed(frames, noise_x_px=10.0, noise_y_px=10.0)[-1]
    for track, x_px in enumerate((127, 139)):
        np.testing.assert_allclose(centres(last.boxes_px[last.track == track]), [[x_px, 200]], atol=5)


def test_a_track_coasts_for_its_time_whatever_the_times_and_their_last_bits_and_ends_after_it():
    frames = one_vessel(40)
    missed = followed(without(frames, 10))
    assert numbers(missed)[1:] == [[0]] * 39
    np.testing.assert_allclose(centres(missed[10].boxes_px), [[130, 200]], atol=1)
    short, long = followed(without(frames, *range(10, 19))), followed(without(frames, *range(10, 20)))
    assert numbers(short) == [[]] + [[0]] * 14 + [[]] * 4 + [[0]] * 21  # seen at 0.9 s, and at 1.9 s again
    assert numbers(long)[19:22] == [[], [], [1]]  # seen at 2.0 s again
    times_s = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.5, 60))
    answers = followed(straight(times_s, [[100, 200], [100, 300]], [[60, 5], [40, -5]]))
    assert numbers(answers)[1:] == [[0, 1]] * 59
    last_px = np.sort(centres(answers[-1].boxes_px)[:, 0])
    np.testing.assert_allclose(last_px, 100 + np.array([40, 60]) * times_s[-1], atol=1)
    for begin in range(20):
        times_s = 1_700_000_000 + np.arange(begin, begin + 5) * 0.1 - 1_700_000_000
        frames = without(straight(times_s, [[100, 200]], [[0, 0]]), 2, 3, 4)
        assert numbers(followed(frames, coast_s=0.2)) == [[], [0], [0], [0], []]


def test_frames_without_detections_have_no_tracks_and_the_order_of_detections_changes_nothing():
    assert numbers(followed([sensed(time_s, []) for time_s in (0.0, 0.1, 0.2)])) == [[], [], []]
    answers = followed(without(one_vessel(30), *range(5), *range(20, 30)))
    assert numbers(answers) == [[]] * 6 + [[0]] * 19 + [[]] * 5 and followed([]) == []
    frames = one_vessel(10)
    unsure = [replace(frame, confidence=np.full(1, 0.3)) for frame in frames]
    assert numbers(followed(unsure)) == [[]] * 10
    assert numbers(followed(frames[:3] + unsure[3:])) == [[]] + [[0]] * 9
    rng = np.random.default_rng(2)
    frames = []
    for step in range(40):
        places = np.array([[100, 200], [300, 220], [500, 240], [700, 800]]) + step * np.array([8, 1])
        frames.append(sensed(step / 10, places + rng.normal(0, 2, (4, 2))))
    shuffled = [replace(frame, boxes_px=frame.boxes_px[rng.permutation(4)]) for frame in frames]
    same = {}
    for one, other in zip(followed(frames), followed(shuffled), strict=True):
        a, b = (np.lexsort(answer.boxes_px.T) for answer in (one, other))
        np.testing.assert_allclose(one.boxes_px[a], other.boxes_px[b], rtol=0, atol=1e-9)
        pairs = zip(one.track[a].tolist(), other.track[b].tolist(), strict=True)
        assert all(same.setdefault(first, second) == second for first, second in pairs)
    assert len(same) == 4


def test_a_track_has_the_label_with_the_most_confidence_and_boxes_end_at_the_edge_of_the_image():
    labelled = zip(one_vessel(5), [0, 1, 1, 1, 0], strict=True)
    mixed = [replace(frame, label=np.array([label])) for frame, label in labelled]
    assert [answer.label.tolist() for answer in followed(mixed)] == [[], [0], [1], [1], [1]]
    seen = straight(np.arange(4) / 10, [[3960, 200]], [[100, 0]])
    answers = followed([*seen, sensed(0.5, []), sensed(0.8, [])])
    assert max(answer.boxes_px[:, 2].max(initial=0) for answer in answers) == 4000
    assert numbers(answers)[-1] == []


def test_the_filter_is_as_uncertain_as_it_is_wrong():
    rng, vessels, steps = np.random.default_rng(3), 400, 15
    tracker = TRACKER.model_copy(update={"lost_s": 9.0, "gate_probability": 1 - 1e-12})
    place = np.stack(np.meshgrid(np.arange(20), np.arange(20)), -1).reshape(-1, 2) * 2000.0 + 1000
    camera = replace(CAMERA, image_size_px=(40000, 40000))
    velocity = rng.normal(0, 30, (vessels, 2))
    frames, places, time_s = [], [], 0.0
    for _ in range(steps):
        frames.append(sensed(time_s, place + rng.normal(0, 2, (vessels, 2))))
        places.append(place)
        step_s = float(rng.uniform(0.2, 1.5))
        # Exact samples of white-noise acceleration over the step.
        first, second = rng.normal(0, 1, (2, vessels, 2))
        place = place + velocity * step_s + step_s**1.5 * (first / 2 + second / np.sqrt(12))
        velocity, time_s = velocity + first * np.sqrt(step_s), time_s + step_s
    answers = list(tracker.follow(frames, camera))
    for answer, true in zip(answers[1:], places[1:], strict=True):
        assert answer.track.tolist() == list(range(vessels))
        error = centres(answer.boxes_px) - true
        nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(answer.covariance_px2), error)
        assert abs(nees.mean() - 2) < 4 * 2 / np.sqrt(vessels)  # chi-square of 2 has a standard deviation of 2
    last_px2 = answers[-1].covariance_px2
    assert last_px2[0, 0, 0] == pytest.approx(last_px2[-1, 1, 1])


def motion(*filter_values):
    return MotionEstimates(*(np.array([value], dtype=float) for value in filter_values))


def filter_values(found):
    return [float(each[0]) for each in vars(found).values()]


def test_a_step_is_that_of_the_hand_and_two_short_predictions_are_one_long_one():
    # place 10, rate 2, variances 4, 1, 1. After 2 s with a change of the rate of 3 a second (variance 9):
    # place 10 + 2 * 2; variance 4 + 2 * 2 * 1 + 4 * 1 + 9 * 8 / 3; mixed 1 + 2 * 1 + 9 * 4 / 2; rate 1 + 9 * 2.
    predicted = motion(10, 2, 4, 1, 1).predicted(2.0, 3.0)
    assert filter_values(predicted) == [14, 2, 36, 21, 19]
    # Measured at 19 with variance 9: total 45, gains 36 / 45 and 21 / 45, surprise 5.
    corrected = predicted.corrected(np.array([19.0]), np.array([9.0]))
    expected = [14 + 0.8 * 5, 2 + 21 / 45 * 5, 36 * 9 / 45, 21 * 9 / 45, 19 - 21 * 21 / 45]
    np.testing.assert_allclose(filter_values(corrected), expected)
    # A place that walks grows uncertain with time.
    assert filter_values(motion(10, 0, 4, 0, 0).predicted(2.0, 0.0, 3.0)) == [10, 0, 4 + 9 * 2, 0, 0]
    start = motion(10, 2, 4, 1, 1)
    twice = start.predicted(0.3, 3.0, 0.5).predicted(1.1, 3.0, 0.5)
    np.testing.assert_allclose(filter_values(twice), filter_values(start.predicted(1.4, 3.0, 0.5)))
    later = start.predicted(2.0, 3.0)
    np.testing.assert_allclose(filter_values(start.smoothed(later, later, 2.0)), filter_values(start), rtol=1e-12)
