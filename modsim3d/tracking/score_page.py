"""Scores of tracks as a document: the outcome, the table, the rules, and where tracks fail."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import orjson

from modsim3d.core.arrays import Array
from modsim3d.core.document import Block, Cell, Document, Figure, Fold, Heading, Table, Text, Where
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted, number
from modsim3d.io.atomic_write import write_files
from modsim3d.tracking.oracle import SMOOTHED
from modsim3d.tracking.run_scores import ScoredTracks, TrackScores
from modsim3d.tracking.score_tables import (
    ENCOUNTER_HEADER,
    HEADER,
    HIDDEN_HEADER,
    OCCLUSION_HEADER,
    SEED_HEADER,
    WORLD_HEADER,
    conclusion_of,
    encounter_rows,
    encounters_in_words,
    hidden_rows,
    is_missed,
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
    world_rows,
    world_rules,
)
from modsim3d.tracking.score_text import MEANINGS, rules_in_words
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.view.pages import charts, page
from modsim3d.view.pages.provenance import Provenance, run_inputs, run_seeds, run_versions, track_inputs

FILES = ("score.json", "score.html")
OCCLUSION = "occlusion"
GROUP_NAMES = {
    "visible_fraction": "visible fraction",
    "phase": "an occlusion",
    OCCLUSION: "length of the occlusion",
    "range": "range, m",
    "size": "size, px",
    "edge": "edge of the image",
    "state": "performance state",
    "label": "class",
}
"""What tables call the groups of a breakdown."""


def write_scores(scores: ScoredTracks, folder: StrPath, command: str | None = None) -> None:
    """Write `score.json` and `score.html` into a folder; the page names the command, or the call if it is None."""
    target = as_path(folder, "folder")
    options = orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
    data = orjson.dumps(score_data(scores), default=str, option=options) + b"\n"
    write_files(dict(zip((target / name for name in FILES), (data, score_page(scores, command)), strict=True)))


def score_page(scores: ScoredTracks, command: str | None = None) -> str:
    """The whole page; it names the command, or the call if it is None."""
    return page.document_page(document(scores), _provenance(scores, command))


def document(scores: ScoredTracks) -> Document:
    """The scores, to be read."""
    return Document(
        f"{scores.run.scene.name}: how well is it tracked?",
        [Text(conclusion_of(scores), "lead", Where.EVERYWHERE)],
        [*(_in_images(scores) if scores.trackers else ()), *_in_world(scores)],
    )


def _in_images(scores: ScoredTracks) -> Iterator[Block]:
    run, rows = scores.run, score_rows(scores)
    yield Table("Scores", HEADER, rows, soft=range(len(scores.trackers), len(rows)), where=Where.EVERYWHERE)
    yield Text(
        "The last two lines are the same detections with perfect association: each detection is given to the vessel "
        "that it came from, and false ones are removed. They are references and no ceilings: a tracker that smooths "
        "better may exceed them.",
        "soft",
        Where.PAGE,
    )
    of_run = f"This run has {counted(run.steps, 'step')} and {counted(len(run.scene.cameras), 'camera')}."
    yield Text(f"{of_run} {remarks_of(scores)}", "soft")
    yield Fold("What the scores mean", [Table("", (), list(MEANINGS.items()), where=Where.PAGE)])
    if curves := _curves(scores):
        said = "HOTA is the mean over these thresholds. A line that falls early has boxes far from the true ones: then "
        yield Figure(partial(_alpha_chart, curves), f"{said}compare centres instead of IoU.")
    yield Heading("Rules")
    yield Table("", (), rules_in_words(scores.rules))
    yield Heading("Detector seeds")
    yield Text(seeds_in_words(scores), "soft")
    yield Table("", SEED_HEADER, seed_rows(scores))
    yield Heading("Where vessels are lost", where=Where.PAGE)
    yield Text(
        "Tracks and vessels are matched once. Recall is the share of the vessel-frames in a line that a track "
        "follows; association is how much of the vessel and of the track belong together, where one follows. The "
        "oracle is the smoothed reference.",
        "soft",
        Where.PAGE,
    )
    yield from _breakdowns(scores)
    yield from part_tables(scores)
    yield Heading("Wholly hidden vessels")
    yield Text("They count neither way in all other tables. A good tracker coasts over them.", "soft", Where.PAGE)
    yield Table("", HIDDEN_HEADER, hidden_rows(scores), where=Where.PAGE)
    yield Heading("Occlusions")
    for each in scores.trackers:
        yield _occlusions(each)
    yield Heading("All scores")
    header = ("score", *(name for name, _ in named_scores(scores)))
    yield Fold("By their keys", [Table("", header, key_rows(scores), where=Where.PAGE)])


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


def _curves(scores: ScoredTracks) -> dict[str, Array]:
    """HOTA at each threshold of similarity, shape (n,), by tracker and reference."""
    curves = {name: found.flat()["hota_by_alpha"] for name, found in named_scores(scores)}
    return {name: np.array(values) for name, values in curves.items() if isinstance(values, tuple)}


def _alpha_chart(curves: Mapping[str, Array]) -> str:
    axes, content = charts.Axes((0, 1), (0, 1.02), width=560), ""
    for place, values in enumerate(curves.values()):
        content += charts.line(axes, np.linspace(0.05, 0.95, len(values)), values, charts.colour_of(place))
    content += charts.key(list(curves), axes.height - 38)
    return axes.drawing(content, "HOTA by threshold", "least similarity of a match", "HOTA")


def _breakdowns(scores: ScoredTracks) -> Iterator[Block]:
    """Recall by each property: on a page of all trackers and the oracle side by side, on a terminal of the best one."""
    best, oracle = scores.trackers[0], ("oracle", scores.references[SMOOTHED])
    yield Heading(f"Where {best.name} loses vessels", where=Where.TERMINAL)
    yield from _breakdown_tables([("", best.scores)], Where.TERMINAL)
    yield from _breakdown_tables([*((each.name, each.scores) for each in scores.trackers), oracle], Where.PAGE)
    groups = [(GROUP_NAMES[group.name], group.explanation) for group in best.scores.breakdown]
    yield Fold("What the lines are", [Table("", (), groups, where=Where.PAGE)])


def _breakdown_tables(named: Sequence[tuple[str, Scores]], where: Where) -> Iterator[Table]:
    names = [f"{name}: " if name else "" for name, _ in named]
    rows: list[list[str | Cell]] = []
    for index, group in enumerate(named[0][1].breakdown):
        bins = list(zip(*(found.breakdown[index].rows for _, found in named), strict=True))
        if group.name == OCCLUSION:
            header = ["length, s", "occlusions", "vessel-frames"]
            lengths = [
                (
                    each[0].bin,
                    f"{each[0].occlusions}",
                    f"{each[0].vessel_frames:,}",
                    *_cells(each, "survived", "recall"),
                )
                for each in bins
            ]
            columns = [name + key for name in names for key in ("survived", "recall")]
            of_occlusions = Table("By length of the occlusion", [*header, *columns], lengths, where=where)
        else:
            for place, each in enumerate(bins):
                name = "" if place else GROUP_NAMES[group.name]
                first = [name, each[0].bin, f"{each[0].vessel_frames:,}"]
                rows.append(first + _cells(each, "recall", "association"))
    columns = [name + key for name in names for key in ("recall", "association")]
    yield Table("", ("by", "", "vessel-frames", *columns), rows, where=where)
    yield of_occlusions


def _cells(bins: tuple[Bin, ...], *keys: str) -> list[str | Cell]:
    """Shares of a bin of each tracker, as bars."""
    return [
        Cell(
            survived_of(each) if key == "survived" else number(getattr(each, key), 2),
            getattr(each, key) or 0.0,
            bar=True,
        )
        for each in bins
        for key in keys
    ]


def _occlusions(tracker: TrackScores) -> Block:
    """The list of a tracker's occlusions, closed at first where there are many."""
    found = tracker.scores.occlusions
    if not found:
        return Text(f"{tracker.name}: no vessel is occluded.", "", Where.PAGE)
    survived, judged = survived_and_judged(found)
    said = f"{tracker.name}: {survived} of {judged} survived; {counted(len(found), 'occlusion')} in all"
    failed = {index for index, each in enumerate(found) if each.survived is False}
    table = Table("", OCCLUSION_HEADER, occlusion_rows(found), bad=failed, where=Where.PAGE)
    return Fold(said, [table], opened=len(found) <= 15)


def _in_world(scores: ScoredTracks) -> Iterator[Block]:
    yield Heading("Tracks in the world")
    yield Table("", WORLD_HEADER, world_rows(scores))
    for each in scores.world[:1]:
        yield Text(world_rules(each), "soft")
    for each in scores.world:
        met = each.scores.encounters
        yield Text(encounters_in_words(each))
        missed = {place for place, vessel in enumerate(met) if is_missed(vessel)}
        yield Table("", ENCOUNTER_HEADER, encounter_rows(met), bad=missed)
