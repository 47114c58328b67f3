"""The command line: each command of this room under its name."""

import atexit
import gc
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import cache, wraps
from inspect import Parameter, signature
from itertools import takewhile
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from modsim3d.cli.ais import ais_command
from modsim3d.cli.campaign_reproduce import campaign_reproduce_command
from modsim3d.cli.campaign_run import campaign_plan_command, campaign_run_command
from modsim3d.cli.campaign_status import campaign_report_command, campaign_status_command, campaign_table_command
from modsim3d.cli.check import check_repeat_command, check_run_command, check_scene_command, check_truth_command
from modsim3d.cli.detect import detect_command
from modsim3d.cli.export import export_command
from modsim3d.cli.learn import learn_command
from modsim3d.cli.learn_voyage import learn_voyage_command
from modsim3d.cli.report import report_command
from modsim3d.cli.run import run_command, scenes_command
from modsim3d.cli.shared import INTERRUPTED, JsonOption, QuietOption, VerboseOption, flag, interrupt_again
from modsim3d.cli.stream import stream_command
from modsim3d.cli.terminal import check_arguments, lost_output, prepare_output, say, say_error, start_afresh
from modsim3d.cli.track_and_score import score_command, track_command
from modsim3d.cli.view import view_film_command, view_frame_command, view_map_command, view_sheet_command
from modsim3d.core.errors import ModsimError
from modsim3d.io.operating_system import address_space_limit

# ---- What names of commands and options that are no more are called now ----

OLD_NAMES = {
    "ais --duration": "ais --end +SECONDS",
    "ais --labels": "ais --label type",
    "ais --gap": "ais --report-gap SECONDS",
    "ais --max-gap": "ais --report-gap SECONDS",
    "campaign": "campaign run CAMPAIGN",
    "campaign --like": "campaign plan CAMPAIGN --like DIR",
    "campaign --expect": "campaign plan CAMPAIGN --expect SCORE=MEAN:SPREAD",
    "campaign --plan": "campaign plan CAMPAIGN",
    "campaign --runs": "campaign table DIR --by run",
    "campaign --scheduler": "campaign run --cluster ADDRESS",
    "campaign --slurm": "campaign run --cluster slurm:JOBS",
    "campaign-report": "campaign report",
    "campaign-run": "campaign reproduce",
    "campaign-status": "campaign status",
    "campaign-table": "campaign table",
    "check": "check scene SCENE",
    "check --supersample": "check truth --set annotation.supersample=N",
    "compare": "check truth",
    "detect --seed": "detect --detector-seed N",
    "export --attitude": "export --true-attitude",
    "guess": "learn --detector FILE --from-condition NAME --to-condition NAME",
    "learn --bias": "",
    "learn --clutter": "learn --false-positives MODEL",
    "learn --correct": "",
    "learn --distance": "learn --match centre:PX",
    "learn --interval": "learn --time-step SECONDS",
    "learn --iou": "learn --match confidence:IOU",
    "learn --page": "learn --out FILE, and the page is beside it as .html",
    "learn --run": "learn RUN...",
    "score --by-class": "score --by class",
    "stream --wait": "stream --timeout SECONDS",
    "learn --scene": "learn-voyage SCENE",
    "learn --start": "learn-voyage SCENE --log-start TIME",
    "learn --state": "learn --states NAME=COND,...",
    "learn-voyage --clutter": "learn-voyage --false-positives MODEL",
    "learn-voyage --interval": "learn-voyage --time-step SECONDS",
    "repeat": "check repeat",
    "report --scale": "report --similarity centre:PX",
    "rerun": "export --format rerun --out DIR",
    "run --render": "run --set annotation.render=PART",
    "score --gospa-c": "score --gospa C",
    "score --gospa-p": "score --gospa C:P",
    "score --scale": "score --similarity centre:PX",
    "verify": "check run",
    "view": "view film RUN, view frame RUN STEP, view map RUN or view sheet RUN",
    "view --at": "view map RUN STEP",
    "view --film": "view film RUN --kind KIND",
    "view --frame": "view frame RUN STEP",
    "view --from": "view film --start S",
    "view --ids": "view frame RUN STEP --kind id_buffer",
    "view --map": "view map RUN",
    "view --night": "view film --look night",
    "view --scale": "view film --similarity centre:PX",
    "view --sheet": "view sheet RUN",
    "view --to": "view film --end S",
    "view --visibility": "view film --look fog:M",
}
OF_A_VOYAGE = ("attitude", "camera", "empty", "fixed", "images", "known", "position-noise", "stale", "write-scene")
OLD_NAMES |= {f"learn --{name}": f"learn-voyage SCENE --{name}" for name in OF_A_VOYAGE}
"""What stood after `modsim3d`, and what stands there now; nothing where an option has gone."""


def refuse_old_names(context: Any, arguments: Sequence[str]) -> None:
    """Raise a `ModsimError` with the new name where one of the arguments after a command's or group's name is an old
    one. `context` is the command or group, as typer has it."""
    command, path = context.command, _path(context)
    subcommands = getattr(command, "commands", None)
    first = arguments[0] if arguments else ""
    if subcommands is not None and first in subcommands:
        return  # which looks at the rest
    names = {name for parameter in command.params for name in parameter.opts}
    options = [word.partition("=")[0] for word in takewhile(lambda word: word != "--", arguments) if word[:2] == "--"]
    asked = [f"{path[0]} {name}" for name in options if name not in names] if path else []
    if subcommands is not None and not path:
        asked.append(first)
    elif subcommands is not None and first[:1] not in ("", "-") and not get_close_matches(first, subcommands):
        asked.append(path[0])  # else typer names the one that was meant
    for old in asked:
        if old in OLD_NAMES:
            new = OLD_NAMES[old]
            raise ModsimError(f"modsim3d {old} is " + (f"now: modsim3d {new}" if new else "no more"))


def _path(context: Any) -> list[str]:
    """The words after `modsim3d` that name the command."""
    return [] if context.parent is None else [*_path(context.parent), str(context.info_name)]


# ---- What `-h` shows, where typer's own would mislead ----


class _Plain:
    """A command whose flags are shown as flags: typer calls them <bool>, as if they took a value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as help shows them."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
        return parameters

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The arguments that are left; an old name raises an error that has the new one. A wrong value is told in the
        words of all other errors, and not in pydantic's, which typer has."""
        refuse_old_names(ctx, args)
        try:
            left: list[str] = super().parse_args(ctx, args)  # type: ignore[misc]
        except typer.BadParameter as error:
            problems: list[Any] = getattr(error.__cause__, "errors", list)()
            if problems:
                from modsim3d.io.validation import words

                error.message = words(problems[0])
            raise
        return left


class Command(_Plain, TyperCommand):
    """A command."""


class CommandGroup(_Plain, TyperGroup):
    """A group of commands, in the order of `COMMANDS`."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of its commands, as help shows them."""
        order = [word for _, name, _, _ in COMMANDS for word in name.split()]
        return sorted(super().list_commands(ctx), key=order.index)


BAD_INPUT = 2  # exit status of a user error
COMPLETE_VARIABLE = "_MODSIM3D_COMPLETE"  # what the scripts of shells set, however the command line is started
MIN_ADDRESS_SPACE = 1 << 30  # libraries take half of it, and what a small run draws with most of the rest
COLLECT_AFTER = 300_000
"""New objects after which Python looks for garbage in cycles. The libraries of a run make 180,000, which stay: with
Python's own 700, a short run spends a tenth of its time looking through them."""

EXAMPLES = """
modsim3d run strait --out runs/first         a shipped scene
modsim3d report runs/first                   a page that plays the run
modsim3d view film runs/first                a film of it
modsim3d check run runs/first                does it obey its detector file?
modsim3d run -h                              all options of a command
"""
RUN, LOOK, TEST, CAMPAIGNS, CHECK, MAKE = "Run", "Look", "Test a tracker", "Campaigns", "Check", "Make"
Entry = tuple[str, str, Callable[..., None], str]
COMMANDS: tuple[Entry, ...] = (  # panel of the help, name, function and short help of each command
    (RUN, "run", run_command, "Simulate a scene: truth, detections and a contact sheet."),
    (RUN, "detect", detect_command, "Run another detector or seed over the truth of a run."),
    (RUN, "stream", stream_command, "Detections line by line, while a scene is simulated."),
    (RUN, "scenes", scenes_command, "List the scenes that come with modsim3d."),
    (LOOK, "report", report_command, "A page that plays a run in the browser."),
    (LOOK, "view film", view_film_command, "A film of a run."),
    (LOOK, "view frame", view_frame_command, "A picture of one time step."),
    (LOOK, "view map", view_map_command, "The scene from above at one time step."),
    (LOOK, "view sheet", view_sheet_command, "The contact sheet of a run again."),
    (TEST, "track", track_command, "Run a tracker over the detections of a run."),
    (TEST, "score", score_command, "How well do tracks follow the vessels of a run?"),
    (CAMPAIGNS, "campaign run", campaign_run_command, "Run a campaign, or go on with one."),
    (CAMPAIGNS, "campaign plan", campaign_plan_command, "How many runs there will be; runs nothing."),
    (CAMPAIGNS, "campaign status", campaign_status_command, "How far a campaign is."),
    (CAMPAIGNS, "campaign table", campaign_table_command, "Mean scores of a campaign with intervals."),
    (CAMPAIGNS, "campaign report", campaign_report_command, "A page: verdicts, charts, the worst runs."),
    (CAMPAIGNS, "campaign reproduce", campaign_reproduce_command, "A run again; films its worst moment."),
    (CHECK, "check scene", check_scene_command, "Everything that is wrong with a scene, at once."),
    (CHECK, "check run", check_run_command, "Does a run obey its detector file?"),
    (CHECK, "check truth", check_truth_command, "Does the rendered truth agree with geometry?"),
    (CHECK, "check repeat", check_repeat_command, "Does a run come out the same again, byte by byte?"),
    (MAKE, "ais", ais_command, "A scene from real traffic, out of AIS logs."),
    (MAKE, "learn", learn_command, "A detector file from results on labelled images."),
    (MAKE, "learn-voyage", learn_voyage_command, "A detector file from a voyage with AIS."),
    (MAKE, "export", export_command, "A run in another program's format."),
)
GROUPS = {  # panel and short help of each group of commands
    "view": (LOOK, "Films, pictures and maps of a run."),
    "campaign": (CAMPAIGNS, "Many runs: their scores, and verdicts on requirements."),
    "check": (CHECK, "Does a scene, a run or the truth hold what it says?"),
}


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        say(f"modsim3d {version('modsim3d')}")
        raise typer.Exit


def _root(
    context: typer.Context,
    version: Annotated[
        bool, flag("--version", "Show the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    start_afresh()
    context.call_on_close(start_afresh)


def _typer(text: str) -> typer.Typer:
    return typer.Typer(
        cls=CommandGroup,
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        help=text,
    )


WITHOUT_JSON = ("stream", "report", "view film", "view frame", "view map", "view sheet", "ais", "export")


def _with_output_options(name: str, command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options that say how much it prints, whose callbacks keep that."""
    options = {"quiet": QuietOption, "verbose": VerboseOption, "json": JsonOption}
    for left_out in ("quiet", "verbose") if name == "scenes" else ("json",) if name in WITHOUT_JSON else ():
        del options[left_out]

    @wraps(command)
    def call(**given: Any) -> None:
        command(**{key: value for key, value in given.items() if key not in options})

    own = signature(command, eval_str=True)
    added = [Parameter(key, Parameter.KEYWORD_ONLY, default=False, annotation=hint) for key, hint in options.items()]
    call.__signature__ = own.replace(parameters=[*own.parameters.values(), *added])  # type: ignore[attr-defined]
    return call


def _app_of(commands: Iterable[Entry]) -> typer.Typer:
    made = _typer(
        f"Simulates cameras and their vessel detector for multi-object trackers.\n\n[bold]Examples[/bold]\n{EXAMPLES}"
    )
    made.callback()(_root)
    groups: dict[str, typer.Typer] = {}
    for panel, name, command, short_help in commands:
        function = _with_output_options(name, command)
        group, _, word = name.rpartition(" ")
        if not group:
            made.command(name, cls=Command, short_help=short_help, rich_help_panel=panel)(function)
            continue
        if group not in groups:
            groups[group] = _typer(GROUPS[group][1])
            groups[group].callback()(lambda: None)
            made.add_typer(groups[group], name=group, short_help=GROUPS[group][1], rich_help_panel=panel)
        groups[group].command(word, cls=Command, short_help=short_help)(function)
    return made


app = _app_of(COMMANDS)


@cache
def _app_for(first: str) -> typer.Typer:
    """The command line with what the first argument names only, since typer takes 2 ms to prepare each command."""
    named = [entry for entry in COMMANDS if entry[1].split()[0] == first]
    return _app_of(named) if named else app


def check_memory() -> None:
    """Raise a `ModsimError` under a limit of addresses in which libraries abort without a word."""
    limit = address_space_limit()
    if limit is not None and limit < MIN_ADDRESS_SPACE:
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
    sys.unraisablehook = interrupt_again
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
        _app_for("".join(sys.argv[1:2]))(prog_name=_program_name(), complete_var=COMPLETE_VARIABLE)
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
