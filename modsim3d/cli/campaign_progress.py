"""The live display of a campaign: how far it is, and the present state of its requirements."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.cli.campaign_text import FIRST, STYLES, about_text, duration_text
from modsim3d.cli.terminal import open_console, remark
from modsim3d.core.text import counted, three_digits

if TYPE_CHECKING:
    from rich.console import Group

    from modsim3d.campaign.running import Progress
    from modsim3d.campaign.verdicts.verdict import Verdict

LINE_EVERY_S = 60.0
"""Between two lines where standard error is no terminal."""
MIN_LOOK_S = 5.0
LOOK_COST = 0.05
"""Most of the time that goes into looking at the requirements."""
MAX_VERDICTS = 8
WIDTH = 30


@contextmanager
def campaign_progress(folder: Path, once: bool) -> Iterator[Callable[[Progress], None]]:
    """Show how far a campaign is: redrawn on a terminal, and a line each minute elsewhere.

    Args:
        folder: Its folder.
        once: Whether its requirements are judged at the end only; what is known of them before is shown as such.

    Yields:
        What to call with the progress.
    """
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
    """How far a campaign is, on a line."""
    parts = [
        f"{progress.done:,} of {counted(progress.total, 'run')}",
        f"{progress.running:,} handed in",
        *([f"{progress.crashed:,} crashed"] if progress.crashed else []),
        duration_text(progress.left_s),
    ]
    return ", ".join(parts)


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
    lines = [Text(present_text(verdict, once), style=_style(verdict, once)) for verdict in ordered[:MAX_VERDICTS]]
    if len(ordered) > MAX_VERDICTS:
        lines.append(Text(f"… and {len(ordered) - MAX_VERDICTS:,} more", style="dim"))
    return Group(bar, *lines)


def _style(verdict: Verdict, once: bool) -> str:
    return "dim" if once else STYLES[verdict.outcome]


def present_text(verdict: Verdict, once: bool) -> str:
    """State of a requirement in words; one that is judged at the end has no verdict yet.

    Args:
        verdict: On what is done.
        once: Whether it is judged at the end only.
    """
    known = "nothing yet"
    if verdict.estimate is not None:
        known = three_digits(verdict.estimate)
        if verdict.low is not None or verdict.high is not None:
            known += f" [{three_digits(verdict.low)}, {three_digits(verdict.high)}]"
    known += f", {counted(verdict.seeds, 'seed')}"
    return f"{about_text(verdict)}: " + (f"so far {known}" if once else f"{verdict.outcome}, {known}")
