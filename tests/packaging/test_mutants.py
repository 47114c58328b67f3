"""The changes that the mutants campaign makes are what they say, and tests that check a line notice them."""

import ast
import functools
import gc
from collections import Counter
from pathlib import Path

from benchmarks.mutants.mutations import mutants_of, mutated
from benchmarks.mutants.processes import KILLED, SURVIVED, TIMED_OUT, caches_of_all, in_a_process
from benchmarks.mutants.reach import Reach
from benchmarks.mutants.trials import functions_of
from modsim3d.world.traffic.tracks import shipped_kinds

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


def test_each_mutant_changes_the_code_once_and_says_where_and_leaves_messages_and_annotations_alone():
    found, original = mutants_of(SOURCE), ast.unparse(ast.parse(SOURCE)).splitlines()
    texts = [ast.unparse(mutated(SOURCE, mutant.index)) for mutant in found]
    for mutant, text in zip(found, texts, strict=True):
        assert sum(line != before for line, before in zip(text.splitlines(), original, strict=True)) == 1, mutant.change
    assert len(set(texts)) == len(texts)
    assert Counter(mutant.function for mutant in found) == {"": 3, "Box.wide": 7, "first": 8}
    changes = " ".join(mutant.change for mutant in found)
    # Neither docstring, annotation nor message; but that the error is raised at all is looked at.
    assert not any(text in changes for text in ("A module", "bool", "{1}"))
    assert "raise ValueError(f'{self.side} is not above {0}') → pass" in changes


def test_expressions_have_these_mutants():
    for code, changed in {
        "a < b": ["a <= b"],
        "a + b.T": ["a - b.T", "a + b"],
        "a and -b": ["a or -b", "a and b"],
        "np.floor(a)": ["np.ceil(a)"],
        "a[1:b]": ["a[2:b]", "a[1:]"],
        "f(a, axis=1)": ["f(a)", "f(a, axis=2)"],
        "0.25": ["0.5"],
    }.items():
        assert [mutant.change for mutant in mutants_of(f"assert {code}")] == [f"{code} → {each}" for each in changed]


def test_process_survives_is_killed_or_times_out():
    def loop() -> bool:
        while True:
            pass

    assert in_a_process(lambda: True, 10) == SURVIVED
    assert in_a_process(lambda: False, 10) == KILLED
    assert in_a_process(functools.partial(int, "no number"), 10) == KILLED
    assert in_a_process(loop, 1) == TIMED_OUT


def test_functions_and_caches_are_found_although_the_tests_hide_them_from_pythons_collector():
    def found() -> bool:
        gc.freeze()
        functions = functions_of({"modsim3d.world.traffic.tracks"})
        gc.freeze()
        return ("modsim3d.world.traffic.tracks", "draw_one") in functions and shipped_kinds in caches_of_all()

    assert in_a_process(found, 10) == SURVIVED


def test_quickest_tests_that_reach_a_line_come_first_within_the_budget(tmp_path: Path):
    reach = Reach({"slow": 5.0, "quick": 1.0, "other": 0.1}, {"a.py": {3: {"slow", "quick"}, 4: {"other"}}}, {})
    assert reach.of_lines("a.py", (2, 3)) == {"slow", "quick"}
    assert reach.quickest({"slow", "quick"}, 3.0) == ["quick"]
    assert reach.quickest({"slow", "quick"}, 6.0) == ["quick", "slow"]
    assert reach.quickest({"slow"}, 3.0) == ["slow"]
    assert reach.of_file("a.py") == {"slow", "quick", "other"}
    fixtures = {name: {"renderer": 1.0} for name in "abc"}  # which tests share, and pay for once
    reach = Reach({"a": 0.1, "b": 0.2, "c": 0.3}, {"a.py": {3: {"a"}}}, fixtures)
    assert reach.quickest(set("abc"), 1.35) == ["a", "b"]
    assert reach.quickest(set("abc"), 1.7) == ["a", "b", "c"] and reach.alone_s("c") == 1.3
    reach = Reach({"a": 0.1, "b": 0.2, "c": 0.3}, {}, {"a": {"campaign": 9.0}})  # which keeps out no other test
    assert reach.quickest(set("abc"), 1.0) == ["b", "c"] and reach.quickest(set("abc"), 0.1) == ["b"]
    reach.save(tmp_path / "reach.json")
    assert Reach.load(tmp_path / "reach.json") == reach
