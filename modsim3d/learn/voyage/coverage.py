"""Places on the sea at which vessels were matched and missed: by bearing from the camera's axis, and by range."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import centre_form
from modsim3d.core.document import Table
from modsim3d.core.text import counted, in_percent
from modsim3d.geometry.camera import Camera
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.voyage.clock import SceneClock
from modsim3d.learn.voyage.labelled_voyage import LabelledVoyage
from modsim3d.learn.voyage.non_ais.classification import ClassifiedDetections
from modsim3d.learn.voyage.non_ais.linking import Behaviour
from modsim3d.learn.voyage.reference_error import View
from modsim3d.scene.ais.options import time_text
from modsim3d.view.pages.charts import svg, svg_text

_STEPS_DEG = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
_MAX_BINS = 9


@dataclass(frozen=True, eq=False)
class Coverage:
    """The n annotations of one camera that were to be detected."""

    camera: str
    bearing_deg: Array  # from the camera's axis, to the right, (n,)
    range_m: Array  # horizontal, (n,)
    found: Mask  # whether it was matched, (n,)

    @property
    def bearings_deg(self) -> Array:
        """Edges of cells of bearing, at round numbers, ascending."""
        low, high = self.bearing_deg.min(), self.bearing_deg.max()
        step = next((width for width in _STEPS_DEG if (high - low) / width <= _MAX_BINS - 1), _STEPS_DEG[-1])
        return np.arange(np.floor(low / step), np.floor(high / step) + 2) * step

    @property
    def ranges_m(self) -> Array:
        """Edges of cells of range: 1, 2, 5, 10 and so on, ascending."""
        series = np.array([digit * 10.0**power for power in range(7) for digit in (1, 2, 5)])
        first = max(int(np.searchsorted(series, self.range_m.min(), side="right")) - 1, 0)
        return series[first : int(np.searchsorted(series, self.range_m.max(), side="right")) + 1]

    def bearings_between(self, low_m: float, high_m: float) -> tuple[float, float]:
        """The lowest and the highest bearing from one range up to another."""
        inside = self.bearing_deg[(self.range_m >= low_m) & (self.range_m < high_m)]
        return inside.min(), inside.max()

    def counts(self) -> tuple[Array, Array]:
        """Numbers matched and to be matched in each cell of bearing and range, shapes (bearings, ranges)."""
        edges = [self.bearings_deg, self.ranges_m]
        whole = np.histogram2d(self.bearing_deg, self.range_m, edges)[0]
        return np.histogram2d(self.bearing_deg[self.found], self.range_m[self.found], edges)[0], whole


def coverages(observed: Outcomes, views: Sequence[View]) -> list[Coverage]:
    """The coverage of each camera that any vessel was before; views of one camera are taken together."""
    labelled, matched = observed.labelled, observed.matched
    of_image = np.full(len(labelled.images), -1)
    cameras: dict[str, Camera] = {}
    for number, view in enumerate(views):
        of_image[view.images] = number
        cameras.setdefault(view.camera.name, view.camera)
    rows = np.flatnonzero(matched.sought)
    names = np.array([view.camera.name for view in views])[of_image[labelled.annotations.image[rows]]]
    done = []
    for name, camera in cameras.items():
        members = rows[names == name]
        if len(members):
            places = bearings(camera, labelled.annotations.boxes_px[members], labelled.annotations.depth_m[members])
            done.append(Coverage(name, *places, matched.detection[members] >= 0))
    return done


def bearings(camera: Camera, boxes_px: Array, depth_m: Array | float) -> tuple[Array, Array]:
    """Bearing from the camera's axis in degrees, to the right, and horizontal range, of boxes (n, 4), shapes (n,)."""
    pixels = np.clip(centre_form(boxes_px)[:, :2], 0, np.array(camera.intrinsics.image_size_px, dtype=np.float64))
    across = np.nan_to_num(camera.intrinsics.unproject(pixels, np.ones(len(pixels)))[:, 0])
    return np.degrees(np.arctan(across)), np.asarray(depth_m * np.hypot(1.0, across))


def range_table(coverage: Coverage) -> Table:
    """Matched and missed by range, the nearest first."""
    matched, whole = (table.sum(axis=0) for table in coverage.counts())
    edges = coverage.ranges_m
    rows = tuple(
        (
            f"{edges[k]:,.0f} to {edges[k + 1]:,.0f} m",
            f"{int(whole[k]):,}",
            f"{int(matched[k]):,}",
            f"{int(whole[k] - matched[k]):,}",
            in_percent(matched[k] / whole[k]),
            "{:+.0f}° to {:+.0f}°".format(*coverage.bearings_between(edges[k], edges[k + 1])),
        )
        for k in np.flatnonzero(whole)
    )
    header = ("range", "to be detected", "matched", "missed", "share matched", "bearings from the axis")
    return Table(f"What camera '{coverage.camera}' matched and missed, by range", header, rows)


def cells(coverage: Coverage) -> list[tuple[int, int, int, int]]:
    """Place of bearing and of range, number matched and number to be matched, of each cell that is not empty."""
    matched, whole = coverage.counts()
    places: Indices = np.argwhere(whole > 0)
    return [(int(b), int(r), int(matched[b, r]), int(whole[b, r])) for b, r in places]


# ---- The longest stretches of time without a match ----

LISTED = 8
_HALF = 0.5


@dataclass(frozen=True, eq=False)
class FrameStretch:
    """Frames of one camera that follow each other."""

    what: str  # the vessel that was missed, or what the detections were taken for
    camera: str
    time_s: Array  # by the log's clock, since the scene's first step, (n,)
    image: Indices
    boxes_px: Array  # the true or detected one in each frame, (n, 4)
    bearing_deg: float  # mean, from the camera's axis, to the right
    range_m: float  # mean; nan of detections
    start_s: float | None  # Unix time of the scene's first step; None if the scene does not say

    def when(self, place: int) -> str:
        """The time of a frame by the log's clock, as `--empty` takes it: UTC if the scene says when it starts."""
        time_s = float(self.time_s[place])
        return f"{time_s:.1f} s" if self.start_s is None else time_text(self.start_s + time_s)

    @property
    def lasts_s(self) -> float:
        """From the first frame to the last."""
        return float(self.time_s[-1] - self.time_s[0])


def missed_stretches(voyage: LabelledVoyage, judged: ClassifiedDetections) -> list[FrameStretch]:
    """Stretches in which a vessel was to be detected in each frame that it was in, and was in none, longest first."""
    labelled, matched = voyage.labelled, judged.telling.matched
    identity, stretches = labelled.annotations.identity, []
    number, start_s = np.full(len(labelled.images), -1), SceneClock.of(voyage.scene).start_s
    for view in voyage.views:
        number[:] = -1
        number[view.images] = np.arange(len(view.images))
        eye = next(other.camera for other in voyage.views if other.camera.name == view.camera.name)
        in_view = np.flatnonzero(matched.sought & (number[labelled.annotations.image] >= 0))
        for who in np.unique(identity[in_view]).tolist():
            rows = in_view[identity[in_view] == who]
            frame = number[labelled.annotations.image[rows]]
            rows, frame = rows[np.argsort(frame)], np.sort(frame)
            missed = matched.detection[rows] < 0
            apart = np.flatnonzero(np.diff(missed.astype(int)).astype(bool) | (np.diff(frame) > 1)) + 1
            for part in np.split(rows, apart):
                if matched.detection[part[0]] < 0:
                    name = voyage.scene.vessel_names[who - view.first_identity]
                    image, boxes = labelled.annotations.image[part], labelled.annotations.boxes_px[part]
                    places = bearings(eye, boxes, labelled.annotations.depth_m[part])
                    bearing, range_m = (float(values.mean()) for values in places)
                    times = labelled.images.time_s[image], image
                    stretches.append(FrameStretch(name, eye.name, *times, boxes, bearing, range_m, start_s))
    return sorted(stretches, key=lambda stretch: (-len(stretch.image), stretch.time_s[0]))


def unmatched_stretches(voyage: LabelledVoyage, judged: ClassifiedDetections) -> list[FrameStretch]:
    """Things that were detected and are no known vessel, those that were detected in most frames first."""
    links, of_view = judged.links, np.full(len(voyage.labelled.images), -1)
    start_s = SceneClock.of(voyage.scene).start_s
    for place, view in enumerate(voyage.views):
        of_view[view.images] = place
    order = np.lexsort((links.time_s, links.link))
    starts = np.searchsorted(links.link[order], np.arange(links.count))
    stretches = []
    for tracklet, rows in enumerate(np.split(order, starts[1:]) if links.count else []):
        view = voyage.views[int(of_view[links.image[rows[0]]])]
        boxes = voyage.labelled.results.boxes_px[links.rows[rows]]
        bearing = float(bearings(view.camera, boxes, 1.0)[0].mean())
        likely = judged.lasting[tracklet]
        against = Behaviour(judged.tracklets.behaviour[tracklet])
        why = "" if against is Behaviour.LIKE_A_VESSEL else f": {against.in_words}"
        what = f"a vessel without a transponder ({in_percent(likely)})" if likely >= _HALF else f"false{why}"
        if judged.empty[links.image[rows]].all():
            what = "false, in a stretch that is marked as empty"
        times = links.time_s[rows], links.image[rows]
        stretches.append(FrameStretch(what, view.camera.name, *times, boxes, bearing, float("nan"), start_s))
    return sorted(stretches, key=lambda stretch: (-len(stretch.image), stretch.time_s[0]))


def missed_table(stretches: list[FrameStretch]) -> Table:
    """The longest stretches in which vessels were missed."""
    rows = tuple(
        (row.what, row.camera, *_times(row), f"{row.range_m:,.0f} m", _degrees(row.bearing_deg))
        for row in stretches[:LISTED]
    )
    title = f"Vessels that were missed for longest{_of(stretches)}"
    return Table(title, ("vessel", "camera", "from", "to", "frames", "range", "from the axis"), rows)


def unmatched_table(stretches: list[FrameStretch]) -> Table:
    """The things without a match that were detected most often."""
    rows = tuple((row.camera, *_times(row), _degrees(row.bearing_deg), row.what) for row in stretches[:LISTED])
    title = f"Detections of nothing known that lasted longest{_of(stretches)}"
    return Table(title, ("camera", "from", "to", "frames", "from the axis", "taken for"), rows)


def _degrees(bearing: float) -> str:
    return f"{bearing:+.0f}°" if abs(bearing) >= _HALF else "0°"


def _of(stretches: list[FrameStretch]) -> str:
    return f" ({LISTED} of {counted(len(stretches), 'stretch', 'stretches')})" if len(stretches) > LISTED else ""


def _times(stretch: FrameStretch) -> tuple[str, str, str]:
    return stretch.when(0), stretch.when(-1), f"{len(stretch.image):,}"


_CELL = (78.0, 34.0)
_LEFT, _TOP, _BELOW = 96.0, 20.0, 36.0
_SKETCH_WIDTH, _TITLE = 400.0, 16.0
_AROUND, _MIN_PX = 8.0, 240.0
_MATCHED, _MISSED, _UNMATCHED = "#2f7fc1", "#d0312d", "#e08a00"
_LOW, _HIGH = np.array([208, 49, 45]), np.array([47, 127, 193])


def coverage_drawing(coverage: Coverage) -> str:
    """Bearing to the right, range upwards; each cell with the share that was matched and of how many."""
    bearings, ranges = coverage.bearings_deg, coverage.ranges_m
    wide, high = _CELL
    width = _LEFT + wide * (len(bearings) - 1) + 20
    foot = _TOP + high * (len(ranges) - 1)
    height = foot + _BELOW
    title = f"Share matched by camera {html.escape(coverage.camera)}"
    parts = [f'<text x="{_LEFT}" y="12" font-weight="600">{title}</text>']
    for b, r, matched, whole in cells(coverage):
        x, y, share = _LEFT + b * wide, foot - (r + 1) * high, matched / whole
        red, green, blue = (_LOW + share * (_HIGH - _LOW)).round().astype(int).tolist()
        middle = x + wide / 2
        parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{wide - 2:.1f}" height="{high - 2:.1f}" '
            f'fill="rgb({red},{green},{blue})" fill-opacity="0.3"/>'
            f'<text x="{middle:.1f}" y="{y + 14:.1f}" text-anchor="middle" font-weight="600">{in_percent(share)}</text>'
            f'<text x="{middle:.1f}" y="{y + 27:.1f}" text-anchor="middle" fill="var(--soft)">of {whole:,}</text>'
        )
    for place, edge in enumerate(bearings.tolist()):
        sign = "−" if edge < 0 else "+" if edge > 0 else ""
        parts.append(svg_text(_LEFT + place * wide, foot + 14, f"{sign}{abs(edge):g}°", "middle"))
    for place, edge in enumerate(ranges.tolist()):
        parts.append(svg_text(_LEFT - 6, foot - place * high + 4, f"{edge:,.0f} m", "end"))
    parts.append(svg_text(width - 20, foot + 30, "bearing from the camera's axis, to the right", "end"))
    return svg(width, height, f"Coverage of camera {coverage.camera}", "\n".join(parts), "long")


def frame_sketch(voyage: LabelledVoyage, judged: ClassifiedDetections, stretch: FrameStretch) -> str:
    """A part of the middle frame of a stretch: what was matched, missed, and detected of nothing known."""
    middle = len(stretch.image) // 2
    image, when = int(stretch.image[middle]), stretch.when(middle)
    labelled, matched = voyage.labelled, judged.observed.matched
    part = _Part.around(stretch.boxes_px[middle], labelled.images.sizes_px[image])
    sought = np.flatnonzero(matched.sought & (labelled.annotations.image == image))
    hits = matched.detection[sought] >= 0
    unmatched = matched.false[labelled.results.image[matched.false] == image]
    boxes = labelled.annotations.boxes_px
    title = f"{stretch.camera}, {when}: {stretch.what}"
    content = [
        *_horizon(labelled.images.half_planes[image], part),
        *(_box(part.of(box), _MATCHED) for box in boxes[sought[hits]]),
        *(_box(part.of(box), _MISSED, dashed=True) for box in boxes[sought[~hits]]),
        *(_box(part.of(box), _UNMATCHED) for box in labelled.results.boxes_px[unmatched]),
        _ring(part.of(stretch.boxes_px[middle])),
    ]
    inner = f'x="0" y="{_TITLE:g}" width="{_SKETCH_WIDTH:g}" height="{part.height:.1f}"'
    clip = f"s{crc32((title + ''.join(content)).encode())}"
    parts = [
        f'<clipPath id="{clip}"><rect {inner}/></clipPath><rect {inner} fill="none" stroke="var(--line)"/>',
        f'<g clip-path="url(#{clip})">{"".join(content)}</g>',
        svg_text(0, 11, title, "start", "var(--ink)"),
        svg_text(_SKETCH_WIDTH - 5, part.height + _TITLE - 6, f"{part.width_px:.0f} px wide", "end"),
    ]
    name = f"Frame of camera {stretch.camera} at {when}"
    return svg(_SKETCH_WIDTH, part.height + _TITLE + 2, name, "\n".join(parts))


@dataclass(frozen=True)
class _Part:
    """A part of an image: its left and upper edge, its width, and the height of its drawing."""

    left_px: float
    top_px: float
    width_px: float
    height: float

    @classmethod
    def around(cls, box_px: Array, size_px: Array) -> _Part:
        """That around a box, eight times as wide as its longer side, and in the image."""
        whole, high = size_px.tolist()
        left, top, right, bottom = box_px.tolist()
        width = min(max(_AROUND * max(right - left, bottom - top), _MIN_PX), whole)
        tall = width * high / whole
        x = min(max((left + right - width) / 2, 0.0), whole - width)
        return cls(x, min(max((top + bottom - tall) / 2, 0.0), high - tall), width, _SKETCH_WIDTH * high / whole)

    def of(self, box_px: Array) -> Array:
        """A box, or any x, y, x, y, in the drawing, shape (4,)."""
        scale = _SKETCH_WIDTH / self.width_px
        return np.asarray((box_px - np.array([self.left_px, self.top_px] * 2)) * scale + np.array([0, _TITLE] * 2))


def _box(box: Array, colour: str, *, dashed: bool = False) -> str:
    left, top, right, bottom = box.tolist()
    dash = ' stroke-dasharray="4 2"' if dashed else ""
    return (
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{max(right - left, 1):.1f}" '
        f'height="{max(bottom - top, 1):.1f}" fill="none" stroke="{colour}" stroke-width="1.5"{dash}/>'
    )


def _ring(box: Array) -> str:
    left, top, right, bottom = box.tolist()
    radius = max(right - left, bottom - top) / 2 + 12
    x, y = (left + right) / 2, (top + bottom) / 2
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="var(--soft)"/>'


def _horizon(half_plane: Array, part: _Part) -> Iterator[str]:
    a, b, c = half_plane.tolist()
    if not np.isfinite(half_plane).all() or not b:
        return
    first, last = part.left_px, part.left_px + part.width_px
    x1, y1, x2, y2 = part.of(np.array([first, -(a * first + c) / b, last, -(a * last + c) / b])).tolist()
    yield f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="var(--line)"/>'
