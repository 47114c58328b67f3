"""Hand-made scenes: a level camera at the origin, 10 m above the sea, with 1000 px focal length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modsim3d.annotate.outlines import Outlines, outline
from modsim3d.camera import Intrinsics, Mount, poses_ashore
from modsim3d.vessels import Vessel

CAMERA_HEIGHT_M = 10.0
INTRINSICS = Intrinsics((1000.0, 1000.0), (400.0, 300.0), (800, 600))


def vessel(name: str, length: float = 10.0, beam: float = 10.0, height: float = 10.0) -> Vessel:
    return Vessel(name, "Vessel", length, beam, height)


def outlines_of(
    places: Sequence[tuple[Vessel, tuple[float, float], float]],
    intrinsics: Intrinsics = INTRINSICS,
    mount: Mount | None = None,
) -> Outlines:
    """Outlines of vessels given as (vessel, (w1, w2), heading) at one step."""
    positions = np.array([[[*place, 0.0] for _, place, _ in places]])
    headings = np.array([[heading for _, _, heading in places]])
    mount = mount or Mount((0.0, 0.0, CAMERA_HEIGHT_M))
    vessels = [vessel for vessel, _, _ in places]
    present = np.ones((1, len(places)), dtype=bool)
    return outline(intrinsics, poses_ashore(mount, 1), vessels, present, positions, headings)


def random_places(
    rng: np.random.Generator, count: int, near_m: float = 15.0, far_m: float = 3000.0
) -> list[tuple[Vessel, tuple[float, float], float]]:
    """Vessels of 2 to 200 m anywhere in front of the camera, with bounding circles that do not touch."""
    places: list[tuple[Vessel, tuple[float, float], float]] = []
    circles: list[tuple[NDArray[np.float64], float]] = []
    while len(places) < count:
        length = float(np.exp(rng.uniform(np.log(2), np.log(200))))
        beam, height = length * rng.uniform(0.15, 0.5), length * rng.uniform(0.1, 0.6)
        distance, bearing = np.exp(rng.uniform(np.log(near_m), np.log(far_m))), rng.uniform(-0.6, 0.6)
        centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
        radius = np.hypot(length, beam) / 2
        clear = all(np.hypot(*(centre - other)) > radius + r for other, r in circles)
        if clear and distance > radius + 5:
            circles.append((centre, radius))
            name = f"v{len(places)}"
            places.append((vessel(name, length, beam, height), tuple(centre), float(rng.uniform(-np.pi, np.pi))))
    return places
