"""tune_trackers: chooses the settings of each tracker for each shipped scene, on seeds that no table uses.

The tracker's own defaults come first, then settings at random from ranges, then the best so far with some of them drawn
anew. Those with the largest mean of HOTA by IoU and HOTA by centre, over the seeds below, are written to
scenes/trackers/NAME.yaml; of trackers in the world, which take longer, those with the least GOSPA in metres over half
of the steps and one detector seed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.tracker_trials import CENTRE, IOU, SCENES, looks, tracks_of, world_tracks_of
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.scores.association import hota_of, sequence
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.world.scoring import score_world

OUT = Path(__file__).resolve().parents[2] / "scenes" / "trackers"
SEEDS = {"fairway": (1001, 1002, 1003)}
"""Traffic seeds of scenes that draw their traffic."""
OTHER_SEED, OTHER_LOOKS = 1001, 2
STEPS = {"fairway": 400, "strait": 300, "harbour": 200, "simulation_1": 500, "simulation_2": 1000, "simulation_3": 600}
DRAWS = 40
REDRAWN = 0.3
"""Share of the best settings that are drawn anew in the second half."""
Range = tuple[float, float] | tuple[int, int] | Sequence[object]
"""Two numbers to draw between, evenly for whole numbers and for shares, else evenly in the logarithm; or values."""
SPACES: dict[str, dict[str, Range]] = {
    "reference": {
        "noise_share": (0.02, 0.3),
        "noise_x_px": (0.5, 60.0),
        "noise_y_px": (0.5, 30.0),
        "velocity_change_px_s": (1.0, 400.0),
        "first_speed_px_s": (5.0, 600.0),
        "start_confidence": (0.2, 0.7),
        "confirm_hits": (1, 5),
        "lost_s": (0.5, 10.0),
        "coast_s": (0.1, 5.0),
    },
    "sort": {
        "lost_s": (0.5, 8.0),
        "minimum_consecutive_frames": (1, 5),
        "minimum_iou_threshold": (-0.6, 0.4),
        "iou": ("iou", "giou", "diou"),
        "state_estimator": ("xyxy", "xcycsr"),
        "boxes": ("detected", "filtered"),
        "coast_s": (0.1, 3.0),
        "track_activation_threshold": (0.2, 0.7),
    },
}
SPACES["bytetrack"] = SPACES["sort"] | {"high_conf_det_threshold": (0.2, 0.7)}
SPACES["ocsort"] = {key: value for key, value in SPACES["sort"].items() if key != "track_activation_threshold"} | {
    "high_conf_det_threshold": (0.2, 0.7),
    "direction_consistency_weight": (0.0, 0.6),
    "delta_t": (1, 8),
}


SPACES["world_gnn"] = {
    "acceleration_density_m2_s3": (0.003, 1.1),
    "speed_sigma_m_s": (1.0, 8.0),
    "waterline_m": (0.0, 10.0),
    "extent_m": (0.5, 12.0),
    "error_scale": (0.7, 2.5),
    "detection_probability": (0.5, 0.98),
    "false_alarms_per_frame": (0.1, 5.0),
    "start_confidence": (0.0, 0.7),
    "start_error": (0.05, 1.1),
    "minimum_detections": (2, 8),
    "tentative_s": (0.3, 3.0),
    "lost_s": (1.0, 10.0),
    "coast_s": (0.2, 4.0),
    "greatest_std_m": (15.0, 80.0),
}
IN_WORLD = ("world_gnn",)
SAME = {"world_jpda": "world_gnn"}
"""Trackers that take the settings of another, which has the same filter and is several times faster."""


def drawn(space: Mapping[str, Range], random: np.random.Generator) -> dict[str, Any]:
    """Settings at random from their ranges, rounded to two digits."""
    found: dict[str, Any] = {}
    for key, (first, *rest) in space.items():
        if isinstance(first, str):
            found[key] = str(random.choice([first, *rest]))
        elif isinstance(first, int):
            found[key] = int(random.integers(first, rest[0] + 1))  # type: ignore[arg-type, operator]
        elif first > 0 and rest[0] > 1:
            found[key] = float(f"{np.exp(random.uniform(np.log(first), np.log(rest[0]))):.2g}")
        else:
            found[key] = float(f"{random.uniform(first, rest[0]):.2g}")  # type: ignore[arg-type]
    return found


def runs_of(scene: str, tracker: str) -> list[RunRows]:
    """The runs that settings are chosen on."""
    share = 2 if tracker in IN_WORLD else 1
    seeds = [(seed, 1) for seed in SEEDS.get(scene, ())] or [(OTHER_SEED, OTHER_LOOKS // share)]
    return [rows for seed, count in seeds for _, rows in looks(scene, seed, count, STEPS[scene] // share)]


def quality(runs: Sequence[RunRows], tracker: str, settings: Mapping[str, object]) -> float:
    """The mean of HOTA by IoU and HOTA by centre over runs, or of GOSPA in metres, below 0."""
    if tracker in IN_WORLD:
        named = named_tracker(tracker, settings, None)
        found = [score_world(rows, world_tracks_of(rows, named)).flat()["gospa_m"] for rows in runs]
        return -float(np.mean([each or 0.0 for each in found]))
    every = [(rows, tracks_of(rows, tracker, settings)) for rows in runs]
    return float(
        np.mean(
            [hota_of(sequence(ScoredRun.of(*each, rules))).hota or 0.0 for each in every for rules in (IOU, CENTRE)]
        )
    )


def chosen(job: tuple[str, str, int]) -> tuple[str, str, dict[str, Any]]:
    """The best settings of a tracker for a scene."""
    scene, tracker, draws = job
    runs, random = runs_of(scene, tracker), np.random.default_rng(0)
    best: dict[str, Any] = {}
    most = first = quality(runs, tracker, best)
    for number in range(draws):
        new = drawn(SPACES[tracker], random)
        if number >= draws // 2:
            new = {key: value if random.random() < REDRAWN else best.get(key, value) for key, value in new.items()}
        if (found := quality(runs, tracker, new)) > most:
            best, most = new, found
    print(f"{tracker} {scene}: {first:.3f} to {most:.3f}", file=sys.stderr, flush=True)
    return scene, tracker, best


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign tune_trackers", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--tracker", choices=[*SPACES, *SAME], nargs="+", default=[*SPACES, *SAME], help="only these trackers"
    )
    parser.add_argument("--draws", type=int, default=DRAWS, help="settings that are tried for each tracker and scene")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for NAME.yaml of each tracker")
    asked = parser.parse_args()
    jobs = [(scene, tracker, asked.draws) for scene in SCENES for tracker in asked.tracker if tracker in SPACES]
    with ProcessPoolExecutor(asked.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = list(pool.map(chosen, jobs))
    asked.out.mkdir(parents=True, exist_ok=True)
    for tracker in filter(SPACES.__contains__, asked.tracker):
        own = {scene: settings for scene, name, settings in found if name == tracker}
        seeds = ", ".join(str(seed) for seed in SEEDS["fairway"])
        best = "mean of HOTA by IoU and by centre (150 px)"
        best = "GOSPA in metres (c = 50 m)" if tracker in IN_WORLD else best
        how = (
            f"the best {best} of {asked.draws} settings of a random search, on "
            f"traffic seeds {seeds} of fairway and on seed {OTHER_SEED} of the other scenes"
        )
        text = yaml.safe_dump({"chosen": how, "scenes": own}, sort_keys=False, width=120)
        head = "# Written by script/campaign tune_trackers; do not edit.\n"
        (asked.out / f"{tracker}.yaml").write_text(head + text, encoding="utf-8")
    for tracker in filter(SAME.__contains__, asked.tracker):
        other = (asked.out / f"{SAME[tracker]}.yaml").read_text(encoding="utf-8")
        said = f"chosen: those of {SAME[tracker]}, "
        (asked.out / f"{tracker}.yaml").write_text(other.replace("chosen: ", said, 1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
