"""The progress bar of commands that take a while."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress


def progress_bar() -> Progress:
    """A bar on standard error that is redrawn at each update."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    class Bar(Progress):
        """Removes itself if an error comes before the first step, so that the error stands alone."""

        def __exit__(self, kind: type[BaseException] | None, *rest: Any) -> None:
            if kind is not None and not any(task.completed for task in self.tasks):
                self.live.transient = True
                self.console.quiet = not self.console.is_terminal
            super().__exit__(kind, *rest)

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Refreshed by updates only: with a second thread, workers could not be forked from this process.
    return Bar(*columns, console=Console(stderr=True), auto_refresh=False)
