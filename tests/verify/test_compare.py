"""`modsim3d check truth`: what it finds, writes and says; and that it finds errors that are planted for it."""

import json
import re
import sys
from contextlib import nullcontext, redirect_stdout
from dataclasses import replace
from functools import cached_property
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.campaigns import compare as campaign
from modsim3d.render.id_pass import IdRenderer
from modsim3d.scene import sight
from modsim3d.truth import analytic, occlusion_order, rendered
from modsim3d.truth.analytic import Hiders
from modsim3d.truth.crosscheck.drawing import Drawing
from modsim3d.truth.occlusion import HiddenPixels
from modsim3d.verify.sources import agreement, compare
from modsim3d.verify.sources.agreement import EXPLANATIONS, Agreement
from tests.command_line import call
from tests.scenes import crossing, write_scene

ROOT = Path(__file__).resolve().parents[2]


def figures_of(monkeypatch, folder, *arguments):
    """Exit status and compare.json of a comparison."""
    status = call(monkeypatch, "check", "truth", *arguments, "--out", folder)
    return status, json.loads((folder / "compare.json").read_text())


@pytest.fixture
def scene(tmp_path):
    return crossing(tmp_path)


@pytest.fixture(autouse=True)
def one_picture(monkeypatch):
    monkeypatch.setattr(compare, "WORST", 1)  # drawing them is most of the time


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A comparison of the whole scene with three pictures: exit status, compare.json, the page, and what is printed."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as monkeypatch, redirect_stdout(StringIO()) as said:
        monkeypatch.setattr(compare, "WORST", 3)
        status, figures = figures_of(monkeypatch, folder / "out", crossing(folder))
    page = (folder / "out" / "compare.html").read_text(encoding="utf-8")
    return SimpleNamespace(status=status, figures=figures, page=page, said=re.sub(r"\s+", " ", said.getvalue()))


def test_every_difference_in_a_scene_is_explained_and_page_and_terminal_say_what_the_file_says(whole):
    found, said, page = whole.figures, whole.said, whole.page
    assert f"vessel-frames compared {found['vessel_frames']} in {found['frames']} frames" in said
    assert f"wrong in total {100 * found['rectangles_against_rendered']['wrong_share']:.1f} %" in said
    assert "UNEXPLAINED 0" in said and "compare.json" in said
    assert not re.search(r"https?://|\bsrc=\"(?!data:)|\bhref=(?!\"#)|<script|<link|@import|url\(", page)
    pictures = re.findall(r'<img src="data:image/png;base64,([A-Za-z0-9+/=]+)"', page)
    assert len(pictures) == page.count("<img") == 3 + 1  # and the rule's worst mistake
    assert all(picture.startswith("iVBORw0KGgo") and len(picture) > 2000 for picture in pictures)
    for word in ("Rendered against drawn and analytic", "rectangle rule", "UNEXPLAINED"):
        assert word in page
    assert " ms" not in page and "Time per frame" not in page  # the same input gives the same bytes
    found = whole.figures
    assert whole.status == 0 and found["unexplained"] == 0 and found["steps"] == found["frames"] == 12
    # The ship is there for eleven of the twelve steps and in the image for some of them.
    assert 24 < found["vessel_frames"] < 36 and 4 <= found["occluded"] < 24
    for kind in ("full_box", "visible_box"):
        assert sum(found[kind]["verdicts"].values()) == found["vessel_frames"]
        assert 0 < found[kind]["side_p99_px"] <= found[kind]["side_max_px"] < 1
    assert list(found["full_box"]["verdicts"]) == list(EXPLANATIONS.values())
    assert 0 < found["visible_fraction"]["largest_share_of_bound"] <= 1
    assert found["visible_fraction"]["above_bound"] == 0 and found["intersecting"] == {}
    assert set(found["ms_per_frame"]) == {"rendered", "analytic", "rectangles"}
    assert all(milliseconds > 0 for milliseconds in found["ms_per_frame"].values())
    drawn = found["drawn"]
    assert drawn["vessels"] == drawn["from_spans"] + drawn["from_buffers"] == found["vessel_frames"]
    assert drawn["frames"] == 12 and drawn["pixels"] > 100 * found["vessel_frames"]
    assert drawn["tie_pixels"] == found["differs_from_drawn"] == found["missing"] == 0
    rule = found["rectangles_against_rendered"]
    assert rule["occluded"] == found["occluded"]
    wrong = rule["box_off_by_more_than_2_px"] + rule["hidden_vessel_kept"] + rule["visible_vessel_dropped"]
    assert rule["wrong_share"] == wrong / rule["occluded"]
    assert wrong > 0  # the ship lies askew: its box hides more of the sail than it does itself


@pytest.mark.parametrize(
    ("options", "steps"), [(["--every", 5], 3), (["--steps", 4], 4), (["--steps", 7, "--every", 3], 3), ([], 12)]
)
def test_every_and_steps_choose_what_is_looked_at(monkeypatch, tmp_path, scene, options, steps):
    looked_at = []
    compare_frames = compare._compare_frames

    def watched(*arguments):
        looked_at.extend(arguments[-1])
        return compare_frames(*arguments)

    monkeypatch.setattr(compare, "_compare_frames", watched)
    _, found = figures_of(monkeypatch, tmp_path / "out", scene, *options)
    assert found["steps"] == steps
    named = dict(zip(options[::2], options[1::2], strict=True))
    assert looked_at == list(range(0, named.get("--steps", 12), named.get("--every", 1)))


def test_blocks_of_steps_change_nothing_and_supersampling_brings_boxes_nearer(monkeypatch, tmp_path, scene, whole):
    monkeypatch.setattr(compare, "BLOCK_STEPS", 5)
    parts = figures_of(monkeypatch, tmp_path / "b", scene)[1]
    own = {key: whole.figures[key] for key in ("ms_per_frame", "scene")}  # a scene has the name of its folder
    assert parts.keys() == whole.figures.keys() and parts | own == whole.figures
    status, fine = figures_of(monkeypatch, tmp_path / "f", scene, "--set", "annotation.supersample=4")
    assert (status, fine["supersample"]) == (0, 4) and fine["full_box"]["side_max_px"] <= 0.25
    assert fine["full_box"]["side_max_px"] < 0.5 * whole.figures["full_box"]["side_max_px"]


def seen_partly(seen):
    """A row that is seen in part, and another that is seen whole."""
    fraction = seen.visible_fraction()
    partly, whole = np.flatnonzero((fraction > 0.1) & (fraction < 0.9)), np.flatnonzero(fraction == 1)
    return partly[0], whole[0]


def swapped_counts(seen):
    rows = list(seen_partly(seen))
    visible = seen.visible_px.copy()
    visible[rows] = visible[rows[::-1]]
    return replace(seen, visible_px=visible)


def shifted(name, by_px):
    def plant(seen):
        boxes = getattr(seen, name).copy()
        boxes[seen_partly(seen)[0]] += by_px
        return replace(seen, **{name: boxes})

    return plant


def nobody_hides(seen):
    none = np.empty(0, dtype=np.int64)
    hidden = HiddenPixels(none, none, none.astype(float))
    return replace(seen, visible_px=seen.silhouette_px, visible_boxes_px=seen.full_boxes_px, hidden=hidden)


def hidden_one_is_seen(seen):
    row = np.flatnonzero(seen.visible_px == 0)[0]
    visible, boxes = seen.visible_px.copy(), seen.visible_boxes_px.copy()
    visible[row], boxes[row] = 3, seen.full_boxes_px[row]
    return replace(seen, visible_px=visible, visible_boxes_px=boxes)


def silhouette_counted_twice(seen):
    return replace(seen, silhouette_px=seen.silhouette_px * np.where(np.arange(len(seen.visible_px)) == 0, 2, 1))


def counts_times(factor):
    """Both counts wrong alike: the fraction stays."""
    return lambda seen: replace(seen, silhouette_px=factor * seen.silhouette_px, visible_px=factor * seen.visible_px)


PLANTED = {
    "counts of two vessels swapped": swapped_counts,
    "full box 3 px to the right": shifted("full_boxes_px", [3, 0, 3, 0]),
    "visible box 3 px too high": shifted("visible_boxes_px", [0, -3, 0, -3]),
    "visible box 3 px too wide": shifted("visible_boxes_px", [0, 0, 3, 0]),
    "nobody hides anybody": nobody_hides,
    "a hidden vessel is seen": hidden_one_is_seen,
    "a silhouette counted twice": silhouette_counted_twice,
    "every count doubled": counts_times(2.0),
    "every count halved": counts_times(0.5),
}


@pytest.mark.parametrize("plant", PLANTED.values(), ids=PLANTED.keys())
def test_planted_error_in_what_was_counted_is_unexplained(monkeypatch, tmp_path, scene, plant):
    """The pixels, drawn again, are right: that explains nothing if the truth does not come from them."""
    occlusion = rendered.rendered_occlusion
    monkeypatch.setattr(compare, "rendered_occlusion", lambda *arguments: plant(occlusion(*arguments)))
    status, found = figures_of(monkeypatch, tmp_path / "out", scene)
    assert status == 1 and found["unexplained"] >= 1
    word = EXPLANATIONS[Agreement.UNEXPLAINED]
    assert found["unexplained"] == sum(found[kind]["verdicts"][word] for kind in ("full_box", "visible_box"))
    page = (tmp_path / "out" / "compare.html").read_text(encoding="utf-8")
    assert "are unexplained" in page and "Unexplained: " in page  # the latter begins what is said of the pictures


def behind_is_before(outlines):
    """The same outlines in the image with 1 / c3 turned about, which is what a reversed depth test draws."""
    (part,) = outlines.parts
    depth = part.vertices_camera[..., 2]
    turned = 1 / (1 / depth.min() + 1 / depth.max() - 1 / depth)
    return replace(outlines, parts=(replace(part, vertices_camera=part.vertices_camera * (turned / depth)[..., None]),))


def test_intersecting_boxes_are_named_and_a_campaign_writes_the_same_bytes_again(monkeypatch, tmp_path, capsys):
    boats = {
        "rafted1": ([12, 4, 3], [[0, 100, -5], [10, 100, 5]]),
        "rafted2": ([12, 4, 5], [[0, 101, -5], [10, 101, 5]]),
        "alone": ([12, 4, 5], [[0, 200, 5], [10, 200, 4]]),
    }
    status, found = figures_of(monkeypatch, tmp_path / "out", write_scene(tmp_path, boats, 4))
    assert status == 0 and found["unexplained"] == 0 and found["intersecting"] == {"rafted1 and rafted2": 4}
    assert found["visible_box"]["verdicts"][EXPLANATIONS[Agreement.INTERSECTING]] == 8
    assert found["visible_at_all_differs"] == 0 and "rafted1 and rafted2" in capsys.readouterr().out
    assert "rafted1 and rafted2" in (tmp_path / "out" / "compare.html").read_text(encoding="utf-8")
    in_this_process = nullcontext(SimpleNamespace(map=map))
    for name, pool in (("a", campaign.ProcessPoolExecutor), ("b", lambda *_: in_this_process)):
        line = ["compare.py", "--scenes", "2", "--processes", "1", "--out", str(tmp_path / name)]
        monkeypatch.setattr(sys, "argv", line)
        monkeypatch.setattr(campaign, "ProcessPoolExecutor", pool)
        assert campaign.main() == 0
    for file in ("compare.json", "compare.md"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    found = json.loads((tmp_path / "a" / "compare.json").read_text())["supersample"]
    assert {factor: column["scenes"] for factor, column in found.items()} == {"1": 2, "4": 2}
    assert all(sum(column["full"].values()) == column["vessel_frames"] > 0 for column in found.values())


def test_scene_that_is_wrong_or_not_there_is_exit_status_two(monkeypatch, tmp_path, scene, capsys):
    assert call(monkeypatch, "check", "truth", "no_such_scene") == 2 and "no_such_scene" in capsys.readouterr().err
    data = json.loads(scene.read_text())
    data["annotation"]["mode"] = 7
    scene.write_text(json.dumps(data))
    assert call(monkeypatch, "check", "truth", scene, "--out", tmp_path / "out") == 2
    assert "annotation.mode" in capsys.readouterr().err and not (tmp_path / "out").exists()
    assert call(monkeypatch, "check", "truth", scene, "--every", 0) == 2
    # Nothing is written unasked either.
    scene = crossing(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert call(monkeypatch, "check", "truth", scene, "--steps", 2) == 0 and sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("seed", range(30))
def test_rafts_are_rendered_as_they_are_drawn(renderer, seed):
    """A sample of the campaign's ten thousand."""
    tally = campaign.compare_scene(seed, 0, renderer)
    assert tally.unexplained == [] and tally.differs_from_drawn == 0
    assert tally.drawn.vessels == tally.vessel_frames and tally.drawn.tie_pixels < 20


def test_committed_campaign_is_that_of_two_thousand_scenes_and_ten_thousand_rafts_without_anything_unexplained():
    figures = json.loads((ROOT / "docs" / "campaigns" / "compare.json").read_text())
    found = figures["supersample"] | {"rafts": figures["rafts"]}
    assert [column["scenes"] for column in found.values()] == [2000, 300, 10_000]
    for factor, column in found.items():
        assert column["unexplained"] == [] and column["differs_from_drawn"] == 0
        assert column["drawn"]["vessels"] == column["vessel_frames"]
        assert column["drawn"]["tie_pixels"] < 1e-6 * column["drawn"]["pixels"]
        assert column["largest_agreed_full_side_px"] <= {"1": 1.0, "4": 0.3, "rafts": 1.0}[factor]


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


def first_shifted(outlines, lens):
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
    "near and far, analytic": lambda m: wrap(m, Hiders, "of", lambda of, hidden, hiders: of(hiders, hidden)),
    "near and far, drawing": in_drawing(lambda depth, occluder: depth.max() + depth.min() - depth),
    "near and far, every ID buffer": farthest_wins,
    "corners, fast path": in_fast_path(first_shifted),
    "corners, analytic": in_analytic(first_shifted),
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
def two_boats(tmp_path):
    return write_scene(tmp_path, BOATS, 2)


def unexplained(monkeypatch, capsys, two_boats):
    """Exit status and the number of unexplained differences."""
    return call(monkeypatch, "check", "truth", two_boats, "--json"), json.loads(capsys.readouterr().out)["unexplained"]


def test_scene_of_the_mutants_has_nothing_unexplained(monkeypatch, capsys, two_boats):
    assert unexplained(monkeypatch, capsys, two_boats) == (0, 0)


@pytest.mark.parametrize("plant", MUTANTS.values(), ids=MUTANTS.keys())
def test_planted_error_is_found(monkeypatch, capsys, two_boats, plant):
    plant(monkeypatch)
    status, count = unexplained(monkeypatch, capsys, two_boats)
    assert status == 1 and count > 0
