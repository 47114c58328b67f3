"""The command `modsim3d compare`: sources of truth side by side."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli.shared import (
    EveryOption,
    JsonOption,
    OverwriteOption,
    QuietOption,
    SceneArgument,
    SetOption,
    StepsOption,
    VerboseOption,
    print_written,
    progress,
    typed_command,
)
from modsim3d.cli.terminal import open_console, print_document, say_json, tell, tell_files, timed
from modsim3d.core.errors import ModsimError


def compare_command(
    context: typer.Context,
    scene: SceneArgument,
    steps: StepsOption = None,
    settings: SetOption = None,
    every: EveryOption = 1,
    supersample: Annotated[
        int | None,
        typer.Option(
            min=1, max=8, metavar="N", help="Rendered pixels per image pixel and axis, in place of the scene's."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for compare.json and compare.html.", show_default="nothing written"),
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Check the rendered truth of a scene against ID buffers and geometry, and the idealised rectangle rule against it.

    Exit status 1 if a difference is unexplained.

    Example: modsim3d compare harbour --every 5 --out runs/compared
    """
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.pipeline import open_renderer
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings
    from modsim3d.verify.sources import report as compare_report
    from modsim3d.verify.sources.compare import compare_sources

    with timed("reading the scene"):
        loaded = load_scene(
            scene, steps=steps, source="rendered", supersample=supersample, settings=read_settings(settings or ())
        )
    written = [out / name for name in compare_report.FILES] if out is not None else []
    tell_files(loaded.copy.read)
    with claimed(written, overwrite=overwrite, inputs=loaded.copy.read), open_renderer(loaded) as renderer:
        if renderer is None:
            raise ModsimError("compare needs the rendered source")
        tell("OpenGL", renderer.context.description)
        with timed("comparison"), progress(loaded.name, None if loaded.live else -(-loaded.steps // every)) as advance:
            comparison = compare_sources(loaded, renderer, every=every, progress=advance)
        if out is not None:
            compare_report.write_report(comparison, loaded, renderer, out, typed_command(context), scene)
    figures = comparison.figures
    console = open_console()
    print_document(console, compare_report.document(comparison, loaded))
    written = [path for path in written if path.exists()]  # a picture only where a vessel is occluded
    print_written(console, written)
    say_json({"command": "compare", **asdict(figures), "written": written})
    if figures.unexplained:
        raise typer.Exit(1)
