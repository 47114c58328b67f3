"""Charts as SVG inside a page: they follow its light or dark colours, and need no library to be seen."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from modsim3d.arrays import Array
from modsim3d.view.palette import vessel_colour

FOUND, ASKED = "#0072b2", "#d55e00"
_MARGIN = (44.0, 12.0, 14.0, 34.0)  # left, right, top, bottom


def colour_of(index: int) -> str:
    """A palette colour by index, for CSS."""
    red, green, blue = vessel_colour(index)
    return f"#{red:02x}{green:02x}{blue:02x}"


def figure(drawings: Sequence[str], caption: str) -> str:
    """Drawings side by side with one caption."""
    return f"<figure>\n{''.join(drawings)}\n<figcaption>{html.escape(caption)}</figcaption>\n</figure>"


@dataclass(frozen=True)
class Axes:
    """A drawing's frame: data ranges on a rectangle of pixels.

    Attributes:
        x: Least and greatest.
        y: Likewise.
        width: Of the whole drawing.
        height: Likewise.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: float = 340.0
    height: float = 260.0

    def place(self, x: Array | float, y: Array | float) -> tuple[Array, Array]:
        """Data to pixels."""
        left, right, top, bottom = _MARGIN
        across = (np.asarray(x, dtype=np.float64) - self.x[0]) / (self.x[1] - self.x[0])
        up = (np.asarray(y, dtype=np.float64) - self.y[0]) / (self.y[1] - self.y[0])
        return left + across * (self.width - left - right), self.height - bottom - up * (self.height - top - bottom)

    def drawing(self, content: str, title: str, x_label: str, y_label: str) -> str:
        """The whole SVG: ticks, labels and what is in it."""
        left, right, top, bottom = _MARGIN
        inner = f'x="{left}" y="{top}" width="{self.width - left - right}" height="{self.height - top - bottom}"'
        clip = f"c{crc32(repr((title, x_label, y_label)).encode())}"  # the same in each process, unlike hash()
        return (
            f'<svg viewBox="0 0 {self.width:g} {self.height:g}" width="{self.width:g}" height="{self.height:g}" '
            'style="max-width:100%;margin-right:0.6rem" font-size="11" fill="var(--ink)" role="img" '
            f'aria-label="{html.escape(title, quote=True)}">\n'
            f'<clipPath id="{clip}"><rect {inner}/></clipPath>'
            f'<rect {inner} fill="none" stroke="var(--line)"/>\n{self._ticks()}'
            f'<g clip-path="url(#{clip})">{content}</g>\n'
            f'<text x="{left}" y="10" font-weight="600">{html.escape(title)}</text>'
            f'<text x="{self.width - right}" y="{self.height - 4}" text-anchor="end" fill="var(--soft)">'
            f"{html.escape(x_label)}</text>"
            f'<text x="{left + 4}" y="{top + 12}" fill="var(--soft)">{html.escape(y_label)}</text></svg>\n'
        )

    def _ticks(self) -> str:
        lines = []
        for value in nice_ticks(*self.x):
            px, _ = self.place(value, self.y[0])
            place = f'x="{px:.1f}" y="{self.height - 20:.1f}"'
            lines.append(f'<text {place} text-anchor="middle" fill="var(--soft)">{value:g}</text>')
        for value in nice_ticks(*self.y):
            _, py = self.place(self.x[0], value)
            lines.append(
                f'<text x="{_MARGIN[0] - 4}" y="{py + 4:.1f}" text-anchor="end" fill="var(--soft)">{value:g}</text>'
            )
        return "".join(lines)


def nice_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers between two, at most so many."""
    if not high > low:
        return [low]
    raw = (high - low) / most
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw)
    return [float(f"{value:.10g}") for value in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]


def dots(axes: Axes, x: Array, y: Array, colour: str) -> str:
    """A cloud of points."""
    px, py = axes.place(x, y)
    marks = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(px.tolist(), py.tolist(), strict=True))
    return (
        f'<path d="{marks}" stroke="{colour}" stroke-width="2.4" stroke-linecap="round" stroke-opacity="0.55" '
        'fill="none"/>'
    )


def line(axes: Axes, x: Array, y: Array, colour: str, dashed: bool = False, width: float = 2.0) -> str:
    """A line through points."""
    px, py = axes.place(x, y)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px.tolist(), py.tolist(), strict=True))
    dash = ' stroke-dasharray="6 4"' if dashed else ""
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>'


def ellipse(mean: Array, covariance: Array, deviations: float = 2.0) -> tuple[Array, Array]:
    """Outline of a two-dimensional normal law at so many standard deviations."""
    angles = np.linspace(0, 2 * np.pi, 73)
    values, vectors = np.linalg.eigh(covariance)
    axes = vectors * np.sqrt(np.maximum(values, 0)) * deviations
    outline = mean[:, None] + axes @ np.stack([np.cos(angles), np.sin(angles)])
    return outline[0], outline[1]


def bars(axes: Axes, x: Array, heights: Array, width: float, colour: str) -> str:
    """Upright bars from the axis."""
    left, top = axes.place(np.asarray(x) - width / 2, heights)
    right, bottom = axes.place(np.asarray(x) + width / 2, np.zeros(len(x)))
    return "".join(
        f'<rect x="{a:.1f}" y="{b:.1f}" width="{c - a:.1f}" height="{max(d - b, 0):.1f}" fill="{colour}" '
        'fill-opacity="0.75"/>'
        for a, b, c, d in zip(left.tolist(), top.tolist(), right.tolist(), bottom.tolist(), strict=True)
    )


def whiskers(axes: Axes, x: Array, low: Array, high: Array, colour: str) -> str:
    """Upright intervals."""
    px, bottom = axes.place(x, low)
    _, top = axes.place(x, high)
    marks = "".join(
        f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in zip(px.tolist(), bottom.tolist(), top.tolist(), strict=True)
    )
    return f'<path d="{marks}" stroke="{colour}" stroke-width="1.5" fill="none"/>'


def timeline(starts: Array, stops: Array, states: Sequence[int], names: Sequence[str], unit: str = "s") -> str:
    """Which state when: a lane for each state.

    Args:
        starts: Begin of each stretch.
        stops: Its end.
        states: Index of its state.
        names: Of the states.
        unit: Of the times.
    """
    lane, left, width = 22.0, 90.0, 900.0
    span = max(float(stops[-1]) - float(starts[0]), 1e-9) if len(starts) else 1.0
    scale = (width - left - 10) / span
    origin = float(starts[0]) if len(starts) else 0.0
    height = lane * len(names) + 26
    parts = [
        f'<text x="{left - 6}" y="{lane * (i + 0.7):.1f}" text-anchor="end">{html.escape(name)}</text>'
        f'<line x1="{left}" x2="{width - 10}" y1="{lane * (i + 1):.1f}" y2="{lane * (i + 1):.1f}" '
        'stroke="var(--line)"/>'
        for i, name in enumerate(names)
    ]
    for start, stop, state in zip(starts.tolist(), stops.tolist(), states, strict=True):
        parts.append(
            f'<rect x="{left + (start - origin) * scale:.1f}" y="{lane * state + 3:.1f}" '
            f'width="{max((stop - start) * scale, 0.6):.1f}" height="{lane - 4}" fill="{colour_of(state)}"/>'
        )
    for value in nice_ticks(origin, origin + span, 8):
        parts.append(
            f'<text x="{left + (value - origin) * scale:.1f}" y="{height - 6}" text-anchor="middle" '
            f'fill="var(--soft)">{value:g} {unit}</text>'
        )
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" style="max-width:100%" font-size="12" '
        f'fill="var(--ink)" role="img" aria-label="performance states over time">{"".join(parts)}</svg>'
    )
