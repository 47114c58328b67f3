"""Texts of the commands for campaigns: plans, warnings, and the line of progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.cli.terminal import open_console, remark
from modsim3d.core.text import counted, listed, three_digits, with_minus
from modsim3d.io.validation import shown

if TYPE_CHECKING:
    from rich.console import Group

    from modsim3d.campaign.keys import CampaignKeys, Factor, Range, Requirement
    from modsim3d.campaign.running import Progress
    from modsim3d.campaign.verdicts.verdict import Verdict
    from modsim3d.campaign.work.checking import CheckedCampaign

MAX_ROWS = 40  # rows of a table that the end of a campaign shows
STYLES = {"met": "green", "failed": "bold red", "undecided": "yellow"}
FIRST = ("failed", "undecided", "met")  # the order in which verdicts are looked at


def plan_rows(campaign: CheckedCampaign) -> list[tuple[str, str]]:
    """A campaign before it starts: what is run, and what must hold."""
    plan, keys = campaign.plan, campaign.file.keys
    rows = [("scenes", _scenes(campaign))]
    varied = [text for factor in keys.vary for text in _factor(factor)] or ["nothing"]
    rows += [("varied" if place == 0 else "", text) for place, text in enumerate(varied)]
    if keys.settings:
        rows.append(("set", ", ".join(f"{key} {shown(value)}" for key, value in keys.settings.items())))
    rows.append(("trackers", listed([tracker.label for tracker in keys.trackers])))
    if keys.search is not None:
        return [*rows, ("search", _search(keys))]
    rows.append(("seeds", _seeds(keys)))
    product = [
        counted(len(plan.conditions), "condition"),
        counted(keys.seeds.traffic, "traffic seed"),
        *([counted(keys.seeds.detector, "detector seed")] if keys.seeds.detector > 1 else []),
        counted(len(keys.trackers), "tracker"),
    ]
    rows.append(("runs", f"{'at most ' * (keys.stop == 'sequential')}{len(plan):,} = {' × '.join(product)}"))
    required = [requirement_in_words(requirement) for requirement in keys.require] or ["nothing"]
    return [*rows, *(("required" if place == 0 else "", text) for place, text in enumerate(required))]


def _scenes(campaign: CheckedCampaign) -> str:
    names = dict(_scene_facts(campaign))
    texts = [name if facts.traffic_has_seed else f"{name} (this traffic only)" for name, facts in names.items()]
    steps = campaign.file.keys.steps
    return listed(texts) + ("" if steps is None else f", {counted(steps, 'step')}")


def _scene_facts(campaign: CheckedCampaign) -> Iterable[tuple[str, Any]]:
    return zip((Path(entry.scene).stem for entry in campaign.plan.conditions), campaign.facts, strict=True)


def traffic_warnings(campaign: CheckedCampaign) -> list[str]:
    """Scenes whose results are of one traffic only."""
    fixed = dict.fromkeys(name for name, facts in _scene_facts(campaign) if not facts.traffic_has_seed)
    if not fixed:
        return []
    traffic = "the traffic of each" if len(fixed) > 1 else "the traffic"
    return [
        f"{listed(list(fixed))}: {traffic} is the same with every seed, so the results "
        "hold for this traffic only; seeds change waves and detections, and fairway draws its traffic"
    ]


def program_warnings(campaign: CheckedCampaign) -> list[str]:
    """Programs that run others, of which no file is known."""
    from modsim3d.tracking.trackers.command import RUNS_OTHERS

    return [
        f"trackers[{place}]: of {tracker.command[0]} only its own file is checked: name the tracker's in files"
        for place, tracker in enumerate(campaign.plan.keys.trackers)
        if tracker.command is not None and not tracker.files and RUNS_OTHERS.fullmatch(Path(tracker.command[0]).name)
    ]


def _factor(factor: Factor) -> list[str]:
    ranges = factor.latin_hypercube or factor.uniform
    if ranges is not None:
        how = "drawn for each traffic seed" + (", Latin hypercube" if factor.latin_hypercube else "")
        return [f"{key}: {_range(span)}, {how}" for key, span in ranges.items()]
    if factor.conditions is not None:
        keys = dict.fromkeys(key for values in factor.conditions for key in values)
        return [f"{counted(len(factor.conditions), 'condition')} of {listed(list(keys))}"]
    lists, together = factor.grid or factor.pairs or {}, " (together)" if factor.pairs else ""
    return [f"{key}: {listed([_plain(value) for value in values])}{together}" for key, values in lists.items()]


def _range(values: Range) -> str:
    if values.choices is not None:
        return f"one of {listed([_plain(value) for value in values.choices])}"
    kinds = [kind for kind in ("whole" * values.whole, "log scale" * (values.scale == "log")) if kind]
    low, high = (with_minus(f"{end:g}") for end in (values.low, values.high))
    return f"{low} to {high}" + (f" ({', '.join(kinds)})" if kinds else "")


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else shown(value)


def _seeds(keys: CampaignKeys) -> str:
    from modsim3d.campaign.plan import traffic_seed

    first, last = traffic_seed(keys.seed, 0), traffic_seed(keys.seed, keys.seeds.traffic - 1)
    text = f"traffic {first}" + (f" to {last}" if last > first else "")
    return text + (f", and {keys.seeds.detector} of the detector for each" if keys.seeds.detector > 1 else "")


def _search(keys: CampaignKeys) -> str:
    from modsim3d.campaign.verdicts.wording import score_name

    search = keys.search
    assert search is not None
    goal = f"lowest {score_name(search.minimise)}" if search.minimise else f"highest {score_name(str(search.maximise))}"
    over = "; ".join(f"{key} {_range(span)}" for key, span in search.over.items())
    return f"the {goal} in {search.budget:,} trials, over {over}"


def requirement_in_words(requirement: Requirement) -> str:
    """A requirement of a campaign file in words."""
    from modsim3d.campaign.verdicts.wording import percent, requirement_text, with_name

    where = ", ".join(
        f"{key} {' or '.join(map(_plain, value)) if isinstance(value, list) else _plain(value)}"
        for key, value in requirement.where.items()
    )
    named = with_name(requirement_text(requirement))
    if requirement.of_time and requirement.share is None:
        return f"{named} in every run{f', where {where}' if where else ''} (not repeatable)"
    text = named if requirement.share is not None else f"mean {named}"
    return f"{text}{f', where {where}' if where else ''} ({percent(requirement.confidence)} confidence)"


def about_text(verdict: Verdict) -> str:
    """Subject of a verdict, in a few words."""
    from modsim3d.campaign.plan import values_text
    from modsim3d.campaign.verdicts.wording import with_name

    about = ", ".join(filter(None, [verdict.tracker, values_text(verdict.values) if verdict.values else ""]))
    return f"{with_name(verdict.text)} ({about})"


def time_left_text(seconds: float | None) -> str:
    """A time that something will take."""
    if seconds is None:
        return "time left unknown"
    if seconds < 90:
        return f"{max(1, round(seconds))} s left"
    minutes = round(seconds / 60)
    return f"{minutes} min left" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min left"


# ---- The live display of a campaign: how far it is, and the present state of its requirements ----

LINE_EVERY_S = 60.0  # between two lines where standard error is no terminal
MIN_LOOK_S = 5.0
LOOK_COST = 0.05  # most of the time that goes into looking at the requirements
MAX_VERDICTS = 8
WIDTH = 30


@contextmanager
def campaign_progress(folder: Path, once: bool) -> Iterator[Callable[[Progress], None]]:
    """Yield what to call with a campaign's progress, to show it: redrawn on a terminal, and a line each minute
    elsewhere. With `once`, requirements are judged at the end only; what is known of them before is shown as such."""
    from rich.live import Live

    console = open_console(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    look = _looks(folder) if once else lambda progress: progress.verdicts
    # A thread that refreshes the display would keep workers from being copies of this process.
    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield lambda progress: live.update(_display(progress, look(progress), once), refresh=True)


def _lines() -> Callable[[Progress], None]:
    last = time.monotonic()

    def tell(progress: Progress) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_EVERY_S:
            last = time.monotonic()
            remark(progress_line(progress))

    return tell


def progress_line(progress: Progress) -> str:
    """State of a campaign, on a line."""
    done = f"{progress.done:,} of {counted(progress.total, 'run')}, {progress.running:,} handed in"
    crashed = f", {progress.crashed:,} crashed" if progress.crashed else ""
    return f"{done}{crashed}, {time_left_text(progress.left_s)}"


def _looks(folder: Path) -> Callable[[Progress], Sequence[Verdict]]:
    """The verdicts on what is done so far, looked at so seldom that it costs little."""
    from modsim3d.campaign.campaign import present_state
    from modsim3d.campaign.folder import opened_campaign

    latest: Sequence[Verdict] = ()
    after = 0.0

    def look(progress: Progress) -> Sequence[Verdict]:
        nonlocal latest, after
        started = time.monotonic()
        if progress.done and started >= after:
            latest = present_state(opened_campaign(folder)).verdicts
            ended = time.monotonic()
            after = ended + max(MIN_LOOK_S, (ended - started) / LOOK_COST)
        return latest

    return look


def _display(progress: Progress, verdicts: Sequence[Verdict], once: bool) -> Group:
    from rich.console import Group
    from rich.text import Text

    filled = WIDTH * progress.done // max(progress.total, 1)
    bar = Text.assemble(("━" * filled, "green"), ("━" * (WIDTH - filled), "dim"), f"  {progress_line(progress)}")
    ordered = sorted(verdicts, key=lambda verdict: FIRST.index(verdict.outcome))
    lines = [
        Text(present_text(verdict, once), style="dim" if once else STYLES[verdict.outcome])
        for verdict in ordered[:MAX_VERDICTS]
    ]
    if len(ordered) > MAX_VERDICTS:
        lines.append(Text(f"… and {len(ordered) - MAX_VERDICTS:,} more", style="dim"))
    return Group(bar, *lines)


def present_text(verdict: Verdict, once: bool) -> str:
    """State of a requirement in words, by the verdict on what is done; with `once`, there is none before the end."""
    state = "nothing yet"
    if verdict.estimate is not None:
        state = three_digits(verdict.estimate)
        if verdict.low is not None or verdict.high is not None:
            state += f" [{three_digits(verdict.low)}, {three_digits(verdict.high)}]"
    state += f", {counted(verdict.seeds, 'seed')}"
    return f"{about_text(verdict)}: " + (f"so far {state}" if once else f"{verdict.outcome}, {state}")
