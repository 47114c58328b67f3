"""Pictures of a detector's figures, as SVG that takes the page's colours."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

import numpy as np

from modsim3d.arrays import Array, Indices

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999933", "#882255")
"""Told apart by colour-blind people (Okabe & Ito (2008))."""
_MOST_DOTS, _MOST_POINTS = 1500, 800
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP, _RIGHT = 460, 320, 56, 46, 14, 14


def colour(index: int) -> str:
    """Of the so many-th thing, moved a little towards the ink of the page, from which it then stands off."""
    return f"color-mix(in srgb, {COLOURS[index % len(COLOURS)]} 80%, currentColor)"


def _svg(parts: Sequence[str], caption: str, width: int = _WIDTH, height: int = _HEIGHT) -> str:
    title = html.escape(caption, quote=True)
    return (
        f'<figure class="plot"><svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-label="{title}" font-size="12" fill="currentColor">{"".join(parts)}</svg>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


class _Axes:
    """A frame with ticks, and places in it."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], x_label: str, y_label: str) -> None:
        self.x, self.y = x, y
        right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
        self.parts = []
        for value in _ticks(*x):
            place = self.across(value)
            self.parts.append(f'<path d="M{place:.1f} {_TOP}V{bottom}" stroke="currentColor" opacity=".13"/>')
            self.parts.append(f'<text x="{place:.1f}" y="{bottom + 16}" text-anchor="middle">{value:g}</text>')
        for value in _ticks(*y):
            place = self.down(value)
            self.parts.append(f'<path d="M{_LEFT} {place:.1f}H{right}" stroke="currentColor" opacity=".13"/>')
            self.parts.append(f'<text x="{_LEFT - 6}" y="{place + 4:.1f}" text-anchor="end">{value:g}</text>')
        middle = (_LEFT + right) / 2
        self.parts.append(f'<text x="{middle}" y="{_HEIGHT - 8}" text-anchor="middle">{html.escape(x_label)}</text>')
        turned = f'transform="translate(14 {(_TOP + bottom) / 2}) rotate(-90)"'
        self.parts.append(f'<text {turned} text-anchor="middle">{html.escape(y_label)}</text>')

    def across(self, value: float) -> float:
        low, high = self.x
        return _LEFT + (value - low) / (high - low) * (_WIDTH - _RIGHT - _LEFT)

    def down(self, value: float) -> float:
        low, high = self.y
        return _HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _BOTTOM - _TOP)

    def line(self, x: Array, y: Array, ink: str) -> None:
        points = " ".join(f"{self.across(a):.1f},{self.down(b):.1f}" for a, b in zip(x, y, strict=True))
        self.parts.append(f'<polyline points="{points}" fill="none" stroke="{ink}" stroke-width="1.8"/>')


def _ticks(low: float, high: float) -> list[float]:
    step = 10 ** math.floor(math.log10((high - low) / 4))
    step *= next(m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= 6)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 10) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def precision_recall(curves: Mapping[str, tuple[Array, Array]], caption: str) -> str:
    """Curves of recall and precision."""
    axes = _Axes((0, 1), (0, 1.02), "recall", "precision")
    for index, (name, (recall, precision)) in enumerate(curves.items()):
        kept = _along(recall, precision)
        axes.line(recall[kept], precision[kept], colour(index))
        axes.parts.append(_key(index, name, _HEIGHT - _BOTTOM - 14 * (len(curves) - index)))
    return _svg(axes.parts, caption)


def _along(recall: Array, precision: Array) -> Indices:
    """Places of points that lie evenly along a curve: most detections may be false, and lie at its end."""
    steps = np.abs(np.diff(recall, prepend=recall[0])) + np.abs(np.diff(precision, prepend=precision[0]))
    walked = np.cumsum(steps)
    return np.unique(np.append(np.searchsorted(walked, np.linspace(0, walked[-1], _MOST_POINTS)), len(recall) - 1))


def _key(index: int, name: str, y: float) -> str:
    return (
        f'<rect x="{_LEFT + 8}" y="{y - 9:.0f}" width="12" height="4" fill="{colour(index)}"/>'
        f'<text x="{_LEFT + 26}" y="{y - 3:.0f}">{html.escape(name)}</text>'
    )


def error_scatter(groups: Mapping[str, Array], x_label: str, y_label: str, caption: str) -> str:
    """Pairs of errors, shape (n, 2) each, with the ellipse that holds 95 % of a normal distribution like them."""
    everything = np.concatenate([*groups.values(), np.zeros((1, 2))])
    rims = {name: _ellipse(points) for name, points in groups.items() if len(points) > 2}
    widest = max((float(np.abs(rim).max()) for rim in rims.values()), default=0.0)
    reach = max(float(np.quantile(np.abs(everything), 0.995)) * 1.15, 1.05 * widest, 1e-6)
    axes = _Axes((-reach, reach), (-reach, reach), x_label, y_label)
    for index, (name, points) in enumerate(groups.items()):
        shown = points[np.abs(points).max(axis=1, initial=0) <= reach][:: max(1, len(points) // _MOST_DOTS)]
        dots = "".join(f"M{axes.across(a):.1f} {axes.down(b):.1f}h0" for a, b in shown)
        ink = colour(index)
        axes.parts.append(f'<path d="{dots}" stroke="{ink}" stroke-width="2.4" stroke-linecap="round" opacity=".5"/>')
        if name in rims:
            axes.line(rims[name][:, 0], rims[name][:, 1], ink)
        axes.parts.append(_key(index, name, _TOP + 14 * (index + 1)))
    return _svg(axes.parts, caption)


def _ellipse(points: Array) -> Array:
    values, vectors = np.linalg.eigh(np.cov(points.T))
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) * math.sqrt(5.991)  # 95 % of chi-square with two degrees
    rim: Array = points.mean(axis=0) + circle * np.sqrt(np.maximum(values, 0)) @ vectors.T
    return rim


def bars(values: Mapping[str, float], unit: str, caption: str) -> str:
    """Horizontal bars with their numbers."""
    height = 26 * len(values) + 12
    most = max([*values.values(), 1e-9])
    parts = []
    for index, (name, value) in enumerate(values.items()):
        y, width = 10 + 26 * index, 220 * max(value, 0) / most
        parts.append(f'<text x="106" y="{y + 13}" text-anchor="end">{html.escape(name)}</text>')
        parts.append(f'<rect x="114" y="{y}" width="{width:.1f}" height="17" fill="{colour(0)}"/>')
        parts.append(f'<text x="{120 + width:.1f}" y="{y + 13}">{value:.2f} {html.escape(unit)}</text>')
    return _svg(parts, caption, height=height)


def confusion_table(names: Sequence[str], counts: Array, shares: Array) -> str:
    """A confusion matrix: counts and, under them, shares of the column; the darker the larger."""
    k = len(names)
    head = "".join(f"<th>{html.escape(name)}</th>" for name in [*names, "background"])
    lines = [f"<tr><th>detected as \\ true</th>{head}</tr>"]
    for row, name in enumerate([*names, "missed"]):
        cells = []
        for column in range(k + 1):
            if row == k and column == k:
                cells.append("<td></td>")
                continue
            share = float(np.nan_to_num(shares[row, column]))
            shade = f"color-mix(in srgb, {COLOURS[0]} {60 * share:.0f}%, transparent)"
            cells.append(
                f'<td class="number" style="background: {shade}">'
                f'{counts[row, column]:.0f}<br><span class="soft">{share:.3f}</span></td>'
            )
        lines.append(f"<tr><th>{html.escape(name)}</th>{''.join(cells)}</tr>")
    return '<table class="shares">\n' + "\n".join(lines) + "\n</table>"
