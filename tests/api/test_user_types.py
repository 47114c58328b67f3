"""A user's own code that uses the package passes `mypy --strict`, and a misspelt name is found."""

import os
import subprocess
import sys
from pathlib import Path

import modsim3d

USER = """
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import modsim3d


def boxes(name: str) -> list[NDArray[np.float64]]:
    scene: modsim3d.Scene = modsim3d.load_scene(name, steps=2, detector=Path("thesis"))
    return [frame.detections.boxes_px for frame in modsim3d.simulate_frames(scene)]


def detected(scene: modsim3d.Scene) -> int:
    result = modsim3d.run_scene(scene, "runs/a")
    run = modsim3d.open_run(result.folder)
    other = modsim3d.detect_run(run, Path("runs/b"), detector="thesis", seed=7)
    good: bool = modsim3d.verify_run("runs/b").obeys and modsim3d.verify_run(run).obeys
    labels: tuple[str, ...] = modsim3d.load_detector("thesis").labels
    learned = modsim3d.learn_detector(truth="gt.json", detections=["dt.json"], match="centre")
    learned.write(Path("learned.yaml"), overwrite=good)
    seconds: float = next(run.frames()).time_s + len(labels) + len(modsim3d.__version__)
    return result.counts.detected + other.counts.detected + int(seconds)
"""
WRONG = {
    "modsim3d.load_scen('strait')\n": 'Module has no attribute "load_scen"',
    "modsim3d.load_scene(3)\n": 'has incompatible type "int"',
    "modsim3d.learn_detector(run='runs/a', match='iou')\n": "has incompatible type \"Literal['iou']\"",
}
SETTINGS = """
[mypy]
strict = true
follow_imports = skip
[mypy-modsim3d.*,numpy.*]
follow_imports = silent
"""
"""The package's own modules are not reported on, as those of an installed one. Its other dependencies, most of what
there is to read, are left out: nothing that a user writes here has a type of theirs."""


def test_strict_types_hold_for_a_user(tmp_path: Path) -> None:
    wrong = "import modsim3d\n\n" + "".join(WRONG)
    for name, text in (("user.py", USER), ("wrong.py", wrong), ("mypy.ini", SETTINGS)):
        (tmp_path / name).write_text(text)
    paths = {**os.environ, "MYPYPATH": str(Path(modsim3d.__file__).parents[1])}
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--cache-dir", "cache", "user.py", "wrong.py"]
    said = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=paths).stdout
    found = [line for line in said.splitlines() if ": error:" in line]
    assert [line for line in found if "wrong.py" not in line] == []
    for number, words in enumerate(WRONG.values(), 3):
        assert any(f"wrong.py:{number}:" in line and words in line for line in found), said
