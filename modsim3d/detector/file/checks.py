"""Checks of the vectors and matrices of a detector file; each returns a list of problems."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.model import ERROR_COMPONENTS

SUM_TOLERANCE = 1e-6
ROUNDING = 1e-9
"""Relative size of an asymmetry or a negative eigenvalue that counts as rounding."""

Rows = Sequence[Sequence[float]]


def matrix_problems(rows: Rows, shape: tuple[int, int], meaning: str) -> list[str]:
    """Whether a matrix has the shape it should have; `meaning` says what its rows and columns are."""
    lengths = {len(row) for row in rows}
    if len(lengths) > 1:
        return [f"its rows have different lengths: {', '.join(str(len(row)) for row in rows)}"]
    found = (len(rows), lengths.pop() if lengths else 0)
    if found == shape:
        return []
    return [f"is {found[0]} × {found[1]}, must be {shape[0]} × {shape[1]}: {meaning}"]


def _sums_to_one(sums: Array) -> bool:
    return bool(np.all(np.abs(sums - 1) <= SUM_TOLERANCE))


def column_problems(rows: Rows, names: Sequence[str]) -> list[str]:
    """Whether the columns of a matrix of the right shape are probability distributions."""
    matrix = np.array(rows, dtype=np.float64)
    sums = matrix.sum(axis=0)
    if _sums_to_one(sums):
        return []
    square = matrix.shape[0] == matrix.shape[1]
    if square and _sums_to_one(matrix.sum(axis=1)):
        return [
            "its rows sum to one and its columns do not: it looks row-stochastic and must be transposed "
            "(a column holds the probabilities of what follows one state)"
        ]
    return [
        f"column '{name}' sums to {total:.9g}, must sum to 1"
        for name, total in zip(names, sums, strict=True)
        if abs(total - 1) > SUM_TOLERANCE
    ]


def transition_problems(rows: Rows, states: Sequence[str]) -> list[str]:
    """Whether A is column-stochastic (Jessen & Mohr (2023), eq. 6.1), with a column for each state."""
    size = len(states)
    return matrix_problems(
        rows, (size, size), f"one row and one column for each of the states {', '.join(states)}"
    ) or column_problems(rows, states)


def confusion_problems(rows: Rows, labels: Sequence[str]) -> list[str]:
    """Whether each column of a confusion matrix is a distribution over labels and background."""
    size = len(labels)
    meaning = f"rows {', '.join(labels)}, background; columns {', '.join(labels)}"
    wrong_shape = matrix_problems(rows, (size + 1, size), meaning)
    transposed = not matrix_problems(rows, (size, size + 1), meaning)
    if transposed and _sums_to_one(np.array(rows, dtype=np.float64).sum(axis=1)):
        return [f"{wrong_shape[0]}; it looks row-stochastic and must be transposed"]
    return wrong_shape or column_problems(rows, labels)


def distribution_problems(values: Sequence[float], labels: Sequence[str]) -> list[str]:
    """Whether there is a probability for each label and they sum to one."""
    if len(values) != len(labels):
        return [f"has {len(values)} entries, must have one for each of the labels {', '.join(labels)}"]
    total = sum(values)
    return [] if abs(total - 1) <= SUM_TOLERANCE else [f"sums to {total:.9g}, must sum to 1"]


def covariance_problems(rows: Rows) -> list[str]:
    """Whether a matrix is the covariance of some random vector (e_x, e_y, e_w, e_h)."""
    problems = matrix_problems(rows, (4, 4), f"rows and columns {', '.join(ERROR_COMPONENTS)}")
    if problems:
        return problems
    matrix = np.array(rows, dtype=np.float64)
    scale = float(np.abs(matrix).max())
    if scale == 0:
        return []
    matrix = matrix / scale  # so that the eigenvalues of enormous entries do not overflow
    for i, j in itertools.combinations(range(4), 2):
        if abs(matrix[i, j] - matrix[j, i]) > ROUNDING:
            first, second = ERROR_COMPONENTS[i], ERROR_COMPONENTS[j]
            problems.append(
                f"is not symmetric: row {first}, column {second} is {rows[i][j]:.9g}, "
                f"row {second}, column {first} is {rows[j][i]:.9g}"
            )
    least = float(np.linalg.eigvalsh(matrix)[0]) if not problems else 0.0
    if least < -ROUNDING:
        problems.append(
            f"is not positive semi-definite, so no errors can have it: its smallest eigenvalue is "
            f"{least * scale:.6g}, must be at least 0"
        )
    return problems
