"""Marks that a mariner reads off a plan: speed vectors, closest approaches, bearings of detections, and tracks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.tracks.tracks import DEFAULT_GATE_M
from modsim3d.view import palette
from modsim3d.view.lights import ground_velocities
from modsim3d.view.map_marks import MARKER_SHARE, NOWHERE, TRAIL_S, MapSheet, Moment
from modsim3d.view.palette import Colour

if TYPE_CHECKING:
    from matplotlib.collections import LineCollection

VECTOR_S = 360.0  # of a speed vector, as on a radar
MAX_APPROACHES, MAX_NAMES = 3, 40  # as many approaches are written, and approaches and tracks together
_CROSS = np.array([(-1, -1), (1, 1), (np.nan, np.nan), (-1, 1), (1, -1)])


class PlanMarks:
    """Speed vectors, closest points of approach, and bearings of detections and tracks."""

    def __init__(self, sheet: MapSheet) -> None:
        """Put the lines where `show` finds them."""
        self._sheet, layers = sheet, sheet.birds_eye.layers
        dotted, bearings = (0, (2, 2)), layers.tracks and sheet.birds_eye.world_tracks is None
        self._vectors = self._lines(layers.vectors, "speed vector, 6 min", lw=1.2, zorder=5.5)
        self._approaches = self._lines(
            layers.cpa and bool(sheet.birds_eye.scene.own_ships),
            "closest approach within 6 min",
            lw=1.6,
            color="black",
            zorder=8.4,
        )
        self._detections = self._lines(layers.detections, "bearing of a detection", lw=0.8, ls=dotted, zorder=4.5)
        self._tracks = self._lines(bearings, "bearing of a track", lw=1.4, zorder=4.6, alpha=0.6)
        self._names = [sheet.names.add("", fontsize=7) for _ in range(MAX_NAMES * (layers.cpa or layers.tracks))]

    def _lines(self, wanted: bool, label: str, **look: Any) -> LineCollection | None:
        return self._sheet.lines(label, **look) if wanted else None

    def show(self, moment: Moment) -> None:
        """Move the lines to a moment."""
        scene, names = self._sheet.birds_eye.scene, iter(self._names)
        velocities_m_s, present = (
            ground_velocities(scene, moment.step),
            np.flatnonzero(moment.poses.present[0]).tolist(),
        )
        here = moment.poses.positions_m[0, :, :2]
        ends = np.stack([here, here + VECTOR_S * velocities_m_s], axis=1)
        colours = [palette.vessel_colour(index, scene.own_ships) for index in present]
        put(self._vectors, [ends[index] for index in present], colours)
        own = [index for index in scene.own_ships if index in present][:1]
        pairs = [(*own, other) for other in present if other not in own] if own and self._approaches else []
        cpas = [(*_approach(here[[*pair]], velocities_m_s[[*pair]]), pair[1]) for pair in pairs]
        nearest = sorted((cpa for cpa in cpas if 0 < cpa[1] <= VECTOR_S), key=lambda cpa: cpa[0])[:MAX_APPROACHES]
        put(self._approaches, [line for _, _, line, _ in nearest])
        for distance_m, after_s, line, other in nearest:
            name, short = scene.vessel_names[other], f"CPA {distance_m:.0f} m in {after_s / 60:.1f} min"
            next(names).show(f"{name}: {short}", line.mean(axis=0), short)
            self._sheet.names.dots_m[-1 - other] = line.mean(axis=0)  # no name lies on it, else no line gets there
        x0, x1, y0, y1 = self._sheet.birds_eye.extent_m
        reach = np.linspace(0, np.hypot(x1 - x0, y1 - y0), 200)[:, None]
        for lines, of_tracks in ((self._detections, False), (self._tracks, True)):
            some = [bearing for bearing in moment.bearings if (bearing.track is not None) == of_tracks]
            rays = [bearing.at_m + reach * bearing.direction for bearing in some]
            put(lines, [ray[[0, -1]] for ray in rays], [bearing.colour for bearing in some])
            for bearing, ray in zip(some, rays, strict=True) if of_tracks and lines else ():
                inside = ray[((ray > (x0, y0)) & (ray < (x1, y1))).all(axis=1)]
                if len(inside) and (name_there := next(names, None)):
                    name_there.show(f"#{bearing.track}", inside[int(0.95 * len(inside))])
        for unused in names:
            unused.place_m = None


class WorldTrackMarks:
    """Tracks in the world with their names: a cross at each estimate in the colour of the nearest vessel, its last
    part, its speed vector, and the ellipse that holds the vessel with 95 % by its covariance."""

    def __init__(self, sheet: MapSheet) -> None:
        """Put the lines where `show` finds them."""
        from matplotlib.patheffects import withStroke

        self._sheet, self._tracks = sheet, sheet.birds_eye.world_tracks
        edge = [withStroke(linewidth=3.4, foreground="white")]  # a cross lies on a vessel of its colour
        self._crosses = sheet.lines("track in the world", lw=1.6, zorder=8.2, path_effects=edge)
        sheet.symbols[self._crosses] = "x"
        self._trails = sheet.lines(f"last {TRAIL_S:g} s of a track", lw=1.0, ls=(0, (1, 1)), zorder=8.0)
        self._ellipses = sheet.lines("95 % by a track's covariance", lw=0.8, zorder=8.1)
        self._vectors = sheet.lines("speed vector of a track", lw=1.0, ls=(0, (5, 3)), zorder=5.6)
        self._names = [sheet.names.add("", fontsize=7) for _ in range(MAX_NAMES)]

    def show(self, moment: Moment) -> None:
        """Move the tracks to a moment."""
        birds_eye, tracks, estimates = moment.birds_eye, self._tracks, moment.birds_eye.estimates
        assert tracks is not None and estimates is not None
        rows = estimates.row[slice(*np.searchsorted(estimates.step, (moment.step, moment.step + 1)))]
        at, colours = tracks.position_m[rows], self._colours(tracks.position_m[rows], moment)
        arms_m = 0.4 * MARKER_SHARE * (birds_eye.extent_m[1] - birds_eye.extent_m[0]) * _CROSS
        put(self._crosses, list(at[:, None] + arms_m), colours)
        put(self._trails, [self._trail(row) for row in rows.tolist()], colours)
        put(self._ellipses, list(at[:, None] + _ellipses(tracks.covariance[rows, :2, :2])), colours)
        ends = at + VECTOR_S * tracks.velocity_m_s[rows]
        put(self._vectors, list(np.stack([at, ends], axis=1)) * birds_eye.layers.vectors, colours)
        texts = [f"#{tracks.track_names[track]}" for track in tracks.track[rows]]
        for name, text, place_m in zip_longest(self._names, texts[:MAX_NAMES], at[:MAX_NAMES]):
            name.place_m = None
            if text is not None:
                name.show(text, place_m)

    def _colours(self, at: Array, moment: Moment) -> list[Colour]:
        """Colour of the vessel nearest to each place, vermilion where none is as near as a vessel that is followed."""
        present = np.flatnonzero(moment.poses.present[0])
        here = moment.poses.positions_m[0, present, :2]
        apart = np.linalg.norm(at[:, None] - here, axis=2)
        own_ships = moment.birds_eye.scene.own_ships
        return [
            palette.vessel_colour(int(present[distances.argmin()]), own_ships)
            if distances.min(initial=np.inf) <= DEFAULT_GATE_M
            else palette.ALARM
            for distances in apart
        ]

    def _trail(self, row: int) -> Array:
        """Positions of a row's track in the last seconds until then, shape (n, 2)."""
        tracks = self._tracks
        assert tracks is not None
        first = int(np.searchsorted(tracks.track, tracks.track[row]))
        since = first + int(np.searchsorted(tracks.time_s[first:row], tracks.time_s[row] - TRAIL_S))
        trail: Array = tracks.position_m[since : row + 1]
        return trail


def _ellipses(covariances_m2: Array) -> Array:
    """The ellipses of 95 % of plane normal distributions about their means, (n, 2, 2) to (n, 49, 2); mere points where
    the covariance is unknown."""
    finite = np.asarray(np.isfinite(covariances_m2).all(axis=(1, 2)))
    variances, axes = np.linalg.eigh(np.where(finite[:, None, None], covariances_m2, 0.0))
    angles = np.linspace(0, 2 * np.pi, 49)
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    sides = np.sqrt(-2 * np.log(1 - 0.95) * np.maximum(variances, 0))
    ellipses: Array = unit * sides[:, None] @ axes.transpose(0, 2, 1)
    return ellipses


def put(lines: LineCollection | None, segments: list[Array], colours: Sequence[Colour] = ()) -> None:
    """Put segments, shape (n, 2) each, and their colours into lines that are shown."""
    if lines is not None:
        lines.set_segments(segments or [NOWHERE])
        if colours:
            lines.set_color([palette.unit_rgb(colour) for colour in colours])


def _approach(here_m: Array, velocities_m_s: Array) -> tuple[float, float, Array]:
    """Least distance of own ship and another vessel on their courses, in metres, after how many seconds, and where both
    are then, shape (2, 2)."""
    apart, closing = here_m[1] - here_m[0], velocities_m_s[1] - velocities_m_s[0]
    after_s = -float(apart @ closing) / max(float(closing @ closing), 1e-12)
    then = here_m + after_s * velocities_m_s
    return float(np.hypot(*(then[1] - then[0]))), after_s, then
