"""The contents of a film's pictures (kinds, cameras, parts of their images, layers), and its sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import intersections
from modsim3d.core.errors import ModsimError
from modsim3d.runs.counts import NOTHING_WRONG, Outcome, faults_of
from modsim3d.runs.selection import Selection
from modsim3d.scene.scene import Scene
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.map_marks import BirdsEye
from modsim3d.view.map_picture import map_height_px
from modsim3d.view.pictures.canvas import (
    MIN_TEXT_PX,
    NOMINAL_PX,
    TEXT_PX,
    Box,
    Label,
    Window,
    font,
    text_size,
    words_apart,
)
from modsim3d.view.pictures.layers import CORNERS, DETECTIONS, MAP, SCENE, Layers, MapLayers
from modsim3d.view.pictures.legend import LegendEntry, detection_entries, id_entries, legend, vessel_entries
from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

GAP_PX = 4
KEY_SHARE = 0.12  # height of the legend, as a share of what is above it, from which on it is set smaller
INSET_LINES = 3.4  # height of a strip beside an inset, in sizes of its text
SEVERAL = 0.7  # however narrow a panel, its text is as large as in one of this share of the sheet


@dataclass(frozen=True, eq=False)
class FilmLayout:
    """The places of everything on the sheet; its sides are even, as films need them."""

    width: int  # of the whole sheet in pixels
    columns: int  # number of panels side by side
    aspects: tuple[float, ...]  # width over height of each panel, row by row
    entries: tuple[LegendEntry, ...]  # of the legend at the bottom
    enlarged: float = 1.0  # size of text and lines, as a multiple of the usual one
    insets: bool = False  # whether a small picture says where in the image each panel is

    @property
    def text_px(self) -> int:
        """Size of the text around the panels."""
        return max(MIN_TEXT_PX, round(self.enlarged * TEXT_PX * self.width / NOMINAL_PX))

    @property
    def head_px(self) -> int:
        """Height of the lines at the top, beside the inset of a single panel."""
        return round((INSET_LINES if self.insets and len(self.aspects) == 1 else 2) * self.text_px)

    @property
    def title_px(self) -> int:
        """Height of the titles above a row of panels, beside their insets; a single panel has none."""
        return round((INSET_LINES if self.insets else 1.7) * self.text_px) if len(self.aspects) > 1 else 0

    @property
    def inset_px(self) -> tuple[int, int]:
        """Width and height that an inset may have."""
        height = self.title_px or self.head_px
        return min(2 * height, self.panel_width // 3), height - 4

    @property
    def nominal_width(self) -> int:
        """Width of the picture for which lines and text of a panel are meant; at least its own, if not enlarged."""
        return round(self.enlarged * max(self.panel_width, SEVERAL * self.width))

    @property
    def panel_width(self) -> int:
        """Width of each panel."""
        return (self.width - (self.columns - 1) * GAP_PX) // self.columns

    @property
    def panel_sizes(self) -> list[tuple[int, int]]:
        """Width and height of each panel in pixels."""
        return [(self.panel_width, max(1, round(self.panel_width / aspect))) for aspect in self.aspects]

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        sizes, places, y = self.panel_sizes, [], self.head_px
        for first in range(0, len(sizes), self.columns):
            row = sizes[first : first + self.columns]
            y += self.title_px
            places += [(i * (self.panel_width + GAP_PX), y) for i in range(len(row))]
            y += max(height for _, height in row) + GAP_PX
        return places

    @cached_property
    def _blank(self) -> Image.Image:
        bottom = max(y + height for (_, y), (_, height) in zip(self._places, self.panel_sizes, strict=True))
        key = legend(self.entries, self.width, self.text_px, KEY_SHARE * bottom)
        height = bottom + key.height
        sheet = Image.new("RGB", (self.width, height + height % 2), palette.PAPER)
        if key.height:
            sheet.paste(key, (0, bottom))
        return sheet

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole sheet in pixels; both are even."""
        return self._blank.size

    def compose(
        self,
        head: Sequence[str],
        titles: Sequence[str],
        panels: Sequence[Image.Image],
        insets: Sequence[Image.Image | None] = (),
    ) -> Image.Image:
        """One picture of the film, from the parts of its head, and from pictures of the sizes `panel_sizes` with their
        insets, if they have some; a single panel shows no title."""
        sheet, single = self._blank.copy(), not self.title_px
        inset_px = max((inset.width for inset in insets if inset is not None), default=0)
        strip = _strip(tuple(head), (self.width, self.head_px), self.text_px, self.width - inset_px * single)
        sheet.paste(strip, (0, 0))
        for place, (title, panel, (x, y)) in enumerate(zip(titles, panels, self._places, strict=True)):
            sheet.paste(panel, (x, y))
            if not single:
                size = self.panel_width, self.title_px
                sheet.paste(_strip((title,), size, self.text_px, size[0]), (x, y - self.title_px))
            if insets and (inset := insets[place]) is not None:
                sheet.paste(inset, (x + self.panel_width - inset.width, y - inset.height - 2))
        return sheet


@lru_cache(maxsize=64)
def _strip(parts: tuple[str, ...], size: tuple[int, int], text_px: int, room_px: int) -> Image.Image:
    """A strip of paper with texts beside each other, or below each other where there is no room, cut at its right end;
    most stay for a whole film."""
    strip, lines = Image.new("RGB", size, palette.PAPER), list(parts[:1])
    for part in parts[1:]:
        longer = f"{lines[-1]}    {part}"
        fits = text_size(words_apart(longer, text_px), text_px)[2] + text_px <= room_px
        lines[-1:] = [longer] if fits or (len(lines) + 1.3) * 1.3 * text_px > size[1] else [lines[-1], part]
    top = (size[1] - 1.3 * text_px * len(lines)) / 2
    for place, line in enumerate(lines):
        at = text_px // 2, round(top + 1.3 * text_px * place)
        ImageDraw.Draw(strip).text(at, words_apart(line, text_px), fill=palette.INK, font=font(text_px))
    return strip


KINDS = ("detections", "scene", "ids", "corners", "map")
PLAN_KINDS = ("detections", "map")  # side by side
ALL = ("detections", "scene", "ids")
TITLES = {"detections": "truth and detections", "ids": "who is at each pixel", "corners": "projected corners"}
"""Titles of panels whose kind's name says too little."""
MAX_COLUMNS = 3
WIDTH_PX, SEVERAL_WIDTH_PX = 1280, 1920
CLOSE_UP_ASPECT, CLOSE_UP_PX = 1.6, 100.0  # width over height, and the least width in pixels of the image
TOLD_APART = 12  # so many vessels are told apart by their colours; more have numbers
MIN_CROP = 0.02  # share of an image that is shown around vessels, however small they are
MIN_ASPECT, MAX_ASPECT = 4 / 3, 3.2  # of the part of an image shown around vessels, if the image is not smaller
STACKED_FROM = 2.4  # panels of this aspect lie below each other


@dataclass(frozen=True, eq=False)
class CloseUp:
    """A vessel, or a track on nothing, that a film follows with an arrow at it. Nothing else has a label."""

    boxes_px: Mapping[int, Box]  # by step, of one size
    captions: Mapping[int, str]  # by step
    vessel: str | None  # name; None of a track on nothing
    tracks: frozenset[int]  # numbers of the tracks that it is about, which alone are drawn

    def wanted(self, label: Label) -> bool:
        """Whether a label is about it."""
        return label.vessel == self.vessel is not None or label.text in {f"#{number}" for number in self.tracks}


@dataclass(frozen=True, eq=False)
class FilmPlan:
    """Content of every picture of a film."""

    kinds: tuple[str, ...]  # some of `KINDS`, shown side by side
    cameras: tuple[int, ...]  # indices into the scene's cameras
    width: int  # of the whole picture in pixels
    layers: Layers | None = None  # of the kinds with boxes; each kind's own if None
    crops_px: tuple[Box | None, ...] = ()  # part of each camera's image that is shown; all of it if None
    style: RenderStyle = PLAIN_STYLE  # of `scene`
    boxes_on_scene: bool = False  # whether `detections` has the boxes in this style, not on plain sea and sky
    steps: int = 0  # of the run, for the tracks of a map
    columns: int | None = None  # panels side by side; those of a camera, or the cameras, if None
    mistakes: Outcome = NOTHING_WRONG  # wrong detections in the pictures, for the legend; see `mistakes_in`
    tracks: FollowedTracks | None = None  # of a tracker, for pictures with the layer `tracks`; none if None
    close_up: CloseUp | None = None  # what the pictures of the one camera follow, in place of a crop
    vessels: tuple[int, ...] | None = None  # in the pictures, for the legend; all if None; see `vessels_in`
    enlarged: float = 1.0  # size of text and lines, for a picture that a page shows smaller than it is
    key: bool = True  # whether there is a legend
    map_layers: MapLayers = MAP  # of a map
    world_tracks: WorldTracks | None = None  # of a tracker, for maps

    def layers_of(self, kind: str) -> Layers:
        """The layers of a kind."""
        scene = replace(SCENE, numbers=self.vessels is not None and len(self.vessels) > TOLD_APART)
        return self.layers or {"detections": DETECTIONS, "corners": CORNERS, "scene": scene}[kind]

    def panels(self) -> list[tuple[int, str]]:
        """Place of the camera in `cameras`, and kind, of each panel."""
        panels = [(place, kind) for place in range(len(self.cameras)) for kind in self.kinds]
        return [panel for panel in panels if panel[1] != "map" or panel[0] == 0]  # one map has all cameras

    def birds_eye(self, scene: Scene) -> BirdsEye:
        """Content of the map."""
        return BirdsEye(scene, self.steps, self.cameras, self.map_layers, self.world_tracks)

    def layout(self, scene: Scene) -> FilmLayout:
        """The places of panels and legend."""
        entries: list[LegendEntry] = []
        if "detections" in self.kinds:
            layers, tracker = self.layers_of("detections"), self.tracks.name if self.tracks else None
            entries += detection_entries(layers, scene.annotation.mode, self.mistakes, tracker)
        indices = range(len(scene.vessels)) if self.vessels is None else self.vessels
        names = {index: scene.vessel_names[index] for index in indices}
        if "ids" in self.kinds:
            entries += id_entries(names, [obstacle.name for obstacle in scene.obstacles], scene.own_ships)
        elif set(self.kinds) & {"scene", "corners"}:
            entries += vessel_entries(names, scene.own_ships)
        panels = self.panels()
        several = len(self.kinds) if len(self.kinds) > 1 else min(len(panels), MAX_COLUMNS)
        aspects = tuple(self._aspect(scene, place, kind) for place, kind in panels)
        shown = tuple(entries) if self.key else ()
        return FilmLayout(self.width, self.columns or several, aspects, shown, self.enlarged, self.insets)

    @property
    def insets(self) -> bool:
        """Whether a small picture says where in the image each panel is."""
        return self.close_up is not None or any(crop is not None for crop in self.crops_px)

    def _aspect(self, scene: Scene, place: int, kind: str) -> float:
        if kind == "map":
            return self.width / map_height_px(self.birds_eye(scene), self.width)
        x0, y0, x1, y1 = self._shown(scene, place)
        return CLOSE_UP_ASPECT if self.close_up else (x1 - x0) / (y1 - y0)

    def _shown(self, scene: Scene, place: int) -> Box:
        width, height = scene.cameras[self.cameras[place]].intrinsics.image_size_px
        return (self.crops_px and self.crops_px[place]) or (0.0, 0.0, float(width), float(height))

    def window(self, scene: Scene, place: int, size: tuple[int, int], step: int) -> Window:
        """The part of a camera's image that its panel shows at a step."""
        if self.close_up is not None:
            image_size_px = scene.cameras[self.cameras[place]].intrinsics.image_size_px
            return Window.around(self.close_up.boxes_px[step], image_size_px, size, CLOSE_UP_PX)
        x0, y0, x1, _ = self._shown(scene, place)
        return Window(x0, y0, size[0] / (x1 - x0), size)


def mistakes_in(selection: Selection) -> Outcome:
    """Faults of any detection in the frames of a selection."""
    return faults_of(frame for step in selection.step_frames() for frame in filter(None, step.frames))


def vessels_in(selection: Selection, crops_px: Sequence[Box | None] = ()) -> tuple[int, ...]:
    """Indices of the vessels that any picture of a selection shows, or of parts of its cameras' images.
    A vessel that carries a camera counts if it has a mesh, since its bow may be seen."""
    scene = selection.run.scene
    carriers = {scene.cameras[index].mount.vessel for index in selection.cameras}
    indices = {index for index, vessel in enumerate(scene.vessels) if vessel.name in carriers and vessel.has_mesh}
    numbers = {name: index for index, name in enumerate(scene.vessel_names)}
    crops = crops_px or (None,) * len(selection.cameras)
    for step in selection.step_frames():
        for frame, crop in zip(step.frames, crops, strict=True):
            if frame is not None:
                shown = np.array(crop or (0.0, 0.0, *frame.image_size_px))
                inside = intersections(frame.truth.full_boxes_px, shown) > 0
                indices |= {numbers[frame.truth.vessels[row]] for row in np.flatnonzero(inside)}
    return tuple(sorted(indices))


def crop_to_vessels(selection: Selection) -> tuple[Box, ...]:
    """The part of each camera's image in which vessels and their detections are, over all steps."""
    boxes: list[list[Array]] = [[np.empty((0, 4))] for _ in selection.cameras]
    for step in selection.step_frames():
        for parts, frame in zip(boxes, step.frames, strict=True):
            if frame is not None:
                true = [vessel is not None for vessel in frame.detections.vessels]
                parts += [frame.truth.full_boxes_px, frame.detections.boxes_px[np.array(true, dtype=bool)]]
    scene = selection.run.scene
    return tuple(
        part_around(np.concatenate(parts), scene.cameras[index].intrinsics.image_size_px)
        for index, parts in zip(selection.cameras, boxes, strict=True)
    )


def part_around(boxes_px: Array, image_size_px: tuple[int, int], margin: float = 0.15, least: float = MIN_CROP) -> Box:
    """The part of an image of some width and height around boxes, shape (n, 4); all of it if there are none.
    `margin` is what is shown beside the boxes, as a share of what they fill, `least` what is shown of the image however
    small the boxes are, as a share of it."""
    size = np.array(image_size_px, dtype=np.float64)
    low, high = (boxes_px[:, :2].min(axis=0), boxes_px[:, 2:].max(axis=0)) if len(boxes_px) else (0 * size, size)
    width, height = np.minimum((1 + margin) * (high - low) + least * size, size)
    shown = np.minimum([max(width, height * MIN_ASPECT), max(height, width / MAX_ASPECT)], size)
    corner = np.clip((low + high - shown) / 2, 0, size - shown)
    (x, y), (right, bottom) = corner.tolist(), (corner + shown).tolist()
    return x, y, right, bottom


def parse_crop(selection: Selection, text: str) -> tuple[Box, ...]:
    """Parse a part of every camera's image from `x_min,y_min,x_max,y_max` in pixels; any other text is an error."""
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError:
        raise ModsimError(
            f"--crop {text}: give four numbers of pixels, x_min,y_min,x_max,y_max, or the word vessels or none"
        ) from None
    for index in selection.cameras:
        camera = selection.run.scene.cameras[index]
        width, height = camera.intrinsics.image_size_px
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise ModsimError(f"--crop {text} is not inside {camera.name}'s image of {width} × {height} px")
    return ((x0, y0, x1, y1),) * len(selection.cameras)


MIN_RATE = 5  # frames per second; slower films show frames several times, as some players stumble over long frames
SAME_S = 1e-6  # steps that differ by less are of the same length


@dataclass(frozen=True, eq=False)
class Timetable:
    """A film's pace: pictures a second, and how many show each frame (0 if the film is too fast for it), shape (n,)."""

    rate: Fraction
    repeats: Indices

    @property
    def duration_s(self) -> float:
        """Length of the film in seconds."""
        return float(int(self.repeats.sum()) / self.rate)

    @classmethod
    def of(cls, durations_s: Array, speed: float, most_rate: int) -> Timetable:
        """The pace of frames that stand for given durations in the run, positive, shape (n,), at `speed` seconds of the
        run in one second of the film.
        Steps of one length, at a rate from `MIN_RATE` to `most_rate` pictures a second, give one picture a frame.
        Otherwise each picture shows the frame that is due at its time."""

        film_s = durations_s / speed
        shortest = float(film_s.min())
        repeats = max(1, int(np.ceil(MIN_RATE * shortest - SAME_S)))
        rate = min(Fraction(repeats / shortest).limit_denominator(1000), Fraction(most_rate))
        if np.ptp(film_s) <= SAME_S and repeats / shortest <= most_rate + SAME_S:
            return cls(rate, np.full(len(film_s), repeats))
        ends = np.rint(np.cumsum(film_s) * float(rate)).astype(np.int64)
        ends[-1] = max(ends[-1], 1)
        return cls(rate, np.diff(ends, prepend=0))
