"""Pictures of the user that a page shows below the boxes: files of a folder, or those of a film."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import imageio.v3 as iio
import numpy as np
from PIL import Image

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene

KINDS = (".jpg", ".jpeg", ".png", ".webp", ".bmp")
_DIGITS = re.compile(r"(\d+)")
_QUALITY = 85


def image_facts(run: StoredRun, images: Path, page: Path, every: int) -> list[dict[str, Any]]:
    """For each camera the pictures' addresses from the page, `files`, and the place among them of what it shows at each
    shown step, `shown`, −1 before its first. Pictures of several cameras are in folders called as they are. Raises
    InputError if there are none, or not as many as the camera has frames."""
    scene, found = run.scene, []
    for camera in scene.cameras:
        folder = images if len(scene.cameras) == 1 and not (images / camera.name).is_dir() else images / camera.name
        taken = scene.frame_steps(camera, 0, run.steps)
        files = _of_frames(_pictures(folder), scene, camera.name, len(taken), folder)
        size = _size(files[0])
        if size != tuple(camera.intrinsics.image_size_px):
            wanted = " × ".join(map(str, camera.intrinsics.image_size_px))
            raise InputError(f"--pictures {files[0]}", [f"has {size[0]} × {size[1]} px, and '{camera.name}' {wanted}"])
        shown = np.searchsorted(taken, np.arange(0, run.steps, every), side="right") - 1
        addresses = [quote(Path(os.path.relpath(file, page.parent)).as_posix()) for file in files]
        found.append({"files": addresses, "shown": shown.tolist()})
    return found


def _pictures(folder: Path) -> list[Path]:
    """The pictures of a folder, in the order of the numbers in their names."""
    if not folder.is_dir():
        raise InputError(f"--pictures {folder}", ["is no folder of pictures"])
    files = [path for path in folder.iterdir() if path.suffix.lower() in KINDS]
    if not files:
        raise InputError(f"--pictures {folder}", [f"has no pictures ({', '.join(KINDS)})"])
    return sorted(files, key=lambda path: [int(each) if each.isdigit() else each for each in _DIGITS.split(path.name)])


def _of_frames(files: list[Path], scene: Scene, camera: str, count: int, folder: Path) -> list[Path]:
    """The picture of each of a camera's frames: by the names of its labelled images if all are there, else in order."""
    by_name = {name: path for path in files for name in (path.name, path.stem)}
    names = () if scene.labels is None else scene.labels.sequence(camera).images
    if names and all(name in by_name for name in names):
        return [by_name[name] for name in names]
    if len(files) < count:
        told = f"has {len(files):,} pictures, and camera '{camera}' has {count:,} frames: one for each is needed"
        raise InputError(f"--pictures {folder}", [told])
    return files[:count]


def _size(path: Path) -> tuple[int, int]:
    try:
        with Image.open(path) as picture:
            return picture.size
    except OSError as error:
        raise InputError(f"--pictures {path}", [f"is no picture ({error})"]) from None


def film_frames(film: Path, folder: Path, progress: Callable[[int], None] = lambda frames: None) -> Path:
    """Write the frames of a film as pictures into a folder, and return it. Raises ModsimError if the film cannot be
    read, or ffmpeg is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        for number, frame in enumerate(iio.imiter(film, plugin="FFMPEG"), 1):
            Image.fromarray(frame).save(folder / f"{number:06d}.jpg", quality=_QUALITY)
            progress(1)
    except ImportError:
        raise ModsimError("--pictures of a film needs ffmpeg: pip install 'modsim3d[video]'") from None
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"--pictures {film}", [f"cannot be read as a film ({error})"]) from None
    return folder
