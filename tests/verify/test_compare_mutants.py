"""`modsim3d check truth` finds an error planted in a source, in both or in the drawing: order, corners, near plane."""

import json
from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest

from modsim3d.render.id_pass import IdRenderer
from modsim3d.scene import sight
from modsim3d.truth import analytic, occlusion_order, rendered
from modsim3d.truth.analytic import Hiding
from modsim3d.truth.crosscheck.drawing import Drawing
from modsim3d.verify.sources import agreement, compare
from tests.command_line import call
from tests.scenes import write_scene
from tests.verify.test_compare import behind_is_before

BOATS = {
    # A boat lies before the stern of a long ship whose centre is nearer: only a plane between them tells which hides.
    "ship": ([210, 8, 15], [[0, 198.0, 10.4], [100, 200.06, 9.99]]),
    "boat": ([2, 4, 4], [[0, 220, -2], [100, 221, -2]]),
    # The near plane cuts a third vessel beside the camera, so narrow that behind a cut nothing of it is left.
    "punt": ([60, 0.5, 9], [[0, 10, -2.6], [100, 11, -2.6]]),
}
NEAR_M = 8.0  # in place of a tenth of a metre


def swap_order(order):
    return replace(order, first_can_hide=order.second_can_hide, second_can_hide=order.first_can_hide)


def wrap(monkeypatch, place, name, change):
    """Put change(function, *arguments) in the place of a function."""
    function = getattr(place, name)
    monkeypatch.setattr(place, name, lambda *arguments, **named: change(function, *arguments, **named))


def in_fast_path(change):
    """Give the fast path, and nothing else, other outlines or another camera."""

    def plant(monkeypatch):
        for name in ("rendered_occlusion", "rendered_spans"):
            wrap(monkeypatch, compare, name, lambda f, o, lens, *rest, **named: f(*change(o, lens), *rest, **named))

    return plant


def in_analytic(change):
    return lambda monkeypatch: wrap(monkeypatch, agreement, "visible_regions", lambda f, o, lens: f(*change(o, lens)))


def in_drawing(inverse_depth):
    """Give each drawing, once it is projected, other depths: a function of its depths and occluders."""

    def changed(project, *arguments):
        drawing = project(*arguments)
        return replace(drawing, inverse_depth=inverse_depth(drawing.inverse_depth, drawing.occluder[:, None]))

    return lambda monkeypatch: wrap(monkeypatch, Drawing, "of", changed)


def shifted(outlines, lens):
    """The first vessel 3 px to the right."""
    first = outlines.occluder == 0
    parts = [
        replace(part, vertices_px=part.vertices_px + np.where(first[part.rows], 3.0, 0.0)[:, None, None] * [1, 0])
        for part in outlines.parts
    ]
    return replace(outlines, parts=tuple(parts)), lens


def plane_moved(outlines, lens):
    return outlines, replace(lens, near_clip_m=NEAR_M)


def first_moved(make, vessels, present, positions_m, *rest, **named):
    """The corners of the first vessel half a metre to port."""
    positions_m = positions_m.copy()
    positions_m[..., 0, 1] += 0.5
    return make(vessels, present, positions_m, *rest, **named)


def farthest_wins(monkeypatch):
    gl_of = IdRenderer._gl.func

    def reversed_gl(renderer):
        gl = gl_of(renderer)
        gl.glDepthFunc(gl.GL_LESS)
        gl.glClearDepth(1.0)
        return gl

    reversed_property = cached_property(reversed_gl)
    reversed_property.__set_name__(IdRenderer, "_gl")
    monkeypatch.setattr(IdRenderer, "_gl", reversed_property)


def near_plane_of_drawing(project, *arguments):
    *others, lens, last = arguments
    return replace(project(*others, replace(lens, near_clip_m=NEAR_M), last), intrinsics=lens)


MUTANTS = {
    "order, fast path": lambda m: wrap(m, rendered, "order_of_pairs", lambda f, *rest: swap_order(f(*rest))),
    "order, analytic": lambda m: wrap(m, analytic, "order_of", lambda f, *rest: swap_order(f(*rest))),
    "order, fast path and analytic alike": lambda m: wrap(
        m, occlusion_order, "_who_can_hide", lambda f, *rest: (f(*rest)[0][:, ::-1], f(*rest)[1])
    ),
    "order, drawing": in_drawing(lambda depth, occluder: np.where(occluder == 0, 1.0, depth)),
    "near and far, fast path": in_fast_path(lambda outlines, lens: (behind_is_before(outlines), lens)),
    "near and far, analytic": lambda m: wrap(m, Hiding, "of", lambda of, hidden, hiders: of(hiders, hidden)),
    "near and far, drawing": in_drawing(lambda depth, occluder: depth.max() + depth.min() - depth),
    "near and far, every ID buffer": farthest_wins,
    "corners, fast path": in_fast_path(shifted),
    "corners, analytic": in_analytic(shifted),
    "corners, fast path and analytic alike": lambda m: wrap(m, sight, "vessel_bodies", first_moved),
    "corners, drawing": lambda m: wrap(m, sight, "vessel_triangles", first_moved),
    "near plane, fast path": in_fast_path(plane_moved),
    "near plane, analytic": in_analytic(plane_moved),
    "near plane, fast path and analytic alike": lambda m: wrap(
        m, sight, "outline", lambda f, lens, *rest, **named: f(replace(lens, near_clip_m=NEAR_M), *rest, **named)
    ),
    "near plane, drawing": lambda m: wrap(m, Drawing, "of", near_plane_of_drawing),
}


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path, BOATS, 2)


def unexplained(monkeypatch, capsys, scene):
    """Exit status and the number of unexplained differences."""
    return call(monkeypatch, "check", "truth", scene, "--json"), json.loads(capsys.readouterr().out)["unexplained"]


def test_scene_of_the_mutants_has_nothing_unexplained(monkeypatch, capsys, scene):
    assert unexplained(monkeypatch, capsys, scene) == (0, 0)


@pytest.mark.parametrize("plant", MUTANTS.values(), ids=MUTANTS.keys())
def test_planted_error_is_found(monkeypatch, capsys, scene, plant):
    plant(monkeypatch)
    status, count = unexplained(monkeypatch, capsys, scene)
    assert status == 1 and count > 0
