"""The scene from above as a picture, after Jessen & Mohr (2023), Figures 9.2, 9.6 and 9.10."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import put_in_place
from modsim3d.view import map_marks, plan_marks
from modsim3d.view.map_names import MapNames

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
WIDTH_IN = 10.0  # a map is laid out at this width, so that text and lines grow with the picture
FURNITURE, INNER = (0.13, 0.08), (0.92, 0.7)
"""Height of title, axis and key, and width of the map, as shares of the picture's width: the first of a wide map, with
its key below it, the second of a high one, with its key beside it."""
SEA = "#eaf1f5"
Mark = map_marks.VesselMark | map_marks.CameraMark | plan_marks.PlanMarks | plan_marks.WorldTrackMarks


def check_matplotlib() -> None:
    """Raise a ModsimError if matplotlib, which draws maps, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ModsimError("maps need matplotlib: pip install 'modsim3d[view]'") from None


def check_map(path: Path) -> None:
    """Raise a ModsimError if no map can be written to a path: for its ending, its folder, or want of matplotlib."""
    if path.suffix.lower() not in FORMATS:
        raise ModsimError(f"{path}: the name of a map must end in {', '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
    check_matplotlib()


class Map:
    """A map whose vessels and cameras can be moved to any step of a run; `sheet` holds the axes of its `figure`."""

    def __init__(self, birds_eye: map_marks.BirdsEye, width_px: int, height_px: int | None = None) -> None:
        """Draw what stays, from the bottom to the top; the map is as high as it needs if no height is given."""
        check_matplotlib()
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        dpi = width_px / WIDTH_IN
        size_in = WIDTH_IN, (height_px or map_height_px(birds_eye, width_px)) / dpi
        self.figure = Figure(figsize=size_in, dpi=dpi, layout="constrained")
        FigureCanvasAgg(self.figure)  # else it makes one anew whenever it is asked for the extent of a text
        (x0, x1, y0, y1), axes = birds_eye.extent_m, self.figure.add_subplot()
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", facecolor=SEA)
        east, north = ("w1, east", "w2, north") if birds_eye.scene.origin else ("w1", "w2")
        axes.set(xlabel=f"{east} (m)", ylabel=f"{north} (m)")
        if birds_eye.scene.origin:
            tip: dict[str, Any] = {"xy": (0.97, 0.97), "xytext": (0.97, 0.9), "xycoords": "axes fraction"}
            axes.annotate("N", **tip, ha="center", va="top", arrowprops={"arrowstyle": "-|>", "color": "black"})
        axes.set_autoscale_on(False)
        axes.tick_params(labelsize=8)
        axes.set_title(birds_eye.scene.name, fontsize=11)
        self.sheet = map_marks.MapSheet(axes, birds_eye, MapNames(axes), [axes.title])
        self.sheet.moving.append(self.sheet.names.leaders)
        self._marks: list[Mark] = list(map_marks.moving_marks(self.sheet))
        self._marks.append(plan_marks.PlanMarks(self.sheet))
        if birds_eye.estimates is not None:
            self._marks.append(plan_marks.WorldTrackMarks(self.sheet))
        map_marks.draw_obstacles(self.sheet)
        handles = [self._in_key(artist) for artist in axes.get_legend_handles_labels()[0]]
        columns, place = (1, "outside right upper") if is_high(birds_eye) else (5, "outside lower center")
        look: dict[str, Any] = {"handles": handles, "loc": place, "fontsize": 8, "frameon": False}
        while (key := self.figure.legend(ncols=columns, **look)).get_window_extent().width > width_px and columns > 1:
            key.remove()
            columns -= 1
        layout = self.figure.get_layout_engine()
        assert layout is not None
        for _ in range(3):  # the places of axes and legend are found from each other's
            layout.execute(self.figure)
            axes.apply_aspect()
        self.figure.set_layout_engine("none")

    def _in_key(self, artist: Any) -> Any:
        """Symbol of an artist in the key: hulls, arrowheads and crosses have a symbol of their shape."""
        from matplotlib.lines import Line2D

        if (marker := self.sheet.symbols.get(artist)) is None:
            return artist
        if isinstance(marker, str):
            return Line2D([], [], ls="", marker=marker, mew=1.6, color=artist.get_color()[0], label=artist.get_label())
        look = {"mfc": artist.get_facecolor(), "mec": artist.get_edgecolor(), "mew": artist.get_linewidth()}
        return Line2D([], [], ls="", marker=marker.tolist(), ms=11 + len(marker), label=artist.get_label(), **look)

    def show(self, step: int, bearings: Sequence[map_marks.Bearing] = ()) -> None:
        """Move everything to where it is at a step, with bearings of detections and tracks."""
        scene = self.sheet.birds_eye.scene
        (time,) = scene.timestamps(step, step + 1)
        self.sheet.axes.set_title(f"{scene.name}    {time} s    step {step}", fontsize=11)
        self.sheet.names.clear()
        moment = map_marks.Moment(self.sheet.birds_eye, step, bearings)
        for mark in self._marks:
            mark.show(moment)
        self.sheet.names.place()


def map_figure(
    birds_eye: map_marks.BirdsEye,
    step: int,
    width_px: int,
    height_px: int | None = None,
    bearings: Sequence[map_marks.Bearing] = (),
) -> Figure:
    """The map at a step, as high as it needs if no height is given."""
    drawn = Map(birds_eye, width_px, height_px)
    drawn.show(step, bearings)
    return drawn.figure


def map_height_px(birds_eye: map_marks.BirdsEye, width_px: int) -> int:
    """The height that a map of the given width needs; even, as films need it."""
    x0, x1, y0, y1 = birds_eye.extent_m
    high = is_high(birds_eye)
    return 2 * round(width_px * (INNER[high] * (y1 - y0) / (x1 - x0) + FURNITURE[high]) / 2)


def is_high(birds_eye: map_marks.BirdsEye) -> bool:
    """Whether a map is higher than wide."""
    x0, x1, y0, y1 = birds_eye.extent_m
    return y1 - y0 > x1 - x0


def save_map(
    birds_eye: map_marks.BirdsEye, step: int, path: Path, width_px: int, bearings: Sequence[map_marks.Bearing] = ()
) -> Path:
    """Write the map at a step in the format of the path's ending; the same map gives the same bytes."""
    check_matplotlib()
    from matplotlib import rc_context

    ending = path.suffix.lower()
    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with rc_context({"svg.hashsalt": "modsim3d"}), put_in_place(path) as partial:
        figure = map_figure(birds_eye, step, width_px, bearings=bearings)
        figure.savefig(partial, format=ending[1:], metadata=metadata[ending], dpi=figure.dpi)
    return path


def map_picture(birds_eye: map_marks.BirdsEye, step: int, size: tuple[int, int]) -> Image.Image:
    """The map at a step as a picture of a size, drawn whole."""
    canvas: Any = map_figure(birds_eye, step, *size).canvas
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
