"""The sections of a page on what a campaign covered, and what not."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pyarrow as pa

from modsim3d.campaign.report.coverage_counts import Counted, Truths, counted_states
from modsim3d.campaign.report.draws import empty_draws
from modsim3d.campaign.report.trace import trace_sections
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.work.coverage import KINDS, VESSELS
from modsim3d.campaign.work.coverage_bins import OCCLUSIONS, RANGES, SIZES
from modsim3d.display import counted
from modsim3d.view.pages import page

__all__ = ["coverage_sections", "trace_sections"]

NO_CLAIM = (
    "A verdict holds for what is counted here. A dash stands for what was not covered: no claim is made about it."
)
ENCOUNTERS = dict(
    zip(
        KINDS.values(),
        (
            "head-on",
            "crossing from starboard",
            "crossing from port",
            "own ship overtakes",
            "own ship is overtaken",
        ),
        strict=True,
    )
)
SEAS = {
    "calm": 0.0,
    "smooth": 0.1,
    "slight": 0.5,
    "moderate": 1.25,
    "rough": 2.5,
    "very rough": 4.0,
    "high": 6.0,
    "very high": 9.0,
}
"""Degrees of the sea, WMO code table 3700, and the significant height in metres from which on."""
ROLLS_DEG = (0.0, 2.0, 5.0, 10.0, 20.0)
_FRAMES = "vessel-frames"


@dataclass(frozen=True)
class Part:
    """A table of a page.

    Attributes:
        title: What its bins are of.
        unit: What is counted.
        rows: A row for each bin.
        note: In a sentence, what the bins mean, or why there are none.
    """

    title: str
    unit: str
    rows: tuple[Counted, ...]
    note: str = ""

    @property
    def empty(self) -> tuple[str, ...]:
        """The bins that nothing is in."""
        return tuple(row.label for row in self.rows if not row.count)

    @property
    def html(self) -> str:
        """The table under its title."""
        cells = [row.cells for row in self.rows]
        header = ["", self.unit, "runs", "traffic seeds"]
        parts = [f"<h3>{html.escape(self.title)}</h3>", page.paragraph(self.note, "soft") if self.note else ""]
        content = "\n".join([*filter(None, parts), page.table(cells, header) if cells else ""])
        return f'<div style="max-width: 30rem">\n{content}\n</div>'


def coverage_sections(folder: CampaignFolder, table: pa.Table) -> list[str]:
    """HTML of what the rows of a campaign cover, in the order of a page.

    Args:
        folder: The campaign.
        table: Its rows so far, see `results_table`.
    """
    truths = Truths.of(table)
    parts = tuple(_parts(folder, table, truths))
    return [
        page.heading("What was covered"),
        page.paragraph(_extent(folder, table, truths)),
        page.paragraph(NO_CLAIM),
        *_gaps(folder, table, parts),
        '<div style="display: flex; flex-wrap: wrap; gap: 0 3rem">',
        *(part.html for part in parts),
        "</div>",
        *_trackers(folder),
    ]


def _extent(folder: CampaignFolder, table: pa.Table, truths: Truths) -> str:
    crashed = len(table) - truths.runs_in_all
    said = (
        f"{truths.runs_in_all:,} of {counted(len(folder.plan), 'run')} are done, over "
        f"{counted(len(truths), 'different truth')} and {counted(truths.seeds_in_all, 'traffic seed')}."
    )
    if crashed:
        said += f" {crashed:,} more crashed and cover nothing."
    fixed = sorted({each["scene"] for each in folder.facts["conditions"] if not each["traffic_has_seed"]})
    if fixed:
        said += f" The traffic of {', '.join(fixed)} is not drawn: it is the same for every seed, and counts as one."
    return said


def _parts(folder: CampaignFolder, table: pa.Table, truths: Truths) -> Iterator[Part]:
    """All tables; the counts of a truth are counted once, however many detectors and trackers met it."""
    yield _encounters(truths)
    yield Part("Performance states of the detector", "frames", counted_states(folder, table))
    classes = sorted(name for name in table.column_names if name.startswith(VESSELS))
    named = [(name, name.removeprefix(VESSELS)) for name in classes]
    yield Part("Classes", "vessels", tuple(truths.counted(*each) for each in named), "Vessels that a camera saw.")
    span = truths.span("covered.least_range_m", "covered.most_range_m", "m")
    note = f"Distance of a visible vessel from the camera. {span}"
    yield Part("Range", _FRAMES, _binned(truths, RANGES.names, RANGES.labels), note)
    span = truths.span("covered.least_size_px", "covered.most_size_px", "px")
    note = f"√(width × height) of the box of a visible vessel. {span}"
    yield Part("Size", _FRAMES, _binned(truths, SIZES.names, SIZES.labels), note)
    yield _occlusions(truths)
    yield _waves(truths)
    yield _rolls(truths)


def _binned(truths: Truths, names: Sequence[str], labels: Sequence[str]) -> tuple[Counted, ...]:
    return tuple(truths.counted(*each) for each in zip(names, labels, strict=True))


def _encounters(truths: Truths) -> Part:
    title, unit = "Encounters of own ship", "encounters"
    if not truths.known("met.seen"):
        return Part(title, unit, (), "No vessel carries a camera, so there is no own ship that could meet another.")
    rows = tuple(truths.counted(*each) for each in ENCOUNTERS.items())
    met, seen = sum(row.count for row in rows), truths.counted("met.seen", "").count
    nearest = truths.span("covered.closest_approach_m", "covered.closest_approach_m", "m", "Closest approach of a run")
    note = (
        f"Vessels that came nearer and passed within a nautical mile; a camera saw {seen:,} of {met:,} before the "
        f"closest approach. {nearest}"
    )
    return Part(title, unit, rows, note)


def _occlusions(truths: Truths) -> Part:
    title, unit = "Occlusions by length", "occlusions"
    if not truths.known(OCCLUSIONS.names[0]):
        return Part(title, unit, (), "The source of the truth cannot tell what is hidden: no occlusion is known.")
    hidden_s = truths.total("covered.hidden_s")
    note = (
        "Less than half of the vessel's silhouette is visible. "
        f"Vessels are wholly hidden for {hidden_s:,.0f} s, all of them together."
    )
    return Part(title, unit, _binned(truths, OCCLUSIONS.names, OCCLUSIONS.labels), note)


def _waves(truths: Truths) -> Part:
    name = "covered.wave_height_m"
    rows = []
    for (sea, low), high in zip(SEAS.items(), (*list(SEAS.values())[1:], np.inf), strict=True):
        label = f"{sea} ({low:g} to {high:g} m)" if np.isfinite(high) else f"{sea} ({low:g} m and more)"
        rows.append(truths.within(name, low, high, label))
    unknown = truths.unknown(name, "wave levels, which have no height")
    note = "Significant wave height, by the degrees of WMO code table 3700."
    return Part("Sea", "truths", (*rows, *([unknown] if unknown.count else [])), note)


def _rolls(truths: Truths) -> Part:
    rows = []
    for low, high in pairwise((*ROLLS_DEG, 180.0)):
        label = f"{low:g} to {high:g}°" if high < 180 else f"{low:g}° and more"
        rows.append(truths.within("covered.camera_roll_rad", np.radians(low), np.radians(high), label))
    return Part("Roll of a camera", "truths", tuple(rows), "By the largest angle of the horizon in an image.")


def _gaps(folder: CampaignFolder, table: pa.Table, parts: Sequence[Part]) -> Iterator[str]:
    """What was not covered, in one list."""
    said = [f"{part.title}: {', '.join(part.empty)}" for part in parts if part.empty]
    said += [f"{part.title}: {part.note}" for part in parts if not part.rows]
    said += empty_draws(folder.keys, table)
    yield "<h3>Not covered</h3>"
    if not said:
        yield page.paragraph("No bin is empty.")
        return
    yield "<ul>\n" + "\n".join(f"<li>{html.escape(text)}</li>" for text in said) + "\n</ul>"


def _trackers(folder: CampaignFolder) -> Iterator[str]:
    """The settings of each tracker, which may differ between scenes and conditions."""
    found: dict[tuple[str, ...], list[int]] = {}
    for number, condition in enumerate(folder.facts["conditions"]):
        for label, facts in condition["trackers"].items():
            settings = ", ".join(f"{key} {value}" for key, value in sorted(facts["settings"].items()))
            row = label, facts["tracker"], facts["package"], settings or "defaults", facts["chosen"]
            found.setdefault(row, []).append(number)
    every = len(folder.facts["conditions"])
    rows = [[*row, "all" if len(numbers) == every else _listed(numbers)] for row, numbers in found.items()]
    yield page.heading("Trackers and their settings")
    yield page.table(rows, ["name", "tracker", "package", "settings", "where they are from", "conditions"])


def _listed(numbers: Sequence[int]) -> str:
    shown = ", ".join(map(str, numbers[:10]))
    return shown if len(numbers) <= 10 else f"{shown} and {len(numbers) - 10} more"
