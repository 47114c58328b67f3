"""Which tests reach which lines, and how long each of them takes."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coverage
import pytest

from benchmarks.mutants.processes import SURVIVED, caches_of_all, clear, in_a_process

SLOW_S = 4.0
QUIET = ("-q", "--assert=plain", "-s", "--tb=no", "--no-header", "--no-summary", "-p", "no:cacheprovider")
"""Options of pytest."""


@dataclass(frozen=True)
class Reach:
    """Which tests reach which lines.

    Attributes:
        cost_s: Processor time of each test, without the fixtures that it shares with others.
        tests: Tests by file and line.
        shared_s: Processor time of these fixtures, by test and name.
    """

    cost_s: dict[str, float]
    tests: dict[str, dict[int, set[str]]]
    shared_s: dict[str, dict[str, float]]

    def of_lines(self, path: str, lines: tuple[int, int]) -> set[str]:
        """The tests that reach one of these lines, the first and the last included."""
        here = self.tests.get(path, {})
        return set().union(*(here.get(line, set()) for line in range(lines[0], lines[1] + 1)))

    def of_file(self, path: str) -> set[str]:
        """The tests that reach any line of a function in a file."""
        return set().union(*self.tests.get(path, {}).values())

    def quickest(self, tests: set[str], budget_s: float) -> list[str]:
        """The quickest tests, at least one if there are any, that take no longer together than the budget. A quick test
        whose fixtures would take too long keeps out no other."""
        chosen, spent, paid = [], 0.0, set[str]()
        for name in sorted(tests, key=lambda name: (self.cost_s[name], name)):
            shared = self.shared_s.get(name, {})
            cost = self.cost_s[name] + sum(cost for fixture, cost in shared.items() if fixture not in paid)
            if spent + cost <= budget_s:
                chosen.append(name)
                spent, paid = spent + cost, paid | set(shared)
        return chosen or sorted(tests, key=lambda name: (self.alone_s(name), name))[:1]

    def alone_s(self, name: str) -> float:
        """Processor time of a test with all its fixtures."""
        return self.cost_s[name] + sum(self.shared_s.get(name, {}).values())

    @classmethod
    def joined(cls, parts: Sequence[Reach]) -> Reach:
        """What several sets of tests reach, as one."""
        cost = {name: spent for part in parts for name, spent in part.cost_s.items()}
        tests: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
        for part in parts:
            for file, lines in part.tests.items():
                for line, names in lines.items():
                    tests[file][line] |= names
        return cls(cost, tests, {name: shared for part in parts for name, shared in part.shared_s.items()})

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        tests = {file: {line: sorted(names) for line, names in lines.items()} for file, lines in self.tests.items()}
        path.write_text(
            json.dumps({"cost_s": self.cost_s, "tests": tests, "shared_s": self.shared_s}), encoding="utf-8"
        )

    @classmethod
    def load(cls, path: Path) -> Reach:
        """Read what `save` wrote."""
        data = json.loads(path.read_text(encoding="utf-8"))
        tests = {
            file: {int(line): set(names) for line, names in lines.items()} for file, lines in data["tests"].items()
        }
        return cls(data["cost_s"], tests, data["shared_s"])


class _TooSlowError(BaseException):
    """A test takes too long; no `except Exception` of its own may catch this."""


def _interrupt(*_: object) -> None:
    raise _TooSlowError


class _Mapper:
    """A plug-in of pytest that notes which lines each test reaches.

    Lines that a shared fixture reaches count for every test that uses the fixture. A test that takes longer than
    `SLOW_S` is interrupted and left out, and so is one that then fails because it shares the fixture that took so long.
    """

    def __init__(self, sources: Sequence[str]) -> None:
        self.measured = coverage.Coverage(data_file=None, include=list(sources), config_file=False)
        self.now = ""
        self.spent: dict[str, float] = defaultdict(float)
        self.shared_by: dict[str, set[str]] = {}
        self.fixture: dict[Any, str] = {}
        self.failed: list[str] = []
        self.slow: set[str] = set()
        self.interrupted: set[str] = set()
        self.since = 0.0

    def _switch(self, context: str) -> str:
        before, self.now = self.now, context
        now = sum(os.times()[:4])  # with the processes that a test starts
        self.spent[before] += now - self.since
        self.since = now
        self.measured.switch_context(context)
        return before

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        caches = caches_of_all()
        signal.signal(signal.SIGVTALRM, _interrupt)
        self.measured.start()
        for item, following in zip(session.items, [*session.items[1:], None], strict=True):
            clear(caches)
            self._switch(item.nodeid)
            signal.setitimer(signal.ITIMER_VIRTUAL, SLOW_S)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            self.shared_by[item.nodeid] = self._shared(item)
        self._switch("")
        self.measured.stop()
        return True

    def _shared(self, item: Any) -> set[str]:
        defined = item._fixtureinfo.name2fixturedefs.values()
        return {self.fixture[each[-1]] for each in defined if each[-1] in self.fixture}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        if fixturedef.scope == "function":
            return (yield)
        name = f"fixture {fixturedef.baseid} {fixturedef.argname} {request.param_index}"
        self.fixture[fixturedef] = name
        before = self._switch(name)
        try:
            return (yield)
        except _TooSlowError:
            self.interrupted.add(name)
            raise
        finally:
            self._switch(before)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        if call.excinfo is None:
            return
        if isinstance(call.excinfo.value, _TooSlowError) or not self.interrupted.isdisjoint(self._shared(item)):
            self.slow.add(item.nodeid)
        else:
            self.failed.append(item.nodeid)

    def reach(self, root: Path) -> Reach:
        users: dict[str, set[str]] = defaultdict(set)
        kept = {test: fixtures for test, fixtures in self.shared_by.items() if test not in self.slow}
        for test, fixtures in kept.items():
            for context in (test, *fixtures):
                users[context].add(test)
        data = self.measured.get_data()
        tests = {
            str(Path(file).relative_to(root)): {
                line: set().union(*(users[context] for context in contexts if context))
                for line, contexts in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }
        shared = {test: {name: self.spent[name] for name in used} for test, used in kept.items()}
        return Reach({test: self.spent[test] for test in kept}, tests, shared)


def map_tests(root: Path, sources: Sequence[str], tests: Sequence[str], out: Path) -> None:
    """Run tests once and write to a file which lines of some sources each reaches.

    Raises:
        RuntimeError: A test fails, without any mutant.
    """

    def _work() -> bool:
        mapper = _Mapper([str(root / source) for source in sources])
        pytest.main([*QUIET, *tests], plugins=[mapper])
        if not mapper.failed:
            mapper.reach(root).save(out)
        print(*mapper.failed, *(f"too slow: {name}" for name in sorted(mapper.slow)), sep="\n", file=sys.stderr)
        return not mapper.failed

    if in_a_process(_work) != SURVIVED:
        raise RuntimeError("tests fail before anything is changed")
