"""Distances of whole sets of trajectories: T-GOSPA by linear programming, and OSPA(2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_array, coo_array, csgraph

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.tracking.scores.errors import ospa_frame

_DECIMALS = 6  # of a weight of an assignment: HiGHS is exact to 1e-7, and nearly all are 0 or 1


@dataclass(frozen=True, eq=False)
class TrajectorySets:
    """Two sets of trajectories over S steps: when each is there, and how far those are apart that are nearer than c.
    Steps ascend in each list."""

    steps: int  # S
    cutoff: float  # c, in the unit of the distances
    truths: Indices  # step and number of a true trajectory wherever one is there, shape (n, 2)
    tracks: Indices  # the same of tracks, shape (m, 2)
    pairs: Indices  # step, true trajectory and track of each pair that is nearer than c, shape (k, 3)
    distance: Array  # of these, shape (k,)

    @classmethod
    def of(cls, frames: Iterable[tuple[Indices, Indices, Array]], cutoff: float) -> Self:
        """The sets from each step's numbers of a true trajectories and b tracks, and their distances (a, b)."""
        truths, tracks, pairs = ([np.zeros((0, size), dtype=np.int64)] for size in (2, 2, 3))
        near, steps = [np.zeros(0)], 0
        for step, (a, b, apart) in enumerate(frames):
            i, j = np.nonzero(apart < cutoff)
            for part, columns in ((truths, (a,)), (tracks, (b,)), (pairs, (a[i], b[j]))):
                part.append(np.column_stack([np.full(len(columns[0]), step), *columns]))
            near.append(apart[i, j])
            steps = step + 1
        every = [np.concatenate(part) for part in (truths, tracks, pairs)]
        return cls(steps, cutoff, every[0], every[1], every[2], np.concatenate(near))


class TGospaParts(NamedTuple):
    """T-GOSPA of trajectories over S steps, for each step, and what it consists of: (t_gospa)^p is their sum."""

    t_gospa: float  # the metric over S^(1/p), in the unit of the cutoff c
    localisation: float  # sum of the p-th powers of the distances of pairs closer than c, over S
    missed: float  # c^p / 2 for each step of a true trajectory without a track closer than c, over S
    false: float  # c^p / 2 for each step of a track without a true trajectory closer than c, over S
    switch: float  # γ^p for each change of the track of a true trajectory, half where one is lost or found, over S


def t_gospa(sets: TrajectorySets, power: float, switch: float) -> TGospaParts | None:
    """T-GOSPA, the metric of García-Fernández, Rahmathullah & Svensson (2020), "A metric on the space of finite sets of
    trajectories for evaluation of multi-target tracking algorithms", IEEE Trans. Signal Process. 68, 3917-3928, by its
    linear program, with its split of the costs. `power` is p and `switch` γ, in the unit of the distances;
    None without steps. It is divided by S, as the authors do for windows of different lengths.

    Exact, and yet small: a pair that is never closer than c gains nothing, so it is left out. What remains falls into
    groups without a common trajectory, each a linear program of its own. In it a weight may change only where pairs of
    one trajectory rival at that step: elsewhere a weight that stays costs no more, see `_group`.
    """
    if not sets.steps:
        return None
    alone = sets.cutoff**power / 2
    cost, both, switched = 0.0, 0.0, 0.0
    names, pair = np.unique(sets.pairs[:, 1:], axis=0, return_inverse=True)
    pair = pair.reshape(-1)
    order = np.argsort(pair, kind="stable")
    ends = np.searchsorted(pair[order], np.arange(len(names) + 1))
    costs = sets.distance**power
    for group in _groups(names):
        rows = [order[ends[number] : ends[number + 1]] for number in group]
        gains = [(sets.pairs[pair_rows, 0], 2 * alone - costs[pair_rows]) for pair_rows in rows]
        weights, changes = _group(names[group], gains, switch**power / 2)
        cost += sum(float(weight @ costs[pair_rows]) for weight, pair_rows in zip(weights, rows, strict=True))
        both += sum(float(weight.sum()) for weight in weights)
        switched += switch**power / 2 * changes
    missed, false = (alone * (len(side) - both) for side in (sets.truths, sets.tracks))
    parts = [part / sets.steps for part in (cost, missed, false, switched)]
    return TGospaParts(sum(parts) ** (1 / power), *parts)


def _groups(names: Indices) -> list[Indices]:
    """Rows of pairs (n, 2) of a true trajectory and a track that hang together by common ones."""
    _, truth = np.unique(names[:, 0], return_inverse=True)
    _, track = np.unique(names[:, 1], return_inverse=True)
    track = track + len(names)
    graph = coo_array((np.ones(len(names)), (truth, track)), shape=(2 * len(names), 2 * len(names)))
    _, group = csgraph.connected_components(graph, directed=False)
    return [np.flatnonzero(group[truth] == number) for number in np.unique(group[truth])]


def _group(names: Indices, gains: list[tuple[Indices, Array]], price: float) -> tuple[list[Array], float]:
    """Weights of the pairs of a group at the steps at which they are near, and the sum of all changes of weights.
    `names` are the trajectory and the track of each pair, `gains` its steps and what it costs less there than both
    alone, and `price` is that of a change.

    A weight is one variable over a stretch of steps. While a pair is not near, its least weight will do for all of the
    stretch: it gains nothing, and takes no more from its rivals. While it is near and no pair of the same trajectory or
    track is, its greatest will do: its rivals are not near, so that theirs stay. Only pairs that are near together with
    a rival have a variable for each step."""
    if len(names) == 1:
        return [np.ones(len(gains[0][0]))], 0.0
    first = min(int(steps[0]) for steps, _ in gains)
    gain = np.zeros((len(names), max(int(steps[-1]) for steps, _ in gains) + 1 - first))
    for row, (steps, values) in zip(gain, gains, strict=True):
        row[steps - first] = values
    near = gain > 0
    sides = [np.unique(side, return_inverse=True)[1].reshape(-1) for side in names.T]
    rival = np.zeros_like(near)
    for side in sides:
        count = np.zeros((side.max() + 1, near.shape[1]), dtype=np.int64)
        np.add.at(count, side, near)
        rival |= near & (count[side] > 1)
    begins = np.ones_like(near)
    begins[:, 1:] = rival[:, 1:] | rival[:, :-1] | (near[:, 1:] != near[:, :-1])
    variable = (np.cumsum(begins) - 1).reshape(near.shape)
    gained = np.asarray(np.bincount(variable.ravel(), gain.ravel()), dtype=np.float64)
    weight, changes = _program(variable, gained, sides, price)
    return [weight[row[steps - first]] for row, (steps, _) in zip(variable, gains, strict=True)], changes


def _program(variable: Indices, gain: Array, sides: list[Indices], price: float) -> tuple[Array, float]:
    """Solution of the linear program: weights in [0, 1] with the greatest gain, less the price of their changes from
    one stretch of a pair to the next. At no step those of one trajectory, or of one track, add up to more than 1.
    `variable` is that of each pair and step, (n, S); `sides` are numbers of the pairs' trajectories and tracks."""
    count = len(gain)
    after = np.setdiff1d(np.arange(count), variable[:, 0])  # variables that follow one of the same pair
    row, ones = np.arange(len(after)), np.ones(len(after))
    ends = np.concatenate([after, after - 1])
    step = coo_array((np.concatenate([ones, -ones]), (np.tile(row, 2), ends)), shape=(len(after), count))
    sums = []
    for side in sides:
        for number in np.flatnonzero(np.bincount(side) > 1):
            taken = np.unique(variable[side == number], axis=1).T
            place = np.repeat(np.arange(len(taken)), taken.shape[1])
            sums.append(coo_array((np.ones(taken.size), (place, taken.reshape(-1))), shape=(len(taken), count)))
    change = coo_array((ones, (row, row)), shape=(len(after), len(after)))
    matrix = block_array([[step, -change], [-step, -change], *([block, None] for block in sums)], format="csr")
    limit = np.concatenate([np.zeros(2 * len(after)), np.ones(matrix.shape[0] - 2 * len(after))])
    solution = linprog(np.concatenate([-gain, price * ones]), matrix, limit, bounds=(0, 1), method="highs")
    if not solution.success:
        raise ModsimError(f"T-GOSPA: its linear program was not solved: {solution.message}")
    weight = np.round(solution.x[:count], _DECIMALS)
    return weight, float(np.abs(weight[after] - weight[after - 1]).sum())


def ospa2(sets: TrajectorySets, power: float, window: int) -> float | None:
    """OSPA(2) of Beard, Vo & Vo (2020), "A solution for large-scale multi-object tracking", IEEE Trans. Signal Process.
    68, 2754-2769: OSPA of the trajectories in a window of so many steps, mean over windows that follow each other; None
    without steps. The distance of two trajectories is the mean over the steps of the window at which one is there: of
    the distance of the two, at most c, or of c where only one is there."""
    distances = []
    for first in range(0, sets.steps, window):
        inside = [
            rows[slice(*np.searchsorted(rows[:, 0], (first, first + window)))] for rows in (sets.truths, sets.tracks)
        ]
        names = [np.unique(rows[:, 1], return_inverse=True) for rows in inside]
        masks = [np.zeros((len(name), window)) for name, _ in names]
        for mask, (_, row), rows in zip(masks, names, inside, strict=True):
            mask[row.reshape(-1), rows[:, 0] - first] = 1
        either = masks[0].sum(axis=1)[:, None] + masks[1].sum(axis=1) - masks[0] @ masks[1].T
        near = slice(*np.searchsorted(sets.pairs[:, 0], (first, first + window)))
        place = tuple(np.searchsorted(names[side][0], sets.pairs[near, 1 + side]) for side in (0, 1))
        apart = sets.cutoff * either
        np.add.at(apart, place, sets.distance[near] - sets.cutoff)
        distances.append(ospa_frame(apart / either, sets.cutoff, power))
    return float(np.mean(distances)) if distances else None
