"""Documents: what is empty is shown nowhere, and each place shows what is for it."""

import io

from modsim3d.cli.terminal import open_console
from modsim3d.cli.terminal_tables import print_document
from modsim3d.core import document as blocks_of
from modsim3d.core.document import Cell, Document, Heading, Table, Text, Where, shown
from modsim3d.view.pages.page import document_page
from modsim3d.view.pages.provenance import Provenance

ROWS = [("sort", "0.5 [0.4, 0.6]"), ("other", "0.25 [0.1, 0.4]")]
DOCUMENT = Document(
    "Two <trackers>",
    [Text("Sort is best.", "lead", Where.EVERYWHERE)],
    [
        blocks_of.Tiles([("HOTA", "0.5", "of sort")]),
        Heading("Scores"),
        Table("", ("tracker", "HOTA"), ROWS, bad={1}, notes={1: "lost & never found"}, where=Where.EVERYWHERE),
        Heading("Curves"),
        blocks_of.Figure(lambda: "<svg></svg>", "A curve."),
        Heading("Nothing here"),
        Text(""),
        Heading("Cells"),
        blocks_of.Fold("pressed", [Table("", ("", "share"), [("a", Cell("30 %", 0.3))], where=Where.PAGE)]),
        blocks_of.Beside([blocks_of.Items(["only printed"], Where.TERMINAL)]),
    ],
)


def printed(document: Document) -> str:
    file = io.StringIO()
    print_document(open_console(file=file, width=80), document)
    return file.getvalue()


PRINTED = """
Scores
tracker             HOTA
sort      0.5 [0.4, 0.6]
other    0.25 [0.1, 0.4]
  other, 0.25 [0.1, 0.4]: lost & never found

Cells
  only printed

Sort is best.
"""


def test_page_terminal_and_notebook_have_what_is_for_them_and_no_heading_of_nothing():
    page = document_page(DOCUMENT, Provenance("a page", "a test", ()))
    for part in ("Two &lt;trackers&gt;", "<h2>Scores</h2>", "<h2>Curves</h2>", "<svg>", "lost &amp; never found",
                 "HOTA", "<summary>pressed</summary>", "30 %", "background: color-mix"):  # fmt: skip
        assert part in page
    assert "Nothing here" not in page and "only printed" not in page
    assert page.index("Sort is best.") < page.index("Scores")
    assert printed(DOCUMENT) == PRINTED  # the outcome last, and neither charts nor their headings
    html = DOCUMENT.notebook()
    assert html.startswith("<p>Sort is best.</p><table>") and html.count("<tr>") == 3
    assert "svg" not in html and "0.25 [0.1, 0.4]" in html


def test_a_heading_is_shown_only_with_something_before_the_next_of_its_level():
    blocks = [Heading("a"), Heading("b", 3), Text("x"), Heading("c", 3), Heading("d"), Heading("e", 3)]
    assert shown(blocks, Where.TERMINAL) == blocks[:3]


def test_a_column_of_drawings_alone_is_not_printed_and_rows_without_names_of_columns_are():
    drawn = Table("drawn", ("a", "axis", "b"), [("1", Cell("", draw=lambda: "<svg></svg>"), "2")])
    said = printed(Document("", [], [drawn, Table("named", (), [("name", "value")])]))
    assert said.split() == ["drawn", "a", "b", "1", "2", "named", "name", "value"]
