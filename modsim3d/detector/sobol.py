"""Scrambled points of Sobol's sequence, the same as those of `scipy.stats.qmc`, whose import takes 0.4 s.

Direction numbers are those of Joe & Kuo (2008), "Constructing Sobol sequences with better two-dimensional projections".
The scrambling is Matousek's (1998): each column of direction numbers is multiplied by a random lower triangular matrix
of bits, and all points are shifted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array

_BITS = 30
_POLYNOMIALS = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)))
"""Degree, inner coefficients as bits, and first direction numbers, of each dimension after the first."""
MOST_DIMENSIONS = 1 + len(_POLYNOMIALS)


def sobol_points(dimensions: int, count: int, generator: np.random.Generator) -> Array:
    """The first points of a scrambled sequence, in [0, 1), shape (count, dimensions).

    Args:
        dimensions: At most `MOST_DIMENSIONS`.
        count: A power of two.
        generator: Draws the scrambling, as `qmc.Sobol` does with the generator that it spawns from the one it is given.
    """
    powers = 2 ** np.arange(_BITS, dtype=np.uint32)
    shift = generator.integers(2, size=(dimensions, _BITS), dtype=np.uint32) @ powers
    matrices = np.tril(generator.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32), -1)
    matrices[:, range(_BITS), range(_BITS)] = 1
    bits = _direction_numbers(dimensions)[..., None] >> np.arange(_BITS, dtype=np.uint32)[::-1] & 1
    # The highest bit comes first in rows of matrices and in `bits`.
    directions = (np.einsum("dpk,djk->djp", matrices, bits) & 1) @ powers[::-1]
    points = shift[None]
    for column in directions.T[: count.bit_length() - 1]:  # in the order of Gray's code
        points = np.concatenate([points, points[::-1] ^ column])
    return points / 2.0**_BITS


def _direction_numbers(dimensions: int) -> NDArray[np.uint32]:
    """Direction numbers as fractions of 2 ** _BITS, shape (dimensions, _BITS)."""
    columns = [[1] * _BITS]
    for degree, inner, first in _POLYNOMIALS[: dimensions - 1]:
        numbers = list(first)
        for k in range(degree, _BITS):
            number = numbers[k - degree] ^ (numbers[k - degree] << degree)
            for i in range(1, degree):
                if inner >> (degree - 1 - i) & 1:
                    number ^= numbers[k - i] << i
            numbers.append(number)
        columns.append(numbers)
    return np.array([[number << (_BITS - 1 - k) for k, number in enumerate(each)] for each in columns], dtype=np.uint32)
