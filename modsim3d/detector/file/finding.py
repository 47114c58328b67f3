"""Which file a detector's path or name stands for."""

from __future__ import annotations

import os
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.validation import nearest, shown
from modsim3d.paths import StrPath, as_path


def shipped_detectors() -> dict[str, Path]:
    """Detector files that come with the package, by names such as `thesis` and `conditions/foggy_cloudy`."""
    folder = data_folder("scenes") / "detectors"
    files = [*folder.glob("*.yaml"), *folder.glob("conditions/*.yaml")]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in sorted(files)}


def find_detector(detector: StrPath) -> Path:
    """The detector file that a path or the name of a shipped detector stands for.

    A file comes before a name. What has an ending is a path, also where there is no such file.

    Raises:
        InputError: It is neither a file nor a name.
        TypeError: It is neither text nor a path.
    """
    path = as_path(detector, "detector", "a path or the name of a shipped detector")
    name, shipped = os.fspath(detector), shipped_detectors()
    try:
        exists = path.exists() and not (path.is_dir() and name in shipped)
    except OSError as error:
        raise InputError(f"detector {shown(name)}", [f"cannot be read: {error.strerror}"]) from None
    if exists or path.suffix or path.is_absolute():
        return path
    if name not in shipped:
        problem = f"no such file, and no shipped detector has this name ({nearest(name, shipped)})"
        raise InputError(f"detector {path}", [problem])
    return shipped[name]
