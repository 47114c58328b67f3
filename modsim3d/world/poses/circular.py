"""Vessels on concentric circles (Jessen & Mohr (2023), §7.2.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.io.validation import Metres, Rate, Strict
from modsim3d.world.poses.base import LongTimes, PoseRequest, Poses, SourceKeys
from modsim3d.world.vessels import Vessel

MAX_DRAWS, DRAWS_AT_ONCE = 10_000, 50


class CircularKeys(SourceKeys, Strict):
    """Vessels on concentric circles (Jessen & Mohr (2023), Table 9.4)."""

    centre_m: tuple[Metres, Metres] = (0.0, 0.0)
    radius_m: tuple[Annotated[Metres, Field(ge=0)], Annotated[Metres, Field(gt=0)]]
    rotation_rate_rad_s: tuple[Rate, Rate]

    @model_validator(mode="after")
    def _ordered(self) -> CircularKeys:
        for key in ("radius_m", "rotation_rate_rad_s"):
            low, high = getattr(self, key)
            if low > high:
                raise ValueError(f"{key} is [least, greatest], but {low} > {high}")
        return self

    def build(self, request: PoseRequest) -> CircularMotion:
        """Random circles from the seed."""
        steps, interval = request.steps or 0, request.time_step_s or 0.0
        limits = self.centre_m, self.radius_m, self.rotation_rate_rad_s
        return circular_motion(request.vessels, steps, interval, *limits, request.seed)


@dataclass(frozen=True, eq=False)
class CircularMotion:
    """Each vessel on a circle of its own, heading along it, counter-clockwise at positive rates."""

    timestamps: Sequence[str]
    centre_m: tuple[float, float]  # common to all circles, w1 and w2
    radii_m: Array  # (V,)
    rates_rad_s: Array  # angular velocity on the circle: (V,)
    phases_rad: Array  # angle on the circle at step 0: (V,)

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1 (eq. 7.5, 7.7)."""
        times_s = np.array([float(text) for text in self.timestamps[first:stop]])
        angle = self.phases_rad + times_s[:, None] * self.rates_rad_s
        w1 = self.centre_m[0] + self.radii_m * np.cos(angle)
        w2 = self.centre_m[1] + self.radii_m * np.sin(angle)
        turn = np.where(self.rates_rad_s < 0, -math.pi / 2, math.pi / 2)
        positions = np.stack([w1, w2, np.zeros_like(angle)], axis=-1)
        return Poses(np.ones(angle.shape, dtype=bool), positions, angle + turn)


def swept_ring(radius_m: float, length_m: float, beam_m: float) -> tuple[float, float]:
    """Inner and outer radius of the ring that a hull sweeps while its centre runs on a circle. The sides lie half a
    beam inside and outside the circle of the hull's centre, and the corners half a length further along the tangent. A
    hull whose inner side passes the centre sweeps a full disc."""
    return max(0.0, radius_m - beam_m / 2), math.hypot(radius_m + beam_m / 2, length_m / 2)


def circular_motion(
    vessels: Sequence[Vessel],
    steps: int,
    time_step_s: float,
    centre_m: tuple[float, float],
    radius_m: tuple[float, float],
    rotation_rate_rad_s: tuple[float, float],
    seed: int,
) -> CircularMotion:
    """Circles with random radii, rates and start phases on which no two hulls can ever touch. `radius_m` and
    `rotation_rate_rad_s` are least and greatest values. The vessels' names key the random numbers. Raises InputError if
    the vessels do not fit between the two radii."""
    streams = Streams(seed)
    starts = [streams.uniforms(Purpose.CIRCLE_START, vessel.name, first=0, count=1) for vessel in vessels]
    rate, phase = np.concatenate(starts).T
    low, high = rotation_rate_rad_s
    return CircularMotion(
        timestamps=LongTimes(steps, time_step_s),
        centre_m=centre_m,
        radii_m=_radii(vessels, radius_m, streams),
        rates_rad_s=low + (high - low) * rate,
        phases_rad=2 * math.pi * phase,
    )


def _radii(vessels: Sequence[Vessel], radius_m: tuple[float, float], streams: Streams) -> Array:
    """A radius for each vessel: (V,). Distinct radii alone do not keep hulls apart: a radius is drawn again until the
    ring that its hull sweeps is free of the rings before it."""
    least, greatest = radius_m
    rings: list[tuple[float, float]] = []
    radii = []
    for vessel in vessels:
        for uniform in _uniforms(streams, vessel.name):
            radius = least + (greatest - least) * uniform
            inner, outer = swept_ring(radius, vessel.length_m, vessel.beam_m)
            if all(outer < other_inner or other_outer < inner for other_inner, other_outer in rings):
                break
        else:
            hull = f"vessel '{vessel.name}' ({vessel.length_m} m × {vessel.beam_m} m)"
            ring = f"radii {least} and {greatest} m in {MAX_DRAWS} draws: widen radius_m or use fewer vessels"
            raise InputError("poses.circular", [f"no free ring for {hull} between {ring}"])
        rings.append((inner, outer))
        radii.append(radius)
    return np.array(radii)


def _uniforms(streams: Streams, vessel: str) -> Iterator[float]:
    """The uniform numbers that the radius of a vessel's circle is drawn from; most vessels need only a few."""
    for first in range(0, MAX_DRAWS, DRAWS_AT_ONCE):
        count = min(DRAWS_AT_ONCE, MAX_DRAWS - first)
        yield from streams.uniforms(Purpose.CIRCLE_RADIUS, vessel, first=first, count=count)[:, 0].tolist()
