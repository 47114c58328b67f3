"""Drawings for the page of `modsim3d ais`: the map of the traffic, and when each vessel is there. Both are SVG."""

from __future__ import annotations

import html
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.document import Figure
from modsim3d.scene.ais.messages import local_metres
from modsim3d.scene.ais.scene_folder import CAMERA_HALF_ANGLE_RAD
from modsim3d.scene.ais.traffic import AisTraffic
from modsim3d.scene.ais.vessel_track import VesselTrack
from modsim3d.view.pages.charts import colour_of, nice_ticks, svg, svg_text, tick_text
from modsim3d.view.pages.tables import scrolling

WIDTH = 1100.0
LEFT, RIGHT, TOP, BOTTOM = 56.0, 20.0, 8.0, 30.0
MARGIN = 0.05
MIN_ASPECT, MAX_ASPECT = 0.45, 0.75  # height of the map over its width
NOT_FAR = 0.2  # a position removed as a jump enlarges the map by at most this share of it; others are on its edge
MIN_EXTENT_M = 200.0
MAX_POINTS, MAX_OF_A_VESSEL = 60_000, 400
MAX_NAMES = 40
LETTER_PX, LINE_PX = 6.2, 12.0  # width of a letter of a name, roughly, and the height of its line
MAX_LANES = 60
KILOMETRES_FROM_M = 10_000.0
CROWD = 100  # of more vessels the triangles are half as large, and reports are left out
LANE_PX, LANE_LEFT, MAX_LETTERS = 16.0, 190.0, 26  # of presence: height of a lane, its left end, letters of a name


def vessel_name(vessel: VesselTrack) -> str:
    """The name that a vessel broadcasts, or else its MMSI."""
    return vessel.hull.name or str(vessel.mmsi)


@dataclass(frozen=True)
class _MapArea:
    """The part of the world that the map shows, in metres, and its height in pixels."""

    west_m: float
    south_m: float
    px_a_metre: float
    height: float

    @classmethod
    def around(cls, places_m: Array) -> _MapArea:
        low, high = places_m.min(axis=0), places_m.max(axis=0)
        size = np.maximum((high - low) * (1 + 2 * MARGIN), MIN_EXTENT_M)
        size = np.maximum(size, [size[1] / MAX_ASPECT, size[0] * MIN_ASPECT])
        west, south = ((low + high - size) / 2).tolist()
        scale = (WIDTH - LEFT - RIGHT) / float(size[0])
        return cls(west, south, scale, float(size[1]) * scale + TOP + BOTTOM)

    @property
    def east_m(self) -> float:
        return self.west_m + (WIDTH - LEFT - RIGHT) / self.px_a_metre

    @property
    def north_m(self) -> float:
        return self.south_m + (self.height - TOP - BOTTOM) / self.px_a_metre

    def place(self, places_m: Array) -> Array:
        """Columns and rows in the drawing of w1 and w2, shape (n, 2)."""
        x = LEFT + (places_m[:, 0] - self.west_m) * self.px_a_metre
        y = self.height - BOTTOM - (places_m[:, 1] - self.south_m) * self.px_a_metre
        return np.stack([x, y], axis=-1)

    def holds(self, places_m: Array) -> Mask:
        """Mask of the places on the map, shape (n,)."""
        x, y = places_m[:, 0], places_m[:, 1]
        return (x >= self.west_m) & (x <= self.east_m) & (y >= self.south_m) & (y <= self.north_m)


def traffic_map(traffic: AisTraffic) -> Figure:
    """The map: tracks, reports, positions that were removed, and the camera."""
    camera_m = np.array([traffic.camera.position_m[:2]])
    jumps_m = np.concatenate([vessel.jumps_m for vessel in traffic.vessels])
    shown_m = np.concatenate([*(vessel.places_m for vessel in traffic.vessels), camera_m])
    low, high = shown_m.min(axis=0), shown_m.max(axis=0)
    reach = NOT_FAR * (high - low).max()
    near_m = jumps_m[((jumps_m >= low - reach) & (jumps_m <= high + reach)).all(axis=1)]
    area = _MapArea.around(np.concatenate([shown_m, near_m]))
    crowded = len(traffic.vessels) > CROWD
    most = max(2, min(MAX_OF_A_VESSEL, MAX_POINTS // len(traffic.vessels)))
    tracks = [
        _vessel(vessel, area, most, colour_of(index), crowded=crowded) for index, vessel in enumerate(traffic.vessels)
    ]
    parts = [_grid(area), _region(traffic, area), _camera(traffic, area), *tracks]
    parts += [_crosses(area, jumps_m), _names(traffic, area)]
    any_absent = any((np.diff(vessel.steps) > 1).any() for vessel in traffic.vessels)
    any_longer = any(len(vessel.steps) > most for vessel in traffic.vessels)
    caption = [
        "w1 points east, w2 north. Lines are the tracks of the hulls' centres",
        "" if crowded else ", dots the reports that they were made from",
        ". Dashes join reports between which a vessel is absent" if any_absent else "",
        ". Crosses are positions that were removed as jumps" if len(jumps_m) else "",
        "" if area.holds(jumps_m).all() else "; those on the edge lie outside the map",
        ". A triangle is where a vessel is last, and points ahead. The wedge is what the scene's camera sees. "
        "AIS does not say where land is.",
        " The dashed frame is the region, where it is on the map." if traffic.options.region else "",
        f" Of long tracks at most {most} points are drawn." if any_longer else "",
        f" The {MAX_NAMES} longest vessels have names." if len(traffic.vessels) > MAX_NAMES else "",
    ]
    content = "\n".join(part for part in parts if part)
    return _wide(round(area.height, 1), "map of the traffic", content, "".join(caption))


def _wide(height: float, label: str, content: str, caption: str) -> Figure:
    """A drawing that narrow screens scroll, so that its text stays legible."""
    return Figure(lambda: scrolling(svg(WIDTH, height, label, content, "long")), caption)


def _grid(area: _MapArea) -> str:
    bottom, right = area.height - BOTTOM, WIDTH - RIGHT
    unit, unit_m = ("km", 1000) if area.east_m - area.west_m > KILOMETRES_FROM_M else ("m", 1)
    clip = f'x="{LEFT}" y="{TOP}" width="{right - LEFT:.1f}" height="{bottom - TOP:.1f}"'
    lines = [f'<clipPath id="map"><rect {clip}/></clipPath><rect {clip} fill="none" stroke="var(--line)"/>']
    for metres in nice_ticks(area.west_m, area.east_m, 8):
        x = float(area.place(np.array([[metres, area.south_m]]))[0, 0])
        lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{bottom:.1f}" stroke="var(--line)"/>')
        lines.append(svg_text(x, bottom + 14, tick_text(metres / unit_m), "middle"))
    for metres in nice_ticks(area.south_m, area.north_m, 6):
        y = float(area.place(np.array([[area.west_m, metres]]))[0, 1])
        lines.append(f'<line x1="{LEFT}" x2="{right:.1f}" y1="{y:.1f}" y2="{y:.1f}" stroke="var(--line)"/>')
        lines.append(svg_text(LEFT - 5, y + 4, tick_text(metres / unit_m), "end"))
    axes = svg_text(right, bottom + 27, f"w1, {unit}", "end"), svg_text(LEFT + 4, TOP + 13, f"w2, {unit}", "start")
    return "\n".join([*lines, *axes])


def _region(traffic: AisTraffic, area: _MapArea) -> str:
    region = traffic.options.region
    if region is None:
        return ""
    south, north, west = region.south_deg, region.north_deg, region.west_deg
    east = west + region.width_deg
    latitudes, longitudes = np.array([south, south, north, north]), np.array([west, east, east, west])
    corners = area.place(local_metres(latitudes, longitudes, traffic.origin)).tolist()
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    style = 'fill="none" stroke="var(--soft)" stroke-dasharray="8 5"'
    return f'<g clip-path="url(#map)"><polygon points="{points}" {style}><title>region</title></polygon></g>'


def _camera(traffic: AisTraffic, area: _MapArea) -> str:
    """The camera and the directions of its image's edges."""
    camera, far_m = traffic.camera, 2 * (area.east_m - area.west_m)
    angles = camera.yaw_rad + np.array([-CAMERA_HALF_ANGLE_RAD, CAMERA_HALF_ANGLE_RAD])
    at = np.array(camera.position_m[:2])
    ends = at + far_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    (x, y), *edges = area.place(np.concatenate([at[None], ends])).tolist()
    wedge = " ".join(f"{a:.1f},{b:.1f}" for a, b in ((x, y), *edges))
    return (
        f'<g clip-path="url(#map)"><polygon points="{wedge}" fill="var(--soft)" fill-opacity="0.12"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="var(--soft)"/></g>'
        f'<text x="{x + 7:.1f}" y="{y + 4:.1f}" fill="var(--soft)">camera</text>'
    )


def _vessel(vessel: VesselTrack, area: _MapArea, most: int, colour: str, *, crowded: bool) -> str:
    """Its track, without a line where it is absent; what joins it there; and its reports."""
    pieces = np.split(np.arange(len(vessel.steps)), np.flatnonzero(np.diff(vessel.steps) > 1) + 1)
    every = max(1, -(-len(vessel.steps) // most))
    lines, joins, last = "", "", None
    for piece in pieces:
        kept = np.unique(np.append(piece[::every], piece[-1]))
        points = [f"{x:.1f},{y:.1f}" for x, y in area.place(vessel.places_m[kept]).tolist()]
        lines += f"M{' '.join(points)}"
        joins += f"M{last} {points[0]}" if last else ""
        last = points[-1]
    reports = vessel.reported_m[:: max(1, -(-len(vessel.reported_m) // most))]
    reports = reports[area.holds(reports)]
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in area.place(reports).tolist())
    colours = f'fill="{colour}" stroke="var(--paper)" stroke-width="0.8"'
    marks = [f'<path d="{lines}" stroke-width="{0.8 if crowded else 1.6}" stroke-linecap="round"/>']
    if joins:
        marks.append(f'<path d="{joins}" stroke-width="1" stroke-dasharray="2 4"/>')
    if dots and not crowded:
        marks.append(f'<path d="{dots}" stroke-width="3.4" stroke-linecap="round" stroke-opacity="0.6"/>')
    marks.append(f'<polygon points="{_triangle(vessel, area, 0.5 if crowded else 1.0)}" {colours}/>')
    name = html.escape(vessel_name(vessel))
    return f'<g fill="none" stroke="{colour}"><title>{name}</title>{"".join(marks)}</g>'


def _triangle(vessel: VesselTrack, area: _MapArea, size: float) -> str:
    """Its last place, pointing ahead; w2 is up and rows go down."""
    cosine, sine = float(np.cos(vessel.headings_rad[-1])), float(np.sin(vessel.headings_rad[-1]))
    ((x, y),) = area.place(vessel.places_m[-1:]).tolist()
    corners = ((9.0 * size, 0.0), (-5.0 * size, 5.0 * size), (-5.0 * size, -5.0 * size))
    return " ".join(f"{x + a * cosine - b * sine:.1f},{y - a * sine - b * cosine:.1f}" for a, b in corners)


def _crosses(area: _MapArea, jumps_m: Array) -> str:
    places = np.clip(area.place(jumps_m), (LEFT, TOP), (WIDTH - RIGHT, area.height - BOTTOM)).tolist()
    marks = "".join(f"M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8" for x, y in places)
    return f'<path d="{marks}" stroke="var(--bad)" stroke-width="1.8" fill="none"/>' if marks else ""


def _names(traffic: AisTraffic, area: _MapArea) -> str:
    """A name where each track ends, unless it would lie on another one or on a vessel."""
    ends = area.place(np.concatenate([vessel.places_m[-1:] for vessel in traffic.vessels])).tolist()
    taken = [(x - 9, y + 4, 18.0) for x, y in ends]
    texts = []
    for vessel in sorted(traffic.vessels, key=lambda vessel: (-vessel.hull.length_m, vessel.mmsi))[:MAX_NAMES]:
        name = vessel_name(vessel)
        ((x, y),) = area.place(vessel.places_m[-1:]).tolist()
        wide = LETTER_PX * len(name)
        places = ((x + 11, y + 4), (x - wide / 2, y - 11), (x - wide / 2, y + 20), (x - 11 - wide, y + 4))
        westward = np.cos(vessel.headings_rad[-1]) < 0
        for left, base in places[::-1] if westward else places:  # last on her track
            inside = left >= LEFT and left + wide <= WIDTH - RIGHT and TOP + LINE_PX <= base <= area.height - BOTTOM
            if inside and not any(
                left < other + length and other < left + wide and abs(base - line) < LINE_PX
                for other, line, length in taken
            ):
                taken.append((left, base, wide))
                texts.append(f'<text x="{left:.1f}" y="{base:.1f}">{html.escape(name)}</text>')
                break
    style = 'paint-order="stroke" stroke="var(--paper)" stroke-width="3" stroke-linejoin="round"'
    return f"<g {style}>{''.join(texts)}</g>"


def presence_chart(traffic: AisTraffic, caption: str) -> Figure:
    """A lane for each vessel: bars while it is in the scene, and dots at its reports."""
    shown = sorted(traffic.vessels, key=lambda vessel: (len(vessel.steps), vessel.mmsi))[:MAX_LANES]
    shown = sorted(shown, key=lambda vessel: vessel.mmsi)
    times = traffic.grid.times_s
    span_s = max(float(times[-1]), 1e-9)
    height = LANE_PX * len(shown) + 32
    scale = (WIDTH - LANE_LEFT - 12) / span_s
    parts = [_lane(vessel, LANE_PX * (lane + 0.5), times, scale) for lane, vessel in enumerate(shown)]
    for seconds in nice_ticks(0.0, span_s, 8):
        parts.append(svg_text(LANE_LEFT + seconds * scale, height - 16, f"{seconds:g}", "middle"))
    parts.append(svg_text(WIDTH - 12, height - 3, "seconds", "end"))
    return _wide(height, "when each vessel is in the scene", "\n".join(parts), caption)


def _lane(vessel: VesselTrack, y: float, times_s: Array, scale: float) -> str:
    """The name of a vessel, and when it is there and reports, at a row of the drawing; `scale` is pixels per second."""
    name = html.escape(vessel_name(vessel)[:MAX_LETTERS])
    parts = [f'<text x="{LANE_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{name}</text>']
    for piece in np.split(vessel.steps, np.flatnonzero(np.diff(vessel.steps) > 1) + 1):
        first, last = float(times_s[piece[0]]), float(times_s[piece[-1]])
        box = f'x="{LANE_LEFT + first * scale:.1f}" width="{max((last - first) * scale, 1.0):.1f}"'
        parts.append(f'<rect {box} y="{y - 5:.1f}" height="10" rx="2" fill="{colour_of(0)}" fill-opacity="0.35"/>')
    inside = vessel.reported_s[(vessel.reported_s >= 0) & (vessel.reported_s <= times_s[-1])]
    inside = inside[:: max(1, -(-len(inside) // MAX_OF_A_VESSEL))]
    dots = "".join(f"M{LANE_LEFT + s * scale:.1f} {y:.1f}h0" for s in inside.tolist())
    if dots:
        parts.append(f'<path d="{dots}" stroke="{colour_of(0)}" stroke-width="3" stroke-linecap="round"/>')
    return "\n".join(parts)
