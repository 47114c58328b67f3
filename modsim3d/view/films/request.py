"""Request for a film or a picture: what it shows of a run, checked before anything is read or drawn."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from modsim3d.core.errors import ModsimError, RendererError
from modsim3d.io.validation import nearest
from modsim3d.render.context import open_context
from modsim3d.runs.counts import NOTHING_WRONG
from modsim3d.runs.selection import Selection
from modsim3d.view.films import plan as film_plan
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.map_picture import check_matplotlib
from modsim3d.view.pictures.canvas import Box
from modsim3d.view.pictures.layers import Layers
from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

WITH_LOOK = ("scene", "detections", "all")
SKIES = {"overcast", "rain", "dusk", "night"}
WITH_TRACKS = ("detections", "all")


def parse_look(text: str) -> RenderStyle:
    """The style of a look such as `plain`, or `night,fog:800`. Raises ModsimError for an unknown word, and for words
    that contradict each other."""
    words = [word.strip() for word in text.split(",")]
    weather = [word for word in words if word not in ("shaded", "plain")]
    fogs = [word.removeprefix("fog:") for word in words if word.startswith("fog:")]
    try:
        visibilities = [float(fog) for fog in fogs]
    except ValueError:
        visibilities = []
    known = {"shaded", "plain", "clear", *SKIES, *(f"fog:{fog}" for fog in fogs)}
    strange = next((word for word in words if word not in known), None)
    apart = ({"shaded", "plain"}, {"dusk", "night"}, {"clear", "overcast"}, {"clear", "rain"})
    if strange or len(visibilities) != len(fogs) or len(fogs) > 1 or any(pair <= {*words} for pair in apart):
        hint = f" ({nearest(strange, sorted(known))})" if strange else ""
        raise ModsimError(
            f"--look {text}: needs shaded or plain, clear or overcast, rain, dusk or night, fog:M with the "
            f"visibility in metres, as in night,fog:800{hint}"
        )
    if weather and "plain" in words:
        raise ModsimError(f"--look {weather[0]} works in shaded pictures only: leave out plain")
    air: dict[str, Any] = {"visibility_m": visibilities[0] if visibilities else None}
    style = RenderStyle("plain" not in words, by_state=not weather, **air | dict.fromkeys(SKIES & {*words}, True))
    return replace(style, caption=f"drawn as: {style.words}, whatever the state" if weather else "")


@dataclass(frozen=True)
class PictureRequest:
    """Content of a picture or of each picture of a film."""

    kind: str = "detections"  # one of `KINDS`, or `all` for detections, scene and IDs side by side
    layers: Sequence[str] | None = None  # names of layers to draw over the image; those of the kind if None
    crop: str | None = None  # x_min,y_min,x_max,y_max in pixels, or `vessels`; all of the image if None
    width: int | None = None  # in pixels; the usual one if None
    look: RenderStyle | None = None  # as `--look` says it; that of the kind if None
    with_tracks: bool = False  # whether tracks of a tracker are drawn

    def __post_init__(self) -> None:
        """Raise ModsimError if parts of the request do not go together, or if there is no such layer."""
        if self.with_tracks and self.kind not in WITH_TRACKS:
            raise ModsimError(f"--tracks works with --kind detections and all, not with {self.kind}")
        if self.look is not None and self.kind not in WITH_LOOK:
            raise ModsimError(f"--look works with --kind scene, detections and all, not with {self.kind}")
        if self.width is not None and self.width % 2:
            even = f"{self.width - 1} or {self.width + 1}"
            raise ModsimError(f"--width {self.width}: films need an even width, such as {even}")
        if self.layers is not None:
            Layers.of(self.layers)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Some of `KINDS`, shown side by side."""
        return film_plan.ALL if self.kind == "all" else tuple(kind for kind in film_plan.KINDS if kind == self.kind)

    def plan(self, selection: Selection, tracks: FollowedTracks | None = None) -> film_plan.FilmPlan:
        """Plan of the pictures of some frames of a run.
        Raises ModsimError if a part of the image is not in it, or a library that this needs is not there."""
        style, boxes_on_scene = self._style()
        if self.kind == "map":
            check_matplotlib()
        crops: tuple[Box, ...] = ()
        if self.crop == "vessels":
            crops = film_plan.crop_to_vessels(selection)
        elif self.crop is not None:
            crops = film_plan.parse_crop(selection, self.crop)
        kinds = {*self.kinds}
        several = self.kind != "map" and (len(kinds) > 1 or len(selection.cameras) > 1)
        return film_plan.FilmPlan(
            self.kinds,
            selection.cameras,
            self.width or (film_plan.SEVERAL_WIDTH_PX if several else film_plan.WIDTH_PX),
            None if self.layers is None else Layers.of(self.layers),
            crops,
            style,
            boxes_on_scene,
            selection.run.steps,
            mistakes=film_plan.mistakes_in(selection) if "detections" in kinds else NOTHING_WRONG,
            tracks=tracks,
            vessels=film_plan.vessels_in(selection, crops) if kinds & {"scene", "ids", "corners"} else (),
        )

    def _style(self) -> tuple[RenderStyle, bool]:
        """Style of scenes, and whether boxes are drawn on such pictures too."""

        style = self.look or RenderStyle(shaded=True, by_state=True)
        boxes_on_scene = self.look is not None and style.shaded
        # Unless shaded pictures are asked for, boxes stay on the plain style, in which they are seen best.
        if not style.shaded or not (boxes_on_scene or self.kind in ("scene", "all")):
            return PLAIN_STYLE, False
        try:
            with open_context():  # a library may have no driver
                pass
        except RendererError as error:
            if boxes_on_scene:
                raise RendererError(f"shaded pictures need OpenGL; use --look plain without it: {error}") from error
            return PLAIN_STYLE, False
        return style, boxes_on_scene
