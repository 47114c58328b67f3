"""Films of maps: each frame is the map drawn whole, and what stays is drawn once."""

import numpy as np
import pytest

from modsim3d.scene.reading import load_scene
from modsim3d.view.films.renderer import MapFilmRenderer
from modsim3d.view.map_marks import BirdsEye
from modsim3d.view.map_picture import map_figure, map_height_px, map_picture
from tests.scenes import crossing

ROUNDING = 2  # units of a colour: what stays above what moves is blended by its own 8 bits


def birds_eye_of(name, steps):
    scene = load_scene(name, steps=steps)
    return BirdsEye(scene, steps, tuple(range(len(scene.cameras))))


@pytest.fixture(scope="module", params=["simulation_1", "strait", "simulation_2"])
def birds_eye(request):
    """A camera ashore, one of two on board, and all on board."""
    return birds_eye_of(request.param, 120)


def test_a_frame_is_the_map_drawn_whole(birds_eye):
    size = 800, map_height_px(birds_eye, 800)
    film = MapFilmRenderer(birds_eye, size)
    frames = {step: np.asarray(film.picture(step)).astype(int) for step in (119, 0)}
    for step, frame in frames.items():
        whole = np.asarray(map_picture(birds_eye, step, size)).astype(int)
        assert np.abs(frame - whole).max() <= ROUNDING
    assert (np.abs(frames[0] - frames[119]) > ROUNDING).any()


def test_only_what_moves_is_drawn_again(birds_eye):
    film, drawn = MapFilmRenderer(birds_eye, (640, map_height_px(birds_eye, 640))), []
    sheet = film.map.sheet
    for artist in film.map.figure.findobj():
        artist.draw = lambda renderer, artist=artist: drawn.append(artist)
    for step in (3, 4, 5):
        film.picture(step)
    assert len(drawn) == 3 * len(sheet.moving) and set(drawn) == set(sheet.moving)
    tracks = [line for line in sheet.axes.lines if len(line.get_xdata()) == birds_eye.steps]
    assert len(tracks) >= len(birds_eye.scene.vessels) and not set(tracks) & set(sheet.moving)


def test_vessels_that_come_and_go_change_nothing_else():
    """Their names, tracks and entries in the legend do not move the map."""
    birds_eye = birds_eye_of("strait", 120)
    places = [map_figure(birds_eye, step, 800).axes[0].get_window_extent().extents for step in (0, 60, 119)]
    np.testing.assert_array_equal(places, places[:1] * 3)


def test_a_vessel_that_is_absent_is_not_drawn(tmp_path):
    scene = load_scene(crossing(tmp_path))
    present = scene.poses.poses(0, scene.steps).present
    (step, *_), (gone, *_) = np.nonzero(~present)
    birds_eye = BirdsEye(scene, scene.steps, (0,))
    film = MapFilmRenderer(birds_eye, (640, map_height_px(birds_eye, 640)))
    film.picture(int(step))
    shown = {name.vessel for name in film.map.sheet.names.names if name.middle_px is not None}
    assert int(gone) not in shown and shown >= set(np.flatnonzero(present[step]).tolist())
