"""A sample of the campaign's cases and every input that failed once: accepted, or refused with a clear error."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import pytest

from modsim3d.core.errors import InputError, ModsimError
from tests.fuzz.cases import files_of, files_of_kept, kept_inputs
from tests.fuzz.corpora import write_files
from tests.fuzz.outcomes import ACCEPTED, FAILED, REFUSED, outcome_of, printed
from tests.fuzz.readers import READERS
from tests.fuzz.workers import Result, tried, warm_up, within_limits

SAMPLE = 20
KEPT = [(name, entry) for name in READERS for entry in kept_inputs(name)]


@pytest.mark.parametrize("name", READERS)
def test_good_inputs_are_accepted_and_a_sample_of_cases_accepted_or_refused(name: str, tmp_path: Path) -> None:
    warm_up(name, tmp_path)
    for number in range(SAMPLE):
        write_files(files_of(name, number), tmp_path / str(number))
        outcome = outcome_of(READERS[name].read, tmp_path / str(number), READERS[name].also_names)
        assert outcome.verdict != FAILED, (number, outcome)


@pytest.mark.parametrize(("name", "entry"), KEPT, ids=[f"{name}: {entry['cause']}" for name, entry in KEPT])
def test_an_input_that_failed_once_is_accepted_or_refused(name: str, entry: dict[str, Any], tmp_path: Path) -> None:
    write_files(files_of_kept(name, entry), tmp_path / "case")
    outcome = outcome_of(READERS[name].read, tmp_path / "case", READERS[name].also_names)
    assert outcome.verdict != FAILED, outcome


@pytest.mark.parametrize("name", ["scene", "yolo", "ais_nmea", "run"])
def test_a_case_has_the_same_files_each_time(name: str) -> None:
    assert all(files_of(name, number) == files_of(name, number) for number in range(10))
    assert len({str(files_of(name, number)) for number in range(10)}) == 10


def _raises(error: Exception) -> Any:
    def read(folder: Path) -> None:
        raise error

    return read


def test_only_a_short_clear_error_that_names_the_source_is_a_refusal(tmp_path: Path) -> None:
    for error, verdict in (
        (InputError(f"scene {tmp_path}/scene.yaml", ["steps: missing"]), REFUSED),
        (ModsimError(f"{tmp_path} holds no run"), REFUSED),
        (KeyError("steps"), FAILED),
        (ResourceWarning("left open"), FAILED),
        (ModsimError("something is wrong"), FAILED),
        (InputError(f"{tmp_path}", ["a bell \x07, a break \n and half a character \ud800"]), REFUSED),
        (ModsimError(f"{tmp_path} {'x' * 3000}"), FAILED),
        (ModsimError(f"{tmp_path} is wrong\nvery wrong"), FAILED),
        (ModsimError(f"{tmp_path} is\twrong"), REFUSED),
        (InputError(f"{tmp_path}{'x' * 3000}", ["wrong"]), FAILED),
        (ModsimError(""), FAILED),
    ):
        assert outcome_of(_raises(error), tmp_path).verdict == verdict, error
    assert "\\u202e" in printed(ModsimError("a\u202eb"))  # as the command line writes it
    assert "\t" not in printed(ModsimError("a\tb"))


def test_a_process_that_crashes_hangs_or_takes_too_much_is_the_result_of_one_case(monkeypatch) -> None:
    def read(folder: Path) -> None:
        if folder.name == "3":
            os._exit(9)
        while folder.name == "5":
            pass
        if folder.name == "6":
            bytearray(10**10)

    monkeypatch.setitem(READERS, "stream", dataclasses.replace(READERS["stream"], read=read))
    monkeypatch.setattr("tests.fuzz.workers.KILLED_CPU_S", 0.5)
    found = {result.number: within_limits(result) for result in tried("stream", range(8), 1, slice_cases=4)}
    assert sorted(found) == list(range(8))
    assert found[3].place == "crash" and found[5].place == "hang" and found[6].said.startswith("MemoryError")
    assert all(found[number].verdict == ACCEPTED for number in (0, 1, 2, 4, 7))
    accepted = outcome_of(lambda folder: None, Path())
    assert within_limits(Result(0, accepted, 1.9, 10**8)).verdict == ACCEPTED
    assert within_limits(Result(0, accepted, 2.1, 10**8)).place == "time"
    assert within_limits(Result(0, accepted, 0.1, 2 * 10**9)).place == "memory"
