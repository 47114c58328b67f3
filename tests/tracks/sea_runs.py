"""A run with a straight-line encounter that can be worked out by hand, and tracks of it as CSV.

Own ship makes 5 m/s along w1 and looks ahead. `crosser` begins 120 m ahead and 60 m to starboard and makes 4 m/s along
w2. `astern` follows own ship, and no camera sees it. `anchored` lies 200 m ahead, own ship does not get there, and
the crosser hides it for a moment.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from tests.run_folders import finished
from tests.scenes import camera_keys

STEPS, STEP_S = 60, 0.5
TIMES_S = np.arange(STEPS) * STEP_S
OWN, CROSSER, ASTERN, ANCHORED = range(4)
NAMES = ("own", "crosser", "astern", "anchored")
ORIGIN = (63.4, 10.4)
VELOCITIES_M_S = np.array([(5.0, 0.0), (0.0, 4.0), (5.0, 0.0), (0.0, 0.0)])
STARTS_M = np.array([(0.0, 0.0), (120.0, -60.0), (-80.0, 10.0), (200.0, 20.0)])
PLACES_M = STARTS_M + TIMES_S[:, None, None] * VELOCITIES_M_S  # (steps, vessels, 2)


def sea_scene(**keys: Any) -> Scene:
    """The scene; keys of the scene file replace its own."""
    hull = {"length_m": 12, "beam_m": 4, "air_draft_m": 6, "label": "boat"}
    headings = np.tile([0.0, np.pi / 2, 0.0, 0.0], (STEPS, 1))
    ahead = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02}
    data: dict[str, Any] = {
        "seed": 1,
        "vessels": dict.fromkeys(NAMES, hull),
        "poses": {"positions_m": PLACES_M, "headings_rad": headings, "time_step_s": STEP_S},
        "cameras": {"bow": camera_keys(1280, 720, focal_length_m=0.008, mount=ahead)},
        "annotation": {"mode": 0, "source": "analytic"},
        "detector": "coastal",
        "origin": {"latitude_deg": ORIGIN[0], "longitude_deg": ORIGIN[1]},
    }
    return Scene.from_dict({key: value for key, value in (data | keys).items() if value is not None}, name="sea")


def sea_run(folder: Path, **keys: Any) -> StoredRun:
    return finished(sea_scene(**keys), folder)


def write_csv(path: Path, columns: Mapping[str, Any]) -> Path:
    lines = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
