"""False positives linked over time; a vessel without a transponder that passes a known one, or one at the border."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.formats.matching import Rule, match
from modsim3d.learn.voyage.non_ais.classification import CrossingTracks, classify_unmatched, fainter
from modsim3d.learn.voyage.non_ais.linking import STEADY, Behaviour, jitter_of, link, tracklets_of
from modsim3d.learn.voyage.report import sentences
from tests.formats.labelled_files import found, truth
from tests.learn.voyage.non_ais.voyages import HEIGHT_PX, HORIZON_PX, SEA, WIDTH_PX, boxes_at, labelled_set, observed

NOTHING = truth([], [], np.empty((0, 4)))


def set_of(image, x, y, size=40.0, **frames):
    """Detections at places, and nothing annotated."""
    return set_of_boxes(image, boxes_at(*np.broadcast_arrays(image, x, y, size)[1:]), **frames)


def set_of_boxes(image, boxes, annotated=NOTHING, frames=60, rate_hz=2.0, seas=SEA):
    results = found(image, 0 * np.asarray(image), boxes, np.full(len(image), 0.9))
    return labelled_set(results, annotated, frames, rate_hz, seas)


def linked(labelled):
    return link(observed(labelled))


def test_what_nears_crosses_the_view_or_is_gone_no_longer_than_seen_is_one_thing_unless_its_size_changes():
    frame = np.arange(40)  # at 1 Hz and 12 px it seems to go faster by up to a twentieth of its length a second
    assert linked(set_of(frame, 100 + 0.3 * frame**2.0, np.full(40, 400.0), 12.0, frames=40, rate_hz=1.0)).count == 1
    image = np.array([0, 1, 2, 3, 8, 9, 10, 20, 21, 50, 51])
    links = linked(set_of(image, 100 + 4.0 * image, np.full(11, 400.0)))
    assert links.link.tolist() == [0] * 9 + [1] * 2
    image = np.arange(10)
    links = linked(set_of(image, 300.0, 400.0, np.where(image < 5, 20.0, 60.0)))
    assert links.link.tolist() == [0] * 5 + [1] * 5
    frame = np.arange(120)
    boxes = np.clip(upright(1300 - 14.0 * frame, 400, 140, 440), 0, [[WIDTH_PX, 700] * 2])  # in and out of view
    seen = boxes[:, 2] - boxes[:, 0] > 1
    labelled = set_of_boxes(frame[seen], boxes[seen], frames=120)
    links = linked(labelled)
    assert links.count == 1 and tracklets_of(links, labelled.images).cut.tolist() == [True]


def upright(left, top, width, bottom):
    """Boxes whose left edges move."""
    return np.column_stack([left, 0 * left + top, left + width, 0 * left + bottom])


def test_a_thing_that_a_known_vessel_or_another_thing_hides_in_part_is_one_thing():
    frame = np.arange(60)
    left, other = 200 + 6.0 * frame, 700 - 4.0 * frame
    low = upright(left, 370, 60, 400)
    known = np.tile([350.0, 380, 450, 410], (60, 1))
    behind = (left > 290) & (left + 60 < 510)
    low[behind, 3] = 380
    assert behind.sum() > 10 and linked(set_of_boxes(frame, low, truth(frame, 0 * frame, known))).count == 1
    low, near = upright(left, 370, 60, 400), upright(other, 380, 200, 430)
    over = (left + 60 > other) & (left < other + 200)
    low[over, 3] = 378
    assert over.sum() > 10 and linked(set_of_boxes(np.tile(frame, 2), np.concatenate([low, near]))).count == 2


def test_things_that_cross_keep_their_numbers():
    frame = np.arange(40)
    right, left = 100 + 12.0 * frame, 574 - 12.0 * frame
    links = linked(set_of(np.tile(frame, 2), np.r_[right, left], np.r_[np.full(40, 400.0), np.full(40, 403.0)]))
    of_right = links.link[np.isclose(links.places_px[:, 1], 400 - HORIZON_PX)]
    assert links.count == 2 and len(set(of_right.tolist())) == 1


def test_a_stray_detection_does_not_take_the_place_of_a_whole_one():
    frame = np.arange(60)
    known = np.tile([590.0, 380, 790, 420], (60, 1))
    whole = boxes_at(300 + 6.0 * frame, np.full(60, 400.0), np.full(60, 60.0))
    piece = np.tile([590.0, 395, 610, 400], (4, 1))  # of the known vessel, beside the other one
    stray = np.array([[490.0, 397, 535, 427]])  # one frame earlier, near where the other one will be
    boxes, image = np.concatenate([whole, piece, stray]), np.r_[frame, 41:45, 40]
    links = linked(set_of_boxes(image, boxes, truth(frame, 0 * frame, known)))
    of_whole = links.link[np.isclose(links.sizes_px[:, 0], 60.0)]
    assert len(of_whole) > 50 and len(set(of_whole.tolist())) == 1


@pytest.mark.parametrize(("seed", "error_px"), [(0, 1.0), (1, 3.0)])
def test_a_vessel_hardly_larger_than_its_box_errors_is_one_thing_where_known_ones_err_as_much(seed, error_px):
    """Of 9 px. Known ones are 14 px long; far larger ones, whose boxes err by far more, do not count."""
    rng, frame = np.random.default_rng(seed), np.arange(300)

    def measured(boxes, error):
        centre, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) / 2
        half = np.maximum(half + rng.normal(0, error / 2, half.shape), 0.5)
        return np.concatenate([centre - half, centre + half], axis=1) + np.tile(rng.normal(0, error, centre.shape), 2)

    known, large = boxes_at(500 + 0.1 * frame, 0 * frame + 300.0, 14.0), boxes_at(800.0 + frame, 0 * frame + 500.0, 300)
    silent = measured(boxes_at(100 + 0.5 * frame, 0 * frame + 400.0, 9.0), error_px)
    image = np.tile(frame, 4)
    boxes = np.concatenate([measured(known, error_px), measured(large, 30.0), measured(large, 30.0), silent])
    annotated = truth(np.tile(frame, 2), np.zeros(600), np.concatenate([known, large]), identity=np.repeat([0, 1], 300))
    labelled = set_of_boxes(image, boxes, annotated, frames=300)
    links = link(observed(labelled, Rule("centre", most_distance_px=30)))
    ours = (links.places_px[:, 0] < 300) & (links.places_px[:, 1] < 250)
    of_silent = np.unique(links.link[ours])
    np.testing.assert_allclose(links.jitter.size_px, np.sqrt(2) * error_px, rtol=0.2)
    assert len(of_silent) == 1 and tracklets_of(links, labelled.images).perhaps_vessel[of_silent].all()
    steady = linked(replace(labelled, annotations=NOTHING))
    assert steady.jitter is STEADY
    pieces = len(np.unique(steady.link[(steady.places_px[:, 0] < 300) & (steady.places_px[:, 1] < 250)]))
    assert (pieces > 5) == (error_px > 2)


def test_errors_of_large_known_vessels_do_not_link_small_strays():
    """A false positive an image of 6 to 24 px, where boxes of 250 px err by 15 px."""
    rng, frame = np.random.default_rng(0), np.arange(600)
    known = np.concatenate([boxes_at(200 + 350.0 * k + 0.1 * frame, 0 * frame + 420.0, 250.0) for k in range(3)])
    single = np.repeat(frame, rng.poisson(1.0, 600))
    count = len(single)
    strays = boxes_at(rng.uniform(400, 800, count), rng.uniform(620, 680, count), rng.uniform(6, 24, count))
    image = np.r_[np.tile(frame, 3), single]
    boxes = np.concatenate([known + rng.normal(0, 15, known.shape), strays])
    annotated = truth(np.tile(frame, 3), np.zeros(1800), known, identity=np.repeat([0, 1, 2], 600))
    judged = classify_unmatched(observed(set_of_boxes(image, boxes, annotated, frames=600), Rule("centre")))
    assert judged.links.jitter.place_px.min() > 10 and judged.tracklets.lasted_s.max() <= 30
    assert not judged.likely.any()


def test_jitter_is_that_of_boxes_in_full_view():
    """Every other vessel is partly hidden or comes into view, and its boxes jump."""
    rng, frame = np.random.default_rng(0), np.arange(200)
    rows = np.tile(frame, 4)
    whole = np.concatenate([boxes_at(0 * frame + x, 0 * frame + 400.0, 20.0) for x in (300, 500, 700)])
    known = np.concatenate([whole, np.tile([0.0, 393, 12, 407], (200, 1))])
    wild = np.repeat([False, False, True, True], 200)[:, None]
    seen = known + np.where(wild, rng.normal(0, 10, known.shape), rng.normal(0, 1, known.shape))
    unsure = np.repeat([False, False, True, False], 200)
    annotated = replace(truth(rows, 0 * rows, known, identity=np.repeat(np.arange(4), 200)), unsure_box=unsure)
    labelled = set_of_boxes(rows, seen, annotated, frames=200)
    jitter = jitter_of(observed(labelled, Rule("centre")), 3.0)
    np.testing.assert_allclose(jitter.place_px, 1.0, rtol=0.25)  # √2 · 1 px / √2 corners
    assert jitter_of(observed(labelled, Rule("centre")), 0.4) is STEADY


def test_a_camera_that_pitches_does_not_break_links_and_frames_without_times_have_none():
    frame = np.arange(40)
    pitch = 80 * np.sin(frame)
    seas = np.column_stack([0 * pitch, 1 + 0 * pitch, -HORIZON_PX - pitch])
    assert linked(set_of(frame, np.full(40, 500.0), 400 + pitch, frames=40, seas=seas)).count == 1
    assert linked(set_of(frame, np.full(40, 500.0), 400 + pitch, frames=40)).count > 5
    labelled = set_of(np.arange(5), 300.0, 400.0)
    labelled.images.time_s[:] = np.nan
    assert linked(labelled).count == 5


def test_what_lies_above_the_horizon_or_jumps_is_no_vessel():
    frame = np.arange(60)
    side = np.where(frame < 8, 0, 1 - 2 * (frame % 2))
    kinds = (-60, 0.0, "ABOVE_THE_HORIZON"), (60, 9.0, "JUMPS"), (60, 1.0, "LIKE_A_VESSEL")
    for below, jump, behaviour in kinds:
        labelled = set_of(frame, 400 + 2.0 * frame + jump * side, HORIZON_PX + below)
        tracklets = tracklets_of(linked(labelled), labelled.images)
        assert tracklets.behaviour[np.argmax(tracklets.detections)] == Behaviour[behaviour]


FRAMES = 400


def set_of_tracks(known, *tracks):
    """Known boxes (F, 4), of which those without a place are absent, and the detections of some tracks (F, 4)."""
    frame = np.arange(FRAMES)
    image, boxes = np.tile(frame, len(tracks)), np.concatenate(tracks)
    seen, there = np.isfinite(boxes).all(axis=1), np.isfinite(known).all(axis=1)
    rng = np.random.default_rng(0)
    single = rng.integers(0, FRAMES, 80)
    stray = boxes_at(rng.uniform(50, 1150, 80), rng.uniform(500, 600, 80), rng.uniform(15, 60, 80))
    image, boxes = np.r_[image[seen], single], np.concatenate([boxes[seen], stray])
    annotated = truth(frame[there], 0 * frame[there], known[there], identity=0 * frame[there])
    return labelled_set(found(image, 0 * image, boxes, np.full(len(image), 0.9)), annotated, FRAMES)


def at(x, y=400.0, size=60.0):
    return boxes_at(*(np.broadcast_to(each, FRAMES) for each in (x, y, size)))


def in_view(boxes):
    """Boxes cut at the image, without a place where less than a pixel of their width is left."""
    cut = np.clip(boxes, 0, [[WIDTH_PX, HEIGHT_PX] * 2])
    return np.where((cut[:, 2] - cut[:, 0] < 1)[:, None], np.nan, cut)


def test_a_known_vessel_that_an_unseen_one_hides_is_neither_missed_nor_matched_by_its_box():
    """It lies at 600 px; another one, which has no transponder, comes along it and hides it."""
    x = 100 + 2.5 * np.arange(FRAMES)
    known, other = at(600.0), at(x, 402.0, 75.0)
    hidden = np.abs(x - 600) < 40
    labelled = set_of_tracks(known, np.where(hidden[:, None], np.nan, known), other)
    judged = classify_unmatched(observed(labelled))
    ignored, matched = judged.labelled.annotations.ignored, judged.observed.matched.annotation
    assert hidden.sum() > 20 and ignored[hidden].all() and not ignored[np.abs(x - 600) > 150].any()
    assert judged.left_out[(matched >= 0) & ignored[matched]].all()
    left = observed(judged.labelled)
    assert not left.missed.any() and len(left.found) > 250
    wrong = np.flatnonzero(np.abs(observed(labelled).pairs.error_px[:, 2]) > 10)
    assert len(wrong) > 5  # the other one's box matches the known one that it hides
    assert np.abs(left.pairs.error_px).max() < 1e-6
    said = f"{judged.crossings.annotations.sum()} boxes of known vessels that these pass are ignored"
    assert any(each.startswith(said) for each in sentences(judged, judged.own_rates(10, 0)))
    assert not (judged.telling.matched.sought & hidden).any()


def test_an_unseen_vessel_beside_a_known_one_does_not_match_it():
    """Their boxes are 12 px apart, and the known one is missed in every other frame."""
    x, frame = 100 + 2.5 * np.arange(FRAMES), np.arange(FRAMES)
    seen = np.where((frame % 2 == 0)[:, None], at(600.0), np.nan)
    judged = classify_unmatched(observed(set_of_tracks(at(600.0), seen, at(x, 440.0, 30.0)), Rule("centre")))
    assert (np.abs(judged.observed.pairs.error_px[:, 1]) > 30).sum() > 5
    assert judged.labelled.annotations.ignored[np.flatnonzero(np.abs(x - 600) < 25)].all()
    assert not np.abs(observed(judged.labelled, Rule("centre")).pairs.error_px).max() > 1


@pytest.mark.parametrize("speed_px", [0.9, 0.7, 0.5])
def test_a_slow_vessel_that_passes_close_is_left_out_where_the_two_touch(speed_px):
    """The slower ones are within 50 px, so that they may match, for most of their lives."""
    frame = np.arange(FRAMES)
    x = np.where(frame < 240, 600 + speed_px * (frame - 120), np.nan)
    known = at(600.0, size=14.0)
    judged = classify_unmatched(observed(set_of_tracks(known, known, at(x, 402.0, 14.0)), Rule("centre")))
    ignored = judged.labelled.annotations.ignored
    assert ignored[np.abs(x - 600) < 14].all() and ignored.sum() < 130


def test_faint_detections_do_not_take_a_known_vessel_from_a_sure_one():
    sure, faint = [570.0, 380, 650, 420], [575.0, 382, 625, 418]
    annotations, results = truth([0], [0], [[570.0, 380, 630, 420]]), found([0, 0], [0, 0], [sure, faint], [0.9, 0.1])
    one = replace(set_of_tracks(at(600.0), at(600.0)), annotations=annotations, results=results)
    tracks = CrossingTracks(np.array([0]), np.array([faint]), np.array([0]))
    assert fainter(tracks, one, match(one, Rule("centre"), 0.2), 0.2).tolist() == [1]


def test_a_vessel_whose_truth_is_off_is_still_missed():
    known = at(600 + 0.2 * np.arange(FRAMES))
    judged = classify_unmatched(observed(set_of_tracks(known, known + np.array([40.0, 0, 40, 0]))))
    assert judged.left_out.sum() >= FRAMES  # what lasts is taken for a vessel
    assert not judged.labelled.annotations.ignored.any()


def test_a_known_vessel_in_view_before_its_truth_is_no_false_positive():
    x = -60 + 3.0 * np.arange(FRAMES)
    seen = in_view(at(x))
    labelled = set_of_tracks(in_view(at(x - 6.0)), seen)
    judged = classify_unmatched(observed(labelled))
    first = int(np.flatnonzero(np.isfinite(seen).all(axis=1))[0])
    early_rows = np.flatnonzero((labelled.results.image < first + 2) & (labelled.results.boxes_px[:, 0] < 1))
    assert len(early_rows) and judged.left_out[early_rows].all()
    (rate,) = judged.own_rates(10, 0)
    assert float(rate.used.estimate) * FRAMES <= 80 + 1e-9
    all_unmatched = len(judged.links.rows)
    assert rate.unmatched == all_unmatched > 80  # more than the stray ones
    assert float(rate.upper.estimate) * FRAMES == pytest.approx(all_unmatched) and rate.used is rate.kept
    said = f"{all_unmatched - 80:g} unmatched detections where vessels pass each other or come into view"
    assert any(each.startswith(said) for each in sentences(judged, (rate,)))
    inland = replace(labelled, annotations=replace(labelled.annotations, boxes_px=labelled.annotations.boxes_px + 300))
    assert not classify_unmatched(observed(inland)).crossings.results[early_rows].any()


def test_on_board_a_known_vessel_comes_into_view_at_its_place_below_the_horizon():
    """Pitch moves the picture by more than the vessel's height from frame to frame."""
    x, pitch_px = -60 + 3.0 * np.arange(FRAMES), 60.0 * (np.arange(FRAMES) % 2)
    known, seen = (in_view(at(x - late, 400 + pitch_px)) for late in (6.0, 0.0))
    first = int(np.flatnonzero(np.isfinite(known).all(axis=1))[0])
    seen[first - 2 : first + 1][[0, 2]] = np.nan  # one sliver, a frame before the vessel is there
    known[first + 1 :: 2] = np.nan
    level = set_of_tracks(known, seen)
    horizon = np.tile(SEA, (FRAMES, 1)) - np.outer(pitch_px, [0, 0, 1])
    on_board = replace(level, images=replace(level.images, half_planes=horizon))
    sliver = np.flatnonzero(level.results.image == first - 1)
    sliver = sliver[level.results.boxes_px[sliver, 0] < 1]
    assert len(sliver) == 1 and not classify_unmatched(observed(level)).crossings.results[sliver].any()
    assert classify_unmatched(observed(on_board)).crossings.results[sliver].all()


def test_the_greatest_rate_has_all_unmatched_detections_also_where_vessels_pass():
    x = 100 + 2.5 * np.arange(FRAMES)
    known, other, stray = at(600.0), at(x, 402.0, 75.0), at(610.0, 405.0, 15.0)
    single = (np.abs(x - 600) < 40) & (np.arange(FRAMES) % 8 == 0)
    judged = classify_unmatched(observed(set_of_tracks(known, known, other, np.where(single[:, None], stray, np.nan))))
    (rate,) = judged.own_rates(10, 0)
    silent, unmatched = np.count_nonzero(~judged.tells), len(judged.links.rows)
    assert silent >= single.sum() > 2 and rate.unmatched == unmatched
    assert float(rate.upper.estimate) * FRAMES == pytest.approx(unmatched)
    of_mixture = (1 - rate.vessel_share.estimate) * (unmatched - silent)
    assert float(rate.mixture.estimate) * FRAMES == pytest.approx(of_mixture)
