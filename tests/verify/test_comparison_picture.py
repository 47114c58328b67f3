"""Which pixels two sources differ in, and the picture of it."""

from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from modsim3d.scene.reading import load_scene
from modsim3d.verify.sources import compare, report
from modsim3d.view import palette
from modsim3d.view.pictures import comparison_picture as pictures
from modsim3d.view.pictures.plain import Solids
from tests.scenes import crossing, write_scene


def test_a_pixel_belongs_to_a_region_if_its_centre_does():
    seen = np.zeros((6, 8), dtype=bool)
    seen[1:4, 1:4] = True
    differing = pictures.differing_pixels(seen, shapely.box(2.4, 0.6, 6.4, 4.4))  # columns 2 to 5, rows 1 to 3
    expected = np.zeros((6, 8))
    expected[1:4, 1] = 2
    expected[1:4, 2:4] = 1
    expected[1:4, 4:6] = 3
    np.testing.assert_array_equal(differing, expected)
    np.testing.assert_array_equal(pictures.differing_pixels(seen, shapely.Polygon()), 2 * seen)
    assert (pictures.differing_pixels(np.ones((3, 3), dtype=bool), shapely.box(-9, -9, 99, 99)) == 1).all()


def test_the_picture_shows_the_pixels_of_each_source(renderer, tmp_path):
    scene = load_scene(crossing(tmp_path))
    solids = Solids.at(scene, scene.cameras[0], 0)
    vessel, box = int(solids.occluders[0]), solids.outlines.boxes_px[0]
    shifted = shapely.box(*(box + np.array([3.0, 0.0, 3.0, 0.0])))
    picture = pictures.comparison_picture(
        pictures.SourceBoxes(*[tuple(box.tolist())] * 5), vessel, solids, shifted, renderer
    )
    pixels = np.asarray(picture)[pictures.KEY_PX :]
    for colour in (pictures.BOTH, *(colour for _, colour in pictures.PIXELS[2:])):
        assert (pixels == colour).all(axis=-1).sum() > 50
    assert (pixels == palette.SEA).all(axis=-1).any()


@pytest.mark.parametrize(
    ("name", "vessel", "region"),
    [
        ("simulation_1", "vessel1", "exact region"),
        ("strait", "barge", "exact region"),
        ("strait", "ferry", "exact region"),
        (None, "rafted", "region that a neighbour may hide"),
    ],
)
def test_the_key_says_what_the_rendered_pixels_are_held_against(monkeypatch, tmp_path, name, vessel, region):
    monkeypatch.setattr(report, "comparison_picture", lambda *arguments: arguments[-2])
    raft = {name: ([12, 4, 3], [[0, 90, w2], [1, 91, w2]]) for name, w2 in (("rafted", 0), ("other", 3))}
    scene = load_scene(name or write_scene(tmp_path, raft, 1))
    case = SimpleNamespace(camera=0, step=0, vessel=scene.vessel_names.index(vessel), boxes_px={})
    assert report.draw_case(scene, case, None, report.RULE) == region


def test_a_picture_shows_the_boxes_that_differ_most():
    box, wide = (0.0, 0.0, 10.0, 10.0), (0.0, 0.0, 13.0, 10.0)
    nothing = (np.nan,) * 4
    assert pictures.boxes_that_differ(pictures.SourceBoxes(box, box, wide, box, nothing)) is pictures.FULL
    assert pictures.boxes_that_differ(pictures.SourceBoxes(box, box, box, wide, nothing)) is pictures.VISIBLE
    assert pictures.boxes_that_differ(pictures.SourceBoxes(box, nothing, wide, nothing, nothing)) is pictures.FULL


def test_the_rules_mistake_is_shown_where_the_other_sources_agree():
    def occlusion(boxes):
        counts = {"visible_px": np.full(2, 5.0), "silhouette_px": np.full(2, 9.0)}
        return SimpleNamespace(visible_boxes_px=np.array(boxes), **counts)

    sources = {
        "rendered": occlusion([[0.0, 0.0, 10.0, 10.0], [0.0, 0.0, 10.0, 10.0]]),
        "analytic": occlusion([[0.0, 0.0, 50.0, 10.0], [0.0, 0.0, 10.4, 10.0]]),
        "rectangles": occlusion([[0.0, 0.0, 90.0, 10.0], [0.0, 0.0, 30.0, 10.0]]),
    }
    chosen = []
    vessels = SimpleNamespace(sources=sources, difference=lambda *row: chosen.append(row) or row)
    assert compare._check_rule(vessels).off == 2
    assert [(row, reason) for row, _, reason in chosen] == [(1, "the rectangle rule is 20 px off")]
