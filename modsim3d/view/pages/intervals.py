"""Charts of means with their intervals; each series has a colour and a shape, so that colour is not its only sign."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.view.pages.charts import Axes, colour_of, nice_ticks, svg

SHAPES = (
    "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",  # disc
    "m-3.6 -3.6h7.2v7.2h-7.2z",  # square
    "m0 -4.8l4.6 8h-9.2z",  # triangle
    "m0 -5l5 5l-5 5l-5 -5z",  # diamond
    "m0 4.8l4.6 -8h-9.2z",  # triangle on its tip
    "m-4 -1.4h2.6v-2.6h2.8v2.6h2.6v2.8h-2.6v2.6h-2.8v-2.6h-2.6z",  # plus
)
"""Paths of the shapes that mark the series, around the pen's place; in turn where there are more series."""
_LETTER_PX = 6.3
"""Mean width of a letter of a chart."""
_LONGEST = 34
"""Letters of a name at the left of a chart; longer ones are cut."""


def marks(axes: Axes, x: Array, y: Array, series: int, opacity: float = 1.0) -> str:
    """The shape of a series at each point of x and y, shape (n,) each."""
    px, py = axes.place(x, y)
    return _shapes(zip(px.tolist(), py.tolist(), strict=True), series, opacity)


def band(axes: Axes, x: Array, low: Array, high: Array, series: int) -> str:
    """The area between two lines over x, shape (n,) each."""
    px, top = axes.place(x, high)
    _, bottom = axes.place(x, low)
    there = list(zip(px.tolist(), top.tolist(), strict=True))
    back = list(zip(px.tolist(), bottom.tolist(), strict=True))[::-1]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in there + back)
    return f'<polygon points="{points}" fill="{colour_of(series)}" fill-opacity="0.16"/>'


def legend(names: Sequence[str]) -> str:
    """A paragraph with the shape, colour and name of each series."""
    parts = []
    for series, name in enumerate(names):
        stroke = f'<path d="M0 6h24" stroke="{colour_of(series)}" stroke-width="2"/>{_shapes([(12, 6)], series)}'
        drawn = f'<svg viewBox="0 0 24 12" width="24" height="12" aria-hidden="true">{stroke}</svg>'
        parts.append(f'<span style="white-space:nowrap;margin-right:1.2rem">{drawn} {html.escape(name)}</span>')
    return f"<p>{''.join(parts)}</p>"


@dataclass(frozen=True)
class Interval:
    """A mean with its interval; the ends are NaN where there is none.

    Attributes:
        mean: The mean.
        low: The lower end.
        high: The upper end.
        series: Number of the series, from 0, that it is of.
    """

    mean: float
    low: float
    high: float
    series: int = 0


def span_of(values: Sequence[float], pad: float = 0.08) -> tuple[float, float]:
    """A range that holds all values that are numbers, with some room at both ends."""
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    room = pad * (high - low) or 0.05 * max(abs(low), 1e-3)
    return low - room, high + room


def forest(
    rows: Sequence[tuple[str, Sequence[Interval]]], title: str, x_label: str, thresholds: Sequence[float] = ()
) -> str:
    """Intervals beside their names, one below the other on one axis, with dashed lines at thresholds.

    Args:
        rows: A name and its intervals.
        title: Stands above.
        x_label: Name and unit of the axis.
        thresholds: Places of the dashed lines.
    """
    values = [value for _, found in rows for each in found for value in (each.mean, each.low, each.high)]
    low, high = span_of([*values, *thresholds])
    left = 14 + _LETTER_PX * min(_LONGEST, max((len(name) for name, _ in rows), default=1))
    width, lane = max(430.0, left + 280), 15.0
    scale = (width - left - 14) / (high - low)
    parts, y = [f'<text x="4" y="11" font-weight="600">{html.escape(title)}</text>'], 22.0
    top = y
    for name, found in rows:
        height = lane * max(len(found), 1) + 6
        parts.append(f'<line x1="4" x2="{width - 10:g}" y1="{y:g}" y2="{y:g}" stroke="var(--line)"/>')
        parts.append(f'<text x="{left - 8:.0f}" y="{y + height / 2 + 4:.1f}" text-anchor="end">{_cut(name)}</text>')
        for place, each in enumerate(found):
            parts.append(_lying(each, y + 3 + lane * (place + 0.5), lambda value: left + (value - low) * scale))
        y += height
    parts += [_dashed(left + (value - low) * scale, top, y) for value in thresholds]
    parts += [
        f'<text x="{left + (value - low) * scale:.1f}" y="{y + 14:g}" text-anchor="middle" fill="var(--soft)">'
        f"{value:g}</text>"
        for value in nice_ticks(low, high)
    ]
    parts.append(
        f'<text x="{width - 10:g}" y="{y + 29:g}" text-anchor="end" fill="var(--soft)">{html.escape(x_label)}</text>'
    )
    return svg(width, y + 34, title, "\n".join(parts))


def strip(interval: Interval, threshold: float, least: bool | None, span: tuple[float, float], label: str) -> str:
    """One interval against a threshold, small enough for a cell of a table; what is right is shaded.

    Args:
        interval: The interval.
        threshold: The dashed line.
        least: Whether values at the threshold and above are right, or else those below; None: neither.
        span: The ends of the axis; intervals in one column share them.
        label: For those who cannot see it.
    """
    width, height = 190.0, 24.0
    scale = (width - 12) / (span[1] - span[0])

    def place(value: float) -> float:
        return 6 + (value - span[0]) * scale

    edge = min(max(place(threshold), 6.0), width - 6)
    start, stop = (edge, width - 6) if least else (6.0, edge)
    shade = f'<rect x="{start:.1f}" y="2" width="{stop - start:.1f}" height="20" fill="{colour_of(2)}"'
    parts = [
        "" if least is None else f'{shade} fill-opacity="0.18"/>',
        f'<line x1="6" x2="{width - 6:g}" y1="22" y2="22" stroke="var(--line)"/>',
        _dashed(edge, 2, 22),
        _lying(interval, 12, place),
    ]
    return f'<div style="min-width: {width:g}px">{svg(width, height, label, "".join(parts))}</div>'


def _lying(each: Interval, y: float, place: Callable[[float], float]) -> str:
    """A mean and its interval on a line."""
    parts = ""
    if np.isfinite(each.low) and np.isfinite(each.high):
        a, b = place(each.low), place(each.high)
        marks = f"M{a:.1f} {y:.1f}H{b:.1f}M{a:.1f} {y - 4:.1f}v8M{b:.1f} {y - 4:.1f}v8"
        parts = f'<path d="{marks}" stroke="{colour_of(each.series)}" stroke-width="1.8" fill="none"/>'
    if np.isfinite(each.mean):
        parts += _shapes([(place(each.mean), y)], each.series)
    return parts


def _dashed(x: float, top: float, bottom: float) -> str:
    style = 'stroke="var(--ink)" stroke-width="1.4" stroke-dasharray="4 3"'
    return f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top:g}" y2="{bottom:g}" {style}/>'


def _shapes(places: Iterable[tuple[float, float]], series: int, opacity: float = 1.0) -> str:
    shape = SHAPES[series % len(SHAPES)]
    path = "".join(f"M{x:.1f} {y:.1f}{shape}" for x, y in places)
    faint = f' fill-opacity="{opacity:g}"' if opacity < 1 else ""
    return f'<path d="{path}" fill="{colour_of(series)}"{faint}/>'


def _cut(name: str) -> str:
    return html.escape(name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "…")
