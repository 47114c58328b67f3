"""The options of `modsim3d view`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

LEAST_WIDTH_PX, MOST_WIDTH_PX = 160, 8192


class Film(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """What a film or a picture shows."""

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


class Format(str, Enum):  # noqa: UP042
    """What a film is written as."""

    mp4 = "mp4"
    gif = "gif"
    png = "png"


Run = Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")]
FilmOption = Annotated[Film | None, typer.Option(help="What to show; all: three side by side.")]
Frame = Annotated[
    str | None, typer.Option(metavar="STEP|TIME", help="One PNG in place of a film: 255, or 51.0 or 51s.")
]
Map = Annotated[bool, typer.Option("--map", help="The scene from above, as PNG, SVG or PDF.")]
At = Annotated[str | None, typer.Option(metavar="STEP|TIME", help="When, with --map.", show_default="the last step")]
Sheet = Annotated[bool, typer.Option("--sheet", help="Draw contact_sheet.png again, with --overwrite if it is there.")]
Cameras = Annotated[list[str] | None, typer.Option(help="May be repeated.", show_default="all")]
From = Annotated[float | None, typer.Option("--from", metavar="S", help="First time, in seconds.")]
To = Annotated[float | None, typer.Option("--to", metavar="S", help="Last time, in seconds.")]
Every = Annotated[int, typer.Option(min=1, metavar="K", help="Every K-th step.")]
OnlyWithVessels = Annotated[
    bool, typer.Option("--only-with-vessels", help="Leave out steps with no vessel in an image.")
]
LayerNames = Annotated[
    str | None, typer.Option(metavar="NAME,...", help="Layers to draw.", show_default="those of the film")
]
Look = Annotated[
    Style | None, typer.Option(help="Of scene and detections.", show_default="scene: shaded, detections: plain")
]
Visibility = Annotated[float | None, typer.Option(metavar="M", help="Fog, in shaded pictures; for illustration only.")]
Night = Annotated[bool, typer.Option("--night", help="Dark, in shaded pictures; for illustration only.")]
Crop = Annotated[
    str | None, typer.Option(metavar="X0,Y0,X1,Y1|vessels", help="A part of the image, or where vessels are.")
]
Width = Annotated[
    int | None,
    typer.Option(min=LEAST_WIDTH_PX, max=MOST_WIDTH_PX, help="Of the picture.", show_default="1280; several: 1920"),
]
FormatOption = Annotated[Format | None, typer.Option("--format", show_default="by --out, or mp4")]
Speed = Annotated[float, typer.Option(help="Seconds of the run in one of the film.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that draw; the film stays the same.")]
Out = Annotated[Path | None, typer.Option(help="The file.", show_default="in the run directory")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a file or a film's folder that is there.")]
