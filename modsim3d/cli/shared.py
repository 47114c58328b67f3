"""Arguments, options and output that several commands share."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from inspect import signature
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli.terminal import ask_json, ask_quiet, ask_verbose, open_console, say
from modsim3d.io.input_files import data_folder
from modsim3d.io.operating_system import POSIX, signals

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from modsim3d.io.processes import WorkerCount


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """An option: what stands for its value in help, its text there, and its names, if not that of its parameter."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def flag(name: str, text: str, **more: Any) -> Any:
    """An option that takes no value."""
    return typer.Option(name, help=text, **more)


def argument(metavar: str, text: str, **more: Any) -> Any:
    """An argument: what stands for it in help, and its text there."""
    return typer.Argument(metavar=metavar, help=text, **more)


def under(panel: str, metavar: str, text: str, **more: Any) -> Any:
    """An option that help shows under a panel, with what stands for its value and its text."""
    return option(metavar, text, rich_help_panel=panel, **more)


# ---- Completions for the Tab key, found without loading more than the command line itself ----

_SCENE_FILES = (".yaml", ".yml", ".json")


def complete_scene(incomplete: str) -> list[str]:
    """Shipped scenes, and scene files of the working directory, that begin so. Where no shipped scene does, there is
    nothing, and the shell completes the names of files and folders by itself."""
    return _completed(incomplete, data_folder("scenes"), _SCENE_FILES)


def complete_campaign(incomplete: str) -> list[str]:
    """Shipped campaigns, and YAML files of the working directory, that begin so; or nothing, as for scenes."""
    return _completed(incomplete, data_folder("scenes") / "campaigns", _SCENE_FILES[:2])


def _completed(incomplete: str, folder: Path, endings: tuple[str, ...]) -> list[str]:
    shipped = [path.stem for path in sorted(folder.glob("*.yaml")) if path.stem.startswith(incomplete)]
    if not shipped:
        return []
    files = (path.name for path in sorted(Path().iterdir()) if path.suffix in endings and path.is_file())
    return shipped + [name for name in files if name.startswith(incomplete)]


def complete_tracker(incomplete: str) -> list[str]:
    """Names of trackers that begin so."""
    from modsim3d.tracking.trackers.names import tracker_names

    return [name for name in tracker_names() if name.startswith(incomplete)]


# ---- Arguments and options that several commands share ----

INTERRUPTED = 130  # exit status after Ctrl-C


def _workers(given: str | int) -> WorkerCount:
    from modsim3d.io.processes import parse_workers

    return parse_workers(str(given))  # the default comes here too, and is a number


SceneArgument = Annotated[
    str, argument("SCENE", "Scene file, or name of a shipped scene (modsim3d scenes).", autocompletion=complete_scene)
]
RunArgument = Annotated[Path, argument("RUN", "Run directory, finished or interrupted.")]
FinishedRunArgument = Annotated[Path, argument("RUN", "Run directory of a finished run.")]
CampaignArgument = Annotated[
    Path, argument("DIR", "Folder of a campaign, finished or not, also while it is worked on.")
]
OverwriteOption = Annotated[bool, flag("--overwrite", "Replace files that exist; never what is read.")]
WorkersOption = Annotated[
    Any,
    option(
        "N|auto",
        "Number of processes that share the work; auto: one for each CPU. The output is the same.",
        parser=_workers,
    ),
]
StepsOption = Annotated[int | None, option("N", "Number of time steps, in place of the scene's.", min=1)]
SeedOption = Annotated[int | None, option("N", "Seed of all random numbers, in place of the scene's.", min=0)]
DetectorOption = Annotated[Path | None, option("FILE", "Detector file, in place of the scene's.")]
DetectorSeedOption = Annotated[
    int | None, option("N", "Seed of the detector; poses and waves keep the scene's.", min=0)
]
SetOption = Annotated[
    list[str] | None, option("KEY=VALUE", "Set a key of the scene or, below detector., of its detector.", "--set")
]
StateOption = Annotated[str | None, option("NAME", "Keep the detector in one of its performance states.")]
FromOption = Annotated[
    str | None, option("DIR", "Take --state from the detectors of a folder; conditions: shipped.", "--from")
]
EveryOption = Annotated[int, option("K", "Take every K-th time step only.", min=1)]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", callback=ask_quiet, help="Print nothing but warnings and errors.")
]
VerboseOption = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        callback=ask_verbose,
        help="Also print versions, files read, the OpenGL in use, times and every test.",
    ),
]
JsonOption = Annotated[bool, flag("--json", "Print the result as one JSON object (docs/json.md).", callback=ask_json)]


def print_line(console: Console, text: str, style: str = "") -> None:
    """Print text as it is: no markup, no highlighting, no wrapping of paths."""
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def print_path(console: Console, name: str, path: Path) -> None:
    """Print a name and a path, on a line of its own where both would not fit on one."""
    from rich.cells import cell_len

    between = "  " if cell_len(f"{name}  {path}") <= console.width else "\n"
    print_line(console, f"{name}{between}{path}")


def print_written(console: Console, paths: Sequence[Path]) -> None:
    """Print which files were written, each on a line of its own; nothing if there are none."""
    if paths:
        print_line(console, "\nwritten")
    for path in paths:
        print_line(console, f"  {path}")


# ---- The command that a user typed, in a form that a page can keep ----

LEFT_OUT = frozenset({"out", "page", "overwrite", "quiet", "verbose", "json", "workers"})
"""Parameters that decide where files go or what is printed, and not what a page says."""


def typed_command(context: typer.Context) -> str:
    """The command with its arguments and the options that were given under their long names, in the order of its help.
    Options that only say where files go or what is printed are left out."""
    words = ["modsim3d", *_command_words(context)]
    parameters = [parameter for parameter in context.command.params if parameter.name not in LEFT_OUT]
    for parameter in sorted(parameters, key=lambda parameter: parameter.param_type_name != "argument"):
        source = context.get_parameter_source(str(parameter.name))
        if source is not None and source.name == "COMMANDLINE":
            words += _words(parameter, context.params[str(parameter.name)])
    return shlex.join(words)


def _command_words(context: Any) -> list[str]:
    """The words after `modsim3d` that name a command."""
    return [] if context.parent is None else [*_command_words(context.parent), str(context.info_name)]


def _words(parameter: Any, value: Any) -> Iterator[str]:
    values = value if isinstance(value, list | tuple) else [value]
    if parameter.param_type_name == "argument":
        yield from map(_text, values)
        return
    name = max(parameter.opts, key=len)
    if getattr(parameter, "is_flag", False):
        yield name
        return
    for entry in values:
        yield from (name, _text(entry))


def _text(value: Any) -> str:
    return str(getattr(value, "value", value))


def arguments(context: typer.Context, function: Callable[..., Any], **others: Any) -> dict[str, Any]:
    """Arguments of a function: others, and the parameters of the command that it has too and that are not None."""
    names = signature(function).parameters.keys() & context.params.keys()
    return {name: value for name in names if (value := context.params[name]) is not None} | others


# ---- The progress bar of commands that take long ----


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
def progress(description: str, total: int | None) -> Iterator[Callable[..., None]]:
    """Show a bar after a description, and yield the function that moves it on by a number of steps; `total` is the
    number of steps in all, None if only the work knows, which may give it to the function beside the steps."""
    with progress_bar() as bar:
        task = bar.add_task(description, total=total)
        yield lambda steps, total=None: bar.update(task, advance=steps, total=total, refresh=True)


# ---- Commands that clean up when the system tells them to stop ----

SIGNALED = 128  # the exit status of a process that a signal has ended is this and the signal's number


class Stopped(KeyboardInterrupt):
    """The process was told to stop by a signal; `status` is its exit status."""

    def __init__(self, number: int) -> None:
        """Make the exit status from the signal's number."""
        super().__init__()
        self.status = SIGNALED + number


@contextmanager
def interruptible(note: str = "") -> Iterator[None]:
    """End the command after Ctrl-C or a signal that `stoppable` takes, and say `note` after `interrupted`."""
    try:
        yield
    except KeyboardInterrupt as stop:
        say(f"\nmodsim3d: interrupted{note}", err=True)
        raise typer.Exit(stop.status if isinstance(stop, Stopped) else INTERRUPTED) from None


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise `Stopped`, as Ctrl-C raises KeyboardInterrupt, where they would end the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    owner = os.getpid()

    def stop(number: int, frame: FrameType | None) -> None:
        if os.getpid() != owner:  # a worker, which has nothing to clean up
            os._exit(SIGNALED + number)
        raise Stopped(number)

    ending = [number for number in signals("SIGTERM", "SIGHUP") if signal.getsignal(number) is signal.SIG_DFL]
    for number in ending:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in ending:
            signal.signal(number, signal.SIG_DFL)


def interrupt_again(dropped: sys.UnraisableHookArgs) -> None:
    """Send this process anew an interrupt that Python dropped, since it came while an object was finalised."""
    if not isinstance(dropped.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)
        return
    number = dropped.exc_value.status - SIGNALED if isinstance(dropped.exc_value, Stopped) else signal.SIGINT
    send = partial(os.kill, os.getpid()) if POSIX else signal.raise_signal
    threading.Timer(0.01, send, (number,)).start()  # a moment later the finaliser has ended


# ---- The options of the commands that show a run with tracks ----

TracksOption = Annotated[
    Path | None,
    option(
        "TRACKS",
        "Show the tracks of a tracker: a folder of modsim3d track, a .csv file, or MOT (docs/track_files.md).",
        "--tracks",
    ),
]

SimilarityOption = Annotated[
    str | None,
    option(
        "iou|centre:PX",
        "Similarity of a track's box and a vessel's: iou, or centre, by distance, with that at which it is 0.",
        show_default="iou",
    ),
]
ThresholdOption = Annotated[
    float | None, option("S", "Least similarity at which a track follows a vessel.", show_default="0.5")
]
