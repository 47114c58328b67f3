"""A picture of a film: what is true, and what the pretrained detector found."""

from __future__ import annotations

import json
import tempfile
from itertools import islice
from pathlib import Path

from PIL import ImageDraw

from benchmarks.stand_in.films import Film, all_films, pictures
from benchmarks.stand_in.rungs import MIN_CONFIDENCE
from benchmarks.stand_in.stored import STORED, restore_films
from modsim3d.view import palette
from modsim3d.view.pictures.canvas import font, text_size

FILM, STEP = "harbour_clear_137", 60
TOP, BOTTOM = 120, 480
"""Rows of the image that are shown: little happens in the sky and in the water near the camera."""
_TEXT_PX, _PAD = 13, 2


def draw_example(file: Path, name: str = FILM, step: int = STEP, stored: Path = STORED) -> None:
    """Draw a step of a film: truth in white, what was found with its confidence in vermilion."""
    with tempfile.TemporaryDirectory(prefix="modsim3d-film-") as folder:
        film = next(film for film in all_films(Path(folder)) if film.name == name)
        restore_films(Path(folder), [film], stored)
        picture, _ = next(islice(pictures(film.scene(), film.weather), step, None))
        truth, found = _boxes(film, step)
    draw = ImageDraw.Draw(picture)
    for x, y, width, height in truth:
        draw.rectangle((x, y, x + width, y + height), outline=palette.WHITE, width=1)
    for (x, y, width, height), confidence in found:
        draw.rectangle((x, y, x + width, y + height), outline=palette.ALARM, width=2)
        text = f"{confidence:.2f}"
        left, top, right, bottom = text_size(text, _TEXT_PX)
        above = y - (bottom - top) - 2 * _PAD
        draw.rectangle((x, above, x + right - left + 2 * _PAD, y), fill=palette.ALARM)
        draw.text((x + _PAD - left, above + _PAD - top), text, fill=palette.WHITE, font=font(_TEXT_PX))
    picture.crop((0, TOP, picture.width, BOTTOM)).save(file)


Box = list[float]


def _boxes(film: Film, step: int) -> tuple[list[Box], list[tuple[Box, float]]]:
    """True boxes at a step, and those that were found with their confidence, the least sure first."""
    truth = json.loads(film.truth.read_text(encoding="utf-8"))
    image = truth["images"][step]["id"]
    true = [each["bbox"] for each in truth["annotations"] if each["image_id"] == image]
    real = json.loads(film.real.read_text(encoding="utf-8"))
    found = [(each["bbox"], each["score"]) for each in real if each["image_id"] == image]
    return true, sorted((each for each in found if each[1] >= MIN_CONFIDENCE), key=lambda each: each[1])
