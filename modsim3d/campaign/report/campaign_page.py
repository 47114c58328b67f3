"""The page of a campaign: the verdict first, then what it rests on."""

from __future__ import annotations

import html
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.folder import CampaignFolder, killed_sentence
from modsim3d.campaign.means import LEVEL, same_detections
from modsim3d.campaign.plan import Plan, cases_of
from modsim3d.campaign.ranking import WorstRun, worst_runs
from modsim3d.campaign.report.coverage import coverage_sections, trace_sections
from modsim3d.campaign.report.parameter_charts import over_seeds, parameter_sections, seed_cells
from modsim3d.campaign.report.words import (
    MAX_KEYS,
    Score,
    condition_cells,
    constant,
    in_words,
    number,
    required_scores,
    requirement_sections,
    rests_on,
    table_scores,
    values_of,
    varying,
    verdict_sentence,
    with_interval,
    without_empty,
)
from modsim3d.campaign.reproduce import remade
from modsim3d.campaign.verdicts.seed_values import PairedDifference, column_of, paired
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.verdicts.wording import levels_of
from modsim3d.campaign.work.row import DONE
from modsim3d.campaign.worst_film import moment_picture
from modsim3d.core.arrays import Array, Indices
from modsim3d.core.document import Cell, Figure, Row
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import counted, listed
from modsim3d.view.pages import page
from modsim3d.view.pages.charts import ChartInterval, span_of, strip

# ---- What is compared ----

MAX_ROWS = 200
"""Of a table."""
CRASHED_RUNS = "crashed runs"


def mean_sections(plan: Plan, table: pa.Table) -> list[str]:
    """The table of means: a row for each condition and tracker."""
    scores = table_scores(plan)
    found = [over_seeds(seed_cells(plan, table, score.column)) for score in scores]
    crashed = _crashed(plan, table)
    places = [(c, t) for c in range(len(plan.conditions)) for t in range(len(plan.keys.trackers))]
    remark = ""
    if len(places) > MAX_ROWS:
        worst = _badness(scores[0], found[0].mean)
        places = sorted(sorted(places, key=lambda each: worst[each])[:MAX_ROWS])
        remark = (
            f" The {MAX_ROWS} rows of {worst.size:,} with the worst {scores[0].name} are shown; "
            "modsim3d campaign-table has all."
        )
    keys, judged = varying(plan), _judged(plan)
    remark += " Intervals of means that are required are those of the requirements, above." * bool(judged)
    rows = [
        (
            *condition_cells(plan, c, keys),
            plan.keys.trackers[t].label,
            *(
                number(each.mean[c, t])
                if (score.column, c, t) in judged
                else with_interval(each.mean[c, t], each.low[c, t], each.high[c, t])
                for score, each in zip(scores, found, strict=True)
            ),
            f"{found[0].seeds[c, t]:,}",
            f"{crashed[c, t]:,}",
        )
        for c, t in places
    ]
    columns = keys if len(keys) <= MAX_KEYS else ["condition"]
    header = (*columns, "tracker", *(score.name for score in scores), "seeds", CRASHED_RUNS)
    bad = {place for place, each in enumerate(places) if crashed[each]}
    return [
        page.paragraph(
            f"Mean over traffic seeds [{100 * LEVEL:g} % interval by Student's t]. The value of a seed is the mean "
            "over its detector seeds. All trackers and conditions have the same seeds. Each interval holds by itself: "
            f"of twenty, one is expected to miss.{_stopped(plan)}{remark}",
            "soft",
        ),
        page.table(*without_empty(rows, header, (CRASHED_RUNS,)), bad=bad),
    ]


def _judged(plan: Plan) -> set[tuple[str, int, int]]:
    """Column, condition and tracker of the means that requirements are about."""
    return {
        (column_of(requirement.score, case), case.condition, case.tracker)
        for requirement in plan.keys.require
        if requirement.share is None and requirement.of is None
        for case in cases_of(plan, requirement)
    }


def _stopped(plan: Plan) -> str:
    """Sentence on sequential campaigns: how stopping changes intervals for a number of seeds fixed beforehand."""
    if plan.keys.stop == "once":
        return ""
    return (
        " This campaign ended when its requirements were decided, so these intervals describe and prove nothing: those "
        "of the requirements hold however often they are looked at."
    )


def _badness(score: Score, mean: Array) -> Array:
    """The lower, the worse; where nothing is known comes first."""
    signed = mean if score.lowest_is_worst else -mean
    return np.where(np.isfinite(signed), signed, -np.inf)


def _crashed(plan: Plan, table: pa.Table) -> Indices:
    """Number of crashed runs, shape (conditions, trackers)."""
    runs = table.filter(pc.not_equal(table["status"], DONE))["run"].to_numpy()
    shape = (len(plan.conditions), plan.keys.seeds.detector, len(plan.keys.trackers))
    counts: Indices = np.bincount(runs % plan.runs_by_seed, minlength=plan.runs_by_seed).reshape(shape).sum(axis=1)
    return counts


def paired_sections(plan: Plan, table: pa.Table) -> list[str]:
    """The differences between trackers over the same seeds, and what the pairing gained."""
    if len(plan.keys.trackers) < 2 or not len(table):
        return []
    scores = dict.fromkeys(each.key for each in required_scores(plan) if each.key in table.column_names)
    found = [each for score in scores for each in paired(plan, table, score)]
    if not found:
        return []
    judged = {
        (requirement.score, case.condition, frozenset((requirement.of, requirement.minus)))
        for requirement in plan.keys.require
        if requirement.share is None
        for case in cases_of(plan, requirement)
        if case.part is None
    }
    said = [(each.score, each.condition, frozenset((each.first, each.second))) in judged for each in found]
    found = [replace(each, low=None, high=None) if here else each for each, here in zip(found, said, strict=True)]
    remark = " Intervals of differences that are required are those of the requirements, above." * any(said)
    keys, span = varying(plan), {}
    for score in {each.score for each in found}:
        here = [each for each in found if each.score == score]
        span[score] = span_of([0.0, *(_or_nan(v) for each in here for v in (each.mean, each.low, each.high))])
    rows: list[Row] = [
        (
            Score(each.score).name,
            *condition_cells(plan, each.condition, keys),
            f"{each.first} − {each.second}",
            with_interval(each.mean, each.low, each.high),
            _difference(each, span[each.score]),
            f"{each.seeds:,}",
            number(each.variance_ratio),
        )
        for each in found[:MAX_ROWS]
    ]
    columns = keys if len(keys) <= MAX_KEYS else ["condition"]
    header = ("score", *columns, "difference", "mean [interval]", "against 0", "seeds", "variance ratio")
    return [
        page.heading("Differences between trackers"),
        page.paragraph(
            "Mean of the difference with the same traffic seeds, with its interval at 95 %: if 0 lies inside, this "
            "campaign does not tell which tracker is better. The variance ratio says how many times as many seeds "
            "would have been needed for this interval with other seeds for each tracker; near 1, pairing gained "
            f"nothing.{remark}",
            "soft",
        ),
        page.table(rows, header),
    ]


def _difference(each: PairedDifference, span: tuple[float, float]) -> Cell:
    found = ChartInterval(_or_nan(each.mean), _or_nan(each.low), _or_nan(each.high))
    label = f"{with_interval(found.mean, found.low, found.high)} against 0"
    return Cell("", draw=partial(strip, found, 0.0, None, span, label))


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


# ---- Single runs on the page ----

WORST = 5
"""Runs that are shown with a picture."""
WIDTH_PX, QUALITY = 960, 82
"""Of a picture: pixels, and of JPEG."""
MAX_ERRORS, MAX_NUMBERS = 20, 8


def worst_sections(
    folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict], advance: Callable[[int], None]
) -> list[str]:
    """The worst runs, each with the moment at which it went wrong and the commands that show more.

    Args:
        folder: The campaign.
        table: Its rows.
        verdicts: The verdicts on its requirements.
        advance: Called with 1 after each run.
    """
    found = worst_runs(folder, table, verdicts, WORST) if len(table) else []
    parts = []
    for each in found:
        parts += _worst_run(folder, each)
        advance(1)
    if not parts:
        return []
    return [
        page.heading("The worst runs"),
        page.paragraph(
            "Runs that crashed come first, then the worst run of each requirement, then the second worst of each; "
            "failed requirements come before the others. They say how a tracker fails, and nothing about how often.",
            "soft",
        ),
        *parts,
    ]


def _worst_run(folder: CampaignFolder, each: WorstRun) -> list[str]:
    run = folder.plan.run(each.number)
    values = {**values_of(folder.plan, each.condition), **run.condition.values}
    what = "crashed" if each.value is None else f"{Score(each.score).name} {number(each.value)}"
    if each.requirement is not None:
        what += f" (requirement {each.requirement + 1})"
    said = in_words(values, [*varying(folder.plan), *folder.plan.drawn])
    parts = [
        f"<h3>{html.escape(f'Run {each.number}: {each.tracker}, {what}')}</h3>",
        page.paragraph(f"{said}; traffic seed {each.traffic_seed}, detector seed {each.detector_seed}.", "soft"),
    ]
    if each.moment_s is not None:
        parts.append(_picture(folder, each, each.moment_s))
    commands = [("Make it again", each.again), ("Film the moment", each.film)]
    return [*parts, *(_command(name, line) for name, line in commands if line)]


def _picture(folder: CampaignFolder, each: WorstRun, moment_s: float) -> str:
    """The moment at which a run went wrong; a run that cannot be made again says why."""
    try:
        image = moment_picture(remade(folder, each.number), moment_s, WIDTH_PX)
    except ModsimError as error:
        return page.paragraph(f"There is no picture: {error}", "soft")
    caption = f"Run {each.number} at {moment_s:g} s: what is true, and the tracks of {each.tracker}."
    return page.html_of(Figure(lambda: page.image(image, caption, "jpeg", quality=QUALITY), caption))


def _command(name: str, line: str) -> str:
    return f'<p>{html.escape(name)}:<br><code style="overflow-wrap: anywhere">{html.escape(line)}</code></p>'


def crash_sections(folder: CampaignFolder, table: pa.Table) -> list[str]:
    """The runs that crashed, by their error."""
    crashed = table.filter(pc.not_equal(table["status"], DONE)).select(["run", "tracker", "error"])
    if not len(crashed):
        return []
    by_error: dict[str, list[dict[str, Any]]] = {}
    for row in crashed.to_pylist():
        by_error.setdefault(row["error"] or "unknown", []).append(row)
    ordered = sorted(by_error.items(), key=lambda each: (-len(each[1]), each[1][0]["run"]))
    rows = [
        (
            f"{len(found):,}",
            error,
            listed(list(dict.fromkeys(row["tracker"] for row in found))),
            listed([str(row["run"]) for row in found], MAX_NUMBERS),
        )
        for error, found in ordered[:MAX_ERRORS]
    ]
    said = (
        f"{counted(len(crashed), 'run')} of {len(table):,} crashed. Means and charts are of the other runs; "
        "requirements count each crash as wrong, or stay undecided. To see an error again:"
    )
    first, path = ordered[0][1][0]["run"], folder.path
    again = (
        f"modsim3d campaign-run {shlex.quote(str(path))} {first} --out {shlex.quote(str(path / 'runs' / str(first)))}"
    )
    more = f" The {MAX_ERRORS} most frequent errors are shown." if len(ordered) > MAX_ERRORS else ""
    return [
        page.heading("Runs that crashed"),
        page.paragraph(said, "soft"),
        _command("Make the first again", again),
        page.table(rows, ("runs", "error", "trackers", "numbers of the runs")),
        *([page.paragraph(more.strip(), "soft")] if more else []),
    ]


REPORT_FILE = "report.html"


def campaign_page(
    folder: CampaignFolder,
    table: pa.Table,
    verdicts: Sequence[Verdict],
    advance: Callable[[int], None] = lambda done: None,
    command: str | None = None,
) -> str:
    """The page as HTML.

    Args:
        folder: The campaign.
        table: Its rows, see `results_table`.
        verdicts: The verdicts on its requirements.
        advance: Called with 1 after each picture.
        command: What the page says it was made by; the call from Python if None.
    """
    plan = folder.plan
    body = [
        page.paragraph(lead(folder, table, verdicts), "lead"),
        *(page.paragraph(text, kind) for text, kind in cautions(folder, table)),
        page.facts(facts(folder, table)),
    ]
    if plan.keys.require:
        body += [page.heading("Requirements"), *requirement_sections(plan, verdicts), *_levels(plan)]
    if len(table):
        body += [page.heading("Means"), *mean_sections(plan, table), *paired_sections(plan, table)]
        body += parameter_sections(plan, table)
        body += worst_sections(folder, table, verdicts, advance)
        body += crash_sections(folder, table)
        body += [*coverage_sections(folder, table), *trace_sections(folder, table, verdicts)]
    asked = "are its requirements met?" if plan.keys.require else "what does it compare?"
    title = f"Campaign {folder.path.resolve().name}: {asked}"
    return page.page(title, body, rests_on(folder, "results of a campaign", command))


def lead(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> str:
    """The first sentence of the page."""
    if folder.finished:
        return verdict_sentence(folder.plan, verdicts)
    done = f"{len(table):,} of {counted(len(folder.plan), 'run')} are done"
    return f"Not finished: {done}, and nothing on this page is a verdict."


def cautions(folder: CampaignFolder, table: pa.Table) -> list[tuple[str, str]]:
    """Cautions that a reader needs before the numbers, with how each is set."""
    plan, found = folder.plan, []
    if crashed := len(table) - int(pc.sum(pc.equal(table["status"], DONE)).as_py() or 0):
        found.append((f"{counted(crashed, 'run')} of {len(table):,} crashed: see below.", "bad"))
    if killed := killed_sentence(folder):
        found.append((killed, ""))
    found += [(f"{text[0].upper()}{text[1:]}.", "bad") for text in same_detections(plan, table)]
    fixed = dict.fromkeys(each["scene"] for each in folder.facts["conditions"] if not each["traffic_has_seed"])
    if fixed:
        said = f"This traffic only: vessels in {listed(list(fixed))} move the same way with every seed. "
        found.append((said + "Seeds change the detector and the waves; no result speaks of other traffic.", ""))
    if plan.keys.uncertainty == "learned":
        said = "The detector's parameters are drawn for each traffic seed from the intervals that learn wrote, so the "
        said += "intervals are wider where its test set was small. A mean is one over all detectors that this set "
        found.append((said + "allows: with many seeds its interval is narrow, however small the set.", ""))
    return found


def facts(folder: CampaignFolder, table: pa.Table) -> list[tuple[str, str]]:
    """Facts about the runs: rows of their table."""
    plan, keys = folder.plan, folder.keys
    seconds = pc.sum(table["simulated_s"]).as_py() or 0.0
    simulated = f"{seconds / 3600:,.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"
    runs = f"{len(table):,}" + ("" if len(table) == len(plan) else f" of {len(plan):,}")
    stop = f"sequential: looked at after every {counted(keys.batch, 'traffic seed')}"
    rows = [
        ("runs", f"{runs}; {simulated} simulated"),
        ("scenes", listed(list(dict.fromkeys(each["scene"] for each in folder.facts["conditions"])), 12)),
        ("trackers", listed([each.label for each in keys.trackers], 12)),
        ("conditions", f"{len(plan.conditions):,}"),
        ("seeds", f"{counted(keys.seeds.traffic, 'traffic seed')}, {keys.seeds.detector:,} of the detector for each"),
        ("the same everywhere", ", ".join(f"{key} {value}" for key, value in constant(plan).items())),
        ("stop", stop if keys.stop == "sequential" else "once: the number of seeds was fixed beforehand"),
        ("SHA-256 of the plan", folder.facts["sha256"]),
    ]
    return [(name, value) for name, value in rows if value]


def _levels(plan: Plan) -> list[str]:
    """At which level the requirements hold together."""
    return ["<h3>How often verdicts are wrong</h3>", page.paragraph(" ".join(levels_of(plan).sentences()))]
