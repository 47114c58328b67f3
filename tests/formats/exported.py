"""A run with what an export may stumble over, and its cameras' truth as `trackeval` would be given it by a tracker.

Two cameras with images of their own size, one of them slow and late; classes with names that no file can have; frames
with nothing in them; boxes that the image's edge cuts; vessels that others hide.
"""

from pathlib import Path

import yaml

from modsim3d.io.input_files import data_folder
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.scene.reading import load_scene
from tests.scenes import write_scene

LABELS = ("sailing boat", "Fähre/ro-ro, gross", "RIB")
STEPS = 40
# Size, label and track of each; the names stand in no file that a tracker may read.
VESSELS = {
    "Zephyrine": ((12, 4, 16), LABELS[0], [[5, 200, -50], [39, 200, 60]]),
    "Quokka": ((60, 10, 12), LABELS[1], [[10, 75, 60], [22, 140, -70]]),
    "Xanthippe": ((10, 4, 3), LABELS[2], [[5, 250, 10], [39, 250, 12]]),
    "Jabberwocky": ((9, 3, 3), LABELS[2], [[5, 30, 40], [30, 60, -60]]),
}


def exported_run(folder: Path, **annotation: object) -> StoredRun:
    detector = yaml.safe_load((data_folder("scenes") / "detectors" / "rich.yaml").read_text(encoding="utf-8"))
    detector["labels"] = list(LABELS)
    (folder / "rich.yaml").write_text(yaml.safe_dump(detector), encoding="utf-8")
    sides = ("length_m", "beam_m", "air_draft_m")
    hulls = {name: {**dict(zip(sides, size, strict=True)), "label": kind} for name, (size, kind, _) in VESSELS.items()}
    lens = {"focal_length_m": 0.01, "pixel_size_m": [2e-5, 2e-5]}
    wide = {"principal_point_px": [200, 150], "image_size_px": [400, 300], "pose": {"position_m": [0, 0, 10]}}
    late = {"principal_point_px": [160, 100], "image_size_px": [320, 201], "frame_rate_hz": 0.4, "start_offset_s": 3}
    late["pose"] = {"position_m": [20, -90, 6], "yaw_rad": 0.9}
    placed = {name: (size, track) for name, (size, _, track) in VESSELS.items()}
    keys = {"vessels": hulls, "cameras": {"name": lens | wide, "quay.2": lens | late}, "detector": "rich.yaml"}
    path = write_scene(folder, placed, STEPS, annotation={"mode": 2, "source": "rendered"} | annotation, **keys)
    return open_run(run_scene(load_scene(path), folder / "run").folder)
