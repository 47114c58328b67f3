"""Drawings of a voyage: the coverage of the sea, and sketches of frames with their boxes."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from modsim3d.arrays import Array
from modsim3d.view.pages.charts import svg
from modsim3d.voyage.labelled_voyage import LabelledVoyage
from modsim3d.voyage.told.coverage import Coverage, cells
from modsim3d.voyage.told.stretches import Stretch
from modsim3d.voyage.unseen.judged import Judged

_CELL = (78.0, 34.0)
_LEFT, _TOP, _BELOW = 96.0, 20.0, 36.0
_SKETCH_WIDTH, _TITLE = 400.0, 16.0
_AROUND, _LEAST_PX = 8.0, 240.0
_MATCHED, _MISSED, _UNMATCHED = "#2f7fc1", "#d0312d", "#e08a00"
_LOW, _HIGH = np.array([208, 49, 45]), np.array([47, 127, 193])


def coverage_drawing(coverage: Coverage) -> str:
    """Bearing to the right, range upwards; each cell with the share that was matched and of how many."""
    bearings, ranges = coverage.bearings_deg, coverage.ranges_m
    wide, high = _CELL
    width = _LEFT + wide * (len(bearings) - 1) + 20
    height = _TOP + high * (len(ranges) - 1) + _BELOW
    foot = height - _BELOW
    parts = [
        f'<text x="{_LEFT}" y="12" font-weight="600">Share matched by camera {html.escape(coverage.camera)}</text>'
    ]
    for b, r, matched, whole in cells(coverage):
        x, y, share = _LEFT + b * wide, foot - (r + 1) * high, matched / whole
        red, green, blue = (_LOW + share * (_HIGH - _LOW)).round().astype(int).tolist()
        middle = x + wide / 2
        parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{wide - 2:.1f}" height="{high - 2:.1f}" '
            f'fill="rgb({red},{green},{blue})" fill-opacity="0.3"/>'
            f'<text x="{middle:.1f}" y="{y + 14:.1f}" text-anchor="middle" font-weight="600">{share:.0%}</text>'
            f'<text x="{middle:.1f}" y="{y + 27:.1f}" text-anchor="middle" fill="var(--soft)">of {whole:,}</text>'
        )
    for place, edge in enumerate(bearings.tolist()):
        sign = "−" if edge < 0 else "+" if edge > 0 else ""
        parts.append(_label(_LEFT + place * wide, foot + 14, f"{sign}{abs(edge):g}°", "middle"))
    for place, edge in enumerate(ranges.tolist()):
        parts.append(_label(_LEFT - 6, foot - place * high + 4, f"{edge:,.0f} m", "end"))
    parts.append(_label(width - 20, foot + 30, "bearing from the camera's axis, to the right", "end"))
    return svg(width, height, f"Coverage of camera {coverage.camera}", "\n".join(parts), "long")


def frame_sketch(voyage: LabelledVoyage, judged: Judged, stretch: Stretch) -> str:
    """A part of the middle frame of a stretch: what was matched, missed, and detected of nothing known."""
    middle = len(stretch.image) // 2
    image, when = int(stretch.image[middle]), stretch.when(middle)
    labelled, matched = voyage.labelled, judged.observed.matched
    part = _Part.around(stretch.boxes_px[middle], labelled.images.sizes_px[image])
    sought = np.flatnonzero(matched.sought & (labelled.annotations.image == image))
    found = matched.detection[sought] >= 0
    unmatched = matched.false[labelled.results.image[matched.false] == image]
    boxes = labelled.annotations.boxes_px
    title = f"{stretch.camera}, {when}: {stretch.what}"
    content = [
        *_horizon(labelled.images.half_planes[image], part),
        *(_box(part.of(each), _MATCHED) for each in boxes[sought[found]]),
        *(_box(part.of(each), _MISSED, dashed=True) for each in boxes[sought[~found]]),
        *(_box(part.of(each), _UNMATCHED) for each in labelled.results.boxes_px[unmatched]),
        _ring(part.of(stretch.boxes_px[middle])),
    ]
    inner = f'x="0" y="{_TITLE:g}" width="{_SKETCH_WIDTH:g}" height="{part.height:.1f}"'
    clip = f"s{crc32((title + ''.join(content)).encode())}"
    parts = [
        f'<clipPath id="{clip}"><rect {inner}/></clipPath><rect {inner} fill="none" stroke="var(--line)"/>',
        f'<g clip-path="url(#{clip})">{"".join(content)}</g>',
        _label(0, 11, title, "start", "var(--ink)"),
        _label(_SKETCH_WIDTH - 5, part.height + _TITLE - 6, f"{part.width_px:.0f} px wide", "end"),
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
        width = min(max(_AROUND * max(right - left, bottom - top), _LEAST_PX), whole)
        tall = width * high / whole
        x = min(max((left + right - width) / 2, 0.0), whole - width)
        y = min(max((top + bottom - tall) / 2, 0.0), high - tall)
        return cls(x, y, width, _SKETCH_WIDTH * high / whole)

    def of(self, box_px: Array) -> Array:
        """A box, or any x, y, x, y, in the drawing, shape (4,)."""
        scale = _SKETCH_WIDTH / self.width_px
        placed: Array = (box_px - np.array([self.left_px, self.top_px] * 2)) * scale + np.array([0, _TITLE] * 2)
        return placed


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
    """The horizon a·x + b·y + c = 0 across the part."""
    a, b, c = half_plane.tolist()
    if not np.isfinite(half_plane).all() or not b:
        return
    first, last = part.left_px, part.left_px + part.width_px
    ends = part.of(np.array([first, -(a * first + c) / b, last, -(a * last + c) / b]))
    x1, y1, x2, y2 = ends.tolist()
    yield f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="var(--line)"/>'


def _label(x: float, y: float, text: str, anchor: str, colour: str = "var(--soft)") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{html.escape(text)}</text>'
