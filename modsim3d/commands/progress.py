"""The progress bar of commands that take long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from modsim3d.commands.terminal import open_console

if TYPE_CHECKING:
    from rich.progress import Progress


def progress_bar() -> Progress:
    """An empty bar on standard error that is redrawn when it is updated with `refresh=True`."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    class Bar(Progress):
        """Removes itself if the work failed before its first step, so that the error stands alone."""

        def __exit__(self, kind: type[BaseException] | None, *rest: Any) -> None:
            if kind is not None and not any(task.completed for task in self.tasks):
                self.live.transient = True
                self.console.quiet = not self.console.is_terminal
            super().__exit__(kind, *rest)

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # A thread that refreshes the bar would keep workers from being copies of this process.
    return Bar(*columns, console=open_console(stderr=True), auto_refresh=False)


@contextmanager
def progress(description: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Show a bar after a description; `total` is the number of steps in all, or None if that is not known.

    Yields:
        The function to call with the number of steps done since its last call.
    """
    with progress_bar() as bar:
        task = bar.add_task(description, total=total)
        yield lambda steps: bar.update(task, advance=steps, refresh=True)
