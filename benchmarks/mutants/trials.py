"""Runs tests against mutants: does the quickest of those that reach a changed line notice the change?

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
import os
import signal
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from hypothesis import Phase, settings

from benchmarks.mutants.processes import SURVIVED, caches_of_all, clear, in_a_process
from benchmarks.mutants.reach import QUIET


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
        functions, caches = functions_of({trial.module for trial in self.trials}), caches_of_all()
        if unknown := {trial.function for trial in self.trials if not functions[trial.module, trial.function]}:
            print("no such functions:", *sorted(unknown), file=sys.stderr)
            raise RuntimeError("mutants that change nothing would all survive")
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


def functions_of(modules: set[str]) -> dict[tuple[str, str], list[FunctionType]]:
    """All functions of some modules by module and qualified name."""
    for name in modules:
        importlib.import_module(name)
    gc.unfreeze()  # what the tests hide from Python's collector is not listed
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
