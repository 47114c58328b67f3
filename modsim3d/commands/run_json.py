"""What `modsim3d run --json` and `modsim3d detect --json` say of a finished run."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.commands.run_summary import run_warnings
from modsim3d.commands.terminal import tell
from modsim3d.commands.truth_summary import truth_warnings

if TYPE_CHECKING:
    from modsim3d.other_truth.detect_truth import TruthResult
    from modsim3d.runs.run import RunResult
    from modsim3d.scene.scene import Scene

FORMAT = 1


def run_json(command: str, scene: Scene, result: RunResult, sheet: bool) -> dict[str, Any]:
    """The result of a run; whatever `RunResult` and `Counts` have is in it."""
    return {
        "format": FORMAT,
        "command": command,
        "scene": scene.name,
        "cameras": [camera.name for camera in scene.cameras],
        "mode": scene.annotation.mode,
        "traffic_seed": scene.traffic_seed,
        "counts": asdict(result.counts),
        **asdict(result),
        "contact_sheet": result.folder / "contact_sheet.png" if sheet else None,
        "warnings": run_warnings(scene, result),
    }


def truth_json(result: TruthResult) -> dict[str, Any]:
    """The result of `detect --truth`."""
    return {
        "format": FORMAT,
        "command": "detect",
        "folder": result.folder,
        "kind": result.kind,
        "counts": asdict(result.counts),
        "sequence_counts": {name: asdict(counts) for name, counts in result.sequence_counts.items()},
        "occlusion": result.occlusion,
        "notes": result.notes,
        "warnings": truth_warnings(result),
        "seconds": result.seconds,
        "written": result.files,
    }


def tell_backend(folder: Path) -> None:
    """Tell which OpenGL drew the truth of a run, if that is asked for."""
    from modsim3d.runs.files.replacing import RUN_FILE, read_json

    tell("OpenGL", str(read_json(folder / RUN_FILE)["backend"]))
