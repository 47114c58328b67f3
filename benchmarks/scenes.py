"""The scenes that are timed, as texts: boats far apart (`small`), ships before ships (`dense`), and a thousand boats.

`python -m benchmarks.scenes` writes small.yaml and dense.yaml. Each vessel moves slowly on a straight track, all the
time within the field of view. What it sweeps over is a rectangle that no other vessel's touches, so none ever meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

HERE = Path(__file__).resolve().parent
DETECTOR = "../scenes/detectors/thesis.yaml"
VESSELS = 50
THOUSAND = 1000
SMALL_STEPS, DENSE_STEPS, THOUSAND_STEPS, TIME_STEP_S = 500, 300, 100, 0.2
MIN_DISTANCE_M, MAX_DISTANCE_M = 300.0, 2500.0
SPEEDS_M_S = (0.5, 3.0)
CLEARANCE_M = 1.0
TRIES = 20_000
SMALL_HEIGHT_M, DENSE_HEIGHT_M, THOUSAND_HEIGHT_M = 20.0, 60.0, 120.0  # of the camera; of small with 50 boats
SPREAD_EXPONENT = 0.85  # with it and the seeds below, the boxes of 12 to 13 % of any number of boats overlap another's

FOCAL_PX, IMAGE_PX, THOUSAND_IMAGE_PX = 5000.0, (3600, 2400), (1920, 1080)
HALF_VIEW_RAD = math.atan(IMAGE_PX[0] / 2 / FOCAL_PX)
SEEDS = {25: 7, 50: 0, 100: 4, 200: 4}
DENSE_SEED = 0

SMALL = """\
# {count} boats of 4 to 14 m at 300 to 2500 m, from {height:.3g} m above the sea: some of them overlap each other.
# Written by benchmarks/scenes.py.
"""
DENSE = """\
# {count} vessels of 5 to 300 m at 300 to 2500 m, from {height:.3g} m above the sea: most are hidden in part or wholly.
# Written by benchmarks/scenes.py.
"""
THOUSAND_BOATS = """\
# {count} boats of 4 to 14 m at 300 to 2500 m in an image of 1920 × 1080, from {height:.3g} m above the sea.
# Written by benchmarks/scenes.py.
"""


@dataclass(frozen=True)
class Hull:
    """What a vessel measures, in metres."""

    length: float
    beam: float
    air_draft: float


def small(boats: int = VESSELS) -> str:
    """Boats of 4 to 14 m.

    The camera stands the higher the more boats there are: the strip of sea that it sees then is so much higher in the
    image that the share of boats that overlap each other stays.
    """
    rng = np.random.default_rng(SEEDS.get(boats, 0))
    hulls, height = _boats(boats, rng), SMALL_HEIGHT_M * (boats / VESSELS) ** SPREAD_EXPONENT
    return SMALL.format(count=boats, height=height) + _text("boat", hulls, height, SMALL_STEPS, rng)


def thousand(boats: int = THOUSAND) -> str:
    """A thousand boats of 4 to 14 m, all in one image of 1920 × 1080."""
    rng = np.random.default_rng(0)
    head = THOUSAND_BOATS.format(count=boats, height=THOUSAND_HEIGHT_M)
    hulls = _boats(boats, rng)
    return head + _text("boat", hulls, THOUSAND_HEIGHT_M, THOUSAND_STEPS, rng, THOUSAND_IMAGE_PX)


def _boats(count: int, rng: np.random.Generator) -> list[Hull]:
    return [
        Hull(length, length * rng.uniform(0.30, 0.40), length * rng.uniform(0.25, 0.35))
        for length in rng.uniform(4, 14, count)
    ]


def dense(vessels: int = VESSELS) -> str:
    """Vessels of 5 to 300 m, log-uniform; a 5 m boat is 2 m wide and 1.7 m high, a 300 m ship 45 m either way."""
    rng = np.random.default_rng(DENSE_SEED)
    hulls = [
        Hull(length, 0.62 * length**0.75 * rng.uniform(0.85, 1.15), 0.47 * length**0.8 * rng.uniform(0.8, 1.2))
        for length in np.exp(rng.uniform(math.log(5), math.log(300), vessels))
    ]
    head = DENSE.format(count=vessels, height=DENSE_HEIGHT_M)
    return head + _text("vessel", hulls, DENSE_HEIGHT_M, DENSE_STEPS, rng)


def _text(
    kind: str,
    hulls: Sequence[Hull],
    height_m: float,
    steps: int,
    rng: np.random.Generator,
    image_px: tuple[int, int] = IMAGE_PX,
) -> str:
    duration_s = steps * TIME_STEP_S
    tracks = _tracks(hulls, duration_s, rng)
    names = [f"{kind}{number}" for number in range(1, len(hulls) + 1)]
    lines = [f"steps: {steps}", f"time_step_s: {TIME_STEP_S}", "seed: 0", "vessels:"]
    lines += [
        f"  {name}: {{length_m: {hull.length:.2f}, beam_m: {hull.beam:.2f}, air_draft_m: {hull.air_draft:.2f}, "
        "label: Vessel}"
        for name, hull in zip(names, hulls, strict=True)
    ]
    lines += ["poses:", "  tracks:                              # [time in s, w1, w2]"]
    lines += [
        f"    {name}: [[0, {start[0]:.2f}, {start[1]:.2f}], [{duration_s:g}, {end[0]:.2f}, {end[1]:.2f}]]"
        for name, (start, end) in zip(names, tracks, strict=True)
    ]
    # Between the waterlines of the nearest and the farthest.
    pitch = (math.atan(height_m / MIN_DISTANCE_M) + math.atan(height_m / MAX_DISTANCE_M)) / 2
    return "\n".join(lines) + "\n" + camera_text(height_m, pitch, image_px)


def camera_text(height_m: float, pitch_rad: float, image_px: tuple[int, int] = IMAGE_PX) -> str:
    """The lens of Simulation 1 at the origin, looking along w1; an image of any size is as wide as Simulation 1's."""
    width, height = image_px
    pixel_e5 = IMAGE_PX[0] / width  # hundredths of a millimetre
    return f"""\
cameras:
  C0:                                  # the optics of simulation_1
    focal_length_m: 0.05
    pixel_size_m: [{pixel_e5}e-5, {pixel_e5}e-5]
    principal_point_px: [{width // 2}, {height // 2}]
    image_size_px: [{width}, {height}]
    pose: {{position_m: [0, 0, {height_m:.3f}], roll_rad: 0, pitch_rad: {pitch_rad:.6f}, yaw_rad: 0}}
annotation: {{mode: 2, source: rendered}}
detector: {DETECTOR}
"""


def _tracks(hulls: Sequence[Hull], duration_s: float, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where each vessel starts and ends; the longest are placed first, while there is room."""
    tracks: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    taken = np.empty(0, dtype=object)
    for index in sorted(range(len(hulls)), key=lambda i: -hulls[i].length):
        start, end, lane = _free_track(hulls[index], duration_s, taken, rng)
        tracks[index] = start, end
        taken = np.append(taken, lane)
    return [tracks[index] for index in range(len(hulls))]


def _free_track(
    hull: Hull, duration_s: float, taken: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, shapely.Polygon]:
    for _ in range(TRIES):
        # Log-uniform: uniformly over the sea, most boats would be a few pixels high.
        distance = math.exp(rng.uniform(math.log(MIN_DISTANCE_M), math.log(MAX_DISTANCE_M)))
        bearing, heading = rng.uniform(-HALF_VIEW_RAD, HALF_VIEW_RAD), rng.uniform(-math.pi, math.pi)
        ahead = np.array([math.cos(heading), math.sin(heading)])
        start = distance * np.array([math.cos(bearing), math.sin(bearing)])
        end = start + rng.uniform(*SPEEDS_M_S) * duration_s * ahead
        if not _in_view(start, end, hull):
            continue
        half = hull.length / 2 * ahead
        lane = shapely.LineString([start - half, end + half]).buffer(hull.beam / 2 + CLEARANCE_M, cap_style="square")
        if not shapely.intersects(lane, taken).any():
            return start, end, lane
    raise ValueError(f"no room for a vessel of {hull.length:.0f} m among {len(taken)} others in {TRIES} tries")


def _in_view(start: np.ndarray, end: np.ndarray, hull: Hull) -> bool:
    """Whether a vessel stays at the distances wanted, and with its bounding circle between the image's sides."""
    places = start + np.linspace(0, 1, 11)[:, None] * (end - start)
    distance, bearing = np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0])
    half_angle = np.arcsin(np.minimum(np.hypot(hull.length, hull.beam) / 2 / distance, 1))
    near_enough = (distance >= MIN_DISTANCE_M) & (distance <= MAX_DISTANCE_M)
    return bool((near_enough & (np.abs(bearing) + half_angle <= HALF_VIEW_RAD)).all())


def main() -> None:
    for name, text in (("small", small()), ("dense", dense())):
        (HERE / f"{name}.yaml").write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
