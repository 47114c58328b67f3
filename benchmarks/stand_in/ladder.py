"""The picture of the ladder: how far simulated scores lie from real ones at each rung, a panel a score and tracker."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.stand_in.differences import AGREES, DIFFERS, UNDECIDED
from benchmarks.stand_in.margins import BY_KEY, Score

SHOWN = ("hota", "deta", "assa", "idf1", "gospa", "id_switches", "track_s", "false_tracks")
LOOKS = {AGREES: ("#0072B2", "o", "full"), DIFFERS: ("#D55E00", "D", "full"), UNDECIDED: ("#595959", "s", "none")}
"""Colour, marker and filling of each verdict: different also in grey and for the colour-blind."""
BAND = "#CDE6F5"
INCHES, DPI = (11.0, 13.6), 110


TITLE = "Simulated minus real: the mean over films and its 95 % interval"


def draw_ladder(results: Mapping[str, Any], file: Path) -> None:
    """Write the picture as PNG; results as `measure` gives them."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    trackers, rungs = results["trackers"], results["rungs"]
    with mpl.rc_context({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}):
        figure, panels = plt.subplots(
            len(SHOWN), len(trackers), figsize=INCHES, sharex=True, sharey="row", squeeze=False, layout="constrained"
        )
        for row, key in zip(panels, SHOWN, strict=True):
            for axes, tracker in zip(row, trackers, strict=True):
                _panel(axes, [results["differences"][rung["name"]][tracker][key] for rung in rungs])
            row[0].set_ylabel(_title(BY_KEY[key]))
        for axes, tracker in zip(panels[0], trackers, strict=True):
            axes.set_title(tracker, fontweight="bold")
        for axes in panels[-1]:
            axes.set_xticks(range(len(rungs)), [rung["name"] for rung in rungs])
            axes.set_xlim(-0.6, len(rungs) - 0.4)
        _key(figure, rungs)
        figure.savefig(file, dpi=DPI, metadata={"Software": None})
        plt.close(figure)


def _panel(axes: Any, found: list[dict[str, Any]]) -> None:
    """One score of one tracker: a mark and an interval at each rung, and the margin as a band."""
    margins = [each["margin"] for each in found if each["margin"] is not None]
    if margins:
        axes.axhspan(-max(margins), max(margins), color=BAND, zorder=0, lw=0)
    axes.axhline(0, color="#595959", lw=0.8, zorder=1)
    for at, each in enumerate(found):
        if each["mean"] is None:
            continue
        colour, marker, filling = LOOKS[each["verdict"]]
        axes.plot([at, at], [each["low"], each["high"]], color=colour, lw=1.8, zorder=2, solid_capstyle="butt")
        face = colour if filling == "full" else "white"
        axes.plot(at, each["mean"], marker, color=colour, markerfacecolor=face, ms=5.5, mew=1.5, zorder=3)
    axes.margins(y=0.08)
    axes.grid(axis="y", color="#E5E5E5", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelbottom=True)


def _key(figure: Any, rungs: list[dict[str, str]]) -> None:
    """What the marks mean, above the panels, and the letters, below them."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = [
        Line2D(
            [], [], color=colour, marker=marker, lw=1.8, mew=1.5, markerfacecolor=colour if filling == "full" else "w"
        )
        for colour, marker, filling in LOOKS.values()
    ]
    steps = [f"{rung['name']}  {'+ ' if at else ''}{rung['title']}" for at, rung in enumerate(rungs)]
    figure.legend(
        [Line2D([], [], lw=0)] * len(steps),
        steps,
        loc="outside lower left",
        ncols=2,
        frameon=False,
        handlelength=0,
    )
    figure.legend(
        [*marks, Patch(color=BAND)],
        [*LOOKS, "margin, fixed beforehand"],
        loc="outside upper left",
        title=TITLE,
        title_fontsize=13,
        alignment="left",
        ncols=len(marks) + 1,
        frameon=False,
        handlelength=1.6,
    )


def _title(score: Score) -> str:
    """The title of a score, in two lines where it is long."""
    return score.title.replace("mean length of a track, s", "mean length\nof a track, s")
