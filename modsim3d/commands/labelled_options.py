"""Options of the commands that read labelled sets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.errors import InputError

if TYPE_CHECKING:
    from modsim3d.formats.reading.builder import ReadOptions

ImageSizeOption = Annotated[
    str | None,
    typer.Option(metavar="W,H", help="Size of the images in pixels, for YOLO and for MOT without seqinfo.ini."),
]
FrameRateOption = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Frames per second, for MOT without seqinfo.ini and for COCO videos."),
]
ConfidenceScaleOption = Annotated[
    str | None,
    typer.Option(metavar="LOW,HIGH", help="Confidences in the files that stand for 0 and for 1, such as 0,100."),
]
HorizonOption = Annotated[
    str | None,
    typer.Option(metavar="ROW", help="Row of the horizon in images that do not say theirs, or X1,Y1,X2,Y2."),
]
SkipBadOption = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out wrong entries of the files, and say how many.")
]


def read_options(
    labels: str | None,
    image_size: str | None,
    skip_bad: bool,
    frame_rate: float | None,
    category_offset: int = 0,
    confidence_scale: str | None = None,
    horizon: str | None = None,
) -> ReadOptions:
    """What options say of labelled sets.

    Raises:
        InputError: A size, a frame rate, a scale or a horizon is none.
    """
    from modsim3d.formats.horizon import parse_horizon
    from modsim3d.formats.reading.builder import ReadOptions

    if frame_rate is not None and not 0 < frame_rate < math.inf:
        raise InputError("--frame-rate", [f"must be above 0 (got {frame_rate:g})"])
    size_px = None if image_size is None else _size_px(image_size)
    names = tuple(part.strip() for part in labels.removesuffix(",").split(",")) if labels else ()
    if "" in names:
        raise InputError(
            "--labels", [f"the name {names.index('') + 1} is empty, so others would move (got '{labels}')"]
        )
    scale = None if confidence_scale is None else _scale(confidence_scale)
    line = None if horizon is None else parse_horizon(horizon)
    return ReadOptions(names, size_px, skip_bad, frame_rate, category_offset, scale, line)


def _scale(text: str) -> tuple[float, float]:
    """Both ends of a text such as `0,100`."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        low, high = math.nan, math.nan
    if not -math.inf < low < high < math.inf:
        raise InputError("--confidence-scale", [f"must be LOW,HIGH, two numbers that rise, as 0,100 (got '{text}')"])
    return low, high


def _size_px(text: str) -> tuple[float, float]:
    """Width and height of a text such as `1920,1080`."""
    try:
        width, height = (float(part) for part in text.replace("x", ",").split(","))
    except ValueError:
        raise InputError("--image-size", [f"must be W,H in pixels, as 1920,1080 (got '{text}')"]) from None
    if not (width > 0 and height > 0):
        raise InputError("--image-size", [f"both sides must be above 0 (got '{text}')"])
    return width, height
