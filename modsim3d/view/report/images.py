"""Pictures of the user that a page shows below the boxes: files of a folder, or those of a film."""

import base64
import os
import re
from collections import Counter
from collections.abc import Sequence
from glob import glob
from operator import attrgetter
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import imageio.v3 as iio
import numpy as np
from PIL import Image

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.geometry.camera import Camera
from modsim3d.io.atomic_write import encoded, put_folder_in_place
from modsim3d.io.validation import shown
from modsim3d.runs.selection import Selection
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.films.renderer import open_film_renderer
from modsim3d.view.films.request import PictureRequest
from modsim3d.view.report.overview import VesselOutcome
from modsim3d.view.report.recorder import Recording
from modsim3d.view.sea_and_sky import RenderStyle

KINDS = (".jpg", ".jpeg", ".png", ".webp", ".bmp")
FILM_FILES = "*.jpg"
KEYFRAMES, KEYFRAME_PX = 60, 960  # most pictures of a scene for each camera, and their width
_NAME = attrgetter("name")
_DIGITS = re.compile(r"(\d+)")
_QUALITY = 85


def image_facts(run: StoredRun, images: Path, page: Path, every: int) -> list[dict[str, Any]]:
    """For each camera the pictures' addresses from the page, `files`, and the place among them of what it shows at each
    shown step, `shown`, −1 before its first. Pictures that labels do not name are taken in order, those of several
    cameras in folders called as they are. Raises InputError if there are none, not as many as the camera has frames, or
    not all that labels name."""
    scene, facts, taken = run.scene, [], set[Path]()
    for camera in scene.cameras:
        folder = images if len(scene.cameras) == 1 and not (images / camera.name).is_dir() else images / camera.name
        steps = scene.frame_steps(camera, 0, run.steps)
        names = () if scene.labels is None else scene.labels.sequence(camera.name).images[: len(steps)]
        files = _called(names, images, folder, taken) or _in_order(folder, camera.name, len(steps))
        taken.update(files)
        _check_size(files[0], camera, files[0])
        shown_at = np.searchsorted(steps, np.arange(0, run.steps, every), side="right") - 1
        addresses = [quote(Path(os.path.relpath(file, page.parent)).as_posix()) for file in files]
        facts.append({"files": addresses, "shown": shown_at.tolist()})
    return facts


def keyframe_facts(run: StoredRun, look: RenderStyle, shown: Recording, every: int) -> list[dict[str, Any]]:
    """For each camera, as `image_facts`, pictures of the scene inside the page: of the first frames of misses and of
    detections with faults, at most `KEYFRAMES` of them, evenly.
    Raises RendererError without OpenGL, and ModsimError for a labelled video, of which no scene is known."""
    if run.scene.labels is not None:
        raise ModsimError("--look: a labelled video has no scene to draw; --pictures shows its images")
    request, facts = PictureRequest("scene", (), width=KEYFRAME_PX, look=look), list[dict[str, Any]]()
    for camera, stretches in enumerate(shown.outcomes):
        faults = np.unique(stretches.first[stretches.outcome >= VesselOutcome.WRONG_CLASS])
        chosen = faults[np.linspace(0, len(faults) - 1, min(len(faults), KEYFRAMES)).astype(np.int64)]
        places = np.full(-(-run.steps // every), -1)
        places[chosen] = np.arange(len(chosen))
        files = list[str]()
        if len(chosen):
            steps = tuple((chosen * every).tolist())
            selection = Selection(run, (camera,), steps, np.ones(len(steps)))
            plan = request.plan(selection)
            layout = plan.layout(run.scene)
            (size,) = layout.panel_sizes
            with open_film_renderer(run.scene, plan) as renderer:
                for step in selection.step_frames():
                    sheet = renderer.draw(step).crop((0, layout.head_px, size[0], layout.head_px + size[1]))
                    data = base64.b64encode(encoded(sheet, ".jpg", quality=_QUALITY)).decode("ascii")
                    files.append(f"data:image/jpeg;base64,{data}")
        facts.append({"files": files, "shown": places.tolist()})
    return facts


def _called(names: Sequence[str], images: Path, folder: Path, taken: set[Path]) -> list[Path]:
    """The pictures that labels name, none twice and none that is taken, all found in one way: by the path below
    `images`, by the name there, by the name or by the stem in the camera's folder. Empty if labels do not name files,
    and not all are found. Raises InputError if they do, and one is missing."""
    wanted, best = [_plain(name) for name in names if images.is_dir()], list[Path | None]()
    deep = "**" if any(len(path.parts) > 1 for path in wanted) else "*"
    for place, pattern, key in ((images, deep, str), (images, "*", _NAME), (folder, "*", _NAME), (folder, "*", _stem)):
        within = glob(pattern, root_dir=place, recursive=True)  # noqa: PTH207 - that of Path follows no links to folders
        listed = ((_plain(path), place / path) for path in within)
        pictures = [(key(path), file) for path, file in listed if path.suffix in KINDS and file not in taken]
        count = Counter(name for name, _ in pictures)
        only = {name: file for name, file in pictures if count[name] == 1}
        files = [only.pop(key(path), None) for path in wanted]
        if not best or files.count(None) < best.count(None):
            best = files
    if None in best and any(path.suffix in KINDS for path in wanted):
        first = best.index(None)
        whose = "which labels name" if wanted[first].suffix in KINDS else "an image whose file labels do not name"
        fault = f"has no picture of its own for {shown(names[first])}, {whose} ({best.count(None):,} of {len(best):,})"
        right = "the path below this folder, or the name in it or in the camera's folder, must be that of the labels"
        raise InputError(f"--pictures {images}", [f"{fault}: {right}"])
    return [] if None in best else [file for file in best if file]


def _plain(name: str) -> PurePosixPath:
    """A path to be compared: without case, and with slashes."""
    return PurePosixPath(name.replace("\\", "/").casefold())


def _stem(path: PurePosixPath) -> str:
    return path.stem if path.suffix in KINDS else path.name


def _in_order(folder: Path, camera: str, count: int) -> list[Path]:
    """All pictures of a camera's folder, one for each of its frames, in the order of the numbers in their names."""
    if not folder.is_dir():
        raise InputError(f"--pictures {folder}", ["is no folder of pictures"])
    files = [path for path in folder.iterdir() if path.suffix.lower() in KINDS]
    if not files:
        raise InputError(f"--pictures {folder}", [f"has no pictures ({', '.join(KINDS)})"])
    if len(files) != count:
        fault = f"has {len(files):,} pictures, and camera '{camera}' has {count:,} frames: one for each is needed"
        raise InputError(f"--pictures {folder}", [f"{fault}, or names as those of the labelled images"])
    return sorted(
        files, key=lambda path: [int(piece) if piece.isdigit() else piece for piece in _DIGITS.split(path.name)]
    )


def _check_size(path: Path, camera: Camera, given: Path) -> None:
    try:
        with Image.open(path) as picture:
            width, height = picture.size
    except OSError as error:
        raise InputError(f"--pictures {path}", [f"is no picture ({error})"]) from None
    if (width, height) != tuple(camera.intrinsics.image_size_px):
        wanted = " × ".join(map(str, camera.intrinsics.image_size_px))
        raise InputError(f"--pictures {given}", [f"has {width} × {height} px, and '{camera.name}' {wanted}"])


def film_frames(film: Path, folder: Path, run: StoredRun) -> Path:
    """Write the pictures of a film at the times of a run's frames into a folder, and return it; the film begins with
    the first frame. Raises ModsimError if the run has several cameras, the film cannot be read, is of another size or
    too short, or ffmpeg is not there."""
    scene = run.scene
    if len(scene.cameras) > 1:
        raise ModsimError(f"--pictures {film}: a film is of one camera, and the run has {len(scene.cameras)}")
    (camera,) = scene.cameras
    times_s = scene.times_s(0, run.steps)[scene.frame_steps(camera, 0, run.steps)]
    try:
        rate_hz = float(iio.immeta(film, plugin="FFMPEG")["fps"])
        wanted = np.rint((times_s - times_s[0]) * rate_hz).astype(np.int64).tolist()
        with put_folder_in_place(folder, FILM_FILES) as partial:
            written = 0
            for number, frame in enumerate(iio.imiter(film, plugin="FFMPEG")):
                while written < len(wanted) and wanted[written] == number:
                    written += 1
                    Image.fromarray(frame).save(partial / f"{written:06d}.jpg", quality=_QUALITY)
                if written == len(wanted):
                    break
            if written < len(wanted):
                fault = (
                    f"ends after {number + 1:,} pictures at {rate_hz:g} a second, and the run after {times_s[-1]:g} s"
                )
                raise InputError(f"--pictures {film}", [fault])
            _check_size(partial / "000001.jpg", camera, film)
    except ImportError:
        raise ModsimError("--pictures of a film needs ffmpeg: pip install 'modsim3d[video]'") from None
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        if isinstance(error, ModsimError):
            raise
        raise InputError(f"--pictures {film}", [f"cannot be read as a film ({str(error).splitlines()[0]})"]) from None
    return folder
