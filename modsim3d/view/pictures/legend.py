"""Legends: samples of lines and colours with what they mean, wrapped to the width of the picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from PIL import Image

from modsim3d.runs.counts import Outcome
from modsim3d.view import palette
from modsim3d.view.followed_tracks import TRAIL_S
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import MIN_TEXT_PX, Box, Canvas, font, text_size, words_apart
from modsim3d.view.pictures.frame_picture import draw_detection, draw_tether
from modsim3d.view.pictures.layers import NAMES, Layers

MIN_SHARE, MAX_ROOM = 0.7, 2.0  # how small the text of a crowded legend may become, and how far it may exceed its room
MARKS = (Outcome.MISLABELLED, Outcome.BELOW_HALF_IOU, Outcome.OFF_VESSEL)  # in the order of the legend


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend: a sample of a colour, and what it means."""

    text: str
    colour: Colour
    style: Literal["box", "dashed", "missed", "hatched", "filled", "track"] | Outcome = "box"


def detection_entries(layers: Layers, mode: int, mistakes: Outcome, tracker: str | None = None) -> list[LegendEntry]:
    """The legend of some layers in an annotation mode, with the mistakes that are there and the tracks of a tracker."""
    marks = [mark for mark in MARKS if layers.detections and layers.mistakes and mark & mistakes]
    shown = (
        (layers.truth, LegendEntry("truth", palette.TRUTH)),
        (layers.full and mode == 2, LegendEntry("whole silhouette", palette.TRUTH, "dashed")),
        (layers.visible and mode < 2, LegendEntry("visible part", palette.TRUTH, "dashed")),
        (layers.detections, LegendEntry("detection, in its vessel's colour", palette.VESSELS[0])),
        *((True, LegendEntry(NAMES[mark], palette.VESSELS[0], mark)) for mark in marks),
        (layers.missed, LegendEntry("missed", palette.ALARM, "missed")),
        (layers.false_positives, LegendEntry(NAMES[Outcome.FALSE_POSITIVE], palette.ALARM, Outcome.FALSE_POSITIVE)),
        *((layers.tracks, entry) for entry in _track_entries(tracker)),
        (layers.hatching, LegendEntry("hidden", palette.VESSELS[1], "hatched")),
    )
    return [entry for drawn, entry in shown if drawn]


def _track_entries(tracker: str | None) -> list[LegendEntry]:
    if tracker is None:
        return []
    first = palette.VESSELS[0]
    return [
        LegendEntry(f"# track of {tracker}, in its vessel's colour, with its last {TRAIL_S:g} s", first, "track"),
        LegendEntry("on a vessel that is hidden or not annotated", first, "dashed"),
        LegendEntry("on nothing", palette.ALARM, "dashed"),
    ]


def vessel_entries(names: Mapping[int, str], own_ships: Sequence[int] = ()) -> list[LegendEntry]:
    """The legend of vessels, by their indices in the scene."""
    return [LegendEntry(f"{i + 1}: {name}", palette.vessel_colour(i, own_ships), "filled") for i, name in names.items()]


def id_entries(
    vessels: Mapping[int, str], obstacles: Sequence[str], own_ships: Sequence[int] = ()
) -> list[LegendEntry]:
    """The legend of an ID map with these vessels, by their indices in the scene, and obstacles."""
    land = [
        LegendEntry(f"{letters(i)}: {name}", palette.obstacle_colour(i, name), "filled")
        for i, name in enumerate(obstacles)
    ]
    return [*vessel_entries(vessels, own_ships), *land, LegendEntry("hidden", palette.VESSELS[0], "hatched")]


def letters(index: int) -> str:
    """The letters of an obstacle on an ID map, where vessels have numbers: a to z, aa, ab, ..."""
    rest, last = divmod(index, 26)
    return (letters(rest - 1) if rest else "") + chr(ord("a") + last)


def legend(entries: Sequence[LegendEntry], width: int, text_px: int, room_px: float = np.inf) -> Image.Image:
    """A strip of the given width, as high as its entries need: 0 without any.
    A legend that needs more than `room_px` is set in smaller type. If it then needs more than `MAX_ROOM` times as
    much, the last names are left out and counted; what lines and marks mean is always there."""
    least_px = min(text_px, max(MIN_TEXT_PX, round(MIN_SHARE * text_px)))
    for size in range(text_px, least_px - 1, -1):
        rows = _rows(entries, width, size)
        if len(rows) * _line_px(size) <= room_px:
            break
    names = sum(entry.style == "filled" for entry in entries)
    shown = names
    while shown > 1 and len(rows) * _line_px(size) > MAX_ROOM * room_px:
        shown -= 1
        rows = _rows(_without_last_names(entries, names - shown), width, size)
    line = _line_px(size)
    strip = Image.new("RGB", (width, line * len(rows)), palette.PAPER)
    canvas = Canvas(strip, 85 * size)
    for row, placed in enumerate(rows):
        for left, entry in placed:
            _entry(canvas, entry, left, row * line, size)
    return strip


def _rows(entries: Sequence[LegendEntry], width: int, text_px: int) -> list[list[tuple[int, LegendEntry]]]:
    """The entries of each row of a legend, with their left edges."""
    rows: list[list[tuple[int, LegendEntry]]] = [[]] if entries else []
    x = text_px // 2
    for entry in entries:
        needed = 3 * text_px + text_size(words_apart(entry.text, text_px), text_px)[2]
        if x + needed > width and rows[-1]:
            rows.append([])
            x = text_px // 2
        rows[-1].append((x, entry))
        x += needed + text_px
    return rows


def _without_last_names(entries: Sequence[LegendEntry], count: int) -> list[LegendEntry]:
    """The entries with the number of the last names in place of them."""
    last = [i for i, entry in enumerate(entries) if entry.style == "filled"][-count:]
    more = LegendEntry(f"and {count} more", palette.PAPER, "filled")
    return [more if i == last[0] else entry for i, entry in enumerate(entries) if i not in last[1:]]


def _line_px(text_px: int) -> int:
    return round(1.8 * text_px)


def _entry(canvas: Canvas, entry: LegendEntry, x: int, y: int, text_px: int) -> None:
    chip = (x, y + round(0.35 * text_px), x + 2 * text_px, y + round(1.5 * text_px))
    ground = entry.colour if entry.style == "filled" else palette.SEA
    canvas.draw.rectangle((chip[0], chip[1], chip[2] - 1, chip[3] - 1), fill=ground)
    inset = text_px // 6 + 1
    if entry.style == "hatched":
        for start in range(chip[0], chip[2], 6):
            top = min(start + chip[3] - chip[1] - 1, chip[2] - 1)
            canvas.draw.line((start, chip[3] - 1, top, chip[3] - 1 - (top - start)), fill=entry.colour, width=2)
    elif entry.style != "filled":
        sample = (chip[0] + inset, chip[1] + inset, chip[2] - inset, chip[3] - inset)
        _draw_sample(canvas, sample, entry.colour, entry.style)
    _, high, _, low = text_size("Ag", text_px)
    place = chip[2] + text_px // 2, (chip[1] + chip[3]) // 2 - (high + low) // 2
    canvas.draw.text(place, words_apart(entry.text, text_px), fill=palette.INK, font=font(text_px))


def _draw_sample(canvas: Canvas, box: Box, colour: Colour, style: str | Outcome) -> None:
    x0, y0, x1, y1 = box
    if style == "missed":
        canvas.brackets((x0 + 3, y0 + 3, x1 - 3, y1 - 3), colour, 1.0)
    elif style == "dashed":
        canvas.dashed_box(box, colour, 0.75, 4.0)
    elif style == "track":
        canvas.box(box, colour, 2.0)
        canvas.segments(np.array([[[(x0 + x1) / 2, (y0 + y1) / 2], [x1 + 4, y1 - 3]]]), colour, 1.0)
    elif style == Outcome.OFF_VESSEL:
        side = (x1 - x0) / 4
        vessel = (x1 - side, y0, x1, y0 + side)
        canvas.box(vessel, palette.TRUTH, 0.75)
        draw_tether(canvas, (x0, y0 + side, x1 - 1.5 * side, y1), vessel)
    elif isinstance(style, Outcome):
        draw_detection(canvas, box, colour, style, 1.0)
    else:
        canvas.box(box, colour, 1.0)
