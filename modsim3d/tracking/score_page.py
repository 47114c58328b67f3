"""Scores of tracks as a document: the outcome, the table, the rules, and where tracks fail."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import orjson

from modsim3d.core.arrays import Array
from modsim3d.core.document import Block, Cell, Document, Figure, Fold, Heading, Table, Text, Where
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import UNKNOWN, counted, number
from modsim3d.io.atomic_write import write_files
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking import score_outcome
from modsim3d.tracking.oracle import REFERENCES
from modsim3d.tracking.score_text import COLUMNS, MEANINGS, keys_of, percent, rules_in_words
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.occlusions import OcclusionEpisode
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.tracking.world.collision import CpaErrors, MetVessel, PredictedApproaches
from modsim3d.tracking.worst_film import ABOUT, Story, moment_pictures
from modsim3d.tracking.worst_moment import worst_moment_s
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
_IN_FULL = Where.PAGE | Where.FULL
JUDGED = (
    "Occlusions survived: of those before which the tracker followed the vessel, so their number differs by tracker; "
    "a dash where there are none."
)
OF_SEEDS = "over detector seeds of this traffic; it says nothing about other traffic"
PART_COLUMNS = COLUMNS[:5]
PART_HEADER = ("", "tracker", *(name for name, _, _ in PART_COLUMNS))
WORLD_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("RMSE, m", "rmse_m", 1),
    ("RMSE, m/s", "rmse_m_s", 2),
    ("ANEES", "anees", 2),
    ("GOSPA, m", "gospa_m", 1),
    ("T-GOSPA, m", "t_gospa_m", 1),
    ("followed", "followed_share", 3),
    ("ID switches", "id_switches", 0),
    ("false tracks", "false_tracks", 0),
    ("established at, m", "established_m", 0),
    ("time left, s", "time_left_s", 0),
)
ENCOUNTER_HEADER = (
    *("vessel", "own ship", "kind", "closest, m", "at, s"),
    *("first seen, s", "established, s", "at distance, m", "time left, s"),
)


def write_scores(scores: score_outcome.ScoredTracks, folder: StrPath, command: str | None = None) -> None:
    """Write `score.json` and `score.html` into a folder; the page names the command, or the call if it is None."""
    target = as_path(folder, "folder")
    options = orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
    data = orjson.dumps(score_outcome.score_data(scores), default=str, option=options) + b"\n"
    write_files(dict(zip((target / name for name in FILES), (data, score_page(scores, command)), strict=True)))


def score_page(scores: score_outcome.ScoredTracks, command: str | None = None) -> str:
    """The whole page; it names the command, or the call if it is None."""
    return page.document_page(document(scores), _provenance(scores, command))


def document(scores: score_outcome.ScoredTracks) -> Document:
    """The scores, to be read."""
    return Document(
        f"{scores.run.scene.name}: how well is it tracked?",
        [Text(score_outcome.conclusion_of(scores), "lead", Where.EVERYWHERE)],
        [*(_in_images(scores) if scores.trackers else ()), *_in_world(scores)],
    )


def _in_images(scores: score_outcome.ScoredTracks) -> Iterator[Block]:
    run = scores.run
    yield _score_table(scores)
    if scores.references:
        yield Text(
            "The last two lines are the same detections with perfect association: each detection is given to the "
            "vessel that it came from, and false ones are removed. They are references and no ceilings: a tracker that "
            "smooths better may exceed them.",
            "soft",
            Where.PAGE,
        )
    judged = {score_outcome.survived_and_judged(entry.occlusions)[1] for _, entry in named_scores(scores)}
    yield Text(JUDGED if len(judged) > 1 or 0 in judged else "", "soft")
    of_run = f"This run has {counted(run.steps, 'step')} and {counted(len(run.scene.cameras), 'camera')}."
    yield Text(f"{of_run} {score_outcome.remarks_of(scores)}", "soft")
    yield Fold("What the scores mean", [Table("", (), list(MEANINGS.items()), where=Where.PAGE)])
    if curves := _curves(scores):
        note = "HOTA is the mean over these thresholds. A line that falls early has boxes far from the true ones: then "
        yield Figure(partial(_alpha_chart, curves), f"{note}compare centres instead of IoU.")
    yield Heading("Where each tracker went wrong", where=Where.PAGE)
    yield Text(f"The worst moment of each: what it lost, before and after. {ABOUT}", "soft", Where.PAGE)
    for tracker in scores.trackers:
        yield Figure(partial(_worst_moment, scores, tracker), tracker.name)
    yield Heading("Rules")
    rules = rules_in_words(scores.rules)
    yield Table("", (), rules, where=_IN_FULL)
    yield Table("", (), rules[:-3], where=Where.BRIEF)  # cameras, similarity and vessels
    yield Heading("Detector seeds")
    yield Text(seeds_in_words(scores), "soft")
    yield Table("", ("tracker", "score", "mean", "standard deviation", "95 % of the mean"), seed_rows(scores))
    yield Heading("Where vessels are lost", where=Where.PAGE)
    yield Text(
        "Tracks and vessels are matched once. Recall is the share of the vessel-frames in a line that a track "
        "follows; association is how much of the vessel and of the track belong together, where one follows. The "
        "oracle is the smoothed reference.",
        "soft",
        Where.PAGE,
    )
    yield from _breakdowns(scores)
    yield from _part_tables(scores)
    yield Heading("Wholly hidden vessels")
    yield Text("They count neither way in all other tables. A good tracker coasts over them.", "soft", Where.PAGE)
    yield _hidden_table(scores)
    yield Heading("Occlusions")
    for tracker in scores.trackers:
        yield _occlusions(tracker)
    yield Heading("All scores")
    header = ("score", *(name for name, _ in named_scores(scores)))
    every = [keys_of(entry) for _, entry in named_scores(scores)]  # counts are whole, all else has three decimals
    rows = [(key, *(number(keys[key], 0 if isinstance(keys[key], int) else 3) for keys in every)) for key in every[0]]
    yield Fold("By their keys", [Table("", header, rows, where=Where.PAGE)])


def _worst_moment(scores: score_outcome.ScoredTracks, tracker: score_outcome.TrackScores) -> str:
    """Pictures of the moment at which a tracker went wrong."""
    rows, rules = RunRows.of(scores.run), scores.rules
    if rules.cameras:
        names = [camera.name for camera in scores.run.scene.cameras]
        rows = rows.in_cameras(tuple(map(names.index, rules.cameras)))
    scored = ScoredRun.of(rows, tracker.track_set.tracks, rules)
    if (at_s := worst_moment_s(scored)) is None:
        return "<p>Nothing went wrong.</p>"
    return page.images(moment_pictures(Story.of(scored, at_s)), f"{tracker.name}: before and after", "jpeg", quality=82)


def _provenance(scores: score_outcome.ScoredTracks, command: str | None) -> Provenance:
    run = scores.run
    given = [(tracker.name, tracker.path) for tracker in scores.trackers]
    given += [(tracker.name, tracker.path) for tracker in scores.world]
    call = f"modsim3d.score_run({str(run.folder)!r}, …).write(…) from Python"
    again = () if scores.seeds is None else (("detector, run again", ", ".join(map(str, scores.seeds.seeds))),)
    tracks = [source for name, path in given for source in track_inputs(name, path)]
    return Provenance(
        page="scores of tracks",
        made_by=command or call,
        inputs=(*run_inputs(run), *tracks),
        seeds=(*run_seeds(run), *again),
        options=tuple((f"Rule: {name}", text) for name, text in rules_in_words(scores.rules)),
        made_before=run_versions(run),
    )


def _curves(scores: score_outcome.ScoredTracks) -> dict[str, Array]:
    """HOTA at each threshold of similarity, shape (n,), by tracker and reference."""
    curves = {name: entry.flat()["hota_by_alpha"] for name, entry in named_scores(scores)}
    return {name: np.array(values) for name, values in curves.items() if isinstance(values, tuple)}


def _alpha_chart(curves: Mapping[str, Array]) -> str:
    axes, content = charts.Axes((0, 1), (0, 1.02), width=560), ""
    for place, values in enumerate(curves.values()):
        content += charts.line(axes, np.linspace(0.05, 0.95, len(values)), values, charts.colour_of(place))
    content += charts.key(list(curves), axes.height - 38)
    return axes.drawing(content, "HOTA by threshold", "least similarity of a match", "HOTA")


def _breakdowns(scores: score_outcome.ScoredTracks) -> Iterator[Block]:
    """Recall by each property: on a page of all trackers and the oracle side by side, on a terminal of the best one."""
    best, oracle = scores.trackers[0], score_outcome.best_reference(scores)
    yield Heading(f"Where {best.name} loses vessels", where=Where.FULL)
    yield from _breakdown_tables([("", best.scores)], Where.FULL)
    named = [(tracker.name, tracker.scores) for tracker in scores.trackers] + ([("oracle", oracle)] if oracle else [])
    yield from _breakdown_tables(named, Where.PAGE)
    groups = [(GROUP_NAMES[group.name], group.explanation) for group in best.scores.breakdown]
    yield Fold("What the lines are", [Table("", (), groups, where=Where.PAGE)])


def _breakdown_tables(named: Sequence[tuple[str, Scores]], where: Where) -> Iterator[Table]:
    names = [f"{name}: " if name else "" for name, _ in named]
    rows: list[list[str | Cell]] = []
    for index, group in enumerate(named[0][1].breakdown):
        bins = list(zip(*(entry.breakdown[index].rows for _, entry in named), strict=True))
        if group.name == OCCLUSION:
            header = ["length, s", "occlusions", "vessel-frames"]
            lengths = []
            for row_bins in bins:
                first = row_bins[0].bin, f"{row_bins[0].occlusions}", f"{row_bins[0].vessel_frames:,}"
                lengths.append((*first, *_cells(row_bins, "survived", "recall")))
            columns = [name + key for name in names for key in ("survived", "recall")]
            of_occlusions = Table("By length of the occlusion", [*header, *columns], lengths, where=where)
        else:
            for place, row_bins in enumerate(bins):
                name = "" if place else GROUP_NAMES[group.name]
                row: list[str | Cell] = [name, row_bins[0].bin, f"{row_bins[0].vessel_frames:,}"]
                rows.append(row + _cells(row_bins, "recall", "association"))
    columns = [name + key for name in names for key in ("recall", "association")]
    yield Table("", ("by", "", "vessel-frames", *columns), rows, where=where)
    yield of_occlusions


def _cells(bins: tuple[Bin, ...], *keys: str) -> list[str | Cell]:
    shares = [(score_bin, key, getattr(score_bin, key)) for score_bin in bins for key in keys]
    return [
        Cell(survived_of(score_bin) if key == "survived" else number(share, 2), share, bar=True)
        for score_bin, key, share in shares
    ]


def _occlusions(tracker: score_outcome.TrackScores) -> Block:
    """The list of a tracker's occlusions, closed at first where there are many."""
    episodes = tracker.scores.occlusions
    if not episodes:
        return Text(f"{tracker.name}: no vessel is occluded.", "", Where.PAGE)
    survived, judged = score_outcome.survived_and_judged(episodes)
    title = f"{tracker.name}: {survived} of {judged} survived; {counted(len(episodes), 'occlusion')} in all"
    failed = {index for index, episode in enumerate(episodes) if episode.survived is False}
    header = ("camera", "vessel", "from", "length", "least visible", "track before", "track after", "survived")
    table = Table("", header, _occlusion_rows(episodes), bad=failed, where=Where.PAGE)
    return Fold(title, [table], opened=len(episodes) <= 15)


def _score_table(scores: score_outcome.ScoredTracks) -> Table:
    rows = []
    for name, entry in named_scores(scores):
        keys, (survived, judged) = keys_of(entry), score_outcome.survived_and_judged(entry.occlusions)
        cells = (number(keys[key], decimals) for _, key, decimals in COLUMNS)
        rows.append((name, *cells, f"{survived} of {judged}" if judged else UNKNOWN))
    header = ("tracker", *(name for name, _, _ in COLUMNS), "occlusions survived")
    soft = range(len(scores.trackers), len(rows))
    return Table("Scores", header, rows, soft=soft, where=Where.EVERYWHERE)


def named_scores(scores: score_outcome.ScoredTracks) -> list[tuple[str, Scores]]:
    """The trackers, then the references, with what tables call them."""
    named = [(tracker.name, tracker.scores) for tracker in scores.trackers]
    return named + [(REFERENCES[name], reference) for name, reference in scores.references.items()]


def seed_rows(scores: score_outcome.ScoredTracks) -> list[tuple[str, ...]]:
    """A line for each tracker and score over detector seeds."""
    if scores.seeds is None:
        return []
    rows: list[tuple[str, ...]] = []
    for name, spreads in scores.seeds.spreads.items():
        for title, key, decimals in (*COLUMNS, ("ANEES", "anees", 1)):
            spread = spreads[key]
            if key == "anees" and spread.mean is None:  # a tracker without covariances
                continue
            interval = UNKNOWN
            if spread.interval is not None:
                interval = " … ".join(number(value, decimals + 1) for value in spread.interval)
            few = "" if len(spread.known) == len(spread.values) else f" of {counted(len(spread.known), 'seed')}"
            shown = number(spread.mean, decimals + 1) + few, number(spread.deviation, decimals + 1)
            rows.append((REFERENCES.get(name, name), title, *shown, interval))
    return rows


def seeds_in_words(scores: score_outcome.ScoredTracks) -> str:
    """Description of the table of seeds."""
    if scores.seeds is None:
        return ""
    seeds = scores.seeds.seeds
    which = f"{counted(len(seeds), 'seed')} of the detector, {seeds[0]} to {seeds[-1]}, that of the run first"
    return f"{which}: {OF_SEEDS}."


def _hidden_table(scores: score_outcome.ScoredTracks) -> Table:
    rows = []
    for name, entry in named_scores(scores):
        keys = keys_of(entry)
        shares = percent(keys["hidden_followed"]), percent(keys["hidden_same_track"])
        rows.append((name, number(keys["hidden_vessel_frames"], 0), *shares))
    header = ("tracker", "vessel-frames", "followed", "by the track from before")
    return Table("", header, rows, where=Where.PAGE)


def _occlusion_rows(occlusions: Sequence[OcclusionEpisode]) -> list[tuple[str, ...]]:
    return [
        (
            episode.camera,
            episode.vessel,
            f"{episode.start_s:.1f} s",
            f"{episode.length_s:.1f} s",
            percent(episode.least_visible_fraction),
            UNKNOWN if episode.track_before is None else f"{episode.track_before}",
            UNKNOWN if episode.track_after is None else f"{episode.track_after}",
            UNKNOWN if episode.survived is None else "yes" if episode.survived else "no",
        )
        for episode in occlusions
    ]


def survived_of(row: Bin) -> str:
    """Number of survived occlusions of a bin, of those that could be; empty outside the group of occlusions."""
    if row.occlusions is None:
        return ""
    return f"{round((row.survived or 0.0) * row.judged)} of {row.judged}" if row.judged else UNKNOWN


def _part_tables(scores: score_outcome.ScoredTracks) -> list[Table]:
    named = named_scores(scores)
    tables = []
    for title, part in (("By performance state", "by_state"), ("By camera", "by_camera")):
        parts = [(name, {key: vars(subset) for key, subset in getattr(entry, part).items()}) for name, entry in named]
        if len(parts[0][1]) > 1:
            tables.append(Table(title, PART_HEADER, _part_rows(parts), where=Where.PAGE))
    if scores.rules.by_class:
        of_class = [(name, {key: subset.flat() for key, subset in entry.by_class.items()}) for name, entry in named]
        tables.append(Table("By class", PART_HEADER, _part_rows(of_class)))
    return tables


def _part_rows(named: Sequence[tuple[str, Mapping[str, Mapping[str, Any]]]]) -> list[tuple[str, ...]]:
    labels = dict.fromkeys(label for _, parts in named for label in parts)
    return [
        (label, name, *(number(parts[label][key], decimals) for _, key, decimals in PART_COLUMNS))
        for label in labels
        for name, parts in named
        if label in parts
    ]


def _in_world(scores: score_outcome.ScoredTracks) -> Iterator[Block]:
    yield Heading("Tracks in the world")
    header = ("tracks in the world", *(name for name, _, _ in WORLD_COLUMNS))
    flat = [(tracker.name, tracker.scores.flat()) for tracker in scores.world]
    rows = [(name, *(number(keys[key], decimals) for _, key, decimals in WORLD_COLUMNS)) for name, keys in flat]
    yield Table("", header, rows)
    for tracker in scores.world[:1]:  # the rules are those of all
        distance = tracker.scores.set_distance
        yield Text(
            f"A track follows a vessel within {tracker.scores.gate_m:g} m. GOSPA: c = {distance.cutoff:g} m, "
            f"p = {distance.power:g}. Errors are averaged within each vessel, then over vessels.",
            "soft",
            _IN_FULL,
        )
    for tracker in scores.world:
        met = tracker.scores.encounters
        yield Text(_encounters_in_words(tracker))
        missed = {place for place, vessel in enumerate(met) if _is_missed(vessel)}
        yield Table("", ENCOUNTER_HEADER, _encounter_rows(met), bad=missed, where=_IN_FULL)
        yield from _approaches(tracker.scores.approaches)
    if approaches := {tracker.name: tracker.scores.approaches for tracker in scores.world if tracker.scores.encounters}:
        note = "Median error of the predicted CPA. Dashed: of a perfect track, which foresees no alteration of course."
        yield Figure(partial(_approach_chart, approaches), note)


def _approaches(approaches: PredictedApproaches) -> Iterator[Block]:
    errors = ("cpa_error_m", "tcpa_error_s", "perfect_cpa_error_m")
    counts = ("in_view", "predicted", "right", "alarms_due", "missed_alarms", "false_alarms")
    rules = approaches.rules
    about = (
        f"A predicted CPA is right within {rules.right_m:g} m of what happened; an alarm is one below {rules.alarm_m:g}"
        f" m. {counted(approaches.ghost_alarms, 'track')} on no vessel had such an alarm within {rules.before_s:g} s."
    )

    def rows(every: Sequence[CpaErrors], keys: Sequence[str]) -> list[tuple[str, ...]]:
        cells = [[getattr(cpa, key) for key in (*keys, *errors)] for cpa in every]
        return [
            (f"{cpa.place:g}", *(number(value, 0 if isinstance(value, int) else 1) for value in row))
            for cpa, row in zip(every, cells, strict=True)
        ]

    named = ("CPA error, m", "TCPA error, s", "perfect track, m")
    if approaches.by_time_left[0].in_view:
        yield Text(about, "soft", _IN_FULL)
        columns = ("s before the CPA", *(name.replace("_", " ") for name in counts), *named)
        yield Table("", columns, rows(approaches.by_time_left, counts), where=_IN_FULL)
        header = ("range from, m", "encounters", *named)
        yield Table("", header, rows(approaches.by_range, ("predicted",)), where=Where.PAGE)


def _approach_chart(approaches: Mapping[str, PredictedApproaches]) -> str:
    curves = []
    for place, forecast in enumerate(approaches.values()):
        for key, dashed in (("cpa_error_m", False), ("perfect_cpa_error_m", True)):
            pairs = [(at.place, getattr(at, key)) for at in forecast.by_time_left if getattr(at, key) is not None]
            curves.append((np.array(pairs).reshape(-1, 2).T, charts.colour_of(place), dashed))
    points = np.concatenate([curve for curve, _, _ in curves], axis=1)
    longest_s, top_m = np.max(points, axis=1, initial=1.0).tolist()
    axes = charts.Axes((0, 1.05 * longest_s), (0, 1.1 * top_m))
    content = "".join(charts.line(axes, x, y, colour, dashed) for (x, y), colour, dashed in curves)
    content += charts.key(list(approaches), axes.height - 38)
    return axes.drawing(content, "CPA as predicted", "time left, s", "error, m")


def _encounter_rows(encounters: Sequence[MetVessel]) -> list[tuple[str, ...]]:
    return [
        (
            *(encounter.vessel, encounter.own_ship, encounter.kind.replace("_", " ")),
            *(number(encounter.closest_m, 0), number(encounter.closest_s, 1)),
            *(number(encounter.seen_s, 1), number(encounter.established_s, 1)),
            *(number(encounter.established_m, 0), number(encounter.time_left_s, 1)),
        )
        for encounter in encounters
    ]


def _is_missed(met: MetVessel) -> bool:
    return met.seen_s is not None and met.established_s is None


def _encounters_in_words(entry: score_outcome.WorldTrackScores) -> str:
    """Number of vessels that met own ship, and of those among them that no track followed, red in the table."""
    met = entry.scores.encounters
    if not met:
        return f"{entry.name}: no vessel came nearer to own ship."
    passed = sum(one.passed for one in met)
    words = f"{entry.name}: {counted(len(met), 'vessel')} came nearer to own ship, and {passed} passed her in this run."
    missed = counted(sum(map(_is_missed, met)), "vessel")
    return f"{words} No track followed {missed} of these that a camera saw." if any(map(_is_missed, met)) else words
