"""Colours that everybody tells apart; tables and charts of pages."""

import re
from itertools import combinations, product

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from modsim3d.core import document as doc
from modsim3d.view import palette
from modsim3d.view.pages import charts, tables
from modsim3d.view.pages.charts import Axes, error_scatter, precision_recall, timeline
from modsim3d.view.pages.page import html_of
from modsim3d.view.pages.tables import aligned

CVD = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}
"""Of linear red, green and blue: Machado, Oliveira & Fernandes (2009), severity 1."""


def linear(colour: str | ArrayLike) -> NDArray[np.float64]:
    """Linear red, green and blue of a CSS colour `rgb(r, g, b)`, or of channels from 0 to 255; shape (3,)."""
    channels = re.findall(r"[\d.]+", colour)[:3] if isinstance(colour, str) else colour
    value = np.asarray(channels, dtype=np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(a: str | ArrayLike, b: str | ArrayLike, seen_with: str | None = None) -> float:
    """The contrast ratio of WCAG 2, 1 to 21, as someone with a colour-blindness of `CVD` sees it, or with none."""
    matrix = np.eye(3) if seen_with is None else np.array(CVD[seen_with])
    low, high = sorted(float(np.clip(matrix @ linear(each), 0, 1) @ [0.2126, 0.7152, 0.0722]) for each in (a, b))
    return (high + 0.05) / (low + 0.05)


SEEN_BY = {"everybody": np.eye(3), **{name: np.array(matrix) for name, matrix in CVD.items()}}
# Linear sRGB to XYZ and its white, IEC 61966-2-1.
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
JUST_NOTICEABLE = 2.3  # Mahy, Van Eycken & Oosterlinck (1994)


def lab(colour, seen):
    ratio = XYZ @ np.clip(seen @ linear(colour), 0, 1) / XYZ.sum(axis=1)
    root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


def least_distance(colours, seen):
    detected_label = [lab(colour, SEEN_BY[seen]) for colour in colours]
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(detected_label, 2))


@pytest.mark.parametrize("seen", SEEN_BY)
def test_vessels_alarm_and_truth_are_far_apart_and_everything_stands_out_from_the_sea(seen):
    assert least_distance([*palette.VESSELS, palette.OWN, palette.ALARM, palette.TRUTH], seen) > 7 * JUST_NOTICEABLE
    sea = lab(palette.SEA, SEEN_BY[seen])
    for colour in (*palette.VESSELS, palette.ALARM, palette.TRUTH, palette.SKY):
        assert np.linalg.norm(lab(colour, SEEN_BY[seen]) - sea) > 10 * JUST_NOTICEABLE
    assert not {palette.ALARM, palette.OWN} & {palette.vessel_colour(i, [3]) for i in range(60) if i != 3}
    assert palette.vessel_colour(3, [3]) == palette.OWN


def test_texts_are_readable_and_states_go_from_pale_to_strong_in_colours_of_their_own():
    """Contrast at least 3 : 1, as WCAG 2 asks for large text; lightness differs by more than 35."""
    np.testing.assert_allclose(lab((255, 255, 255), np.eye(3)), [100, 0, 0], atol=0.02)  # white is white in Lab
    for plate in [palette.vessel_colour(i) for i in range(18)] + [palette.ALARM, palette.TRUTH, palette.OWN]:
        assert abs(lab(plate, np.eye(3))[0] - lab(palette.ink_on(plate), np.eye(3))[0]) > 35, plate
    for states, seen in product((2, 3, 5), SEEN_BY):
        ramp = palette.state_colours(states)
        assert len(ramp) == states and least_distance(ramp, seen) > 4 * JUST_NOTICEABLE, (states, seen)
        lightness = [lab(colour, SEEN_BY[seen])[0] for colour in ramp]
        assert lightness == sorted(lightness, reverse=True), (states, seen)
    others = [palette.ALARM, palette.TRUTH, palette.SEA, palette.SKY, *palette.VESSELS]
    for state in palette.state_colours(5):
        assert all(np.linalg.norm(lab(state, np.eye(3)) - lab(other, np.eye(3))) > 10 for other in others), state
    assert palette.state_colours(1) == palette.state_colours(2)[:1]  # a detector with one state


ALIGNED = [  # points and signs, both ends of intervals, units within, units, versions
    (["-0.5", "12.25", "3", "–"], ["−0.5\u2007", "12.25", "3\u2008\u2007\u2007", "–"]),
    (["0.5 [-1.0, 2.0]", "0.5 [1.0, 12.0]"], ["0.5 [−1.0, \u20072.0]", "0.5 \u2007[1.0, 12.0]"]),
    (["2.1 [0.62, 3.7]", "9.16 [0.262, 0.595]"], ["2.1\u2007 [0.62,\u2007 3.7]\u2007\u2007", "9.16 [0.262, 0.595]"]),
    (["0.5° to 1.25°", "2° to 3.5°"], ["0.5° to 1.25°", "2°\u2008\u2007 to 3.5°\u2007"]),
    (["0.5 s", "2 s", "3 so"], ["0.5 s", "2 s\u2008\u2007", "3 so"]),
    (["2.4.6", "26.0"], ["2.4.6", "26.0"]),
]


def test_what_belongs_together_is_below_each_other_and_long_keys_and_checksums_may_be_broken():
    table = tables.table([("a", "–", "–"), ("b", "2", "yes")], ("name", "count", "word"))
    assert '<th class="number">count</th>' in table and '<td class="number">–</td><td>–</td>' in table
    assert "<th>word</th>" in table and '<td class="number">2</td><td>yes</td>' in table
    for cells, below_each_other in ALIGNED:
        assert aligned(cells) == below_each_other
    for cell in ("1. hota at least 0.5", "2. hota at least 0.6", "0.1.0", "2.4.6"):
        assert 'class="number"' not in tables.table([(cell,)], ("version",)), cell
    rows = [("a", "−1.5 [−2, 3]"), ("b", "100.25 [1, 20.5]")]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", tables.table(rows, ("name", "value [interval]")))
    assert [re.sub(r"<i.*?</i>|<.*?>", "", cell) for cell in cells] == [text for row in rows for text in row]
    assert "<td>0 to 5 m</td>" in tables.table([("0 to 5 m", "3")], ("", "runs"))
    name = "states.clear.confusion[background][boat]"
    table = tables.table([(name, "1")], ("parameter", "asked"))
    assert name not in table and name in table.replace("<wbr>", "")
    header = ("", *(f"{number}" for number in range(9)))
    written = tables.table([["a", "5.6 [4.5, 7.0]", *["1"] * 8], ["b", "43.9 [133.6, 57.3]", *["1"] * 8]], header)
    first = written.partition('data-label="0">')[2].partition("</td>")[0]
    assert first.startswith('5.6 <span class="whole"><i class="pad">') and first.endswith("7.0]</span>")
    checksum = "6c5565f7c7d53c2a0301052c9311c88904166820ee6fe3257c0885f4296d9476"
    written = tables.table([["seed", "3"], ["steps", "60"], ["scene_sha256", checksum]], ("", "A"))
    assert '<td class="number broken">6c5565f7c7d53c2a<wbr>0301052c9311c889<wbr>' in written


def test_whatever_a_document_says_is_text_in_a_page_and_in_a_notebook() -> None:
    said, everywhere = '"><s>', doc.Where.EVERYWHERE
    mixed = [[doc.Cell(said, 0.5, bar=True), said, f"1.5 {said}", said, "1"], ["a", "b", "2.5", "c", "1"]]
    for block, in_page, in_notebook in (
        (doc.Heading(said), 1, 0),
        (doc.Text(said, where=everywhere), 1, 1),
        (doc.Text(said, "code", everywhere), 1, 1),
        (doc.Text(said, "bad", everywhere), 1, 1),
        (doc.Items([said], everywhere), 1, 1),
        (doc.Tiles([(said, said, said)]), 3, 0),
        (doc.Figure(lambda: "", said), 1, 0),
        (doc.Fold(said, [doc.Text(said)]), 2, 0),
        (doc.Table(said, [said] * 5, mixed, notes={0: said}, about=said, where=everywhere), 22, 10),
        (doc.Table(said, (), [(said, said)], where=everywhere), 3, 3),
    ):
        for written, count in ((html_of(block), in_page), (doc.Document("", [], [block]).notebook(), in_notebook)):
            assert "<s>" not in written and written.count("&gt;&lt;s&gt;") == count, block


def lines(svg):
    """Points of each line of a drawing, shape (n, 2)."""
    texts = re.findall(r'<polyline points="([^"]*)"', svg)
    return [np.array([point.split(",") for point in text.split()], dtype=float) for text in texts]


def test_ellipses_stay_inside_curves_move_timelines_have_the_ramp_and_drawings_are_the_same(monkeypatch):
    rng = np.random.default_rng(0)
    groups = {"many": rng.normal(0, 1, (5000, 2)), "few": rng.normal(0, 1, (40, 2)) * (6, 1)}
    svg = error_scatter(groups, ["red", "blue"], "e_x", "e_y")
    left, width = (float(re.search(rf'<rect[^>]* {name}="([\d.]+)"', svg)[1]) for name in ("x", "width"))
    ellipses = lines(svg)
    assert len(ellipses) == 2
    assert all(left < ellipse[:, 0].min() and ellipse[:, 0].max() < left + width for ellipse in ellipses)
    recall = np.concatenate([np.linspace(0.002, 0.8, 400), np.full(200_000, 0.8)])
    precision = np.concatenate([1 - 0.2 * np.linspace(0, 1, 400) ** 2, 320 / np.arange(400, 200_400)])
    (drawn,) = lines(precision_recall({"usual": (recall, precision)}, ["red"]))
    assert len(drawn) <= 802 and np.abs(np.diff(drawn, axis=0)).max() < 5  # of 374 by 252
    axes = Axes((0, 1), (0, 1.02))
    for end in (0, -1):
        np.testing.assert_allclose(drawn[end], axes.place(recall[end], precision[end]), atol=0.06)
    assert len(lines(precision_recall({"one point": (np.array([0.5]), np.array([1.0]))}, ["red"]))[0]) == 1
    svg = timeline(np.array([0.0, 3.0]), np.array([3.0, 5.0]), [2, 0], ["excellent", "good", "bad"])
    drawn = re.findall(r'<rect[^>]*fill="color-mix\(in srgb, (#[0-9a-f]{6})', svg)
    first, _, last = map(palette.css, palette.state_colours(3))
    assert drawn == [last, first]
    monkeypatch.setattr(charts, "hash", None, raising=False)  # that of a text differs from process to process
    assert len({Axes((0, 1), (0, 1)).drawing("", "a title", "x", "y") for _ in range(2)}) == 1
