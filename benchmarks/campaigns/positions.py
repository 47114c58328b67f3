"""positions: bearing, inverse range and position of detections against the truth, on flat and curved seas.

Each scene's truth is made once; its detector is run over it with one seed after another, and as with errors a fifth as
large, at which positions are given more often. The inertial unit of own ship has the same seed. An error is
what `locate` makes of a detected box less what the true box gives with the true attitude; it is divided by the standard
deviation that `locate` states.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import TRUE
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import horizon_inverse_range, inverse_range
from modsim3d.runs.locating import MAX_RANGE_ERROR, Attitude, Viewpoints, directions, first_order, locate, points_of
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.verify.evidence import CameraEvidence, ManyDetections
from modsim3d.world.vessel_motion import Imu

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SCENES = {"simulation_1": 400, "simulation_2": 400, "simulation_3": 400, "harbour": 400, "strait": 300}
"""Number of steps of each scene."""
SEEDS = 40
UNIT = Imu(attitude_noise_rad=0.003, attitude_bias_rad=0.002, heading_noise_rad=0.005, heading_bias_rad=0.005)
INSIDE, INSIDE_2 = 1.959964, 5.991465
"""95 % of a standard normal number lie within the first, of chi-square with two degrees of freedom below the second."""
SHARES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.26, 0.3)
HORIZONS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
THRESHOLDS = (0.05, 0.1, 0.2, 0.3)
DRAWS = 1_000_000
MIN_GIVEN = 1000
"""Fewer positions say little."""
MAX_MEAN, MAX_STD, COVERAGE, MIN_POSITION = 0.2, 0.1, (0.93, 0.97), 0.92
"""Bounds of the campaign: |mean|, |standard deviation − 1|, coverage of 95 % intervals, and of 95 % ellipses."""


def sharper(model: DetectorModel, share: float) -> DetectorModel:
    """A detector whose box errors are a share of those of another."""
    laws = [state.box_error for state in model.states]
    scaled = [replace(law, mean=share * law.mean, covariance=share**2 * law.covariance) for law in laws]
    states = [replace(state, box_error=law) for state, law in zip(model.states, scaled, strict=True)]
    return replace(model, states=tuple(states))


def samples(scene: Scene, part: CameraEvidence, attitude: Attitude) -> Array:
    """Errors of the true detections of whole boxes of a camera.

    Returns:
        Columns: standardised errors of bearing and inverse range; squared and along-the-ray standardised error of the
        position to first order; standard deviation of the inverse range over it; whether the position is given;
        standardised errors of bearing and inverse range against the vessel's centre; its distance beyond the foot in m,
        and that in half its extent along the ray.
    """
    found, camera = part.detections, next(each for each in scene.cameras if each.name == part.frames.camera)
    rows = np.flatnonzero(found.kind == TRUE)
    true_px = part.targets.boxes_px[found.target[rows]]
    width, height = camera.intrinsics.image_size_px
    whole = (true_px[:, 0] > 0) & (true_px[:, 2] < width) & (true_px[:, 3] < height)
    rows, true_px = rows[whole], true_px[whole]
    steps, vessel = part.frames.steps[found.frame[rows]], part.targets.vessel[found.target[rows]]
    place = locate(scene, camera.name, steps, found.boxes_px[rows], attitude)
    at, frame = np.unique(steps, return_inverse=True)
    view = Viewpoints.of(scene, camera, at, measured=False)
    poses = view.poses()
    poses = CameraPoses(poses.camera_R_world[frame], poses.positions_m[frame])
    bearing, inverse = true_foot(scene, camera, poses, true_px)
    by_bearing = turned(place.bearing_rad - bearing) / place.bearing_std_rad
    by_range = (place.inverse_range_per_m - inverse) / place.inverse_range_std_per_m
    squared, along = position_errors(place, bearing, inverse, poses.positions_m[:, :2])
    centre = view.vessels.poses.positions_m[frame, vessel] - poses.positions_m
    beyond, half = np.hypot(centre[:, 0], centre[:, 1]) - 1 / inverse, half_extents(scene, view, frame, vessel, centre)
    of_centre = turned(place.bearing_rad - np.arctan2(centre[:, 1], centre[:, 0])) / place.bearing_std_rad
    centre_range = place.inverse_range_per_m - 1 / np.hypot(centre[:, 0], centre[:, 1])
    columns = [by_bearing, by_range, squared, along]
    columns += [place.inverse_range_std_per_m / place.inverse_range_per_m, np.isfinite(place.positions_m[:, 0])]
    columns += [of_centre, centre_range / place.inverse_range_std_per_m, beyond, beyond / half]
    return np.column_stack(columns)


def true_foot(scene: Scene, camera: Camera, poses: CameraPoses, boxes_px: Array) -> tuple[Array, Array]:
    """Bearing and inverse range that true boxes give from true poses."""
    seen = directions(camera, poses, points_of(boxes_px))
    horizon = horizon_inverse_range(poses.positions_m[:, 2], curved=scene.sea == "curved")
    return seen[:, 0], inverse_range(seen[:, 1], horizon)


def turned(angle: Array) -> Array:
    """Angles within half a turn."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def position_errors(place: Any, bearing: Array, inverse: Array, cameras_m: Array) -> tuple[Array, Array]:
    """Squared standardised error of every position to first order, given or not, and the part along the ray."""
    deviation = np.stack([place.bearing_std_rad, place.inverse_range_std_per_m], axis=-1)
    covariance = deviation[:, :, None] * deviation[:, None, :]
    covariance[:, 0, 1] = covariance[:, 1, 0] = place.covariance_rad_per_m
    reached = np.where(place.inverse_range_per_m > 0, place.inverse_range_per_m, np.nan)
    positions, spread = first_order(place.bearing_rad, reached, covariance, cameras_m)
    ahead = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    error = positions - cameras_m - ahead / inverse[:, None]
    squared = np.full(len(error), np.inf)  # beyond the horizon there is no position, and so none that is right
    known = np.isfinite(error[:, 0])
    solved = np.linalg.solve(spread[known], error[known][:, :, None])[:, :, 0]
    squared[known] = (error[known] * solved).sum(axis=1)
    along = (error * ahead).sum(axis=1) / np.sqrt(np.einsum("ni,nij,nj->n", ahead, spread, ahead))
    along[~known] = np.inf
    unknown = np.isnan(place.bearing_rad) | np.isnan(place.inverse_range_per_m)
    return np.where(unknown, np.nan, squared), np.where(unknown, np.nan, along)


def half_extents(scene: Scene, view: Viewpoints, frame: Indices, vessel: Indices, away_m: Array) -> Array:
    """Half of each vessel's extent along the ray to it."""
    aspect = np.arctan2(away_m[:, 1], away_m[:, 0]) - view.vessels.poses.headings_rad[frame, vessel]
    sides = np.array([each.extents_m[:2] for each in scene.vessels])[vessel]
    extent: Array = np.abs(np.cos(aspect)) * sides[:, 0] + np.abs(np.sin(aspect)) * sides[:, 1]
    return extent / 2


def look_at(name: str, sea: str, attitude: Attitude, share: float, steps: int, seeds: int) -> dict[str, Any]:
    """A row of the campaign."""
    scene = replace(load_scene(name, steps=steps, source="analytic"), sea=sea)
    scene = replace(scene, detector=sharper(scene.detector, share), imu=UNIT if scene.own_ships else scene.imu)
    many, tables = ManyDetections.of_scene(scene), []
    for seed in range(seeds):
        seeded = replace(scene, seed=seed)  # of the inertial unit; waves and poses stay
        tables += [samples(seeded, part, attitude) for part in many.detect(scene.detector, seed).cameras]
    table = np.concatenate(tables)
    given = table[:, 5] == 1
    return {
        "scene": name,
        "sea": sea,
        "attitude": attitude if scene.own_ships else "ashore",
        "errors": share,
        "bearing": moments(table[:, 0]),
        "inverse_range": moments(table[:, 1]),
        "given": int(given.sum()),
        "inside_given": share_below(table[given, 2], INSIDE_2),
        "short_given": share_below(table[given, 3], -INSIDE),
        "far_given": share_below(-table[given, 3], -INSIDE),
        "inside_others": share_below(table[~given, 2], INSIDE_2),
        "short_others": share_below(table[~given, 3], -INSIDE),
        "far_others": share_below(-table[~given, 3], -INSIDE),
        "thresholds": [at_threshold(table, most) for most in THRESHOLDS],
        "centre_bearing": middle(table[:, 6]),
        "centre_inverse_range": middle(table[:, 7]),
        "centre_beyond_foot_m": median(table[:, 8]),
        "centre_beyond_foot_in_half_extents": median(table[:, 9]),
    }


def at_threshold(table: Array, most: float) -> dict[str, Any]:
    """How many positions would be given up to a share of the range's error, and how good they would be."""
    given = table[(table[:, 4] > 0) & (table[:, 4] <= most)]
    return {
        "share": most,
        "given": len(given),
        "inside": share_below(given[:, 2], INSIDE_2),
        "short": share_below(given[:, 3], -INSIDE),
        "far": share_below(-given[:, 3], -INSIDE),
    }


def moments(values: Array) -> dict[str, Any]:
    """Number, mean, standard deviation and share within ±1.96 of standardised errors."""
    known = values[np.isfinite(values)]
    inside = float(np.mean(np.abs(known) < INSIDE))
    return {"n": len(known), "mean": float(known.mean()), "std": float(known.std()), "inside": inside}


def share_below(values: Array, most: float) -> float | None:
    known = values[~np.isnan(values)]
    return float(np.mean(known < most)) if len(known) else None


def middle(values: Array) -> dict[str, float]:
    """Median of standardised errors, and share within ±1.96: a few may be very large."""
    return {"median": median(values), "inside": moments(values)["inside"]}


def median(values: Array) -> float:
    return float(np.median(values[np.isfinite(values)]))


def position_law(draws: int = DRAWS) -> list[dict[str, float]]:
    """The range from a normal inverse range whose standard deviation is a share of it, to first order."""
    normal, rows = np.random.default_rng(0).standard_normal(draws), []
    for share in SHARES:
        inverse = 1 + share * normal  # in units of the true one
        error = np.where(inverse > 0, (1 / inverse - 1) / (share / inverse**2), np.inf)
        known = error[np.isfinite(error)]
        short, far = float(np.mean(error < -INSIDE)), float(np.mean(error > INSIDE))
        rows.append({"share": share, "mean": float(known.mean()), "short": short, "far": far})
    return rows


def horizon_law(errors: tuple[float, ...] = (0.05, 0.5, 2.0)) -> list[dict[str, float]]:
    """Standardised errors of the inverse range near the horizon of a curved sea, in units of the horizon's."""
    normal, rows = np.random.default_rng(1).standard_normal(DRAWS), []
    one = np.ones(1)
    for distance in HORIZONS:
        for error in errors:
            true = 1 / distance
            flat = true + 1 / true + error * normal  # κ = ρ + 1 / (2 R H ρ), and 2 R H is 1 here
            estimate = inverse_range(flat, np.ones(DRAWS))
            more, less = (inverse_range(flat + side * error, np.ones(DRAWS)) for side in (1, -1))
            rows.append({"distance": distance, "error": error, **moments((estimate - true) * 2 / (more - less))})
    assert float(inverse_range(2 * one, one)[0]) == 1.0
    return rows


def problems(rows: list[dict[str, Any]]) -> list[str]:
    """What is out of bounds."""
    found = []
    for row in rows:
        for key in ("bearing", "inverse_range"):
            seen = row[key]
            good = abs(seen["mean"]) <= MAX_MEAN and abs(seen["std"] - 1) <= MAX_STD
            if not (good and COVERAGE[0] <= seen["inside"] <= COVERAGE[1]):
                found.append(f"{row['scene']}, {row['sea']}, {row['attitude']}, {row['errors']}: {key} {seen}")
        if row["given"] >= MIN_GIVEN and row["inside_given"] < MIN_POSITION:
            found.append(f"{row['scene']}, {row['sea']}, {row['errors']}: positions {row['inside_given']:.3f}")
    return found


def spread(seen: dict[str, Any]) -> str:
    return f"{seen['mean']:+.2f} ± {seen['std']:.2f}, {seen['inside']:.1%}"


def percent(value: float | None) -> str:
    return "–" if value is None else f"{value:.1%}"


def page(data: dict[str, Any]) -> str:
    lines = [
        "# Detections in the world against the truth",
        "",
        "Written by `script/campaign positions`; the same figures are in `positions.json`. "
        "[Positions](../positions.md) says what is measured.",
        "",
        f"True detections of whole boxes, {data['seeds']} seeds of each scene's detector over this traffic only. "
        "*Errors* is the size of its box errors against those of its file. An error is that of the middle and of the "
        "foot of the box against the true box with the true attitude, over the stated standard deviation: mean, "
        "standard deviation, and how many lie within 1.96. *Given* counts the positions, *inside* is the share of "
        "these that have the truth in their 95 % ellipse, and *short / far* how many are nearer and farther than the "
        "truth by more than 1.96 standard deviations along the ray, each 2.5 % if the error were normal. The same of "
        "the *others*, which are not given, as they would have been to first order.",
        "",
        "| Scene | Sea | Attitude | Errors | Detections | Bearing | Inverse range | Given | Inside | Short / far "
        "| Others inside | Short / far |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in data["rows"]:
        seen = [spread(row["bearing"]), spread(row["inverse_range"])]
        lines.append(
            f"| {row['scene']} | {row['sea']} | {row['attitude']} | {row['errors']:g} | "
            f"{row['inverse_range']['n']:,} | {' | '.join(seen)} | {row['given']:,} | {percent(row['inside_given'])} | "
            f"{percent(row['short_given'])} / {percent(row['far_given'])} | {percent(row['inside_others'])} | "
            f"{percent(row['short_others'])} / {percent(row['far_others'])} |"
        )
    lines += [
        "",
        "Against the vessel's centre, which is what a tracker estimates: the foot is the near waterline. *Beyond* is "
        "how far behind the true foot the centre lies, the median in metres and in half the vessel's extent along the "
        "ray. Bearing and inverse range have the median standardised error, and how many lie within 1.96.",
        "",
        "| Scene | Sea | Attitude | Errors | Bearing | Inverse range | Beyond | In half extents |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in data["rows"]:
        pair = (row["centre_bearing"], row["centre_inverse_range"])
        seen = [f"{s['median']:+.2f}, {s['inside']:.1%}" for s in pair]
        lines.append(
            f"| {row['scene']} | {row['sea']} | {row['attitude']} | {row['errors']:g} | {' | '.join(seen)} | "
            f"{row['centre_beyond_foot_m']:.1f} m | {row['centre_beyond_foot_in_half_extents']:.2f} |"
        )
    lines += [
        "",
        "What another threshold of ε would give, on flat seas with the true attitude: how many positions, how many of "
        "them in their 95 % ellipses, and short / far as above.",
        "",
        "| Scene | Errors |" + "".join(f" ε ≤ {share:g} |" for share in THRESHOLDS),
        "|---|---|" + "---|" * len(THRESHOLDS),
    ]
    for row in data["rows"]:
        if row["sea"] == "flat" and row["attitude"] != "measured":
            cells = [
                f"{at['given']:,}: {percent(at['inside'])}, {percent(at['short'])} / {percent(at['far'])}"
                if at["given"] >= MIN_GIVEN
                else f"{at['given']}"
                for at in row["thresholds"]
            ]
            lines.append(f"| {row['scene']} | {row['errors']:g} | {' | '.join(cells)} |")
    lines += [
        "",
        "The range from a normal inverse range, whose standard deviation is a share ε of it, to first order: "
        f"{DRAWS:,} draws. The mean error is in stated standard deviations; *short* and *far* are the shares of errors "
        "beyond 1.96 on either side, 2.5 % if it were normal.",
        "",
        "| ε | Mean | Short | Far |",
        "|---|---|---|---|",
        *(f"| {r['share']:g} | {r['mean']:+.3f} | {r['short']:.2%} | {r['far']:.2%} |" for r in data["position_law"]),
        "",
        "The inverse range near the horizon of a curved sea. Distances are in that of the horizon, errors in its "
        "inverse.",
        "",
        "| Distance | Error | Mean | Standard deviation | Inside |",
        "|---|---|---|---|---|",
    ]
    for row in data["horizon_law"]:
        lines.append(
            f"| {row['distance']:g} | {row['error']:g} | {row['mean']:+.2f} | {row['std']:.2f} | {row['inside']:.1%} |"
        )
    lines += ["", "With " + ", ".join(f"{name} {number}" for name, number in data["versions"].items()) + "."]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign positions", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for positions.md and positions.json")
    asked = parser.parse_args()
    rows = []
    for name, steps in SCENES.items():
        attitudes: tuple[Attitude, ...] = ("true", "measured") if load_scene(name).own_ships else ("true",)
        for share in (1.0, 0.2):
            for sea in ("flat", "curved"):
                rows += [look_at(name, sea, attitude, share, steps, asked.seeds) for attitude in attitudes]
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    data = {
        "format": 1,
        "versions": {"modsim3d": version("modsim3d"), "NumPy": np.__version__},
        "seeds": asked.seeds,
        "most_range_error": MAX_RANGE_ERROR,
        "rows": rows,
        "position_law": position_law(),
        "horizon_law": horizon_law(),
    }
    asked.out.mkdir(parents=True, exist_ok=True)
    (asked.out / "positions.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    (asked.out / "positions.md").write_text(page(data), encoding="utf-8")
    for problem in problems(rows):
        print(problem, file=sys.stderr)
    return int(bool(problems(rows)))


if __name__ == "__main__":
    sys.exit(main())
