import ast
import io
import itertools
import tracemalloc
from collections import defaultdict
from enum import Enum, unique
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import modsim3d
from modsim3d.cli.terminal import open_console
from modsim3d.cli.terminal_tables import print_document
from modsim3d.core import document as blocks_of
from modsim3d.core import random_streams
from modsim3d.core.arrays import distinct, occurring, run_starts
from modsim3d.core.document import Cell, Document, Heading, Table, Text, Where, blocks_at
from modsim3d.core.random_streams import Purpose, Streams, normals
from modsim3d.view.pages.page import document_page
from modsim3d.view.pages.provenance import Provenance

UNIFORM = [purpose for purpose in Purpose if purpose.width is not None]


def test_every_purpose_is_used_in_exactly_one_module_and_shares_no_text():
    package, modules = Path(modsim3d.__file__).parent, defaultdict(set)
    for path in package.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "Purpose" in text else ():  # to parse the others takes seconds
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Purpose":
                modules[Purpose[node.attr]].add(path.relative_to(package).as_posix())
    modules[Purpose.PLUGIN].add("a plug-in's")
    assert {purpose.name: sorted(modules[purpose]) for purpose in Purpose if len(modules[purpose]) != 1} == {}
    texts = [purpose.value for purpose in Purpose]
    assert len(set(texts)) == len(texts) == len(Purpose.__members__)
    with pytest.raises(ValueError, match="duplicate"):

        @unique
        class Twice(Enum):
            __new__ = Purpose.__new_member__
            ONE = "text", 1, "this"
            TWO = "text", 2, "that"

    assert all(purpose.meaning and purpose.meaning != purpose.value for purpose in Purpose)
    assert len({purpose.meaning for purpose in Purpose}) == len(Purpose)


def test_a_purpose_has_one_width_and_a_seed_is_not_negative() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        Streams(-1)
    assert Streams(3).uniforms(Purpose.BOX_ERROR, "C0", "a", first=0, count=1).shape == (1, 4)
    with pytest.raises(ValueError, match="AGENTS has a generator for each step and no uniform numbers"):
        Streams(3).uniforms(Purpose.AGENTS, first=0, count=1)
    with pytest.raises(ValueError, match="BOX_ERROR has 4 uniform numbers a step and no generator"):
        Streams(3).generator(Purpose.BOX_ERROR, "C0", "a", step=0)
    one = np.zeros(1, int)
    with pytest.raises(ValueError, match="BOX_ERROR has 4 uniform numbers a step and no generator"):
        Streams(3).generated(Purpose.BOX_ERROR, owners=("a",), owner=one, steps=one, first=0, count=1)


@given(st.lists(st.integers(0, 60), max_size=6), st.sampled_from(UNIFORM), st.integers(0, 2**40))
def test_a_step_has_the_same_numbers_in_parts_and_among_others(borders: list[int], purpose, first: int) -> None:
    whole = Streams(3).uniforms(purpose, "C0", first=first, count=60)
    streams, parts = Streams(3), []
    for a, b in itertools.pairwise([0, *sorted(borders), 60]):
        streams.uniforms(purpose, "b", first=0, count=3)
        streams.generator(Purpose.AGENTS, "C0", step=0).random(7)
        parts.append(streams.uniforms(purpose, "C0", first=first + a, count=b - a))
    assert np.array_equal(np.concatenate(parts), whole)


def test_a_row_starts_at_its_steps_blocks_of_philox_and_no_rows_or_steps_give_no_numbers():
    streams = Streams(3)
    numbers = streams.uniforms(Purpose.TRANSIENT, "C0", first=7, count=2)
    key = streams._key(0, Purpose.TRANSIENT, ("C0",))
    slow = [np.random.Generator(np.random.Philox(key=key, counter=2 * step)).random(5) for step in (7, 8)]
    assert np.array_equal(numbers, slow)
    nothing, no_words = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint64)
    assert Streams(3).uniforms_of(Purpose.CLASS, owners=["a"], owner=nothing, steps=nothing).shape == (0, 1)
    assert Streams(1).uniforms(Purpose.WAVE_ANGLES, first=5, count=0).shape == (0, 3)
    assert random_streams.uniforms(no_words.reshape(0, 2), no_words, no_words, 3, 5).shape == (0, 5)


def test_another_seed_purpose_or_name_gives_other_numbers_and_generators_are_repeatable():
    ours = Streams(3).uniforms(Purpose.CLASS, "a", "b", first=0, count=100)
    others = [(4, Purpose.CLASS, ("a", "b")), (3, Purpose.CLASS_KEPT, ("a", "b"))]
    others += [(3, Purpose.CLASS, names) for names in (("a",), ("b", "a"), ("ab",), ("a", "b", ""))]
    for seed, purpose, names in others:
        theirs = Streams(seed).uniforms(purpose, *names, first=0, count=100)
        assert not np.intersect1d(ours, theirs).size, (seed, purpose, names)
    streams = Streams(3)
    draws = [streams.generator(Purpose.AGENTS, "a", step=step).random(1000) for step in range(5)]
    assert len(np.unique(np.concatenate(draws))) == 5000
    one, two = streams.generator(Purpose.AGENTS, "a", step=1), streams.generator(Purpose.AGENTS, "a", step=1)
    two.random(5)
    assert np.array_equal(one.random(3), Streams(3).generator(Purpose.AGENTS, "a", step=1).random(3))


@pytest.mark.parametrize(
    ("owners", "span", "at_once"),
    [(1, 7, False), (3, 9, False), (3, 50_000, True), (200, 2, True)],
    ids=["one", "few", "few far apart", "many"],
)
@pytest.mark.parametrize("purpose", [Purpose.CLASS, Purpose.TRANSIENT], ids=["a block a step", "two blocks a step"])
def test_numbers_of_many_streams_are_those_of_each(owners: int, span: int, at_once, purpose, monkeypatch) -> None:
    random, names = np.random.default_rng(owners), [f"vessel{index}" for index in range(owners)]
    owner, steps = random.integers(0, owners, 2 * owners + 5), 2**40 + random.integers(0, span, 2 * owners + 5)
    vectorised = Mock(wraps=random_streams.uniforms)
    monkeypatch.setattr(random_streams, "uniforms", vectorised)
    ours = Streams(3).uniforms_of(purpose, "C0", owners=names, owner=owner, steps=steps)
    assert vectorised.called == at_once
    rows = zip(owner.tolist(), steps.tolist(), strict=True)
    each = [Streams(3).uniforms(purpose, "C0", names[index], first=step, count=1)[0] for index, step in rows]
    assert np.array_equal(ours, each)


def test_few_numbers_are_drawn_beside_those_of_short_tracks_and_those_of_one_step_in_turn(monkeypatch):
    tracks, frames, long = 150, 2_000, 130
    random, names = np.random.default_rng(3), [f"vessel{index}" for index in range(tracks)]
    owner = np.repeat(np.arange(tracks), long)
    steps = (random.integers(0, frames - long, tracks)[:, None] + np.arange(long)).ravel()
    tracemalloc.start()
    numbers = Streams(3).uniforms_of(Purpose.BOX_ERROR, "C0", owners=names, owner=owner, steps=steps)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10 * numbers.nbytes
    # As those of the few vessels of a live step: for so few numbers many at once take ten times as long.
    monkeypatch.setattr(random_streams, "uniforms", Mock(side_effect=AssertionError))
    names = [f"vessel{index}" for index in range(9)]
    for owner in (np.arange(9), np.array([4])):
        steps = np.full(len(owner), 2**40)
        assert len(Streams(3).uniforms_of(Purpose.CLASS, owners=names, owner=owner, steps=steps)) == len(owner)


@pytest.mark.parametrize("times", [1, 9], ids=["mostly in turn", "mostly at once"])
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2**40)), max_size=6), st.integers(0, 9), st.integers(0, 9))
def test_numbers_of_many_generators_are_those_of_each(times: int, some, first: int, count: int) -> None:
    streams, owners, purpose = Streams(3), ("a", "b", "c"), Purpose.BOX_ERROR_REDRAW
    rows = some * times
    owner, steps = np.array(rows, dtype=np.int64).reshape(-1, 2).T
    ours = streams.generated(purpose, "C0", owners=owners, owner=owner, steps=steps, first=first, count=count)
    each = [streams.generator(purpose, "C0", owners[index], step=step).random(first + count) for index, step in rows]
    assert np.array_equal(ours, np.reshape(each, (len(rows), first + count))[:, first:])


def test_numbers_are_the_same_in_every_process_and_normals_are_finite() -> None:
    numbers = Streams(2023).uniforms(Purpose.CONFIDENCE, "C0", "vessel1", first=12, count=1)
    assert numbers.tolist() == [[0.18153337862538155, 0.694646420313789]]
    generator = Streams(2023).generator(Purpose.BOX_ERROR_REDRAW, "C0", "vessel1", step=12)
    assert generator.random(2).tolist() == [0.10250895715086494, 0.07279324687871547]
    assert normals(np.array([0.0, 0.5])).tolist() == pytest.approx([-8.2924, 0.0], abs=1e-4)


WORD, HALF_WORD = st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1)
COUNTER, NUMBER = st.integers(0, 2**62), st.integers(0, 30)
SPAWN_KEYS = st.integers(1, 9).flatmap(lambda width: st.lists(st.tuples(*[HALF_WORD] * width), min_size=1, max_size=4))


def generator(key: tuple[int, int], low: int, high: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array(key, dtype=np.uint64), counter=low + (high << 192)))


@given(st.lists(st.tuples(st.tuples(WORD, WORD), st.tuples(WORD, WORD, WORD, WORD)), min_size=1, max_size=9))
def test_blocks_are_those_of_numpy(drawn: list[tuple[tuple[int, int], tuple[int, int, int, int]]]) -> None:
    keys, counters = (np.array(part, dtype=np.uint64) for part in zip(*drawn, strict=True))
    blocks = random_streams.philox(keys.T, counters.T)
    for (key, words), block in zip(drawn, blocks.T, strict=True):
        before = (sum(word << (64 * place) for place, word in enumerate(words)) - 1) % 2**256
        numpys = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=before)
        assert block.tolist() == numpys.random_raw(4).tolist()


@given(st.lists(st.tuples(st.tuples(WORD, WORD), COUNTER, COUNTER), min_size=1, max_size=5), NUMBER, NUMBER)
def test_numbers_are_those_of_numpy(drawn: list[tuple[tuple[int, int], int, int]], first: int, count: int) -> None:
    keys, low, high = (np.array(part, dtype=np.uint64) for part in zip(*drawn, strict=True))
    numpys = [generator(*each).random(first + count)[first:] for each in drawn]
    assert np.array_equal(random_streams.uniforms(keys, low, high, first, count), numpys)


@given(st.integers(0, 2**200), SPAWN_KEYS)
def test_seeded_keys_are_those_of_numpy(seed: int, spawn_keys: list[tuple[int, ...]]) -> None:
    ours = random_streams.seeded_keys(seed, np.array(spawn_keys, dtype=np.uint32).T)
    numpys = [np.random.SeedSequence(seed, spawn_key=key).generate_state(2, np.uint64) for key in spawn_keys]
    np.testing.assert_array_equal(ours, numpys)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_starts_of_runs_distinct_values_and_indices_that_occur_are_those_of_plain_python(count: int) -> None:
    rng = np.random.default_rng(count)
    (one, other), values, indices = (rng.integers(0, *shape) for shape in ((2, (2, count)), (9, count), (60, count)))
    rows = list(zip(one.tolist(), other.tolist(), strict=True))
    assert run_starts(one, other).tolist() == [i for i in range(count) if i == 0 or rows[i] != rows[i - 1]]
    assert distinct(values).tolist() == sorted(set(values.tolist()))
    occur = sorted(set(indices.tolist()))
    assert [each.tolist() for each in occurring(indices, 60)] == [occur, [occur.index(i) for i in indices.tolist()]]


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
        blocks_of.BlockRow([blocks_of.Items(["only printed"], Where.TERMINAL)]),
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


def test_pages_terminals_and_notebooks_have_what_is_for_them_and_no_heading_of_nothing():
    page = document_page(DOCUMENT, Provenance("a page", "a test", ()))
    for part in ("Two &lt;trackers&gt;", ">Scores</h2>", ">Curves</h2>", "<svg>", "lost &amp; never found",
                 "HOTA", "<summary>pressed</summary>", "30\u00a0%", "background: color-mix"):  # fmt: skip
        assert part in page
    assert "Nothing here" not in page and "only printed" not in page
    assert page.index("Sort is best.") < page.index("Scores")
    assert printed(DOCUMENT) == PRINTED  # the outcome last, and neither charts nor their headings
    html = DOCUMENT.notebook()
    assert html.startswith("<p>Sort is best.</p><table>") and html.count("<tr>") == 3
    assert "svg" not in html and "0.25 [0.1, 0.4]" in html
    blocks = [Heading("a"), Heading("b", 3), Text("x"), Heading("c", 3), Heading("d"), Heading("e", 3)]
    assert blocks_at(blocks, Where.TERMINAL) == blocks[:3]
    drawn = Table("drawn", ("a", "axis", "b"), [("1", Cell("", draw=lambda: "<svg></svg>"), "2")])
    said = printed(Document("", [], [drawn, Table("named", (), [("name", "value")])]))
    assert said.split() == ["drawn", "a", "b", "1", "2", "named", "name", "value"]
