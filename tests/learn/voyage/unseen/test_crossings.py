"""A vessel without a transponder that passes a known one, and a known one at the image's border."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.formats.matching import Rule, match
from modsim3d.learn.voyage.non_ais.classification import CrossingTracks, classify_unmatched, fainter
from modsim3d.learn.voyage.report import sentences
from tests.formats.labelled_files import found, truth
from tests.learn.voyage.unseen.voyages import HEIGHT_PX, SEA, WIDTH_PX, boxes_at, labelled_set, observed

FRAMES = 400


def set_of(known, *tracks):
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
    labelled = set_of(known, np.where(hidden[:, None], np.nan, known), other)
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
    judged = classify_unmatched(observed(set_of(at(600.0), seen, at(x, 440.0, 30.0)), Rule("centre")))
    assert (np.abs(judged.observed.pairs.error_px[:, 1]) > 30).sum() > 5
    assert judged.labelled.annotations.ignored[np.flatnonzero(np.abs(x - 600) < 25)].all()
    assert not np.abs(observed(judged.labelled, Rule("centre")).pairs.error_px).max() > 1


@pytest.mark.parametrize("speed_px", [0.9, 0.7, 0.5])
def test_a_slow_vessel_that_passes_close_is_left_out_where_the_two_touch(speed_px):
    """The slower ones are within 50 px, so that they may match, for most of their lives."""
    frame = np.arange(FRAMES)
    x = np.where(frame < 240, 600 + speed_px * (frame - 120), np.nan)
    known = at(600.0, size=14.0)
    judged = classify_unmatched(observed(set_of(known, known, at(x, 402.0, 14.0)), Rule("centre")))
    ignored = judged.labelled.annotations.ignored
    assert ignored[np.abs(x - 600) < 14].all() and ignored.sum() < 130


def test_faint_detections_do_not_take_a_known_vessel_from_a_sure_one():
    sure, faint = [570.0, 380, 650, 420], [575.0, 382, 625, 418]
    annotations, results = truth([0], [0], [[570.0, 380, 630, 420]]), found([0, 0], [0, 0], [sure, faint], [0.9, 0.1])
    one = replace(set_of(at(600.0), at(600.0)), annotations=annotations, results=results)
    tracks = CrossingTracks(np.array([0]), np.array([faint]), np.array([0]))
    assert fainter(tracks, one, match(one, Rule("centre"), 0.2), 0.2).tolist() == [1]


def test_a_vessel_whose_truth_is_off_is_still_missed():
    known = at(600 + 0.2 * np.arange(FRAMES))
    judged = classify_unmatched(observed(set_of(known, known + np.array([40.0, 0, 40, 0]))))
    assert judged.left_out.sum() >= FRAMES  # what lasts is taken for a vessel
    assert not judged.labelled.annotations.ignored.any()


def test_a_known_vessel_in_view_before_its_truth_is_no_false_positive():
    x = -60 + 3.0 * np.arange(FRAMES)
    seen = in_view(at(x))
    labelled = set_of(in_view(at(x - 6.0)), seen)
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
    level = set_of(known, seen)
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
    judged = classify_unmatched(observed(set_of(known, known, other, np.where(single[:, None], stray, np.nan))))
    (rate,) = judged.own_rates(10, 0)
    silent, unmatched = np.count_nonzero(~judged.tells), len(judged.links.rows)
    assert silent >= single.sum() > 2 and rate.unmatched == unmatched
    assert float(rate.upper.estimate) * FRAMES == pytest.approx(unmatched)
    assert float(rate.mixture.estimate) * FRAMES == pytest.approx(
        (1 - rate.vessel_share.estimate) * (unmatched - silent)
    )
