"""The command line: each command of `commands/` under its name."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from modsim3d.commands.ais import ais_command
from modsim3d.commands.compare import compare_command
from modsim3d.commands.detect import detect_command
from modsim3d.commands.guess import guess_command
from modsim3d.commands.learn import export_command, learn_command
from modsim3d.commands.repeat import repeat_command
from modsim3d.commands.report import report_command, rerun_command
from modsim3d.commands.run import run_command
from modsim3d.commands.scenes import check_command, scenes_command
from modsim3d.commands.shared import INTERRUPTED
from modsim3d.commands.terminal import check_arguments, prepare_output, say, say_error
from modsim3d.commands.verify import verify_command
from modsim3d.commands.view import view_command
from modsim3d.errors import ModsimError

BAD_INPUT = 2
"""Exit status of a user error."""
LEAST_ADDRESS_SPACE = 1 << 30
"""Libraries take half of it, and what a small run draws with most of the rest."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="""Simulates cameras and their vessel detector in front of a multi-object tracker.

[bold]Examples[/bold]

  modsim3d run simulation_1 --mode 2          a shipped scene, with occlusion from pixels

  modsim3d run my/scene.yaml --out runs/mine  a scene of your own

  modsim3d detect runs/mine --detector my/detector.yaml --out runs/other    the detector alone, over the same truth

  modsim3d verify runs/mine                   check that the run obeys its detector file

  modsim3d repeat runs/mine                   check that the run comes out the same again, byte by byte

  modsim3d check my/scene.yaml                everything that is wrong with a scene, at once

  modsim3d compare my/scene.yaml              rendered truth against exact geometry

  modsim3d ais log.csv --out scenes/traffic   a scene from real traffic

  modsim3d report runs/first                  a page that plays a run

  modsim3d view runs/simulation_1 --film all  a film of a run

  modsim3d learn --truth gt.json --detections dt.json --out detector.yaml    a detector file from real results

  modsim3d guess detector.yaml --from noon_clear --to foggy_cloudy --out in_fog.yaml    the detector in fog: a guess

  modsim3d scenes                             the shipped scenes""",
)

app.command("run")(run_command)
app.command("detect")(detect_command)
app.command("verify")(verify_command)
app.command("repeat")(repeat_command)
app.command("view")(view_command)
app.command("report")(report_command)
app.command("rerun")(rerun_command)
app.command("check")(check_command)
app.command("compare")(compare_command)
app.command("ais")(ais_command)
app.command("learn")(learn_command)
app.command("guess")(guess_command)
app.command("export")(export_command)
app.command("scenes")(scenes_command)


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        say(f"modsim3d {version('modsim3d')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    pass


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
    if limit != resource.RLIM_INFINITY and limit < LEAST_ADDRESS_SPACE:
        needed = f"at least {LEAST_ADDRESS_SPACE >> 20} MB are needed to load the libraries"
        raise ModsimError(f"the address space is limited to {limit >> 20} MB (ulimit -v): {needed}")


def main() -> None:
    """Run the command line; a user error is one message on standard error and exit status 2."""
    # Small matrices and short tables are no faster with threads, and a process without threads can be forked.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    prepare_output()
    try:
        check_memory()
        check_arguments(sys.argv[1:])
        app()
    except ModsimError as error:
        say_error(error)
        sys.exit(BAD_INPUT)
    except OSError as error:
        say(f"modsim3d: {error.filename or 'a file'}: {error.strerror or error}", err=True)
        sys.exit(BAD_INPUT)
    except MemoryError:
        say("modsim3d: there is not enough memory: give it more, or a smaller input", err=True)
        sys.exit(BAD_INPUT)
    except ImportError as error:
        say(f"modsim3d: a library cannot be loaded: {error}", err=True)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        say("modsim3d: interrupted", err=True)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
