"""Request for a film or a picture: what it shows of a run, checked before anything is read or drawn."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from modsim3d.core.errors import ModsimError, RendererError
from modsim3d.io.validation import nearest
from modsim3d.render.context import open_context
from modsim3d.runs.counts import NOTHING_WRONG
from modsim3d.runs.selection import Selection
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.view.films import plan as film_plan
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.map_picture import check_matplotlib
from modsim3d.view.pictures.canvas import Box
from modsim3d.view.pictures.layers import MAP, PLAN, Layers, MapLayers
from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

WITH_LOOK = ("scene", "detections", "all", "plan")
SKIES = {"overcast", "rain", "dusk", "night"}
CROPPED = ("detections", "ids", "all", "plan")  # to where vessels are, unless another part is asked for
WITH_TRACKS = ("detections", "all", "plan", "map")


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
    terms = {"shaded", "plain", "clear", *SKIES, *(f"fog:{fog}" for fog in fogs)}
    strange = next((word for word in words if word not in terms), None)
    apart = ({"shaded", "plain"}, {"dusk", "night"}, {"clear", "overcast"}, {"clear", "rain"})
    if strange or len(visibilities) != len(fogs) or len(fogs) > 1 or any(pair <= {*words} for pair in apart):
        hint = f" ({nearest(strange, sorted(terms))})" if strange else ""
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

    kind: str = "detections"  # one of `KINDS`, `all`: detections, scene and IDs, or `plan`: detections and map
    layers: Sequence[str] | None = None  # names of layers to draw over the image; those of the kind if None
    crop: str | None = None  # x_min,y_min,x_max,y_max in pixels, `vessels`, or `none`: all; that of the kind if None
    width: int | None = None  # in pixels; the usual one if None
    look: RenderStyle | None = None  # as `--look` says it; that of the kind if None
    with_tracks: bool = False  # whether tracks of a tracker are drawn

    def __post_init__(self) -> None:
        """Raise ModsimError if parts of the request do not go together, or if there is no such layer."""
        if self.with_tracks and self.kind not in WITH_TRACKS:
            raise ModsimError(f"--tracks works with --kind detections, all, plan and map, not with {self.kind}")
        if self.look is not None and self.kind not in WITH_LOOK:
            raise ModsimError(f"--look works with --kind scene, detections, all and plan, not with {self.kind}")
        if self.width is not None and self.width % 2:
            even = f"{self.width - 1} or {self.width + 1}"
            raise ModsimError(f"--width {self.width}: films need an even width, such as {even}")
        if self.layers is not None:
            (MapLayers if "map" in self.kinds else Layers).of(self.layers)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Some of `KINDS`, shown side by side."""
        several = {"all": film_plan.ALL, "plan": film_plan.PLAN_KINDS}
        return several.get(self.kind) or tuple(kind for kind in film_plan.KINDS if kind == self.kind)

    @property
    def map_layers(self) -> MapLayers:
        """The layers of a map; without tracks there is none of them."""
        asked = MapLayers.of(self.layers) if "map" in self.kinds and self.layers is not None else None
        chosen = asked or (PLAN if self.with_tracks or self.kind == "plan" else MAP)
        return replace(chosen, tracks=chosen.tracks and self.with_tracks)

    def plan(
        self,
        selection: Selection,
        tracks: FollowedTracks | None = None,
        world_tracks: WorldTracks | None = None,
    ) -> film_plan.FilmPlan:
        """Plan of the pictures of some frames of a run.
        Raises ModsimError if a part of the image is not in it, or a library that this needs is not there."""
        style, boxes_on_scene = self._style()
        with_map = "map" in self.kinds
        if with_map:
            check_matplotlib()
        crops: tuple[Box, ...] = ()
        crop = self.crop or ("vessels" if self.kind in CROPPED else "none")
        if crop == "vessels":
            crops = film_plan.crop_to_vessels(selection)
        elif crop != "none":
            crops = film_plan.parse_crop(selection, crop)
        kinds = {*self.kinds}
        panels = 1 if self.kind == "map" else len(kinds) * len(selection.cameras)
        wide = all((x1 - x0) / (y1 - y0) >= film_plan.STACKED_FROM for x0, y0, x1, y1 in crops)
        stacked = bool(crops) and wide and panels <= film_plan.MAX_COLUMNS and not with_map
        several = panels > 1 and not stacked
        return film_plan.FilmPlan(
            self.kinds,
            selection.cameras,
            self.width or (film_plan.SEVERAL_WIDTH_PX if several else film_plan.WIDTH_PX),
            None if self.layers is None or with_map else Layers.of(self.layers),
            crops,
            style,
            boxes_on_scene,
            selection.run.steps,
            1 if stacked else None,
            mistakes=film_plan.mistakes_in(selection) if "detections" in kinds else NOTHING_WRONG,
            tracks=tracks,
            vessels=film_plan.vessels_in(selection, crops) if kinds & {"scene", "ids", "corners"} else (),
            map_layers=self.map_layers,
            world_tracks=world_tracks,
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
