"""The command line: parse, load, run, say what happened. Heavy imports come after parsing."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.cli_view import view_command
from modsim3d.errors import ModsimError
from modsim3d.progress import progress_bar

if TYPE_CHECKING:
    from rich.console import Console

    from modsim3d.learn.parameters import Verdict
    from modsim3d.run import RunResult
    from modsim3d.scene import Scene

BAD_INPUT, INTERRUPTED = 2, 130
WIDE = 150  # columns of a table that goes into a file

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="""Simulates cameras and their vessel detector in front of a multi-object tracker.

[bold]Examples[/bold]

  modsim3d run simulation_1 --mode 2          a shipped scene, occlusion from pixels

  modsim3d run my/scene.yaml --out runs/mine  a scene of your own

  modsim3d detect runs/mine --detector my/detector.yaml --out runs/other    the detector alone, over the same truth

  modsim3d verify runs/mine                   does the run obey its detector file?

  modsim3d check my/scene.yaml                what is wrong with it, all at once

  modsim3d compare my/scene.yaml              rendered truth against exact geometry

  modsim3d ais log.csv --out scenes/traffic   a scene from real traffic
  modsim3d report runs/first                  a page that plays a run
  modsim3d view runs/simulation_1 --film all  a film of a run

  modsim3d scenes                             the scenes that come with it""",
)
app.command("view")(view_command)


class Source(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """Where the truth comes from."""

    rendered = "rendered"
    analytic = "analytic"
    rectangles = "rectangles"


class Render(str, Enum):  # noqa: UP042
    """How much of an image is drawn."""

    regions = "regions"
    full = "full"


class Labels(str, Enum):  # noqa: UP042
    """What vessels from AIS are labelled by."""

    vessel = "vessel"
    type = "type"


SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help="A scene file, or the name of a shipped scene.")]


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"modsim3d {version('modsim3d')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    pass


@app.command("run")
def run_command(
    scene: SceneArgument,
    out: Annotated[Path | None, typer.Option(help="Run directory.", show_default="runs/SCENE")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a run that is there.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="In place of the scene's.")] = None,
    detector: Annotated[Path | None, typer.Option(help="Detector file, in place of the scene's.")] = None,
    detector_seed: Annotated[int | None, typer.Option(min=0, help="Of the detector alone.")] = None,
    mode: Annotated[int | None, typer.Option(min=0, max=2, help="Annotation mode, in place of the scene's.")] = None,
    source: Annotated[Source | None, typer.Option(help="Source of the truth, in place of the scene's.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Number of time steps, in place of the scene's.")] = None,
    render: Annotated[Render | None, typer.Option(help="Draw only where vessels overlap, or whole images.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes that share the work; the files stay the same.")] = 1,
    sheet: Annotated[bool, typer.Option("--sheet/--no-sheet", help="Draw contact_sheet.png.")] = True,
) -> None:
    """Run a scene: truth, detections and a contact sheet into a run directory.

    Example: modsim3d run simulation_1 --mode 2 --out runs/first
    """

    from modsim3d.run import run_scene
    from modsim3d.scene_reader import load_scene

    loaded = load_scene(
        scene,
        seed=seed,
        detector=detector,
        detector_seed=detector_seed,
        steps=steps,
        mode=mode,
        source=source.value if source else None,
        render=render.value if render else None,
    )
    folder = out if out is not None else Path("runs") / loaded.name
    try:
        with progress_bar() as bar:
            task = bar.add_task(loaded.name, total=None if loaded.live else loaded.steps)
            result = run_scene(
                loaded,
                folder,
                overwrite=overwrite,
                resume=resume,
                workers=workers,
                progress=lambda steps: bar.update(task, advance=steps, refresh=True),
            )
    except KeyboardInterrupt:
        kept = f"in {folder / 'unfinished'}" if loaded.live else "go on with --resume"
        typer.echo(f"\nmodsim3d: interrupted; what was finished is kept: {kept}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    if sheet:
        from modsim3d.draw_run import draw_contact_sheet

        draw_contact_sheet(loaded, folder, result.reference)
    _summarise(loaded, result, sheet)


@app.command("detect")
def detect_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run directory of a finished run.")],
    out: Annotated[Path, typer.Option(help="The new run directory.")],
    detector: Annotated[Path | None, typer.Option(help="Detector file, in place of the run's.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the detector, in place of the run's.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a run that is there.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes that share the work; the files stay the same.")] = 1,
) -> None:
    """Run another detector, or another seed of it, over a finished run's truth, without rendering again.

    Example: modsim3d detect runs/first --detector my/detector.yaml --seed 7 --out runs/second
    """
    from modsim3d.detect_run import detect_run
    from modsim3d.stored_run import open_run

    stored = open_run(run)
    with progress_bar() as bar:
        task = bar.add_task(stored.scene.name, total=stored.scene.steps)
        result = detect_run(
            stored,
            out,
            detector=detector,
            seed=seed,
            overwrite=overwrite,
            workers=workers,
            progress=lambda steps: bar.update(task, advance=steps, refresh=True),
        )
    _summarise(stored.scene, result, sheet=False)


@app.command("verify")
def verify_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run directory of a finished run.")],
    detector: Annotated[Path | None, typer.Option(help="Hold it against this file, not the run's own.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for verify.json and verify.html.", show_default="RUN")
    ] = None,
) -> None:
    """Does a run obey its detector file? Every parameter, asked and measured, with a verdict.

    Exit status 1 if a verdict is against the run.

    Example: modsim3d verify runs/first
    """
    from rich.console import Console

    from modsim3d import verify_report
    from modsim3d.stored_run import open_run
    from modsim3d.verify_run import verify_run

    verified = verify_run(open_run(run), detector)
    folder = run if out is None else out
    verify_report.write_report(verified, folder)
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDE)
    for group, verdicts in verify_report.groups_of(verified.verification).items():
        _print_verdicts(console, group, verdicts)
    for note in verify_report.notes_of(verified.verification):
        console.print(note, style="dim", highlight=False, markup=False)
    obeys = verified.verification.obeys
    console.print(
        f"\n{verify_report.conclusion(verified.verification)}",
        style="bold" if obeys else "bold red",
        highlight=False,
        markup=False,
    )
    written = f"written  {folder / 'verify.html'}, {folder / 'verify.json'}"
    console.print(f"\n{written}", highlight=False, soft_wrap=True)
    if not obeys:
        raise typer.Exit(1)


@app.command("check")
def check_command(scene: SceneArgument) -> None:
    """Read a scene and every file that it names, and say all that is wrong.

    Example: modsim3d check my/scene.yaml
    """
    from modsim3d.scene_reader import load_scene

    loaded = load_scene(scene)
    steps = "as they come" if loaded.live else loaded.steps
    typer.echo(
        f"{loaded.path}: no problems found. Vessels: {len(loaded.vessels)}, cameras: {len(loaded.cameras)}, "
        f"steps: {steps}, annotation mode: {loaded.annotation.mode}, source: {loaded.annotation.source}"
    )


@app.command("compare")
def compare_command(
    scene: SceneArgument,
    steps: Annotated[int | None, typer.Option(min=1, help="Number of time steps, in place of the scene's.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Look at every K-th step.")] = 1,
    supersample: Annotated[int | None, typer.Option(min=1, max=8, help="In place of the scene's.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write compare.json and compare.html here.")] = None,
) -> None:
    """Check the rendered truth of a scene against exact geometry, and the rectangle rule against both.

    Exit status 1 if a difference is unexplained.

    Example: modsim3d compare simulation_1 --every 5 --out runs/compared
    """
    from rich.console import Console

    from modsim3d import compare_report
    from modsim3d.compare import compare_sources
    from modsim3d.scene_reader import load_scene
    from modsim3d.simulate import open_renderer

    loaded = load_scene(scene, steps=steps, source="rendered", supersample=supersample)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)  # better now than after all the work
    with open_renderer(loaded) as renderer:
        if renderer is None:
            raise ModsimError("the rendered source is needed to compare with")
        with progress_bar() as bar:
            task = bar.add_task(loaded.name, total=-(-loaded.steps // every))
            report = compare_sources(
                loaded, renderer, every=every, progress=lambda steps: bar.update(task, advance=steps, refresh=True)
            )
        if out is not None:
            compare_report.write_report(report, loaded, renderer, out)
    figures = report.figures()
    console = Console()
    for title, rows in (
        ("rendered against analytic", compare_report.figure_rows(figures)),
        ("verdicts: full box, visible part", compare_report.verdict_rows(figures)),
        ("rectangle rule against rendered", compare_report.rule_rows(figures)),
        ("shoebox against mesh", compare_report.looseness_rows(figures)),
        ("time per frame", compare_report.time_rows(figures)),
        ("intersecting boxes", compare_report.intersection_rows(figures)),
    ):
        if rows:
            _print_rows(console, title, rows)
    if out is not None:
        console.print(f"\nwritten  {out / 'compare.html'}, {out / 'compare.json'}", highlight=False, soft_wrap=True)
    if report.unexplained:
        raise typer.Exit(1)


@app.command("ais")
def ais_command(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="AIS logs: CSV or NMEA, also gzipped.")],
    out: Annotated[Path, typer.Option(help="Scene folder to make.")],
    origin: Annotated[str | None, typer.Option(metavar="LAT,LON", show_default="median position")] = None,
    region: Annotated[str | None, typer.Option(metavar="LAT1,LON1,LAT2,LON2", help="Leave out the rest.")] = None,
    start: Annotated[str | None, typer.Option(metavar="TIME", help="UTC.", show_default="first report")] = None,
    end: Annotated[str | None, typer.Option(metavar="TIME", help="UTC.", show_default="last report")] = None,
    duration: Annotated[float | None, typer.Option(metavar="SECONDS", help="In place of --end.")] = None,
    time_step: Annotated[float, typer.Option(metavar="SECONDS", help="Between steps.")] = 1.0,
    max_gap: Annotated[float, typer.Option(metavar="SECONDS", help="Away between reports further apart.")] = 400.0,
    max_speed: Annotated[float, typer.Option(metavar="KNOTS", help="Faster is a jump, and dropped.")] = 60.0,
    labels: Annotated[Labels, typer.Option(help="One label for all, or one for each group of ship types.")] = (
        Labels.vessel
    ),
    label: Annotated[list[str] | None, typer.Option(metavar="GROUP=LABEL", help="Label of one group.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a scene folder that is there.")] = False,
) -> None:
    """Make a scene folder from real traffic: AIS of Denmark, MarineCadastre or a receiver.

    Example: modsim3d ais aisdk-2024-01-04.csv --region 55.6,12.6,55.8,12.9 --duration 600 --out scenes/sound
    """
    from rich.console import Console

    from modsim3d.ais import options as given
    from modsim3d.ais.conversion import read_traffic
    from modsim3d.ais.report import summary_rows
    from modsim3d.ais.scene_folder import SCENE, check_free, write_scene
    from modsim3d.shipped import data_folder

    options = given.Options(
        origin=given.parse_origin(origin) if origin else None,
        region=given.parse_region(region) if region else None,
        start_s=given.parse_time(start, "--start") if start else None,
        end_s=given.parse_time(end, "--end") if end else None,
        duration_s=duration,
        time_step_s=time_step,
        max_gap_s=max_gap,
        max_speed_kn=max_speed,
        labels_by_type=labels is Labels.type,
        labels=given.parse_labels(label or ()),
    )
    check_free(out, overwrite)
    traffic = read_traffic(files, options)
    write_scene(traffic, out, data_folder("scenes") / "detectors" / "thesis.yaml", overwrite)
    console = Console()
    for title, rows in summary_rows(traffic):
        if rows:
            _print_rows(console, title, rows)
    scene = out / SCENE
    console.print(f"\nscene folder  {out}\nrun it with   modsim3d run {scene}", highlight=False, soft_wrap=True)


@app.command("report")
def report_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")],
    out: Annotated[Path | None, typer.Option(help="The file to write.", show_default="RUN/report.html")] = None,
    every: Annotated[int, typer.Option(min=1, help="Show every K-th step; the tables count all.")] = 1,
) -> None:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

    Example: modsim3d report runs/first
    """
    from modsim3d.run_report import write_report
    from modsim3d.stored_run import open_run

    opened = open_run(run)
    with progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        written = write_report(opened, out, every, progress=lambda steps: bar.update(task, advance=steps, refresh=True))
    if not opened.finished:
        typer.echo(f"an interrupted run: {opened.steps} of {opened.scene.steps} steps are there and shown")
    typer.echo(f"written  {written}  ({written.stat().st_size / 1e6:.1f} MB)")


@app.command("rerun")
def rerun_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")],
    out: Annotated[Path | None, typer.Option(help="The file to write.", show_default="RUN/run.rrd")] = None,
    every: Annotated[int, typer.Option(min=1, help="Only every K-th step.")] = 1,
) -> None:
    """Write a run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time.

    Example: modsim3d rerun runs/first --out first.rrd
    """
    from modsim3d.run_rerun import write_recording
    from modsim3d.stored_run import open_run

    opened = open_run(run)
    out = run / "run.rrd" if out is None else out
    with progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        write_recording(opened, out, every, progress=lambda steps: bar.update(task, advance=steps, refresh=True))
    typer.echo(f"written  {out}  ({out.stat().st_size / 1e6:.1f} MB); look at it with: rerun {out}")


@app.command("scenes")
def scenes_command() -> None:
    """List the scenes that come with modsim3d.

    Example: modsim3d scenes
    """
    from modsim3d.scene_reader import shipped_scenes

    for name, path in shipped_scenes().items():
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        typer.echo(f"{name:<16}{first.lstrip('# ')}\n{'':<16}{path}")


def _print_rows(console: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    console.print()
    console.print(table)


def _print_verdicts(console: Console, title: str, verdicts: Sequence[Verdict]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from modsim3d.verify_report import HEADER, row_of

    # Numbers that wrap cannot be read: a narrow terminal gets fewer of them, the files have all.
    left_out = {name for name, least in (("interval", 120), ("noticed from", 100)) if console.width < least}
    shown = [i for i, name in enumerate(HEADER) if name not in left_out]
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim")
    for i in shown:
        table.add_column(HEADER[i], no_wrap=HEADER[i] == "parameter", overflow="fold")
    for verdict in verdicts:
        cells = row_of(verdict)
        table.add_row(*(escape(cells[i]) for i in shown), style="bold red" if verdict.fails else None)
    console.print()
    console.print(table)


def _summarise(scene: Scene, result: RunResult, sheet: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    counts = result.counts
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    table.add_column(style="dim")
    true = max(counts.detected, 1)
    rows: list[tuple[str, str, str]] = [
        (
            "frames",
            str(counts.frames),
            f"{len(scene.cameras)} camera(s), {result.steps} steps, mode {scene.annotation.mode}",
        ),
        (
            "vessels seen",
            str(counts.seen),
            "vessels in images, summed over frames",
        ),
        ("occlusions", f"{counts.partly_hidden} partly, {counts.fully_hidden} fully", ""),
        ("annotated", str(counts.annotated), ""),
        ("detections", str(counts.detected), _share(counts.detected, counts.annotated, "of annotated")),
        ("missed", str(counts.missed), _share(counts.missed, counts.annotated, "of annotated")),
        (
            "false",
            str(counts.false_positives),
            _share(counts.false_positives, counts.detected + counts.false_positives, "of all detections"),
        ),
        ("mislabelled", str(counts.mislabelled), ""),
        (
            "IoU below 0.5",
            str(counts.below_half_iou),
            f"{counts.below_half_iou / true:.1%} of detections: a matching evaluation misses these",
        ),
        (
            "box redrawn",
            str(counts.redrawn),
            f"{counts.redrawn / true:.1%}: the first error left less than a pixel of the box",
        ),
        (
            "time per frame",
            f"{1e3 * result.seconds / max(counts.frames, 1):.2f} ms",
            f"{result.seconds:.1f} s in all",
        ),
    ]
    rows += _model_rows(result)
    if result.resumed_steps:
        rows.append(("resumed", str(result.resumed_steps), "steps taken from the interrupted run"))
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    for pair in result.intersecting:
        message = f"{' and '.join(pair)} intersect: what is seen of them is left open; only the rendered source decides"
        console.print(message, highlight=False, soft_wrap=True, style="yellow")
    console.print(f"\nrun directory  {result.folder}", highlight=False, soft_wrap=True)
    if sheet:
        console.print(f"contact sheet  {result.folder / 'contact_sheet.png'}", highlight=False, soft_wrap=True)


def _model_rows(result: RunResult) -> list[tuple[str, str, str]]:
    """What the detector's own rules did, where they did anything."""
    counts, rows = result.counts, []
    total = sum(state["detections"] for state in result.truncation.values())
    redrawn = sum(state["redrawn"] * state["detections"] for state in result.truncation.values()) / max(total, 1)
    if redrawn >= 0.005:
        worst = max(result.truncation, key=lambda name: abs(result.truncation[name]["mean_shift"][2]))
        state = result.truncation[worst]
        width, height = (f"{shift:+.3g}" for shift in state["mean_shift"][2:])
        of = "box sides" if state["unit"] == "relative" else "px"
        rows.append(
            ("truncation bias", f"{width}, {height} {of}", f"mean width, height error in '{worst}'; all in run.json")
        )
    if counts.missed_by_gate:
        rows.append(
            ("gated", str(counts.missed_by_gate), _share(counts.missed_by_gate, counts.missed, "of the missed"))
        )
    if counts.merged:
        rows.append(("merged", str(counts.merged), "boxes around two vessels"))
    return rows


def _share(part: int, whole: int, of: str) -> str:
    return f"{part / whole:.1%} {of}" if whole else ""


def main() -> None:
    """Run the command line; a user's error is one message on standard error and exit status 2."""
    # Neither small matrices nor short tables gain from threads; without them workers can be copies of this process.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    try:
        app()
    except ModsimError as error:
        typer.echo(f"modsim3d: {error}", err=True)
        sys.exit(BAD_INPUT)
    except OSError as error:
        typer.echo(f"modsim3d: {error.filename or 'a file'}: {error.strerror or error}", err=True)
        sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()
