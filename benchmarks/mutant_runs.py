"""Runs tests against mutants: which tests reach which lines, and whether the quickest of them notice a change.

Each mutant gets a process of its own, forked from one that has imported everything, so that imports are paid once. A
mutant of a function gets that function's changed code; one of a module's or a class's body imports the changed module
anew.
"""

from __future__ import annotations

import ast
import functools
import gc
import importlib
import importlib.abc
import importlib.util
import json
import math
import os
import resource
import select
import signal
import sys
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import coverage
import pytest
from hypothesis import Phase, settings

SURVIVED, KILLED, TIMED_OUT = "survived", "killed", "timed out"
LIBRARIES = ("hypothesis.extra.numpy", "pyarrow.parquet", "pydantic", "scipy.optimize", "scipy.spatial", "scipy.stats")
LIBRARIES += ("shapely", "trimesh", "yaml")
SLOW_S = 4.0
MOST_BYTES = 8 << 30
WALL_S = 300.0
"""Only for a process that waits for ever: what counts against a mutant is its processor time."""
QUIET = ("-q", "--assert=plain", "-s", "--tb=no", "--no-header", "--no-summary", "-p", "no:cacheprovider")


@dataclass(frozen=True)
class Reach:
    """Which tests reach which lines.

    Attributes:
        cost_s: Processor time of each test, with the fixtures that it shares with others.
        tests: Tests by file and line.
    """

    cost_s: dict[str, float]
    tests: dict[str, dict[int, set[str]]]

    def of_lines(self, path: str, lines: tuple[int, int]) -> set[str]:
        """The tests that reach one of these lines, the first and the last included."""
        here = self.tests.get(path, {})
        return set().union(*(here.get(line, set()) for line in range(lines[0], lines[1] + 1)))

    def of_file(self, path: str) -> set[str]:
        """The tests that reach any line of a function in a file."""
        return set().union(*self.tests.get(path, {}).values())

    def quickest(self, tests: set[str], budget_s: float) -> list[str]:
        """The quickest tests, at least one if there are any, that take no longer together than the budget."""
        chosen, spent = [], 0.0
        for name in sorted(tests, key=lambda name: (self.cost_s[name], name)):
            spent += self.cost_s[name]
            if chosen and spent > budget_s:
                break
            chosen.append(name)
        return chosen

    @classmethod
    def joined(cls, parts: Sequence[Reach]) -> Reach:
        """What several sets of tests reach, as one."""
        cost = {name: spent for part in parts for name, spent in part.cost_s.items()}
        tests: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
        for part in parts:
            for file, lines in part.tests.items():
                for line, names in lines.items():
                    tests[file][line] |= names
        return cls(cost, tests)

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        tests = {file: {line: sorted(names) for line, names in lines.items()} for file, lines in self.tests.items()}
        path.write_text(json.dumps({"cost_s": self.cost_s, "tests": tests}), encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Reach:
        """Read what `save` wrote."""
        data = json.loads(path.read_text(encoding="utf-8"))
        tests = {
            file: {int(line): set(names) for line, names in lines.items()} for file, lines in data["tests"].items()
        }
        return cls(data["cost_s"], tests)


def preload() -> None:
    """Import what forked processes need, without threads, but nothing of the package, of which a module may change."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    for name in LIBRARIES:
        importlib.import_module(name)


# ---- processes ---------------------------------------------------------------------------------


def in_a_process(work: Callable[[], bool], cpu_s: float | None = None) -> str:
    """Do some work in a forked process and say how it ended: its result is whether it survived."""
    pid = os.fork()
    if pid == 0:
        _child(work, cpu_s)
    watch = os.pidfd_open(pid)
    ended = select.select([watch], [], [], None if cpu_s is None else WALL_S)[0]
    os.close(watch)
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # it, if it waits for ever, and the workers that it may have left
    _, status = os.waitpid(pid, 0)
    if not ended or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return TIMED_OUT
    return SURVIVED if status == 0 else KILLED


def _child(work: Callable[[], bool], cpu_s: float | None) -> None:
    os.setsid()
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    if cpu_s is not None:
        os.dup2(nothing, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu_s), math.ceil(cpu_s) + 5))
        resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    code = 1
    try:
        code = int(not work())
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


# ---- which tests reach which lines -------------------------------------------------------------


class _TooSlowError(BaseException):
    """A test takes too long; no `except Exception` of its own may catch this."""


def _interrupt(*_: object) -> None:
    raise _TooSlowError


class _Mapper:
    """A plug-in of pytest that notes which lines each test reaches.

    Lines that a shared fixture reaches count for every test that uses the fixture. A test that takes longer than
    `SLOW_S` is interrupted and left out.
    """

    def __init__(self, sources: Sequence[str]) -> None:
        self.measured = coverage.Coverage(data_file=None, include=list(sources), config_file=False)
        self.now = ""
        self.spent: dict[str, float] = defaultdict(float)
        self.shared_by: dict[str, set[str]] = {}
        self.fixture: dict[Any, str] = {}
        self.failed: list[str] = []
        self.slow: set[str] = set()
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
            defined = item._fixtureinfo.name2fixturedefs.values()
            self.shared_by[item.nodeid] = {self.fixture[each[-1]] for each in defined if each[-1] in self.fixture}
        self._switch("")
        self.measured.stop()
        return True

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        if fixturedef.scope == "function":
            return (yield)
        name = f"fixture {fixturedef.baseid} {fixturedef.argname} {request.param_index}"
        self.fixture[fixturedef] = name
        before = self._switch(name)
        try:
            return (yield)
        finally:
            self._switch(before)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        if call.excinfo is not None and isinstance(call.excinfo.value, _TooSlowError):
            self.slow.add(item.nodeid)
        elif call.excinfo is not None:
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
        cost = {test: self.spent[test] + sum(self.spent[f] for f in used) for test, used in kept.items()}
        return Reach(cost, tests)


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


def caches_of_all() -> list[functools._lru_cache_wrapper[Any]]:
    """The cached functions of the package and of the tests."""
    found = [each for each in gc.get_objects() if isinstance(each, functools._lru_cache_wrapper)]
    return [each for each in found if each.__module__.startswith(("modsim3d", "tests"))]


def clear(caches: Sequence[functools._lru_cache_wrapper[Any]]) -> None:
    """Forget what cached functions have computed."""
    for each in caches:
        each.cache_clear()


# ---- mutants -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trial:
    """A mutant and the tests that are to notice it.

    Attributes:
        key: Says which mutant of which state of which module it is.
        path: Of the module, relative to the repository.
        function: Qualified name of the outermost function that changes; empty for the body of a module or class.
        tree: Makes the changed module.
        cost_s: Names of tests, in the order in which they run, and the processor time of each without a mutant.
    """

    key: str
    path: str
    function: str
    tree: Callable[[], ast.Module]
    cost_s: dict[str, float]

    @property
    def tests(self) -> list[str]:
        """Names of the tests."""
        return list(self.cost_s)

    @property
    def limit_s(self) -> float:
        """Processor time after which the mutant has timed out, if no single test has before."""
        return 3 + 3 * sum(self.cost_s.values())

    @property
    def module(self) -> str:
        """Name of the module."""
        return self.path.removesuffix(".py").replace("/", ".")


class _StopAtOnce:
    """A plug-in of pytest that ends the process at the first failure, and wastes no time on making it small."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self, session: pytest.Session) -> None:
        settings.register_profile("mutants", settings(), phases=(Phase.explicit, Phase.generate))
        settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        if call.excinfo is not None and not isinstance(call.excinfo.value, pytest.skip.Exception):
            os._exit(1)


class _Runner(_StopAtOnce):
    """A plug-in of pytest that runs trials instead of the tests."""

    def __init__(self, trials: Sequence[Trial], note: Callable[[Trial, str], None]) -> None:
        self.trials, self.note = trials, note

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        functions, caches = _functions({trial.module for trial in self.trials}), caches_of_all()
        for trial in self.trials:
            chosen = [items[name] for name in trial.tests]
            work = functools.partial(_run_items, trial, functions, caches, chosen)
            self.note(trial, in_a_process(work, trial.limit_s) if chosen else SURVIVED)
        return True


def _run_items(
    trial: Trial,
    functions: dict[tuple[str, str], list[FunctionType]],
    caches: Sequence[functools._lru_cache_wrapper[Any]],
    items: list[pytest.Item],
) -> bool:
    found = functions[trial.module, trial.function]
    (code,) = (code for code in _codes(compile(trial.tree(), trial.path, "exec")) if code.co_qualname == trial.function)
    for function in found:
        function.__code__ = code
    clear(caches)
    for item, following in zip(items, [*items[1:], None], strict=True):
        signal.setitimer(signal.ITIMER_PROF, 1 + 3 * trial.cost_s[item.nodeid])  # its signal ends the process
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
    return True


def _functions(modules: set[str]) -> dict[tuple[str, str], list[FunctionType]]:
    """All functions of some modules by module and qualified name."""
    for name in modules:
        importlib.import_module(name)
    found = defaultdict(list)
    for each in gc.get_objects():
        if isinstance(each, FunctionType) and each.__module__ in modules:
            found[each.__module__, each.__code__.co_qualname].append(each)
    return found


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Imports one module from a changed tree."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != self.trial.module:
            return None
        return importlib.util.spec_from_file_location(fullname, Path(self.trial.path).resolve(), loader=self)

    def get_source(self, fullname: str) -> str:
        return ast.unparse(self.trial.tree())

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.trial.tree(), str(Path(self.trial.path).resolve()), "exec")


def _run_anew(trial: Trial, options: Sequence[str]) -> bool:
    sys.meta_path.insert(0, _Changed(trial))
    return pytest.main([*QUIET, "-x", *options, *trial.tests], plugins=[_StopAtOnce()]) == 0


def run_trials(trials: Sequence[Trial], results: Path, options: Sequence[str]) -> None:
    """Run trials of functions from a process that has everything imported, the others from this one, which has not.

    The outcome of each is added to a file as it comes.
    """
    functions = [trial for trial in trials if trial.function]
    files = sorted({name.split("::")[0] for trial in functions for name in trial.tests})
    with results.open("a", encoding="utf-8") as lines:

        def _note(trial: Trial, outcome: str) -> None:
            print(trial.key, outcome, sep="\t", file=lines, flush=True)

        def _work() -> bool:
            return pytest.main([*QUIET, *options, *files], plugins=[_Runner(functions, _note)]) in (0, 5)

        if functions and in_a_process(_work) != SURVIVED:
            raise RuntimeError("the process that runs the mutants has failed")
        for trial in trials:
            if not trial.function:
                work = functools.partial(_run_anew, trial, options)
                _note(trial, in_a_process(work, trial.limit_s) if trial.tests else SURVIVED)


def outcomes(results: Path) -> dict[str, str]:
    """Outcome of each trial, by its key; the last one counts."""
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    return dict(line.split("\t") for line in lines)
