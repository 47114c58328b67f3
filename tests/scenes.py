"""Hand-made scenes: a level camera at the origin, 10 m above the sea, with 1000 px focal length."""

import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml
from numpy.typing import NDArray

from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.io.input_files import data_folder
from modsim3d.render.id_pass import Region
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import PixelMasks
from modsim3d.truth.crosscheck.comparison import mask_of
from modsim3d.truth.crosscheck.drawing import Drawing, vessel_triangles
from modsim3d.truth.outlines import Outlines, outline
from modsim3d.truth.rendered import rendered_spans
from modsim3d.truth.silhouettes import Spans
from modsim3d.world.bodies import Obstacle, obstacle_bodies, placed, vessel_bodies
from modsim3d.world.vessels import Vessel, shoebox

CAMERA_HEIGHT_M = 10.0
INTRINSICS = Intrinsics((1000.0, 1000.0), (400.0, 300.0), (800, 600))
Place = tuple[Vessel, tuple[float, float], float]
Box = tuple[Vessel, tuple[float, float, float], float]
"""A vessel, the centre of its bottom plane (on the sea for a place, anywhere for a box), and its heading."""


def vessel(name: str, length: float = 10.0, beam: float = 10.0, height: float = 10.0) -> Vessel:
    return Vessel(name, "Vessel", length, beam, height)


def crate(size_m: Sequence[float], place: tuple[float, float], heading_rad: float = 0.0) -> Obstacle:
    """A box as an obstacle on the sea, by the centre of its bottom."""
    return Obstacle("crate", (placed(shoebox(), np.array(size_m), np.array([*place, 0.0]), heading_rad),))


def outlines_at(boxes: Sequence[Box], intrinsics=INTRINSICS, mount=None, obstacles=(), **options) -> Outlines:
    """Outlines of vessels at any height, and of obstacles, at one step, with the options of `outline`."""
    positions = np.array([[place for _, place, _ in boxes]], dtype=np.float64).reshape(1, -1, 3)
    headings = np.array([[heading for _, _, heading in boxes]])
    camera = poses_ashore(mount or Mount((0.0, 0.0, CAMERA_HEIGHT_M)), 1)
    vessels, present = [box[0] for box in boxes], np.ones((1, len(boxes)), dtype=bool)
    bodies = vessel_bodies(vessels, present, positions, world_R_vehicle(headings))
    return outline(intrinsics, camera, bodies + obstacle_bodies(obstacles, len(boxes), 1), **options)


def outlines_of(places: Sequence[Place], *view: Any, **options: Any) -> Outlines:
    """Outlines of vessels on the sea at one step, with the options of `outlines_at`."""
    return outlines_at([(each, (*place, 0.0), heading) for each, place, heading in places], *view, **options)


def harbour_of_shoeboxes(**options) -> Scene:
    """The shipped harbour with a shoebox in place of each mesh: crowded, and exact geometry tells all of it."""
    data = yaml.safe_load((data_folder("scenes") / "harbour.yaml").read_text(encoding="utf-8"))
    for vessel in data["vessels"].values():
        del vessel["mesh"]
    return Scene.from_dict({**data, "detector": "thesis"}, **options)


def drawing_of(places: Sequence[Place], intrinsics=INTRINSICS, mount=None, supersample=1) -> Drawing:
    """The cross-check's drawing of what `outlines_of` projects."""
    camera = poses_ashore(mount or Mount((0.0, 0.0, CAMERA_HEIGHT_M)), 1)
    present, positions = np.ones(len(places), dtype=bool), np.array([[*place, 0.0] for _, place, _ in places])
    headings = np.array([heading for _, _, heading in places])
    triangles = vessel_triangles([each for each, _, _ in places], present, positions, world_R_vehicle(headings))
    return Drawing.of(triangles, camera.camera_R_world[0], camera.positions_m[0], intrinsics, supersample)


def pixel_masks(outlines: Outlines, intrinsics: Intrinsics, renderer, row: int, supersample=1) -> PixelMasks:
    """The pixels of one vessel, a row of the outlines, from whole images."""
    size = intrinsics.image_size_px[0] * supersample, intrinsics.image_size_px[1] * supersample
    region = Region.around(outlines.boxes_px[row] * supersample, size)
    spans = _spans(outlines, intrinsics, renderer, supersample)
    return PixelMasks(region, *(mask_of(each.take(each.row == row), region) for each in spans))


@lru_cache(maxsize=1)
def _spans(*view: Any) -> tuple[Spans, Spans]:
    return rendered_spans(*view, full=True)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _clear(centre: NDArray[np.float64], radius: float, hulls: Sequence[tuple[NDArray[np.float64], float]]) -> bool:
    """Whether a circle touches none of others."""
    return all(math.dist(centre, other) > radius + r for other, r in hulls)


def random_places(rng: np.random.Generator, count: int, near_m: float = 15.0, far_m: float = 3000.0) -> list[Place]:
    """Vessels of 2 to 200 m anywhere in front of the camera, with bounding circles that do not touch."""
    places: list[Place] = []
    circles: list[tuple[NDArray[np.float64], float]] = []
    while len(places) < count:
        length = _log_uniform(rng, 2, 200)
        beam, height = length * rng.uniform(0.15, 0.5), length * rng.uniform(0.1, 0.6)
        distance, bearing = _log_uniform(rng, near_m, far_m), rng.uniform(-0.6, 0.6)
        centre, radius = distance * np.array([np.cos(bearing), np.sin(bearing)]), float(np.hypot(length, beam)) / 2
        if _clear(centre, radius, circles) and distance > radius + 5:
            circles.append((centre, radius))
            boat = vessel(f"v{len(places)}", length, beam, height)
            places.append((boat, tuple(centre), float(rng.uniform(-np.pi, np.pi))))
    return places


def random_view(rng: np.random.Generator) -> tuple[Intrinsics, Mount]:
    """A camera of any kind: wide or long lens, skewed, non-square pixels, rolled, pitched, near the water or high."""
    width, height = int(rng.integers(200, 1600)), int(rng.integers(150, 1200))
    focal = _log_uniform(rng, 0.4, 12) * width
    focal_px = focal, focal * rng.uniform(0.6, 1.6)
    middle_px = width * rng.uniform(0.2, 0.8), height * rng.uniform(0.2, 0.8)
    skew, near_m = rng.choice([0.0, rng.normal(0, 0.1) * focal]), float(rng.choice([0.1, 1.0, 5.0]))
    intrinsics = Intrinsics(focal_px, middle_px, (width, height), skew=skew, near_clip_m=near_m)
    height_m, rolls_rad = _log_uniform(rng, 1.0, 150.0), [0.0, rng.uniform(-np.pi, np.pi), rng.normal(0, 0.05)]
    roll_rad, pitch_rad, yaw_rad = rng.choice(rolls_rad), rng.normal(0.02, 0.1), rng.uniform(-np.pi, np.pi)
    return intrinsics, Mount((0.0, 0.0, height_m), roll_rad=roll_rad, pitch_rad=pitch_rad, yaw_rad=yaw_rad)


def random_scene(rng: np.random.Generator) -> tuple[list[Place], Intrinsics, Mount]:
    """1 to 40 disjoint boxes of 2 to 400 m at 5 m to 10 km, crowded into the view, some abeam or behind the camera."""
    intrinsics, mount = random_view(rng)
    half_view = np.arctan(intrinsics.image_size_px[0] / 2 / intrinsics.focal_px[0])
    spread = rng.uniform(0.1, 1.2) * half_view if rng.random() < 0.8 else np.pi
    places: list[Place] = []
    hulls: list[tuple[NDArray[np.float64], float]] = []
    wanted = int(rng.integers(1, 41))
    for _ in range(20 * wanted):
        if len(places) == wanted:
            break
        length = _log_uniform(rng, 2, 400)
        beam, height = length * rng.uniform(0.1, 0.6), length * rng.uniform(0.05, 0.6)
        distance, bearing = _log_uniform(rng, 5, 10_000), mount.yaw_rad + rng.uniform(-spread, spread)
        centre, radius = distance * np.array([np.cos(bearing), np.sin(bearing)]), float(np.hypot(length, beam)) / 2
        if distance > radius + 0.5 and _clear(centre, radius, hulls):
            hulls.append((centre, radius))
            heading = float(rng.choice([0.0, rng.uniform(-np.pi, np.pi)]))
            places.append((vessel(f"v{len(places)}", length, beam, height), (centre[0], centre[1]), heading))
            if rng.random() < 0.15:  # a twin that touches it side by side, nothing between
                side = centre + beam * np.array([-np.sin(heading), np.cos(heading)])
                if _clear(side, radius, hulls[:-1]) and np.hypot(*side) > radius + 0.5:
                    hulls.append((side, radius))
                    twin = vessel(f"v{len(places)}", length, beam, height * rng.uniform(0.5, 1.5))
                    places.append((twin, (side[0], side[1]), heading))
    return places, intrinsics, mount


def moved(places: Sequence[Place], mount: Mount, turn_rad: float, shift_m) -> tuple[list[Box], Mount]:
    """World and camera turned about w3, then shifted: nothing that the camera sees has changed."""
    turn = world_R_vehicle(turn_rad)
    boxes = [(v, tuple(turn @ [*place, 0.0] + shift_m), heading + turn_rad) for v, place, heading in places]
    position = turn @ np.array(mount.position_m) + shift_m
    return boxes, replace(mount, position_m=tuple(position), yaw_rad=mount.yaw_rad + turn_rad)


def mirrored(places: Sequence[Place], intrinsics: Intrinsics, mount: Mount) -> tuple[list[Place], Intrinsics, Mount]:
    """World and camera in a mirror along w1 and w3: the image has its left and right exchanged."""
    w1, w2, w3 = mount.position_m
    a1, a2 = intrinsics.principal_point_px
    lens = replace(intrinsics, principal_point_px=(intrinsics.image_size_px[0] - a1, a2), skew=-intrinsics.skew)
    camera = replace(mount, position_m=(w1, -w2, w3), roll_rad=-mount.roll_rad, yaw_rad=-mount.yaw_rad)
    return [(v, (place[0], -place[1]), -heading) for v, place, heading in places], lens, camera


def cyclic_beams() -> tuple[list[Box], Mount]:
    """Three beams, one along each axis of the world, each in front of the next, seen along their axis of symmetry."""
    long, thick = 8.0, 1.0
    boxes: list[Box] = [
        (vessel("x", long, thick, thick), (0.0, 1.0, -1.0 - thick / 2), 0.0),
        (vessel("y", thick, long, thick), (-1.0, 0.0, 1.0 - thick / 2), 0.0),
        (vessel("z", 1, 1, long), (1.0, -1.0, -long / 2), 0.0),
    ]
    return boxes, Mount((20.0, 20.0, 20.0), pitch_rad=float(np.arctan(np.sqrt(0.5))), yaw_rad=-3 * np.pi / 4)


def camera_keys(width_px: int = 800, height_px: int = 600, **keys: Any) -> dict[str, Any]:
    """Keys of a camera of a scene file: a focal length of 1000 px about the middle of the image, unless keys differ."""
    size = {"principal_point_px": [width_px // 2, height_px // 2], "image_size_px": [width_px, height_px]}
    return {"focal_length_m": 0.01, "pixel_size_m": [1e-5, 1e-5], **size, **keys}


def rectangles(centres_m: NDArray[np.float64], headings_rad: NDArray[np.float64], sizes_m: Any) -> NDArray[np.object_]:
    """Polygons on the sea by centre, shape (..., 2), heading, and length and beam, shape (..., 2)."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * np.asarray(sizes_m)[..., None, :]
    turns = world_R_vehicle(headings_rad)[..., :2, :2]
    return shapely.polygons(corners @ np.swapaxes(turns, -1, -2) + centres_m[..., None, :])


def footprints(scene: Scene, steps: NDArray[np.int64]) -> NDArray[np.object_]:
    """Polygons of the vessels' rectangles on the sea, shape (S, V)."""
    poses, sizes = scene.poses.poses(0, scene.steps), [vessel.extents_m[:2] for vessel in scene.vessels]
    return rectangles(poses.positions_m[steps][..., :2], poses.headings_rad[steps], sizes)


Boats = Mapping[str, tuple[Sequence[float], Sequence[Sequence[float]]]]


def write_scene(folder: Path, boats: Boats, steps: int | None, **keys: object) -> Path:
    """A scene file: this module's camera, and boats as name → (length, beam and air draft; waypoints [time, w1, w2],
    none at all for a boat without a track); a step a second. `steps` is None where the poses say it. Keys of the scene
    come beside these or in their place; None leaves a key out."""
    shutil.copy(data_folder("scenes") / "detectors" / "thesis.yaml", folder / "detector.yaml")
    keys_of_size = ("length_m", "beam_m", "air_draft_m")
    sizes = {name: dict(zip(keys_of_size, size, strict=True)) for name, (size, _) in boats.items()}
    scene = {
        **{"steps": steps, "time_step_s": 1.0},
        "vessels": {name: {**size, "label": "Vessel"} for name, size in sizes.items()},
        "poses": {"tracks": {name: track for name, (_, track) in boats.items() if track}},
        "cameras": {"C0": camera_keys(pose={"position_m": [0, 0, CAMERA_HEIGHT_M]})},
        **{"annotation": {"mode": 2}, "detector": "detector.yaml", **keys},
    }
    path = folder / "scene.yaml"
    given = {key: value for key, value in scene.items() if value is not None}
    path.write_text(json.dumps(given), encoding="utf-8")  # which is YAML too
    return path


def crossing(folder: Path, steps: int = 12, **keys: object) -> Path:
    """A ship that crosses close by and hides, one after the other, a boat wholly and another in part; keys as those of
    `write_scene`."""
    boats = {
        "boat": ([10, 4, 3], [[0, 250, 10], [100, 250, 12]]),
        "sail": ([12, 4, 16], [[0, 200, -10], [100, 202, -10]]),
        "ship": ([60, 10, 12], [[0, 75, 60], [10, 140, -60]]),
    }
    return write_scene(folder, boats, steps, **keys)


CLASSES = {"sailboat": "sailboat", "ferry": "ferry", "container_ship": "ferry"}
"""Of the strait's vessels; all others are motorboats."""


def mistaken_strait(folder: Path, steps: int = 130) -> Path:
    """The strait before a detector that makes every kind of mistake; written into the folder."""
    scenes = data_folder("scenes")
    detector = yaml.safe_load((scenes / "detectors" / "rich.yaml").read_text(encoding="utf-8"))
    mistakes = {"duplicates": 0.05, "splits": 0.2, "split_aspect": 2.5, "merges": 1.0, "merge_overlap": 0.05}
    detector["false_positives"] |= mistakes
    detector["states"]["clear"]["false_discovery_rate"] = detector["states"]["haze"]["false_discovery_rate"] = 0.3
    for state, variance in (("clear", 30), ("haze", 400)):
        covariance = np.diag([variance, variance / 4, variance, variance / 4]).tolist()
        detector["states"][state]["box_error"] = {"unit": "px", "mean": [0, 0, 0, 0], "covariance": covariance}
    (folder / "detector.yaml").write_text(yaml.safe_dump(detector), encoding="utf-8")
    scene = yaml.safe_load((scenes / "strait.yaml").read_text(encoding="utf-8"))
    for name, values in scene["vessels"].items():
        values["label"] = CLASSES.get(name, "motorboat")
        values.pop("mesh", None)
    scene |= {"steps": steps, "detector": "detector.yaml", "annotation": {"mode": 2, "source": "analytic"}}
    path = folder / "mistakes.yaml"
    path.write_text(yaml.safe_dump(scene), encoding="utf-8")
    return path


def random_rafts(rng: np.random.Generator) -> tuple[list[Place], Intrinsics, Mount]:
    """1 to 4 rafts of 2 to 6 boats with faces in one plane: side by side or astern, overlapping, touching or apart."""
    intrinsics, mount = random_view(rng)
    half_view = np.arctan(intrinsics.image_size_px[0] / 2 / intrinsics.focal_px[0])
    places: list[Place] = []
    hulls: list[tuple[NDArray[np.float64], float]] = []
    for _ in range(int(rng.integers(1, 5))):
        length, distance = float(np.exp(rng.uniform(1, 4))), _log_uniform(rng, 20, 2000)
        beam, height = length * rng.uniform(0.15, 0.5), length * rng.uniform(0.1, 0.6)
        bearing, heading = mount.yaw_rad + rng.uniform(-0.8, 0.8) * half_view, float(rng.uniform(-np.pi, np.pi))
        count, overlap = int(rng.integers(2, 7)), float(rng.choice([0.1, 0.1, 0.0, 1.0, -0.01]))
        along, across = rng.permutation([1.0 - overlap, 0.0])
        radius = count * length
        centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
        if distance < radius + 1 or any(math.dist(centre, c) < radius + r for c, r in hulls):
            continue
        hulls.append((centre, radius))
        for i in rng.permutation(count):
            at = centre + world_R_vehicle(heading)[:2, :2] @ [along * length * i, across * beam * i]
            air = height * rng.choice([1.0, 1.0, rng.uniform(0.5, 1.5)])
            places.append((vessel(f"v{len(places)}", length, beam, air), (at[0], at[1]), heading))
    order = rng.permutation(len(places))
    return [places[i] for i in order], intrinsics, mount
