"""Tracks in pictures, films and Rerun."""

import numpy as np
import pytest
from PIL import Image

from modsim3d.scene.reading import load_scene
from modsim3d.tracks.tracks import Similarity
from modsim3d.view import palette
from modsim3d.view.films.plan import FilmLayout
from modsim3d.view.followed_tracks import FollowedTracks
from tests.command_line import call
from tests.run_folders import interrupt
from tests.scenes import crossing
from tests.view.made_tracks import FALSE_TRACK, as_set, perfect, with_false, write_csv
from tests.view.test_run_rerun import read, views

STEPS, WIDTH, STEP = 12, 1600, 9


@pytest.fixture(scope="module")
def followed(rows) -> FollowedTracks:
    """One track on each vessel and a false one all the time."""
    return FollowedTracks.of(as_set(with_false(perfect(rows), range(STEPS))), rows, Similarity())


@pytest.fixture(scope="module")
def tracks(rows, followed, tmp_path_factory):
    return write_csv(followed.tracks, rows, tmp_path_factory.mktemp("csv") / "made.csv")


def test_a_box_has_its_tracks_colour_and_trail_and_a_false_one_that_of_mistakes(
    monkeypatch, capsys, exact_run, followed, tracks, tmp_path
):
    options = ("--width", WIDTH, "--layers", "tracks", "--tracks", tracks, "--out", tmp_path / "a.png")
    assert call(monkeypatch, "view", "frame", exact_run, STEP, *options) == 0
    assert followed.sentence() in " ".join(capsys.readouterr().out.split())
    with Image.open(tmp_path / "a.png") as written:  # under the head line, with two pixels for one of the image
        picture = np.asarray(written)[FilmLayout(WIDTH, 1, (), ()).head_px :].astype(int)
    here = followed.rows_of(STEP)
    assert here.stop - here.start >= 3
    for number, (x0, y0, _, y1) in zip(followed.tracks.track[here], followed.tracks.boxes_px[here], strict=True):
        colour = palette.ALARM if number == FALSE_TRACK else palette.track_colour(int(number))
        left = picture[int(2 * y0) + 2 : int(2 * y1) - 2, int(2 * x0) + 2 : int(2 * x0) + 4]
        share = (left == colour).all(axis=-1).mean()
        assert share > (0.4 if number == FALSE_TRACK else 0.6), number  # a false one is dashed
    assert not (picture == palette.TRACKS[6]).all(axis=-1).any()
    trail = followed.trail_px(here.start + followed.tracks.track[here].tolist().index(2))
    assert len(trail) == 3  # a step a second, two seconds back
    for x, y in (trail[:-1] + trail[1:]) / 2:
        around = picture[int(2 * y) - 2 : int(2 * y) + 3, int(2 * x) - 2 : int(2 * x) + 3]
        assert (np.abs(around - palette.track_colour(2)).max(axis=-1) < 40).any()


def test_pictures_without_the_layer_are_those_without_tracks(monkeypatch, exact_run, tracks, tmp_path):
    for name, options in {"a": (), "b": ("--tracks", tracks)}.items():
        layers = ("--layers", "horizon,truth,detections,labels", "--width", 640)
        arguments = (STEP, *layers, *options, "--out", tmp_path / f"{name}.png")
        assert call(monkeypatch, "view", "frame", exact_run, *arguments) == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_films_with_tracks_are_the_same_bytes_whatever_the_workers(monkeypatch, exact_run, tracks, tmp_path):
    options = ("--kind", "detections", "--every", 4, "--width", 320, "--tracks", tracks)
    for workers in (1, 2):
        out = ("--workers", workers, "--out", tmp_path / f"{workers}.gif")
        assert call(monkeypatch, "view", "film", exact_run, *options, *out) == 0
    assert (tmp_path / "1.gif").read_bytes() == (tmp_path / "2.gif").read_bytes()


def test_tracks_are_refused_where_they_are_not_drawn_and_of_an_interrupted_run(
    monkeypatch, capsys, exact_run, tmp_path, tracks
):
    for line in (("film", exact_run), ("frame", exact_run, 3)):
        assert call(monkeypatch, "view", *line, "--kind", "scene", "--tracks", tracks, "--overwrite") == 2
        assert "--tracks works with --kind detections and all" in capsys.readouterr().err
    cut = interrupt(load_scene(str(crossing(tmp_path, 400)), source="analytic"), tmp_path / "cut")
    for line in (("report", cut), ("export", cut, "--format", "rerun"), ("view", "frame", cut, 0)):
        assert call(monkeypatch, *line, "--tracks", tracks, "--out", tmp_path / "x.png") == 2
        assert "tracks need a finished one" in " ".join(capsys.readouterr().err.split())


def test_rerun_has_the_tracks_with_number_and_vessel(monkeypatch, capsys, exact_run, rows, followed, tracks, tmp_path):
    assert call(monkeypatch, "export", exact_run, "--format", "rerun", "--tracks", tracks, "--out", tmp_path) == 0
    assert followed.sentence() in " ".join(capsys.readouterr().out.split())
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
