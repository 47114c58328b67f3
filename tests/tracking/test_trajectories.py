"""T-GOSPA and OSPA(2) against examples of their authors, values worked out by hand, and all assignments tried."""

import itertools

import numpy as np
import pytest

from modsim3d.tracking.scores.trajectories import TrajectorySets, ospa2, t_gospa

C, GAMMA = 5.0, 1.0
NONE = np.nan


def sets_of(truths, tracks, cutoff=C):
    """Sets of trajectories on a line, NaN where one is absent: shapes (n, steps) and (m, steps)."""
    frames = []
    for x, y in zip(np.transpose(truths), np.transpose(tracks), strict=True):
        a, b = np.flatnonzero(~np.isnan(x)), np.flatnonzero(~np.isnan(y))
        frames.append((a, b + 100, np.abs(x[a][:, None] - y[b])))
    return TrajectorySets.of(frames, cutoff)


def line(value, first=1, last=5, steps=5):
    return [value if first <= step <= last else NONE for step in range(1, steps + 1)]


# The six examples that García-Fernández, Rahmathullah & Svensson (2020) discuss, and a seventh with a hole, with the
# numbers of the authors' demonstration: one dimension, c = 5, p = 1, γ = 1, δ = 1 and Δ = 0.1. Sums worked out by hand.
EXAMPLES = {
    "one track is off by δ": ([line(1)], [line(2)], (5, 0, 0, 0)),
    "it ends a step early": ([line(1)], [line(2, 1, 4)], (4, 2.5, 0, 0)),
    "it is split into two": ([line(1)], [line(1.1, 1, 3), line(1.1, 4, 5)], (0.5, 0, 0, 1)),
    "both sides have a split, and cross": (
        [line(1), line(2.2, 1, 3), line(2.2, 4, 5)],
        [line(1.1, 1, 3), line(1.1, 4, 5), line(2.1)],
        (1, 0, 0, 2),
    ),
    "two tracks are exchanged halfway": (
        [line(1, steps=4), line(2.2, steps=4)],
        [[2, 2, 1.2, 1.2], [1.2, 1.2, 2, 2]],
        (1.6, 0, 0, 2),
    ),
    "one of two is split": (
        [line(1, steps=4), line(2.2, steps=4)],
        [line(2, steps=4), line(1.2, 1, 2, 4), line(1.2, 3, 4, 4)],
        (1.6, 0, 0, 1),
    ),
    "a hole is no switch": ([line(0.5), [2, 2, NONE, 2, 2]], [line(1.5), line(0)], (4.5, 0, 2.5, 0)),
}


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_authors_examples_have_the_sums_of_their_parts(example):
    truths, tracks, parts = EXAMPLES[example]
    found = t_gospa(sets_of(truths, tracks), 1, GAMMA)
    assert found is not None
    assert [each * len(truths[0]) for each in found] == pytest.approx([sum(parts), *parts])


def by_trying_all(truths, tracks, power, switch):
    """The metric by the best sequence of assignments, each step's tried all."""
    n, m, alone = len(truths), len(tracks), C**power / 2
    choices = [
        each for each in itertools.product(range(-1, m), repeat=n) if len({*each} - {-1}) == sum(j >= 0 for j in each)
    ]

    def cost(step, choice):
        taken, total = set(), 0.0
        for x, j in zip(truths[:, step], choice, strict=True):
            y = NONE if j < 0 else tracks[j, step]
            taken |= {j}
            there = (not np.isnan(x)) + (not np.isnan(y))
            total += min(abs(x - y), C) ** power if there == 2 else alone * there
        return total + alone * sum(not np.isnan(tracks[j, step]) for j in range(m) if j not in taken)

    def change(one, other):
        return switch**power / 2 * sum((a >= 0) + (b >= 0) for a, b in zip(one, other, strict=True) if a != b)

    best = {each: cost(0, each) for each in choices}
    for step in range(1, truths.shape[1]):
        best = {each: cost(step, each) + min(best[one] + change(one, each) for one in choices) for each in choices}
    return min(best.values())


@pytest.mark.parametrize("power", [1, 2])
def test_t_gospa_is_that_of_the_best_of_all_assignments(power):
    rng = np.random.default_rng(4)
    for _ in range(25):
        truths, tracks = rng.uniform(0, 8, (2, 5)), rng.uniform(0, 8, (3, 5))
        for each in (truths, tracks):
            each[rng.random(each.shape) < 0.25] = NONE
        switch = float(rng.uniform(0.2, 6))
        found = t_gospa(sets_of(truths, tracks), power, switch)
        assert found is not None
        assert 5 * found.t_gospa**power == pytest.approx(by_trying_all(truths, tracks, power, switch), abs=1e-4)
        assert found.t_gospa**power == pytest.approx(sum(found[1:]))


def test_long_trajectories_that_rival_for_moments_only_make_a_small_program_with_the_same_result(monkeypatch):
    steps, sizes = 4000, []
    truths = np.vstack([np.zeros(steps), np.full(steps, 40.0)])
    tracks = np.full((40, steps), NONE)
    for index in range(40):
        tracks[index, 100 * index : 100 * index + 104] = 1  # each begins four steps before the one before it ends
    from modsim3d.tracking.scores import trajectories

    solve = trajectories.linprog
    monkeypatch.setattr(
        trajectories, "linprog", lambda cost, *rest, **more: sizes.append(len(cost)) or solve(cost, *rest, **more)
    )
    found = t_gospa(sets_of(truths, tracks), 1, GAMMA)
    assert found is not None and sum(sizes) < 2000
    expected = (1 * steps, C / 2 * steps, C / 2 * 4 * 39, GAMMA * 39)
    assert [each * steps for each in found[1:]] == pytest.approx(expected)


def test_ospa2_of_tracks_that_are_there_half_the_time_or_split_is_worked_out_by_hand():
    whole, half = np.zeros((1, 8)), np.where(np.arange(8) < 4, 1.0, NONE)[None]
    assert ospa2(sets_of(whole, whole + 2), 1, 8) == pytest.approx(2)
    assert ospa2(sets_of(whole, half), 1, 8) == pytest.approx((4 * 1 + 4 * C) / 8)
    split = np.vstack([half, half[:, ::-1]])
    # One half is assigned, at a distance of (1 + c) / 2; the other is one track too many of two.
    assert ospa2(sets_of(whole, split), 1, 8) == pytest.approx(((1 + C) / 2 + C) / 2)
    assert ospa2(sets_of(whole, split), 2, 8) == pytest.approx((((1 + C) ** 2 / 4 + C**2) / 2) ** 0.5)
    assert ospa2(sets_of(whole, split), 1, 4) == pytest.approx(1)  # in each window it is one track
    nothing = np.full((1, 8), NONE)
    assert [ospa2(sets_of(*each), 1, 8) for each in ((nothing, nothing), (whole, nothing))] == [0, C]
    assert ospa2(TrajectorySets.of([], C), 1, 8) is t_gospa(TrajectorySets.of([], C), 1, 1) is None
