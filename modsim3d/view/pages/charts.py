"""Charts as SVG inside a page, for what `modsim3d check run` and `modsim3d learn` write.
matplotlib does not draw them: it is an extra, and pages must do without it. Lines and text take the colours of the
page, light or dark, from its CSS variables."""

import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.view import palette
from modsim3d.view.pages.tables import FILL, scrolling

COLOURS = (FILL, "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999933", "#882255")
"""Colours that colour-blind people can tell apart: Okabe & Ito (2008), and two of Tol (2021)."""
MAX_DOTS, MAX_POINTS = 1500, 800
CHI_SQUARE_95 = 5.991  # the 95 % point of chi-square with two degrees of freedom
_MARGIN = (44.0, 12.0, 14.0, 34.0)  # left, right, top, bottom
_HALO = 'stroke="var(--paper)" stroke-width="3" paint-order="stroke"'  # around text that lies on lines
_LINE_PX = 14  # height of a line of the key


def colour_of(index: int) -> str:
    """The CSS colour of a series by its index, mixed with the page's ink so that it stands out from the paper."""
    return _inked(COLOURS[index % len(COLOURS)])


def state_colours(states: int) -> list[str]:
    """The CSS colours of a detector's performance states in the order of its file: the ramp of the palette, mixed."""
    return [_inked(palette.css(colour)) for colour in palette.state_colours(states)]


def _inked(colour: str) -> str:
    return f"color-mix(in srgb, {colour} 80%, var(--ink))"


FOUND, ASKED = colour_of(0), colour_of(1)


@dataclass(frozen=True)
class Axes:
    """The frame of a chart: ranges of the data, and the size of the whole drawing with its margins in pixels.
    `x_ticks` are places with their texts below the chart; without them there are round numbers."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float = 430.0
    height: float = 300.0
    x_ticks: tuple[tuple[float, str], ...] = ()

    def place(self, x: Array | float, y: Array | float) -> tuple[Array, Array]:
        """Columns and rows of data points in the drawing, in pixels, each of the shape of its argument."""
        left, right, top, bottom = _MARGIN
        across = (np.asarray(x, dtype=np.float64) - self.x[0]) / (self.x[1] - self.x[0])
        up = (np.asarray(y, dtype=np.float64) - self.y[0]) / (self.y[1] - self.y[0])
        return left + across * (self.width - left - right), self.height - bottom - up * (self.height - top - bottom)

    def drawing(self, content: str, title: str, x_label: str, y_label: str) -> str:
        """The whole SVG: frame, ticks, labels and the SVG elements of its content."""
        left, right, top, bottom = _MARGIN
        inner = f'x="{left}" y="{top}" width="{self.width - left - right}" height="{self.height - top - bottom}"'
        clip = f"c{crc32((title + content).encode())}"  # the same in each process, unlike hash()
        content = (
            f'<clipPath id="{clip}"><rect {inner}/></clipPath>'
            f'<rect {inner} fill="none" stroke="var(--line)"/>\n{self._ticks()}'
            f'<g clip-path="url(#{clip})">{content}</g>\n'
            f'<text x="{left}" y="10" font-weight="600">{html.escape(title)}</text>'
            f'<text x="{self.width - right}" y="{self.height - 4}" text-anchor="end" fill="var(--soft)">'
            f"{html.escape(x_label)}</text>"
            f'<text x="{left + 4}" y="{top + 12}" fill="var(--soft)" {_HALO}>{html.escape(y_label)}</text>'
        )
        return svg(self.width, self.height, title, content)

    def _ticks(self) -> str:
        lines = []
        for value, text in self.x_ticks or [(value, tick_text(value)) for value in nice_ticks(*self.x)]:
            px, _ = self.place(value, self.y[0])
            lines.append(svg_text(float(px), self.height - 20, text, "middle"))
        for value in nice_ticks(*self.y):
            _, py = self.place(self.x[0], value)
            lines.append(svg_text(_MARGIN[0] - 4, float(py) + 4, tick_text(value), "end"))
        return "".join(lines)


def tick_text(value: float) -> str:
    """The number at a tick of an axis, with a true minus sign."""
    return f"{value:g}".replace("-", "−")


def svg_text(x: float, y: float, text: str, anchor: str, colour: str = "var(--soft)") -> str:
    """A text in a drawing; `anchor` says which end of it is at x."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{html.escape(text)}</text>'


def svg(width: float, height: float, label: str, content: str, kind: str = "") -> str:
    """A drawing of a width and height in pixels, with a label for those who cannot see it, and a class."""
    mark = f'class="{kind}" ' if kind else ""
    return (
        f'<svg {mark}viewBox="0 0 {width:g} {height:g}" width="{width:g}" style="max-width:100%;margin-right:0.6rem" '
        f'font-size="11" fill="var(--ink)" role="img" aria-label="{html.escape(label, quote=True)}">\n{content}</svg>\n'
    )


def nice_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers from low to high, at most `most` + 1."""
    if not high > low:
        return [low]
    raw = (high - low) / most
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw)
    return [float(f"{value:.10g}") + 0.0 for value in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]


def dots(axes: Axes, x: Array, y: Array, colour: str) -> str:
    """A dot for each point of x and y, shape (n,) each."""
    px, py = axes.place(x, y)
    marks = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(px.tolist(), py.tolist(), strict=True))
    style = 'stroke-width="2.4" stroke-linecap="round" stroke-opacity="0.55" fill="none"'
    return f'<path d="{marks}" stroke="{colour}" {style}/>'


def line(axes: Axes, x: Array, y: Array, colour: str, dashed: bool = False, width: float = 2.0) -> str:
    """A line through the points of x and y, shape (n,) each."""
    px, py = axes.place(x, y)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px.tolist(), py.tolist(), strict=True))
    dash = ' stroke-dasharray="6 4"' if dashed else ""
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>'


def ellipse(mean: Array, covariance: Array, deviations: float = 2.0) -> tuple[Array, Array]:
    """The outline of a normal distribution at some standard deviations from its mean, shape (2,), by its covariance,
    shape (2, 2): x and y, shape (73,) each."""
    angles = np.linspace(0, 2 * np.pi, 73)
    values, vectors = np.linalg.eigh(covariance)
    axes = vectors * np.sqrt(np.maximum(values, 0)) * deviations
    outline = mean[:, None] + axes @ np.stack([np.cos(angles), np.sin(angles)])
    return outline[0], outline[1]


def bars(axes: Axes, x: Array, heights: Array, width: float, colour: str) -> str:
    """Upright bars from y = 0, with their middles at x and a width in units of x; x and heights of shape (n,)."""
    left, top = axes.place(np.asarray(x) - width / 2, heights)
    right, bottom = axes.place(np.asarray(x) + width / 2, np.zeros(len(x)))
    return "".join(
        f'<rect x="{a:.1f}" y="{b:.1f}" width="{c - a:.1f}" height="{max(d - b, 0):.1f}" fill="{colour}" '
        'fill-opacity="0.75"/>'
        for a, b, c, d in zip(left.tolist(), top.tolist(), right.tolist(), bottom.tolist(), strict=True)
    )


def whiskers(axes: Axes, x: Array, low: Array, high: Array, colour: str) -> str:
    """Upright intervals from low to high at x, shape (n,) each."""
    px, bottom = axes.place(x, low)
    _, top = axes.place(x, high)
    spans = zip(px.tolist(), bottom.tolist(), top.tolist(), strict=True)
    marks = "".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in spans)
    return f'<path d="{marks}" stroke="{colour}" stroke-width="1.5" fill="none"/>'


def timeline(starts: Array, stops: Array, states: Sequence[int], names: Sequence[str], unit: str = "s") -> str:
    """A chart of ascending stretches of time in a state, with a lane for each state.
    Each has a start, a stop and the index of its state, shape (n,) each."""
    lane, left, width = 22.0, 90.0, 900.0
    colours = state_colours(len(names))
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
            f'width="{max((stop - start) * scale, 0.6):.1f}" height="{lane - 4}" fill="{colours[state]}"/>'
        )
    for value in nice_ticks(origin, origin + span, 8):
        parts.append(svg_text(left + (value - origin) * scale, height - 6, f"{value:g} {unit}", "middle"))
    return scrolling(svg(width, height, "performance states over time", "".join(parts), "long"))


def key(names: Sequence[str], bottom: float, colours: Sequence[str] = ()) -> str:
    """Names with the colours of their series, or those given, one below the other, above a row of the drawing."""
    x, parts = _MARGIN[0] + 8, []
    for index, name in enumerate(names):
        y, colour = bottom - _LINE_PX * (len(names) - 1 - index), colours[index] if colours else colour_of(index)
        parts.append(
            f'<rect x="{x:g}" y="{y - 7:g}" width="12" height="4" fill="{colour}"/>'
            f'<text x="{x + 18:g}" y="{y - 1:g}">{html.escape(name)}</text>'
        )
    return "".join(parts)


def precision_recall(curves: Mapping[str, tuple[Array, Array]], colours: Sequence[str]) -> str:
    """A chart of precision against recall, shape (n,) each, for each name with its colour."""
    axes, content = Axes((0, 1), (0, 1.02)), ""
    for colour, (recall, precision) in zip(colours, curves.values(), strict=True):
        kept = _along(recall, precision)
        content += line(axes, recall[kept], precision[kept], colour)
    content += key(list(curves), axes.height - _MARGIN[3] - 4, colours)
    return axes.drawing(content, "precision against recall", "recall", "precision")


def _along(recall: Array, precision: Array) -> Indices:
    """Indices of points that lie evenly along a curve: most detections may be false, and lie at its end."""
    steps = np.abs(np.diff(recall, prepend=recall[0])) + np.abs(np.diff(precision, prepend=precision[0]))
    walked = np.cumsum(steps)
    return np.unique(np.append(np.searchsorted(walked, np.linspace(0, walked[-1], MAX_POINTS)), len(recall) - 1))


def error_scatter(groups: Mapping[str, Array], colours: Sequence[str], x_label: str, y_label: str) -> str:
    """A chart of pairs of errors, shape (n, 2) for each name with its colour, with ellipses that hold 95 % of normal
    ones like them. The labels of the axes name the first and the second error of a pair, each with its unit."""
    deviations = CHI_SQUARE_95**0.5
    rims = {name: ellipse(e.mean(axis=0), np.cov(e.T), deviations) for name, e in groups.items() if len(e) > 2}
    widest = max((float(np.abs(rim).max()) for rim in rims.values()), default=0.0)
    everything = np.concatenate([*groups.values(), np.zeros((1, 2))])
    reach = max(float(np.quantile(np.abs(everything), 0.995)) * 1.15, 1.05 * widest, 1e-6)
    axes, content = Axes((-reach, reach), (-reach, reach)), ""
    for colour, (name, errors) in zip(colours, groups.items(), strict=True):
        shown = errors[:: max(1, len(errors) // MAX_DOTS)]
        content += dots(axes, shown[:, 0], shown[:, 1], colour)
        if name in rims:
            content += line(axes, *rims[name], colour)
    content += key(list(groups), axes.height - _MARGIN[3] - 4, colours)
    return axes.drawing(content, f"{y_label} against {x_label}", x_label, y_label)


def named_bars(values: Mapping[str, float], unit: str, label: str) -> str:
    """A chart of horizontal bars with their names and numbers."""
    height, most = 26 * len(values) + 12, max([*values.values(), 1e-9])
    parts = []
    for index, (name, value) in enumerate(values.items()):
        y, width = 10 + 26 * index, 220 * max(value, 0) / most
        parts.append(
            f'<text x="106" y="{y + 13}" text-anchor="end">{html.escape(name)}</text>'
            f'<rect x="114" y="{y}" width="{width:.1f}" height="17" fill="{colour_of(0)}"/>'
            f'<text x="{120 + width:.1f}" y="{y + 13}">{value:.2f} {html.escape(unit)}</text>'
        )
    return svg(460, height, label, "".join(parts))


# ---- Charts of means with their intervals ----

SHAPES = (  # paths of the shapes that mark the series, around the pen's place; in turn where there are more series
    "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",  # disc
    "m-3.6 -3.6h7.2v7.2h-7.2z",  # square
    "m0 -4.8l4.6 8h-9.2z",  # triangle
    "m0 -5l5 5l-5 5l-5 -5z",  # diamond
    "m0 4.8l4.6 -8h-9.2z",  # triangle on its tip
    "m-4 -1.4h2.6v-2.6h2.8v2.6h2.6v2.8h-2.6v2.6h-2.8v-2.6h-2.6z",  # plus
)
_LETTER_PX = 6.3  # mean width of a letter of a chart
_MAX_NAME_LENGTH = 34  # letters of a name at the left of a chart; longer ones are cut


def marks(axes: Axes, x: Array, y: Array, series: int, opacity: float = 1.0) -> str:
    """The shape of a series at each point of x and y, shape (n,) each."""
    px, py = axes.place(x, y)
    return _shapes(zip(px.tolist(), py.tolist(), strict=True), series, opacity)


def band(axes: Axes, x: Array, low: Array, high: Array, series: int) -> str:
    """The area between two lines over x, shape (n,) each."""
    px, top = axes.place(x, high)
    _, bottom = axes.place(x, low)
    upper_line = list(zip(px.tolist(), top.tolist(), strict=True))
    back = list(zip(px.tolist(), bottom.tolist(), strict=True))[::-1]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in upper_line + back)
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
class ChartInterval:
    """A mean with its interval; the ends are NaN where there is none."""

    mean: float
    low: float
    high: float
    series: int = 0  # number of the series that it is of


def span_of(values: Sequence[float], pad: float = 0.08) -> tuple[float, float]:
    """A range that holds all values that are numbers, with some room at both ends."""
    numbers = np.array([value for value in values if np.isfinite(value)])
    if not len(numbers):
        return 0.0, 1.0
    low, high = float(numbers.min()), float(numbers.max())
    room = pad * (high - low) or 0.05 * max(abs(low), 1e-3)
    return low - room, high + room


def forest(
    rows: Sequence[tuple[str, Sequence[ChartInterval]]], title: str, x_label: str, thresholds: Sequence[float] = ()
) -> str:
    """Named intervals, one below the other on one axis, with dashed lines at thresholds; `x_label` has the unit."""
    values = [value for _, group in rows for bar in group for value in (bar.mean, bar.low, bar.high)]
    low, high = span_of([*values, *thresholds])
    left = 14 + _LETTER_PX * min(_MAX_NAME_LENGTH, max((len(name) for name, _ in rows), default=1))
    width, lane = max(430.0, left + 280), 15.0
    scale = (width - left - 14) / (high - low)
    top = y = 22.0
    parts = [f'<text x="4" y="11" font-weight="600">{html.escape(title)}</text>']
    for name, group in rows:
        height = lane * max(len(group), 1) + 6
        parts.append(f'<line x1="4" x2="{width - 10:g}" y1="{y:g}" y2="{y:g}" stroke="var(--line)"/>')
        parts.append(f'<text x="{left - 8:.0f}" y="{y + height / 2 + 4:.1f}" text-anchor="end">{_cut(name)}</text>')
        for place, bar in enumerate(group):
            parts.append(_lying(bar, y + 3 + lane * (place + 0.5), lambda value: left + (value - low) * scale))
        y += height
    parts += [_dashed(left + (value - low) * scale, top, y) for value in thresholds]
    texts = [(f"{left + (value - low) * scale:.1f}", y + 14, "middle", f"{value:g}") for value in nice_ticks(low, high)]
    for x, row, anchor, text in [*texts, (f"{width - 10:g}", y + 29, "end", html.escape(x_label))]:
        parts.append(f'<text x="{x}" y="{row:g}" text-anchor="{anchor}" fill="var(--soft)">{text}</text>')
    return svg(width, y + 34, title, "\n".join(parts))


def strip(interval: ChartInterval, threshold: float, least: bool | None, span: tuple[float, float], label: str) -> str:
    """One interval against a threshold, small enough for a cell of a table; what is right is shaded: values at the
    threshold and above if `least`, those below if not, neither if None. Intervals in one column share `span`, the ends
    of the axis. The label is for those who cannot see it."""
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


def _lying(bar: ChartInterval, y: float, place: Callable[[float], float]) -> str:
    parts = ""
    if np.isfinite(bar.low) and np.isfinite(bar.high):
        a, b = place(bar.low), place(bar.high)
        marks = f"M{a:.1f} {y:.1f}H{b:.1f}M{a:.1f} {y - 4:.1f}v8M{b:.1f} {y - 4:.1f}v8"
        parts = f'<path d="{marks}" stroke="{colour_of(bar.series)}" stroke-width="1.8" fill="none"/>'
    if np.isfinite(bar.mean):
        parts += _shapes([(place(bar.mean), y)], bar.series)
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
    return html.escape(name if len(name) <= _MAX_NAME_LENGTH else name[: _MAX_NAME_LENGTH - 1] + "…")
