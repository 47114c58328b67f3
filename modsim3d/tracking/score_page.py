"""The page of scores: its sentence, the table, the rules, and where tracks fail."""

from __future__ import annotations

import html
from collections.abc import Mapping

import numpy as np
import orjson

from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted
from modsim3d.io.atomic_write import write_files
from modsim3d.tracking.oracle import RAW, REFERENCES
from modsim3d.tracking.run_scores import ScoredTracks, TrackScores
from modsim3d.tracking.score_tables import (
    GROUP_NAMES,
    HEADER,
    HIDDEN_HEADER,
    OCCLUSION_HEADER,
    SEED_HEADER,
    conclusion_of,
    hidden_rows,
    key_rows,
    named_scores,
    occlusion_rows,
    part_tables,
    remarks_of,
    score_data,
    score_rows,
    seed_rows,
    seeds_in_words,
    survived_and_judged,
    survived_of,
    world_sections,
)
from modsim3d.tracking.score_text import MEANINGS, number, rules_in_words
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.view.pages import charts, page
from modsim3d.view.pages.provenance import Provenance, run_inputs, run_seeds, run_versions, track_inputs

FILES = ("score.json", "score.html")
CLOSE = "padding-right: 0.4rem"
"""Style of the columns of bars, so that those of four trackers and a reference fit on a page."""
GROUP_TITLES = {"phase": "Before, during and after an occlusion", "occlusion": "By length of the occlusion, s"}


def write_scores(scores: ScoredTracks, folder: StrPath, command: str | None = None) -> None:
    """Write `score.json` and `score.html` into a folder; the page names the command, or the call if it is None."""
    target = as_path(folder, "folder")
    options = orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
    data = orjson.dumps(score_data(scores), default=str, option=options) + b"\n"
    write_files(dict(zip((target / name for name in FILES), (data, score_page(scores, command)), strict=True)))


def score_page(scores: ScoredTracks, command: str | None = None) -> str:
    """The whole page; it names the command, or the call if it is None."""
    run = scores.run
    of_run = f"This run has {counted(run.steps, 'step')} and {counted(len(run.scene.cameras), 'camera')}."
    body = [page.paragraph(conclusion_of(scores), "lead")]
    if scores.trackers:
        body += [
            page.table(score_rows(scores), HEADER),
            page.paragraph(
                "The last two lines are the same detections with perfect association: each detection is given to the "
                "vessel that it came from, and false ones are removed. They are references and no ceilings: a tracker "
                "that smooths better may exceed them.",
                "soft",
            ),
            page.paragraph(f"{of_run} {remarks_of(scores)}", "soft"),
            page.folded("What the scores mean", page.table(list(MEANINGS.items()))),
            _alpha_chart(scores),
            page.heading("Rules"),
            page.table(rules_in_words(scores.rules)),
            *_seeds(scores),
            page.heading("Where vessels are lost"),
            page.paragraph(
                "Tracks and vessels are matched once. Recall is the share of the vessel-frames in a line that a track "
                "follows; association is how much of the vessel and of the track belong together, where one follows.",
                "soft",
            ),
            *_breakdowns(scores),
            *_parts(scores),
            page.heading("Wholly hidden vessels"),
            page.paragraph("They count neither way in all other tables. A good tracker coasts over them.", "soft"),
            page.table(hidden_rows(scores), HIDDEN_HEADER),
            page.heading("Occlusions"),
            *(part for each in scores.trackers for part in _occlusions(each)),
            page.heading("All scores"),
            page.folded(
                "By their keys", page.table(key_rows(scores), ("score", *(name for name, _ in named_scores(scores))))
            ),
        ]
    title = f"{run.scene.name}: how well is it tracked?"
    return page.page(title, [*body, *world_sections(scores)], _provenance(scores, command))


def _provenance(scores: ScoredTracks, command: str | None) -> Provenance:
    run = scores.run
    given = [(each.name, each.path) for each in scores.trackers]
    given += [(each.name, each.path) for each in scores.world]
    call = f"modsim3d.score_run({str(run.folder)!r}, …).write(…) from Python"
    again = () if scores.seeds is None else (("detector, run again", ", ".join(map(str, scores.seeds.seeds))),)
    tracks = [found for name, path in given for found in track_inputs(name, path)]
    return Provenance(
        page="scores of tracks",
        made_by=command or call,
        inputs=(*run_inputs(run), *tracks),
        seeds=(*run_seeds(run), *again),
        options=tuple((f"Rule: {name}", text) for name, text in rules_in_words(scores.rules)),
        made_before=run_versions(run),
    )


def _alpha_chart(scores: ScoredTracks) -> str:
    """HOTA at each threshold of similarity."""
    axes, content = charts.Axes((0, 1), (0, 1.02), width=560), ""
    names: list[str] = []
    for name, found in named_scores(scores):
        values = found.flat()["hota_by_alpha"]
        if not isinstance(values, tuple):
            continue
        alphas = np.linspace(0.05, 0.95, len(values))
        content += charts.line(axes, alphas, np.array(values), charts.colour_of(len(names)))
        names.append(name)
    if not names:
        return ""
    content += charts.key(names, axes.height - 38)
    drawing = axes.drawing(content, "HOTA by threshold", "least similarity of a match", "HOTA")
    return charts.figure(
        [drawing],
        "HOTA is the mean over these thresholds. A line that falls early has boxes far from the true ones: then "
        "compare centres instead of IoU.",
    )


def _seeds(scores: ScoredTracks) -> list[str]:
    if scores.seeds is None:
        return []
    rows = page.table(seed_rows(scores), SEED_HEADER)
    return [page.heading("Detector seeds"), page.paragraph(seeds_in_words(scores), "soft"), rows]


def _breakdowns(scores: ScoredTracks) -> list[str]:
    """A table for each property, with the trackers and the smoothed reference side by side."""
    shown = [each for each in named_scores(scores) if each[0] != REFERENCES[RAW]]
    parts = []
    for index, group in enumerate(shown[0][1].breakdown):
        bins = {name: {each.bin: each for each in found.breakdown[index].rows} for name, found in shown}
        title = GROUP_TITLES.get(group.name, f"By {GROUP_NAMES[group.name]}")
        parts += [f"<h3>{html.escape(title)}</h3>", page.paragraph(group.explanation, "soft")]
        parts.append(_bin_table(bins, group.name == "occlusion") if group.rows else page.paragraph("There are none."))
    return parts


def _bin_table(bins: Mapping[str, Mapping[str, Bin]], of_occlusions: bool) -> str:
    """Recall and association of the bins of one property, as bars."""
    first = next(iter(bins.values()))
    per = ("survived", "recall") if of_occlusions else ("recall", "association")
    spans = "".join(f'<th colspan="{len(per)}">{html.escape(name)}</th>' for name in bins)
    counts = ("occlusions", "vessel-frames") if of_occlusions else ("vessel-frames",)
    head = "".join(f'<th class="number">{name}</th>' for name in counts)
    head += "".join(f'<th class="number" style="{CLOSE}">{name}</th>' for name in per * len(bins))
    lines = [f"<thead><tr><th></th>{'<th></th>' * len(counts)}{spans}</tr>", f"<tr><th></th>{head}</tr></thead>"]
    for name, row in first.items():
        cells = [f'<td class="number">{row.occlusions}</td>'] if of_occlusions else []
        cells.append(f'<td class="number">{row.vessel_frames:,}</td>')
        for each in bins.values():
            cells += [_bar(getattr(each[name], key), _text(each[name], key)) for key in per]
        lines.append(f'<tr><th style="white-space: nowrap">{html.escape(name)}</th>{"".join(cells)}</tr>')
    return page.scrolling("<table>\n" + "\n".join(lines) + "\n</table>")


def _text(row: Bin, key: str) -> str:
    return survived_of(row) if key == "survived" else number(getattr(row, key), 2)


def _bar(share: float | None, text: str) -> str:
    """A share as text with a bar behind it, of one width for a share in all columns, so that bars can be compared."""
    width = f"{3.5 * min(max(share or 0.0, 0.0), 1.0):.3g}rem"
    shade = f"color-mix(in srgb, {charts.COLOURS[0]} 35%, transparent)"
    fill = f"linear-gradient(to right, {shade} {width}, transparent {width})"
    return f'<td class="number" style="background: {fill}; min-width: 3.5rem; {CLOSE}">{text}</td>'


def _parts(scores: ScoredTracks) -> list[str]:
    """HOTA and others by state, by camera and by class."""
    found = []
    for title, header, rows in part_tables(scores):
        found += [page.heading(title), page.table(rows, header)]
    return found


def _occlusions(tracker: TrackScores) -> list[str]:
    """The list of a tracker's occlusions, closed at first where there are many."""
    found: Scores = tracker.scores
    if not found.occlusions:
        return [page.paragraph(f"{tracker.name}: no vessel is occluded.")]
    survived, judged = survived_and_judged(found.occlusions)
    said = f"{tracker.name}: {survived} of {judged} survived; {counted(len(found.occlusions), 'occlusion')} in all"
    failed = {index for index, each in enumerate(found.occlusions) if each.survived is False}
    table = page.table(occlusion_rows(found.occlusions), OCCLUSION_HEADER, failed)
    return [page.folded(said, table, opened=len(found.occlusions) <= 15)]
