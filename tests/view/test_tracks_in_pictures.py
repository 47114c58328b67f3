"""Tracks in pictures, films and Rerun, which vessel each is shown on, and where it switches."""

import numpy as np
import pytest
from PIL import Image

from modsim3d.core.arrays import NOBODY
from modsim3d.scene.reading import load_scene
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.view import palette
from modsim3d.view.films.plan import FilmLayout
from modsim3d.view.followed_tracks import FollowedTracks
from tests.cli.bad_input.builders import answer, refusal
from tests.run_folders import interrupt
from tests.scenes import crossing
from tests.view.made_tracks import FALSE_TRACK, as_set, perfect, swapped, with_false, write_csv
from tests.view.test_run_rerun import read, views

STEPS, WIDTH, STEP = 12, 1600, 9


@pytest.fixture(scope="module")
def followed(rows) -> FollowedTracks:
    """One track on each vessel and a false one all the time."""
    return FollowedTracks.of(as_set(with_false(perfect(rows), range(STEPS))), rows, Similarity())


@pytest.fixture(scope="module")
def tracks(rows, followed, tmp_path_factory):
    return write_csv(followed.tracks, rows, tmp_path_factory.mktemp("csv") / "made.csv")


def test_a_track_and_its_trail_have_the_colour_of_its_vessel_a_false_one_the_alarms(
    call, exact_run, followed, tracks, tmp_path
):
    options = (
        "--width",
        WIDTH,
        "--crop",
        "none",
        "--layers",
        "tracks",
        "--tracks",
        tracks,
        "--out",
        tmp_path / "a.png",
    )
    said = answer(call, ("view", "frame", exact_run, STEP, *options))
    assert followed.sentence() in " ".join(said.split())
    with Image.open(tmp_path / "a.png") as written:  # under the head line, with two pixels for one of the image
        picture = np.asarray(written)[FilmLayout(WIDTH, 1, (), ()).head_px :].astype(int)
    here = followed.rows_of(STEP)
    assert here.stop - here.start >= 3
    for number, (x0, y0, _, y1) in zip(followed.tracks.track[here], followed.tracks.boxes_px[here], strict=True):
        colour = palette.ALARM if number == FALSE_TRACK else palette.vessel_colour(int(number))
        left = picture[int(2 * y0) + 2 : int(2 * y1) - 2, int(2 * x0) + 2 : int(2 * x0) + 4]
        share = (left == colour).all(axis=-1).mean()
        assert share > (0.4 if number == FALSE_TRACK else 0.6), number  # a false one is dashed
    trail = followed.trail_px(here.start + followed.tracks.track[here].tolist().index(2))
    assert len(trail) == 3  # a step a second, two seconds back
    for x, y in (trail[:-1] + trail[1:]) / 2:
        around = picture[int(2 * y) - 2 : int(2 * y) + 3, int(2 * x) - 2 : int(2 * x) + 3]
        assert (np.abs(around - palette.vessel_colour(2)).max(axis=-1) < 40).any()


def test_pictures_without_the_layer_are_those_without_tracks(call, exact_run, tracks, tmp_path):
    for name, options in {"a": (), "b": ("--tracks", tracks)}.items():
        layers = ("--layers", "horizon,truth,detections,labels", "--width", 640)
        arguments = (STEP, *layers, *options, "--out", tmp_path / f"{name}.png")
        answer(call, ("view", "frame", exact_run, *arguments))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_films_with_tracks_are_the_same_bytes_whatever_the_workers(call, exact_run, tracks, tmp_path):
    options = ("--kind", "detections", "--every", 4, "--width", 320, "--tracks", tracks)
    for workers in (1, 2):
        out = ("--workers", workers, "--out", tmp_path / f"{workers}.gif")
        answer(call, ("view", "film", exact_run, *options, *out))
    assert (tmp_path / "1.gif").read_bytes() == (tmp_path / "2.gif").read_bytes()


def test_tracks_not_drawn_or_of_an_interrupted_run_are_refused(call, exact_run, tmp_path, tracks):
    for line in (("film", exact_run), ("frame", exact_run, 3)):
        line = ("view", *line, "--kind", "scene", "--tracks", tracks, "--overwrite")
        refusal(call, line, "--tracks works with --kind detections, all, plan and map")
    cut = interrupt(load_scene(str(crossing(tmp_path, 400)), source="analytic"), tmp_path / "cut")
    for line in (("report", cut), ("export", cut, "--format", "rerun"), ("view", "frame", cut, 0)):
        said = refusal(call, (*line, "--tracks", tracks, "--out", tmp_path / "x.png"))
        assert "tracks need a finished one" in " ".join(said.split())


def test_rerun_has_the_tracks_with_number_and_vessel(call, exact_run, rows, followed, tracks, tmp_path):
    said = answer(call, ("export", exact_run, "--format", "rerun", "--tracks", tracks, "--out", tmp_path))
    assert followed.sentence() in " ".join(said.split())
    found, names = read(tmp_path / "run.rrd"), [*rows.scene.vessel_names, "nothing"]
    for step in range(STEPS):
        here = followed.rows_of(step)
        numbers, vessels = followed.tracks.track[here].tolist(), followed.vessel[here].tolist()
        entity = found["/world/cameras/C0/image/tracks"][step]
        assert entity["labels"] == [f"#{n} on {names[v]}" for n, v in zip(numbers, vessels, strict=True)]
        centre = (followed.tracks.boxes_px[here, :2] + followed.tracks.boxes_px[here, 2:]) / 2
        np.testing.assert_allclose(entity["centers"], centre, rtol=1e-5)
        assert found["/counts/C0/tracks"][step]["scalars"] == [len(numbers)]
        assert found["/counts/C0/false_tracks"][step]["scalars"] == [1]
    plot = views(tmp_path / "run.rrd")["tracks, and those on nothing"]
    assert plot == ("TimeSeries", ["/counts/C0/tracks", "/counts/C0/false_tracks"])


BOAT, SAIL = 0, 1


def follow(rows, tracks, *similarity):
    return FollowedTracks.of(as_set(tracks), rows, Similarity(*similarity))


def test_tracks_with_the_boxes_of_the_truth_follow_their_vessels_without_a_switch_and_trail_them(rows):
    shown = follow(rows, perfect(rows))
    np.testing.assert_array_equal(shown.vessel, shown.tracks.track)
    assert not (shown.switched | shown.moved | shown.unscored | shown.false).any()
    assert shown.sentence() == "Tracks of made: 3 tracks on 3 vessels, 0 identity switches, 0 false tracks."
    none = follow(rows, perfect(rows).take(np.zeros(0, dtype=np.int64)))
    assert none.sentence() == "Tracks of made: 0 tracks on 0 vessels, 0 identity switches, 0 false tracks."
    row = int(np.flatnonzero((shown.tracks.track == SAIL) & (shown.tracks.step == 2))[0])
    mine = shown.tracks.take((shown.tracks.track == SAIL) & (shown.tracks.step <= 2))  # two seconds of a step each
    centres = (mine.boxes_px[:, :2] + mine.boxes_px[:, 2:]) / 2
    np.testing.assert_allclose(shown.trail_px(row), centres[::-1], rtol=1e-12)


def test_two_tracks_that_swap_switch_and_move_a_new_number_switches_and_a_track_alone_that_goes_on_moves(rows):
    tracks = perfect(rows)
    shown = follow(rows, swapped(tracks, BOAT, SAIL, 6))
    for marked in (shown.switched, shown.moved):
        first = [shown.tracks.step[(shown.tracks.step >= 6) & (shown.vessel == vessel)].min() for vessel in (0, 1)]
        places = sorted(zip(shown.vessel[marked].tolist(), shown.tracks.step[marked].tolist(), strict=True))
        assert places == [(BOAT, first[0]), (SAIL, first[1])]
    assert "2 identity switches" in shown.sentence()
    number = np.where((tracks.track == SAIL) & (tracks.step >= 5), 7, tracks.track)
    shown = follow(rows, Tracks.of(1, tracks.frame, number, tracks.boxes_px))
    assert shown.tracks.track[shown.switched].tolist() == [7] and not shown.moved.any()
    assert "4 tracks on 3 vessels, 1 identity switch, 0" in shown.sentence()
    some = tracks.take(((tracks.track == SAIL) & (tracks.step < 2)) | ((tracks.track == 2) & (tracks.step >= 4)))
    shown = follow(rows, Tracks.of(1, some.frame, np.full(len(some), 5), some.boxes_px))
    assert shown.moved.sum() == 1 and not shown.switched.any()


def test_a_track_where_no_vessel_is_is_false_and_one_beside_its_vessel_follows_it_by_distance_only(rows):
    shown = follow(rows, with_false(perfect(rows), range(3, 6)))
    np.testing.assert_array_equal(shown.false, shown.tracks.track == FALSE_TRACK)
    assert shown.vessel[shown.false].tolist() == [NOBODY] * 3
    assert shown.sentence().endswith("4 tracks on 3 vessels, 0 identity switches, 1 false track.")
    tracks = perfect(rows).take(perfect(rows).track == 2)
    beside = tracks.boxes_px + np.tile((tracks.boxes_px[:, 2] - tracks.boxes_px[:, 0])[:, None], 4) * (1, 0, 1, 0)
    moved = Tracks.of(1, tracks.frame, tracks.track, beside)
    assert follow(rows, moved).false.all() and not follow(rows, moved, "centre", 2000.0, 0.1).false.any()


def test_a_track_that_stays_on_a_hidden_vessel_is_on_it_and_unscored(rows):
    hidden = (rows.numbers("visible_px") == 0) & (rows.numbers("silhouette_px") > 0)
    assert hidden.any()
    shown = follow(rows, Tracks.of(1, rows.truth_frame, rows.truth_vessel, rows.boxes_px("full")))
    on = set(zip(rows.truth_frame[hidden].tolist(), rows.truth_vessel[hidden].tolist(), strict=True))
    kept = shown.tracks.take(shown.unscored)
    assert set(zip(kept.frame.tolist(), kept.track.tolist(), strict=True)) == on
    np.testing.assert_array_equal(shown.vessel[shown.unscored], kept.track)
