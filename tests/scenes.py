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


def random_view(rng: np.random.Generator) -> tuple[Intrinsics, Mount]:
    """A camera of any kind: wide or long lens, skewed, non-square pixels, rolled, pitched, near the water or high."""
    width, height = int(rng.integers(200, 1600)), int(rng.integers(150, 1200))
    focal = float(np.exp(rng.uniform(np.log(0.4), np.log(12)))) * width
    intrinsics = Intrinsics(
        focal_px=(focal, focal * rng.uniform(0.6, 1.6)),
        principal_point_px=(width * rng.uniform(0.2, 0.8), height * rng.uniform(0.2, 0.8)),
        image_size_px=(width, height),
        skew=rng.choice([0.0, rng.normal(0, 0.1) * focal]),
        near_clip_m=float(rng.choice([0.1, 1.0, 5.0])),
    )
    mount = Mount(
        (0.0, 0.0, float(np.exp(rng.uniform(np.log(1.0), np.log(150.0))))),
        roll_rad=rng.choice([0.0, rng.uniform(-np.pi, np.pi), rng.normal(0, 0.05)]),
        pitch_rad=rng.normal(0.02, 0.1),
        yaw_rad=rng.uniform(-np.pi, np.pi),
    )
    return intrinsics, mount


def random_scene(
    rng: np.random.Generator,
) -> tuple[list[tuple[Vessel, tuple[float, float], float]], Intrinsics, Mount]:
    """1 to 40 disjoint boxes of 2 to 400 m at 5 m to 10 km, crowded into the view, some abeam or behind the camera."""
    intrinsics, mount = random_view(rng)
    half_view = np.arctan(intrinsics.image_size_px[0] / 2 / intrinsics.focal_px[0])
    spread = rng.uniform(0.1, 1.2) * half_view if rng.random() < 0.8 else np.pi
    places: list[tuple[Vessel, tuple[float, float], float]] = []
    hulls: list[tuple[NDArray[np.float64], float]] = []
    wanted = int(rng.integers(1, 41))
    for _ in range(20 * wanted):
        if len(places) == wanted:
            break
        length = float(np.exp(rng.uniform(np.log(2), np.log(400))))
        beam, height = length * rng.uniform(0.1, 0.6), length * rng.uniform(0.05, 0.6)
        distance = float(np.exp(rng.uniform(np.log(5), np.log(10_000))))
        bearing = mount.yaw_rad + rng.uniform(-spread, spread)
        centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
        radius = float(np.hypot(length, beam)) / 2
        if distance > radius + 0.5 and all(np.hypot(*(centre - c)) > radius + r for c, r in hulls):
            hulls.append((centre, radius))
            heading = float(rng.choice([0.0, rng.uniform(-np.pi, np.pi)]))
            places.append((vessel(f"v{len(places)}", length, beam, height), (centre[0], centre[1]), heading))
            if rng.random() < 0.15:  # a twin that touches it side by side, nothing between
                side = centre + beam * np.array([-np.sin(heading), np.cos(heading)])
                if all(np.hypot(*(side - c)) > radius + r for c, r in hulls[:-1]) and np.hypot(*side) > radius + 0.5:
                    hulls.append((side, radius))
                    twin = vessel(f"v{len(places)}", length, beam, height * rng.uniform(0.5, 1.5))
                    places.append((twin, (side[0], side[1]), heading))
    return places, intrinsics, mount
