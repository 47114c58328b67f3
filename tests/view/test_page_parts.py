"""Tables and charts of pages: what stands below each other, may be broken, stays inside its axes."""

import re

import numpy as np

from modsim3d.core import document as doc
from modsim3d.view import palette
from modsim3d.view.pages import charts, tables
from modsim3d.view.pages.charts import Axes, error_scatter, precision_recall, timeline
from modsim3d.view.pages.page import html_of
from modsim3d.view.pages.tables import aligned, table


def test_an_unknown_number_stands_where_the_numbers_of_its_column_do() -> None:
    table = tables.table([("a", "–", "–"), ("b", "2", "yes")], ("name", "count", "word"))
    assert '<th class="number">count</th>' in table and '<td class="number">–</td><td>–</td>' in table
    assert "<th>word</th>" in table and '<td class="number">2</td><td>yes</td>' in table


ALIGNED = [  # points and signs, both ends of intervals, units within, units, versions
    (["-0.5", "12.25", "3", "–"], ["−0.5\u2007", "12.25", "3\u2008\u2007\u2007", "–"]),
    (["0.5 [-1.0, 2.0]", "0.5 [1.0, 12.0]"], ["0.5 [−1.0, \u20072.0]", "0.5 \u2007[1.0, 12.0]"]),
    (["0.5° to 1.25°", "2° to 3.5°"], ["0.5° to 1.25°", "2°\u2008\u2007 to 3.5°\u2007"]),
    (["0.5 s", "2 s", "3 so"], ["0.5 s", "2 s\u2008\u2007", "3 so"]),
    (["2.4.6", "26.0"], ["2.4.6", "26.0"]),
]


def test_what_belongs_together_is_below_each_other_and_numbers_are_the_same_without_their_spaces() -> None:
    for cells, below_each_other in ALIGNED:
        assert aligned(cells) == below_each_other
    for cell in ("1. hota at least 0.5", "2. hota at least 0.6", "0.1.0", "2.4.6"):
        assert 'class="number"' not in tables.table([(cell,)], ("version",)), cell
    rows = [("a", "−1.5 [−2, 3]"), ("b", "100.25 [1, 20.5]")]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", tables.table(rows, ("name", "value [interval]")))
    assert [re.sub(r"<i.*?</i>|<.*?>", "", cell) for cell in cells] == [text for row in rows for text in row]


def test_a_column_without_a_name_has_the_names_of_the_rows_and_a_key_may_be_broken_and_is_the_same_text() -> None:
    assert "<td>0 to 5 m</td>" in tables.table([("0 to 5 m", "3")], ("", "runs"))
    name = "states.clear.confusion[background][boat]"
    table = tables.table([(name, "1")], ("parameter", "asked"))
    assert name not in table and name in table.replace("<wbr>", "")


def test_spaces_that_align_an_interval_belong_to_it_and_a_checksum_between_numbers_may_be_broken():
    header = ("", *(f"{number}" for number in range(9)))
    written = table([["a", "5.6 [4.5, 7.0]", *["1"] * 8], ["b", "43.9 [133.6, 57.3]", *["1"] * 8]], header)
    first = written.partition('data-label="0">')[2].partition("</td>")[0]
    assert first.startswith('5.6 <span class="whole"><i class="pad">') and first.endswith("7.0]</span>")
    checksum = "6c5565f7c7d53c2a0301052c9311c88904166820ee6fe3257c0885f4296d9476"
    written = table([["seed", "3"], ["steps", "60"], ["scene_sha256", checksum]], ("", "A"))
    assert '<td class="number broken">6c5565f7c7d53c2a<wbr>0301052c9311c889<wbr>' in written


def test_whatever_a_document_says_is_text_in_a_page_and_in_a_notebook() -> None:
    said, everywhere = '"><s>', doc.Where.EVERYWHERE
    mixed = [[doc.Cell(said, 0.5, bar=True), said, f"1.5 {said}", said], ["a", "b", "2.5", "c"]]
    for block, in_page, in_notebook in (
        (doc.Heading(said), 1, 0),
        (doc.Text(said, where=everywhere), 1, 1),
        (doc.Text(said, "code", everywhere), 1, 1),
        (doc.Text(said, "bad", everywhere), 1, 1),
        (doc.Items([said], everywhere), 1, 1),
        (doc.Tiles([(said, said, said)]), 3, 0),
        (doc.Figure(lambda: "", said), 1, 0),
        (doc.Fold(said, [doc.Text(said)]), 2, 0),
        (doc.Table(said, [said] * 4, mixed, notes={0: said}, about=said, where=everywhere), 19, 9),
        (doc.Table(said, (), [(said, said)], where=everywhere), 3, 3),
    ):
        for written, count in ((html_of(block), in_page), (doc.Document("", [], [block]).notebook(), in_notebook)):
            assert "<s>" not in written and written.count("&gt;&lt;s&gt;") == count, block


def lines(svg):
    """Points of each line of a drawing, shape (n, 2)."""
    texts = re.findall(r'<polyline points="([^"]*)"', svg)
    return [np.array([point.split(",") for point in text.split()], dtype=float) for text in texts]


def test_an_ellipse_stays_inside_the_axes():
    rng = np.random.default_rng(0)
    groups = {"many": rng.normal(0, 1, (5000, 2)), "few": rng.normal(0, 1, (40, 2)) * (6, 1)}
    svg = error_scatter(groups, ["red", "blue"], "e_x", "e_y")
    left, width = (float(re.search(rf'<rect[^>]* {name}="([\d.]+)"', svg)[1]) for name in ("x", "width"))
    ellipses = lines(svg)
    assert len(ellipses) == 2
    assert all(left < ellipse[:, 0].min() and ellipse[:, 0].max() < left + width for ellipse in ellipses)


def test_a_drawing_is_the_same_in_each_process(monkeypatch):
    monkeypatch.setattr(charts, "hash", None, raising=False)  # that of a text differs from process to process
    assert len({Axes((0, 1), (0, 1)).drawing("", "a title", "x", "y") for _ in range(2)}) == 1


def test_a_curve_is_drawn_where_it_moves_however_many_false_detections_follow():
    recall = np.concatenate([np.linspace(0.002, 0.8, 400), np.full(200_000, 0.8)])
    precision = np.concatenate([1 - 0.2 * np.linspace(0, 1, 400) ** 2, 320 / np.arange(400, 200_400)])
    (drawn,) = lines(precision_recall({"usual": (recall, precision)}, ["red"]))
    assert len(drawn) <= 802 and np.abs(np.diff(drawn, axis=0)).max() < 5  # of 374 by 252
    axes = Axes((0, 1), (0, 1.02))
    for end in (0, -1):
        np.testing.assert_allclose(drawn[end], axes.place(recall[end], precision[end]), atol=0.06)
    assert len(lines(precision_recall({"one point": (np.array([0.5]), np.array([1.0]))}, ["red"]))[0]) == 1


def test_states_have_the_ramp_of_the_palette_on_a_timeline():
    svg = timeline(np.array([0.0, 3.0]), np.array([3.0, 5.0]), [2, 0], ["excellent", "good", "bad"])
    drawn = re.findall(r'<rect[^>]*fill="color-mix\(in srgb, (#[0-9a-f]{6})', svg)
    first, _, last = map(palette.css, palette.state_colours(3))
    assert drawn == [last, first]
