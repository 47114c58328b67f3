"""The page of a campaign: the verdict first, then what it rests on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign import means
from modsim3d.campaign.folder import CampaignFolder, killed_sentence
from modsim3d.campaign.keys import TIMES
from modsim3d.campaign.plan import Case, Plan, cases_of, key_columns, values_text
from modsim3d.campaign.ranking import WorstRun, worst_runs
from modsim3d.campaign.report import words
from modsim3d.campaign.report.coverage import coverage_sections, trace_sections
from modsim3d.campaign.report.parameter_charts import parameter_sections
from modsim3d.campaign.report.words import condition_cells, varying
from modsim3d.campaign.reproduce import remade
from modsim3d.campaign.verdicts.seed_values import (
    ApproachCounts,
    PairedDifference,
    SeedRows,
    counted_approaches,
    paired,
)
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.verdicts.wording import levels_of, score_name
from modsim3d.campaign.work.row import DONE, SAID, error_text, rules_of
from modsim3d.core.arrays import NOBODY
from modsim3d.core.document import Block, BlockRow, Cell, Document, Figure, Heading, Row, Table, Text
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import counted, listed, three_digits, three_digits_with_interval
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.worst_film import ABOUT, Story, moment_pictures
from modsim3d.tracking.worst_moment import LOWERED_BY, row_to_show
from modsim3d.tracks.tracks import Tracks
from modsim3d.view.pages import charts
from modsim3d.view.pages.charts import ChartInterval, span_of, strip
from modsim3d.view.pages.page import document_page, images

DISTANCES_M = (100.0, 200.0, 400.0, 600.0, 900.0, 1200.0, 1600.0, 2000.0, 3000.0)
SIZE_EDGES_M = (0.0, 8.0, 15.0, 50.0, np.inf)
MIN_APPROACHES = 5  # a share of fewer is not drawn
MAX_CURVES = 8  # of a chart; the table has all


def lookout_sections(plan: Plan, table: pa.Table) -> Iterator[Block]:
    """The table and the charts of a campaign with a lookout requirement."""
    asked = {requirement.known_at_m for requirement in plan.keys.require if requirement.known_at_m is not None}
    distances = sorted({*DISTANCES_M, *asked})
    rows, keys, drawn = SeedRows(plan, table), varying(plan), []
    cells: list[Row] = []
    cases = list(product(range(len(plan.conditions)), range(len(plan.keys.trackers))))
    for low, high in pairwise(SIZE_EDGES_M):
        size, curves = f"{low:,g} to {high:,g} m" if high < np.inf else f"{low:,g} m and more", {}
        for condition, tracker in cases:
            seeds, crashed = rows.approaches(Case(tracker, condition))
            sized = [[approach for approach in seed if low <= approach["length_m"] < high] for seed in seeds]
            counts = [counted_approaches(sized, crashed, distance) for distance in distances]
            label, values = plan.keys.trackers[tracker].label, condition_cells(plan, condition, keys)
            if any(count.came.sum() for count in counts):
                cells.append((size, label, *values, *(f"{c.known.sum():.0f} of {c.came.sum():.0f}" for c in counts)))
                curves[", ".join([label, *values])] = dict(zip(distances, counts, strict=True))
        drawn += [Figure(partial(_chart, size, curves), "")] if curves else []
    yield Heading("From where on vessels are known")
    yield Text(
        "Approaches that one track followed before the vessel came to a distance, and kept until the closest approach, "
        "of those that were in view beyond it and came so near; vessels that appeared nearer, or never came so near, "
        "are not among them. The charts have means over traffic seeds, where there are at least "
        f"{MIN_APPROACHES} approaches.",
        "soft",
    )
    yield Table("", ("length", "tracker", *key_columns(keys), *(f"{distance:,g} m" for distance in distances)), cells)
    yield BlockRow(drawn)


def _chart(size: str, curves: Mapping[str, Mapping[float, ApproachCounts]]) -> str:
    axes, content = charts.Axes((0, 1.05 * DISTANCES_M[-1]), (0, 1.14)), ""
    for place, counts in enumerate(list(curves.values())[:MAX_CURVES]):
        shown = [(at_m, count.share) for at_m, count in counts.items() if count.came.sum() >= MIN_APPROACHES]
        x, y = np.array(shown, dtype=np.float64).reshape(-1, 2).T
        content += charts.line(axes, x, y, charts.colour_of(place))
    content += charts.key(list(curves)[:MAX_CURVES], axes.height - 38)
    return axes.drawing(content, f"Vessels of {size}", "distance, m", "share known")


MAX_ROWS = 200  # of a table


def mean_sections(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict] = ()) -> list[Block]:
    """The table of means: a row for each condition and tracker."""
    score, scores = words.required_scores(plan)[0], means.usual_scores(plan, table)
    rows = means.mean_rows(table, means.usual_keys(plan), scores)
    remark, count = "", len(rows)
    if count > MAX_ROWS and scores:
        worst = sorted(rows, key=lambda row: _badness(score, row.means[scores[0]].value))[:MAX_ROWS]
        rows = [row for row in rows if any(row is other for other in worst)]
        remark = f" The {MAX_ROWS} rows of {count:,} with the worst {score.name} are shown; "
        remark += "modsim3d campaign table has all."
    shown = means.with_required(plan, rows, verdicts)
    remark += f" {means.REQUIRED}" * (shown != rows)
    stopped = (  # stopping changes intervals for a number of seeds fixed beforehand
        " This campaign ended when its requirements were decided, so these intervals describe and prove nothing: those "
        "of the requirements hold however often they are looked at."
    ) * (plan.keys.stop != "once")
    return [
        Text(
            f"Mean over traffic seeds [{100 * means.LEVEL:g} % interval by Student's t]. The value of a seed is the "
            "mean over its detector seeds. All trackers and conditions have the same seeds. Each interval holds by "
            f"itself: of twenty, one is expected to miss.{stopped}{remark}",
            "soft",
        ),
        means.mean_table(shown, "", names=score_name),
    ]


def _badness(score: words.Score, mean: float | None) -> float:
    """The lower, the worse; where nothing is known comes first."""
    if mean is None or not np.isfinite(mean):
        return -np.inf
    return mean if score.lowest_is_worst else -mean


def paired_sections(plan: Plan, table: pa.Table) -> list[Block]:
    """The differences between trackers over the same seeds, and what the pairing gained."""
    if len(plan.keys.trackers) < 2 or not len(table):
        return []
    keys_of_scores = (score.key for score in words.required_scores(plan) if score.key not in TIMES)
    scores = dict.fromkeys(key for key in keys_of_scores if key in table.column_names)
    pairs = [pair for score in scores for pair in paired(plan, table, score)]
    if not pairs:
        return []
    judged = {
        (requirement.score, case.condition, frozenset((requirement.of, requirement.minus)))
        for requirement in plan.keys.require
        if requirement.share is None
        for case in cases_of(plan, requirement)
        if case.part is None
    }
    required = [(pair.score, pair.condition, frozenset((pair.first, pair.second))) in judged for pair in pairs]
    pairs = [replace(pair, low=None, high=None) if here else pair for pair, here in zip(pairs, required, strict=True)]
    remark = " Intervals of differences that are required are those of the requirements, above." * any(required)
    keys, span = words.varying(plan), {}
    for score in {pair.score for pair in pairs}:
        here = [pair for pair in pairs if pair.score == score]
        span[score] = span_of([0.0, *(words.or_nan(v) for pair in here for v in (pair.mean, pair.low, pair.high))])
    rows: list[Row] = [
        (
            words.Score(pair.score).name,
            *words.condition_cells(plan, pair.condition, keys),
            f"{pair.first} − {pair.second}",
            three_digits_with_interval(pair.mean, pair.low, pair.high),
            _difference(pair, span[pair.score]),
            f"{pair.seeds:,}",
            three_digits(pair.variance_ratio),
        )
        for pair in pairs[:MAX_ROWS]
    ]
    header = ("score", *key_columns(keys), "difference", "mean [interval]", "against 0", "seeds", "variance ratio")
    return [
        Heading("Differences between trackers"),
        Text(
            "Mean of the difference with the same traffic seeds, with its interval at 95 %: if 0 lies inside, this "
            "campaign does not tell which tracker is better. The variance ratio says how many times as many seeds "
            "would have been needed for this interval with other seeds for each tracker; near 1, pairing gained "
            f"nothing.{remark}",
            "soft",
        ),
        Table("", header, rows),
    ]


def _difference(pair: PairedDifference, span: tuple[float, float]) -> Cell:
    interval = ChartInterval(words.or_nan(pair.mean), words.or_nan(pair.low), words.or_nan(pair.high))
    label = f"{three_digits_with_interval(interval.mean, interval.low, interval.high)} against 0"
    return Cell("", draw=partial(strip, interval, 0.0, None, span, label))


WORST = 5  # runs that are shown with a picture
QUALITY = 82  # of a picture, as JPEG
MAX_ERRORS, MAX_NUMBERS = 20, 8


def worst_sections(
    folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict], advance: Callable[..., None]
) -> list[Block]:
    """The worst runs, the moment at which each went wrong, and commands that show more; `advance(1)` follows each."""
    runs = worst_runs(folder, table, verdicts, WORST) if len(table) else []
    about = (
        "Runs that crashed come first, then the worst run of each requirement, then the second worst of each; "
        "failed requirements come before the others. They say how a tracker fails, and nothing about how often."
    )
    advance(0, len(runs))
    blocks = (block for run in runs for block in _worst_run(folder, run, advance))
    return [Heading("The worst runs"), Text(about if runs else "", "soft"), *blocks]


def _worst_run(folder: CampaignFolder, worst: WorstRun, advance: Callable[..., None]) -> Iterator[Block]:
    run = folder.plan.run(worst.number)
    values = {**words.values_of(folder.plan, worst.condition), **run.condition.values}
    what = "crashed" if worst.value is None else f"{score_name(worst.score)} {three_digits(worst.value)}"
    if worst.requirement is not None:
        what += f" (requirement {worst.requirement + 1})"
    settings = values_text(values, [*words.varying(folder.plan), *folder.plan.drawn])
    yield Heading(f"Run {worst.number}: {worst.tracker}, {what}", 3)
    yield Text(f"{settings}; traffic seed {worst.traffic_seed}, detector seed {worst.detector_seed}.", "soft")
    if worst.moment_s is not None:
        yield moment_block(folder, worst.number, worst.tracker, worst.moment_s, worst.score)
    advance(1)
    for name, line in (("Make it again:", worst.again), ("Film:", worst.film)):
        if line:
            yield Text(name)
            yield Text(line, "code")


def moment_block(folder: CampaignFolder, number: int, tracker: str, moment_s: float, score: str) -> Block:
    """Pictures of what made a score of a run low, or of its worst moment; a run that cannot be made again says why."""
    try:
        made = remade(folder, number)
        assert isinstance(made.tracks, Tracks)  # of tracks in the world no moment is known
        scored = ScoredRun.of(made.rows, made.tracks, rules_of(folder.keys.score))
        story = Story.of(scored, moment_s, row := row_to_show(scored, score))
        pictures, step = moment_pictures(story), story.lost // scored.by_step
    except ModsimError as error:
        return Text(f"There is no picture: {error}", "soft")
    wanted, at_s = LOWERED_BY.get(score.rpartition(".")[2]), made.rows.scene.timestamps(step, step + 1)[0]
    none = f"There is no {wanted} to show: this is where most is wrong. " if wanted and row == NOBODY else ""
    caption = f"Run {number} before and after {float(at_s):.1f} s, with {tracker}. {none}{ABOUT}"
    return Figure(partial(images, pictures, caption, "jpeg", quality=QUALITY), caption)


def crash_sections(folder: CampaignFolder, table: pa.Table) -> list[Block]:
    """The runs that crashed, by their error."""
    crashed = table.filter(pc.not_equal(table["status"], DONE))
    if not len(crashed):
        return []
    by_error: dict[str, list[dict[str, Any]]] = {}
    shown = [name for name in ("run", "tracker", "error", SAID) if name in table.column_names]
    for row in crashed.select(shown).to_pylist():
        by_error.setdefault(row["error"] or "unknown", []).append(row)
    ordered = sorted(by_error.items(), key=lambda entry: (-len(entry[1]), entry[1][0]["run"]))
    rows = [
        (
            f"{len(group):,}",
            error_text(group[0]),
            listed(list(dict.fromkeys(row["tracker"] for row in group))),
            listed([str(row["run"]) for row in group], MAX_NUMBERS),
        )
        for _, group in ordered[:MAX_ERRORS]
    ]
    summary = (
        f"{counted(len(crashed), 'run')} of {len(table):,} crashed. Means and charts are of the other runs; "
        "requirements count each crash as wrong, or stay undecided. To see an error again:"
    )
    again = folder.reproducing(ordered[0][1][0]["run"])
    more = f"The {MAX_ERRORS} most frequent errors are shown." if len(ordered) > MAX_ERRORS else ""
    return [
        Heading("Runs that crashed"),
        Text(summary, "soft"),
        Text(again, "code"),
        Table("", ("runs", "error", "trackers", "numbers of the runs"), rows),
        Text(more, "soft"),
    ]


REPORT_FILE = "report.html"


def campaign_page(
    folder: CampaignFolder,
    table: pa.Table,
    verdicts: Sequence[Verdict],
    advance: Callable[..., None] = lambda *_: None,
    command: str | None = None,
) -> str:
    """Page of a campaign as HTML. `advance(1)` follows each picture; `command` made it, or the call from Python."""
    plan = folder.plan
    asked = "are its requirements met?" if plan.keys.require else "what does it compare?"
    document = Document(
        f"Campaign {folder.path.resolve().name}: {asked}",
        [Text(lead(folder, table, verdicts), "lead"), *cautions(folder, table)],
        [
            Table("", (), facts(folder, table)),
            *requirement_blocks(plan, verdicts),
            *(lookout_sections(plan, table) if len(table) and plan.keys.lookout else ()),
            *(compared_blocks(folder, table, verdicts) if len(table) else ()),
            *(parameter_sections(plan, table, verdicts) if len(table) else ()),
            *worst_sections(folder, table, verdicts, advance),
            *(coverage_sections(folder, table) if len(table) else ()),
            *(trace_sections(folder, table, verdicts) if len(table) else ()),
        ],
    )
    return document_page(document, words.rests_on(folder, "results of a campaign", command))


def requirement_blocks(plan: Plan, verdicts: Sequence[Verdict]) -> list[Block]:
    """The verdicts, and at which level they hold together; nothing without requirements."""
    if not plan.keys.require:
        return []
    levels = Text(" ".join(levels_of(plan).sentences()), "soft")
    wrong = Heading("How often verdicts are wrong", 3)
    return [Heading("Requirements"), *words.requirement_sections(plan, verdicts), wrong, levels]


def compared_blocks(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> list[Block]:
    """Means, differences between trackers, and the runs that crashed."""
    sections = mean_sections(folder.plan, table, verdicts)
    sections += [Text(sentence) for sentence in means.repeat_sentences(folder.plan, table)]
    return [Heading("Means"), *sections, *paired_sections(folder.plan, table), *crash_sections(folder, table)]


def lead(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> str:
    """The first sentence of the page."""
    if folder.finished:
        return words.verdict_sentence(folder.plan, verdicts)
    done = f"{len(table):,} of {counted(len(folder.plan), 'run')} are done"
    return f"Not finished: {done}, and nothing on this page is a verdict."


def cautions(folder: CampaignFolder, table: pa.Table) -> list[Text]:
    """Cautions that a reader needs before the numbers."""
    plan, notes = folder.plan, list[Text]()
    if crashed := len(table) - int(pc.sum(pc.equal(table["status"], DONE)).as_py() or 0):
        notes.append(Text(f"{counted(crashed, 'run')} of {len(table):,} crashed: see below.", "bad"))
    if killed := killed_sentence(folder):
        notes.append(Text(killed))
    notes += [Text(f"{text[0].upper()}{text[1:]}.", "bad") for text in means.same_detections(plan, table)]
    fixed = dict.fromkeys(entry["scene"] for entry in folder.facts["conditions"] if not entry["traffic_has_seed"])
    if fixed:
        line = f"This traffic only: vessels in {listed(list(fixed))} move the same way with every seed. "
        notes.append(Text(line + "Seeds change the detector and the waves; no result speaks of other traffic."))
    if plan.keys.uncertainty == "learned":
        line = "The detector's parameters are drawn for each traffic seed from the intervals that learn wrote, so the "
        line += "intervals are wider where its test set was small. A mean is one over all detectors that this set "
        notes.append(Text(line + "allows: with many seeds its interval is narrow, however small the set."))
    return notes


def facts(folder: CampaignFolder, table: pa.Table) -> list[tuple[str, str]]:
    """Facts about the runs: rows of their table."""
    plan, keys = folder.plan, folder.keys
    seconds = pc.sum(table["simulated_s"]).as_py() or 0.0
    simulated = f"{seconds / 3600:,.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"
    runs = f"{len(table):,}" + ("" if len(table) == len(plan) else f" of {len(plan):,}")
    stop = f"sequential: looked at after every {counted(keys.batch, 'traffic seed')}"
    rows = [
        ("runs", f"{runs}; {simulated} simulated"),
        ("scenes", listed(list(dict.fromkeys(entry["scene"] for entry in folder.facts["conditions"])), 12)),
        ("trackers", listed([tracker.label for tracker in keys.trackers], 12)),
        ("conditions", f"{len(plan.conditions):,}"),
        ("seeds", f"{counted(keys.seeds.traffic, 'traffic seed')}, {keys.seeds.detector:,} of the detector for each"),
        ("the same everywhere", ", ".join(f"{key} {value}" for key, value in words.constant(plan).items())),
        ("stop", stop if keys.stop == "sequential" else "once: the number of seeds was fixed beforehand"),
        ("SHA-256 of the plan", folder.facts["sha256"]),
    ]
    return [(name, value) for name, value in rows if value]
