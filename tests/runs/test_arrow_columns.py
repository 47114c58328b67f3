"""Columns of tables that are made of arrays are those that `pa.array` makes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from modsim3d.arrays import Array
from modsim3d.runs.files.tables import flags, named, numbers

SQUARE = np.arange(24.0).reshape(6, 4)


@pytest.mark.parametrize(
    "values",
    [
        np.array([0.5, np.nan, -np.inf, 0.0, np.nan, 7.0, 8.0, 9.0, np.nan]),
        np.full(3, np.nan),
        SQUARE[:, 1],
        np.arange(11),
        np.arange(3, dtype=np.int32),
        np.empty(0),
    ],
    ids=["some missing", "all missing", "a column", "whole", "short", "none"],
)
def test_numbers(values: Array) -> None:
    made = numbers(values)
    made.validate(full=True)
    wanted = pa.array(np.ascontiguousarray(values), from_pandas=True)
    assert made.equals(wanted)
    assert made.type == wanted.type
    assert made.null_count == np.isnan(values).sum()


@pytest.mark.parametrize("count", [0, 1, 8, 19])
def test_flags(count: int) -> None:
    values = np.arange(count) % 3 == 0
    flags(values).validate(full=True)
    assert flags(values).to_pylist() == values.tolist()


def test_names_by_index() -> None:
    assert named(["a", "b"], np.array([1, -1, 0])).to_pylist() == ["b", None, "a"]


RUN = """
import sys
import modsim3d
modsim3d.run_scene(modsim3d.load_scene("simulation_1", steps=2), sys.argv[1])
print("numpy.ma" in sys.modules)
"""


def test_no_run_imports_masked_arrays(tmp_path: Path) -> None:
    said = subprocess.run([sys.executable, "-c", RUN, tmp_path / "run"], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["False"]
