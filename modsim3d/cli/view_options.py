"""The options of `modsim3d view`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.core.errors import ModsimError
from modsim3d.io.overwrite_guard import check_not_read, claimed, locked_file
from modsim3d.runs.files.overwrite import read_of_run

if TYPE_CHECKING:
    from modsim3d.runs.stored_run import StoredRun


MIN_WIDTH_PX, MAX_WIDTH_PX = 160, 8192


class Film(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """Content of a film or a picture."""

    detections = "detections"
    scene = "scene"
    ids = "ids"
    corners = "corners"
    map = "map"
    all = "all"


class Style(str, Enum):  # noqa: UP042
    """How a scene looks."""

    shaded = "shaded"
    plain = "plain"


class FilmFormat(str, Enum):  # noqa: UP042
    """File format of a film."""

    mp4 = "mp4"
    gif = "gif"
    png = "png"


FilmOption = Annotated[
    Film | None,
    typer.Option(
        metavar="KIND",
        help="Draw a film, or with --frame a picture: detections, scene, ids, corners, map, or all three side by side.",
    ),
]
Frame = Annotated[
    str | None,
    typer.Option(metavar="STEP|TIME", help="Draw one PNG in place of a film: step 255, or time 51.0 or 51s."),
]
Map = Annotated[bool, typer.Option("--map", help="Draw the scene from above, as PNG, SVG or PDF.")]
At = Annotated[
    str | None,
    typer.Option(metavar="STEP|TIME", help="Step or time that --map shows.", show_default="the last step"),
]
Sheet = Annotated[bool, typer.Option("--sheet", help="Draw contact_sheet.png of the run again, with --overwrite.")]
IdBuffer = Annotated[
    bool,
    typer.Option("--ids", help="With --frame: write the ID at each pixel, as a PNG of 16 bits or, by --out, as .npy."),
]
Cameras = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Camera whose images are drawn; repeatable.", show_default="all cameras"),
]
From = Annotated[float | None, typer.Option("--from", metavar="S", help="Time at which a film begins, in seconds.")]
To = Annotated[float | None, typer.Option("--to", metavar="S", help="Time at which a film ends, in seconds.")]
Every = Annotated[int, typer.Option(min=1, metavar="K", help="Draw every K-th time step only.")]
OnlyWithVessels = Annotated[
    bool, typer.Option("--only-with-vessels", help="Leave out steps with no vessel in an image.")
]
LayerNames = Annotated[
    str | None,
    typer.Option(
        metavar="NAME,...", help="Layers to draw over the image (docs/pictures.md).", show_default="those of the film"
    ),
]
Look = Annotated[
    Style | None,
    typer.Option(
        "--look",
        metavar="LOOK",
        help="How vessels and sea are drawn: shaded or plain.",
        show_default="shaded for scene, plain for detections",
    ),
]
Visibility = Annotated[
    float | None,
    typer.Option(metavar="M", help="Fog with this visibility in metres, in shaded pictures; it changes no detection."),
]
Night = Annotated[bool, typer.Option("--night", help="Darkness, in shaded pictures; it changes no detection.")]
Crop = Annotated[
    str | None,
    typer.Option(
        metavar="X0,Y0,X1,Y1|vessels", help="Part of the image to draw, in pixels, or vessels: where vessels are."
    ),
]
Width = Annotated[
    int | None,
    typer.Option(
        min=MIN_WIDTH_PX,
        max=MAX_WIDTH_PX,
        metavar="PX",
        help="Width of the picture or film in pixels.",
        show_default="1280; several side by side: 1920",
    ),
]
FormatOption = Annotated[
    FilmFormat | None,
    typer.Option(
        "--format",
        metavar="FORMAT",
        help="Format of a film: mp4, gif, or png for a folder of pictures.",
        show_default="by the name in --out, or mp4",
    ),
]
Speed = Annotated[float, typer.Option(metavar="X", help="Seconds of the run that one second of a film shows.")]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Picture or film to write; a folder with --format png.",
        show_default="in the run directory",
    ),
]


# ---- Where `modsim3d view` writes to, and as what ----

FRAME_FILES = "frame_*.png"


def film_format(option: FilmFormat | None, out: Path | None) -> str:
    """The format that `--format` asks for, or the ending of the file's name.

    Raises:
        ModsimError: The two differ, or no film has such an ending.
    """
    ending = "" if out is None or out.is_dir() else out.suffix.lower().removeprefix(".")
    if option is None:
        if ending and ending not in ("mp4", "gif"):
            raise ModsimError(
                f"{out}: films cannot be written as .{ending}; use .mp4, .gif, or --format png with a folder"
            )
        return ending or "mp4"
    if ending in [known.value for known in FilmFormat] and ending != option.value:
        raise ModsimError(f"the ending of {out} contradicts --format {option.value}")
    return option.value


@contextmanager
def claimed_file(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that a picture or a film of a run can be written to a file, and hold its lock.

    Raises:
        ModsimError: Its folder is missing, or it may not be written; see `claimed`.
    """
    _check_parent(path)
    with claimed([path], overwrite=overwrite, inputs=read_of_run(run.folder)):
        yield


@contextmanager
def claimed_folder(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that the PNG files of a film of a run can be written to a folder, and hold its lock.

    Raises:
        ModsimError: It is a file, holds other files than a film's, or holds a film that is not to be overwritten.
    """
    _check_parent(path)
    check_not_read(path, read_of_run(run.folder))
    _check_free_folder(path, overwrite)
    with locked_file(path):
        _check_free_folder(path, overwrite)  # another process may have ended just now
        yield


def _check_free_folder(path: Path, overwrite: bool) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise ModsimError(f"{path} is a file: choose another name with --out")
    entries = list(path.iterdir())
    strange = [entry.name for entry in entries if not entry.match(FRAME_FILES)]
    if strange:
        raise ModsimError(f"{path} holds other files than frames of a film ({strange[0]}): choose another folder")
    if entries and not overwrite:
        raise ModsimError(f"{path} exists: use --overwrite, or another name with --out")


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
