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
        min=LEAST_WIDTH_PX,
        max=MOST_WIDTH_PX,
        metavar="PX",
        help="Width of the picture or film in pixels.",
        show_default="1280; several side by side: 1920",
    ),
]
FormatOption = Annotated[
    Format | None,
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
