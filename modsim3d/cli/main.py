"""The command line: each command of `commands/` under its name."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from modsim3d.cli.ais import ais_command
from modsim3d.cli.campaign import campaign_command
from modsim3d.cli.campaign_run import campaign_run_command
from modsim3d.cli.campaign_status import campaign_report_command, campaign_status_command, campaign_table_command
from modsim3d.cli.compare import compare_command
from modsim3d.cli.detect import detect_command
from modsim3d.cli.export import export_command
from modsim3d.cli.guess import guess_command
from modsim3d.cli.learn import learn_command
from modsim3d.cli.repeat import repeat_command
from modsim3d.cli.report import report_command, rerun_command
from modsim3d.cli.run import run_command
from modsim3d.cli.scenes import check_command, scenes_command
from modsim3d.cli.score import score_command
from modsim3d.cli.shared import INTERRUPTED
from modsim3d.cli.stream import stream_command
from modsim3d.cli.terminal import check_arguments, lost_output, prepare_output, say, say_error, start_afresh
from modsim3d.cli.track import track_command
from modsim3d.cli.verify import verify_command
from modsim3d.cli.view import view_command
from modsim3d.core.errors import ModsimError

# ---- What `-h` shows, where typer's own would mislead ----


class Command(TyperCommand):
    """A command whose flags are shown as flags: typer calls them <bool>, as if they took a value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as help shows them."""
        return _plain(super().get_params(ctx))


class CommandGroup(TyperGroup):
    """A group of commands, as `Command`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as help shows them."""
        return _plain(super().get_params(ctx))


def _plain(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters


BAD_INPUT = 2
"""Exit status of a user error."""
COMPLETE_VARIABLE = "_MODSIM3D_COMPLETE"
"""What the scripts of shells set, however the command line is started."""
MIN_ADDRESS_SPACE = 1 << 30
"""Libraries take half of it, and what a small run draws with most of the rest."""
COLLECT_AFTER = 300_000
"""New objects after which Python looks for garbage in cycles. The libraries of a run make 180,000, which stay: with
Python's own 700, a short run spends a tenth of its time looking through them."""

EXAMPLES = """
modsim3d run strait --out runs/first   a shipped scene
modsim3d report runs/first             a page that plays the run
modsim3d view runs/first --film all    a film of it
modsim3d verify runs/first             does it obey its detector file?
modsim3d run -h                        all options of a command
"""
RUN, LOOK, TEST, CAMPAIGNS, CHECK, MAKE = "Run", "Look", "Test a tracker", "Campaigns", "Check", "Make"
Entry = tuple[str, str, Callable[..., None], str]
COMMANDS: tuple[Entry, ...] = (
    (RUN, "run", run_command, "Simulate a scene: truth, detections and a contact sheet."),
    (RUN, "detect", detect_command, "Run another detector or seed over the truth of a run."),
    (RUN, "stream", stream_command, "Detections line by line, while a scene is simulated."),
    (RUN, "scenes", scenes_command, "List the scenes that come with modsim3d."),
    (LOOK, "report", report_command, "A page that plays a run in the browser."),
    (LOOK, "view", view_command, "Films, pictures and maps of a run."),
    (LOOK, "rerun", rerun_command, "A recording for the Rerun viewer."),
    (TEST, "track", track_command, "Run a tracker over the detections of a run."),
    (TEST, "score", score_command, "How well do tracks follow the vessels of a run?"),
    (CAMPAIGNS, "campaign", campaign_command, "Many runs: their scores, and verdicts on requirements."),
    (CAMPAIGNS, "campaign-status", campaign_status_command, "How far a campaign is."),
    (CAMPAIGNS, "campaign-table", campaign_table_command, "Mean scores of a campaign with intervals."),
    (CAMPAIGNS, "campaign-report", campaign_report_command, "A page: verdicts, charts, the worst runs."),
    (CAMPAIGNS, "campaign-run", campaign_run_command, "A run of a campaign again; films its worst moment."),
    (CHECK, "check", check_command, "Everything that is wrong with a scene, at once."),
    (CHECK, "verify", verify_command, "Does a run obey its detector file?"),
    (CHECK, "repeat", repeat_command, "Does a run come out the same again, byte by byte?"),
    (CHECK, "compare", compare_command, "Does the rendered truth agree with exact geometry?"),
    (MAKE, "ais", ais_command, "A scene from real traffic, out of AIS logs."),
    (MAKE, "learn", learn_command, "A detector file from results on labelled images."),
    (MAKE, "guess", guess_command, "A guess of a detector in other weather."),
    (MAKE, "export", export_command, "A run in another program's format."),
)
"""Group, name, function and short help of each command."""


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        say(f"modsim3d {version('modsim3d')}")
        raise typer.Exit


def _root(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    start_afresh()
    context.call_on_close(start_afresh)


def _app_of(commands: Iterable[Entry]) -> typer.Typer:
    made = typer.Typer(
        cls=CommandGroup,
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        help=(
            "Simulates cameras and their vessel detector for multi-object trackers.\n\n"
            f"[bold]Examples[/bold]\n{EXAMPLES}"
        ),
    )
    made.callback()(_root)
    for group, name, function, short_help in commands:
        made.command(name, cls=Command, short_help=short_help, rich_help_panel=group)(function)
    return made


app = _app_of(COMMANDS)


def _asked(arguments: Sequence[str]) -> typer.Typer:
    """The command line with the one command that the first argument names, since typer takes 2 ms to prepare each."""
    named = [entry for entry in COMMANDS if entry[1] in arguments[:1]]
    return _app_of(named) if named else app


def check_memory() -> None:
    """Refuse to start under a limit in which libraries abort without a word.

    Raises:
        ModsimError: The process may not have as many addresses as the libraries need.
    """
    try:
        import resource  # not on Windows
    except ImportError:
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE:
        needed = f"at least {MIN_ADDRESS_SPACE >> 20} MB are needed to load the libraries"
        raise ModsimError(f"the address space is limited to {limit >> 20} MB (ulimit -v): {needed}")


def main() -> None:
    """Run the command line; a user error is one message on standard error and exit status 2."""
    # Small matrices and short tables are no faster with threads, and a process without threads can be forked.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # Arrow's own allocators keep some 30 MB more
    gc.set_threshold(COLLECT_AFTER)
    atexit.register(gc.freeze)  # else Python looks through all objects when it ends, for a fifth of a short run
    prepare_output()
    status = _status()
    if (problem := lost_output()) is not None:
        say(f"modsim3d: standard output cannot be written to: {problem.strerror or problem}", err=True)
        status = BAD_INPUT
    sys.exit(status)


def _status() -> int:
    """Run the command line, and return its exit status."""
    try:
        check_memory()
        check_arguments(sys.argv[1:])
        _asked(sys.argv[1:])(prog_name=_program_name(), complete_var=COMPLETE_VARIABLE)
    except SystemExit as ended:
        return int(ended.code or 0)
    except ModsimError as error:
        say_error(error)
    except OSError as error:
        say(f"modsim3d: {error.filename or 'a file'}: {error.strerror or error}", err=True)
    except MemoryError:
        say("modsim3d: there is not enough memory: give it more, or a smaller input", err=True)
    except ImportError as error:
        say(f"modsim3d: a library cannot be loaded: {error}", err=True)
    except KeyboardInterrupt:
        say("modsim3d: interrupted", err=True)
        return INTERRUPTED
    else:
        return 0
    return BAD_INPUT


def _program_name() -> str:
    """The name in messages, whatever module Python was started with; shells complete only the short one."""
    completing = any("-completion" in argument for argument in sys.argv[1:])
    return "python -m modsim3d" if sys.argv[0].endswith("__main__.py") and not completing else "modsim3d"


if __name__ == "__main__":
    main()
