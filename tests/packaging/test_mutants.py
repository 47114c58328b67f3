"""The changes that the mutants campaign makes are what they say, and tests that check a line notice them."""

import ast
import functools
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.mutants.mutations import mutants_of, mutated
from benchmarks.mutants.processes import KILLED, SURVIVED, TIMED_OUT, in_a_process
from benchmarks.mutants.reach import Reach

SOURCE = '''
"""A module."""
from x import y

LIMIT = 4


class Box:
    side: int = 2

    def wide(self, other, *, near=0.5) -> bool:
        """Whether it is wide."""
        if not self.side and other:
            raise ValueError(f"{self.side} is not above {0}")
        return self.side - other < LIMIT


def first(values):
    def lowest():
        return min(values, key=abs)

    values[0] = -lowest()
    return values[:LIMIT]
'''


def test_each_mutant_changes_the_code_once_and_says_where():
    found = mutants_of(SOURCE)
    texts = [ast.unparse(mutated(SOURCE, mutant.index)) for mutant in found]
    original = ast.unparse(ast.parse(SOURCE)).splitlines()
    for mutant, text in zip(found, texts, strict=True):
        lines = text.splitlines()
        (changed,) = [number for number, line in enumerate(lines) if line != original[number]] or [None]
        assert changed is not None, mutant.change
        assert len(lines) == len(original)
    assert len(set(texts)) == len(texts)
    assert Counter(mutant.function for mutant in found) == {"": 3, "Box.wide": 7, "first": 8}


def test_messages_annotations_and_docstrings_are_left_alone():
    changes = " ".join(mutant.change for mutant in mutants_of(SOURCE))
    assert "A module" not in changes
    assert "{1}" not in changes  # but that the error is raised at all is looked at
    assert "raise ValueError(f'{self.side} is not above {0}') → pass" in changes
    assert "bool" not in changes


@pytest.mark.parametrize(
    ("code", "changes"),
    [
        ("a < b", ["a < b → a <= b"]),
        ("a + b.T", ["a + b.T → a - b.T", "a + b.T → a + b"]),
        ("a and -b", ["a and -b → a or -b", "a and -b → a and b"]),
        ("np.floor(a)", ["np.floor(a) → np.ceil(a)"]),
        ("a[1:b]", ["a[1:b] → a[2:b]", "a[1:b] → a[1:]"]),
        ("f(a, axis=1)", ["f(a, axis=1) → f(a)", "f(a, axis=1) → f(a, axis=2)"]),
        ("0.25", ["0.25 → 0.5"]),
    ],
)
def test_expression_has_these_mutants(code, changes):
    assert [mutant.change for mutant in mutants_of(f"assert {code}")] == changes


def _loop() -> bool:
    while True:
        pass


def test_process_survives_is_killed_or_times_out():
    assert in_a_process(lambda: True, 10) == SURVIVED
    assert in_a_process(lambda: False, 10) == KILLED
    assert in_a_process(functools.partial(int, "no number"), 10) == KILLED
    assert in_a_process(_loop, 1) == TIMED_OUT


def test_quickest_tests_that_reach_a_line_come_first_within_the_budget():
    reach = Reach({"slow": 5.0, "quick": 1.0, "other": 0.1}, {"a.py": {3: {"slow", "quick"}, 4: {"other"}}}, {})
    assert reach.of_lines("a.py", (2, 3)) == {"slow", "quick"}
    assert reach.quickest({"slow", "quick"}, 3.0) == ["quick"]
    assert reach.quickest({"slow", "quick"}, 6.0) == ["quick", "slow"]
    assert reach.quickest({"slow"}, 3.0) == ["slow"]
    assert reach.of_file("a.py") == {"slow", "quick", "other"}


def test_fixture_that_tests_share_is_paid_for_once():
    shared = {name: {"renderer": 1.0} for name in "abc"}
    reach = Reach({"a": 0.1, "b": 0.2, "c": 0.3}, {}, shared)
    assert reach.quickest(set("abc"), 1.35) == ["a", "b"]
    assert reach.quickest(set("abc"), 1.7) == ["a", "b", "c"] and reach.alone_s("c") == 1.3


def test_reach_is_read_back_as_it_was_written(tmp_path: Path):
    reach = Reach({"test": 1.0}, {"a.py": {3: {"test"}}}, {"test": {"fixture": 2.0}})
    reach.save(tmp_path / "reach.json")
    assert Reach.load(tmp_path / "reach.json") == reach
