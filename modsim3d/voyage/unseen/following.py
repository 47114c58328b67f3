"""Things followed from frame to frame, by those of their sides that are not cut off.

In each frame the detections are assigned to the things of the frames before, with the least sum of distances to where
each thing is expected; a detection without a thing counts like one as far off as may be. Things keep their velocity,
and the sizes of their whole boxes. What is left is tried again with the sides beside other detections as cut off: one
thing may hide another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.voyage.unseen.jitter import Jitter

MOST_HIDDEN_S = 30.0
"""The longest that a thing may be hidden."""
_LEAST_SEEN = 5
"""Detections of a thing that may be missed for longer than usual."""
_NEAR, _LEAST_NEAR_PX = 0.6, 5.0
"""How far off a box may lie, in sides of it, and in pixels."""
_SPEED_SIDES_S = 1.0
"""How fast a thing may be, in lengths a second: a boat of 10 m at 20 knots makes one."""
_MOST_WAY_SIDES = 2.0
_MOST_LOG_RATIO = np.log(2.0)
_GATE_STDS = 3.0
"""A box may also be as far off, and as much larger or smaller, as so many standard deviations of the jitter."""
_ASPECT = 3.0
"""Width over height of a thing whose width was never seen."""
_VAGUE = 0.5
"""How far off a thing counts to be along an axis where no side tells, in reaches."""
_NOTHING = 1.001
_BESIDE_PX = 5.0
"""A side so near to another detection's box may be hidden by what is there."""
_MEMORY, _LEAST_MEMORY, _MEMORY_S = 12, 5, 6.0
"""Detections that a velocity is made from; not many more than in so long, since what nears seems to go ever faster."""
_AXES = np.array([0, 1, 0, 1])
"""Axis of the left, upper, right and lower side."""


@dataclass(eq=False)
class _Thing:
    """A thing: its number, how often, when first and when last it was seen.

    Its sides (4,), which of them are known (4,), its velocity along and below the horizon (2,), and how many detections
    tell where it is along each (2,).
    """

    number: int
    seen: int
    first_s: float
    last_s: float
    sides: Array
    known: Mask
    velocity: Array
    told: Array

    def lost(self, now: float, longest_s: float) -> bool:
        """Whether it is another thing if it is seen again: it may be hidden for as long as it was followed."""
        hidden_s = min(self.last_s - self.first_s, MOST_HIDDEN_S) if self.seen >= _LEAST_SEEN else 0.0
        return now - self.last_s > max(longest_s, hidden_s) + 1e-9

    def expected(self, now: float) -> Array:
        """Its sides at a later time, shape (4,)."""
        sides: Array = self.sides + self.velocity[_AXES] * (now - self.last_s)
        return sides

    def update(self, now: float, measured: Array, sure: Mask) -> None:
        """Move it to where it was detected, by least squares over its last detections."""
        apart, expected = now - self.last_s, self.expected(now)
        usable = (sure & self.known).reshape(2, 2)
        self.seen += 1
        memory = np.clip(_MEMORY_S / apart, _LEAST_MEMORY, _MEMORY)
        self.told = np.minimum(self.told + usable.any(axis=0), memory)
        off = _offsets(measured[None], sure[None], expected[None], self.known[None])[0, 0] * usable.any(axis=0)
        # Gains of a straight line through the last detections, evenly spaced (Brookner (1998), section 1.2.10).
        sides = expected + (2 * (2 * self.told - 1) / (self.told * (self.told + 1)) * off)[_AXES]
        self.velocity = self.velocity + 6 / (self.told * (self.told + 1)) * off / apart
        both = usable.all(axis=0)  # then the size is seen as well
        larger = ((measured - sides)[2:] - (measured - sides)[:2]) / 2 * both / self.told
        sides += np.concatenate([-larger, larger])
        sides = np.where(self.known, sides, measured)
        self.sides, self.known, self.last_s = sides, self.known | sure, now


def follow(time_s: Array, sides: Array, sure: Mask, longest_s: float, jitter: Jitter) -> Indices:
    """Number the detections of one sequence by what they are of, from 0 up, shape (n,).

    Args:
        time_s: Time of each, ascending, shape (n,).
        sides: Left, upper, right and lower side, shape (n, 4).
        sure: Which of them nothing cuts off, shape (n, 4).
        longest_s: How long a thing may be missed at least before it is another one.
        jitter: By how much small boxes change through the detector's errors.
    """
    numbers, things, count = np.full(len(time_s), -1), list[_Thing](), 0
    edges = np.flatnonzero(np.diff(time_s)) + 1
    for ours in np.split(np.arange(len(time_s)), edges) if len(time_s) else []:
        now = float(time_s[ours[0]])
        things = [thing for thing in things if not thing.lost(now, longest_s)]
        free = np.arange(len(ours))
        for seen in (sure[ours], sure[ours] & ~_beside_others(sides[ours])):
            waiting = [thing for thing in things if thing.last_s < now]
            taken = _assigned(waiting, now, sides[ours[free]], seen[free], jitter)
            for place, thing in taken:
                row = ours[free[place]]
                numbers[row] = waiting[thing].number
                waiting[thing].update(now, sides[row], seen[free[place]])
            free = np.delete(free, [place for place, _ in taken])
            if not len(free):
                break
        for row in ours[free].tolist():
            numbers[row] = count
            things.append(_Thing(count, 1, now, now, sides[row].copy(), sure[row].copy(), np.zeros(2), np.ones(2)))
            count += 1
    return numbers


def _assigned(things: list[_Thing], now: float, measured: Array, sure: Mask, jitter: Jitter) -> list[tuple[int, int]]:
    """Pairs of a detection and the thing that it is of, as places; measured and sure are (n, 4)."""
    if not things:
        return []
    expected, known = np.stack([each.expected(now) for each in things]), np.stack([each.known for each in things])
    apart, told = np.array([(now - each.last_s, each.told.min()) for each in things]).T
    width, height = np.maximum(expected[:, 2:] - expected[:, :2], 1.0).T
    whole = known[:, 0] & known[:, 2]
    side = np.sqrt(np.where(whole, width, np.maximum(width, _ASPECT * height)) * height)
    way = np.minimum(apart * _SPEED_SIDES_S, _MOST_WAY_SIDES) / np.sqrt(told)
    near = np.maximum(_GATE_STDS * jitter.off_px(side), _LEAST_NEAR_PX)
    reach = np.maximum(_NEAR * side, near) + side * way
    off = np.linalg.norm(_offsets(measured, sure, expected, known), axis=-1) / reach
    fits = (off <= 1) & _alike(measured, sure, expected, known, jitter)
    if not fits.any():
        return []
    vague = 2 - (sure[:, None] & known[None]).reshape(*off.shape, 2, 2).any(axis=2).sum(axis=-1)
    cost = np.where(fits, np.maximum(off, _VAGUE * vague), _NOTHING)
    pairs = zip(*linear_sum_assignment(cost), strict=True)
    return [(int(a), int(b)) for a, b in pairs if fits[a, b]]


def _beside_others(sides: Array) -> Mask:
    """Which sides (n, 4) of detections in one frame lie in or just beside the box of another, shape (n, 4)."""
    low, high = sides[:, :2] - _BESIDE_PX, sides[:, 2:] + _BESIDE_PX
    meets = ((sides[:, None, :2] <= high) & (sides[:, None, 2:] >= low)).all(axis=-1) & ~np.eye(len(sides), dtype=bool)
    inside = (sides[:, None] >= np.tile(low, 2)) & (sides[:, None] <= np.tile(high, 2))
    beside: Mask = np.asarray((inside & meets[..., None]).any(axis=1))
    return beside


def _offsets(measured: Array, sure: Mask, expected: Array, known: Mask) -> Array:
    """How far n detections lie from where k things are expected, along and below the horizon, shape (n, k, 2).

    By the sides that are sure; if none is, by how far the two are apart, which is 0 where they overlap.
    """
    usable = (sure[:, None] & known[None]).reshape(len(measured), len(expected), 2, 2)
    off = (measured[:, None] - expected[None]).reshape(usable.shape)
    number = usable.sum(axis=2)
    mean = np.where(usable, off, 0.0).sum(axis=2) / np.maximum(number, 1)
    before = np.maximum(expected[None, :, :2] - measured[:, None, 2:], 0)
    after = np.maximum(measured[:, None, :2] - expected[None, :, 2:], 0)
    offsets: Array = np.where(number > 0, mean, after - before)
    return offsets


def _alike(measured: Array, sure: Mask, expected: Array, known: Mask, jitter: Jitter) -> Mask:
    """Whether n detections are about as large as k things, along axes where all sides are sure, shape (n, k)."""
    usable = (sure[:, None] & known[None]).reshape(len(measured), len(expected), 2, 2).all(axis=2)
    found, whole = (np.maximum(each[..., 2:] - each[..., :2], 1.0) for each in (measured[:, None], expected[None]))
    near = np.abs(found - whole) <= _GATE_STDS * jitter.resized_px(np.sqrt(whole.prod(axis=-1)))
    alike: Mask = (~usable | near | (np.abs(np.log(found / whole)) <= _MOST_LOG_RATIO)).all(axis=-1)
    return alike
