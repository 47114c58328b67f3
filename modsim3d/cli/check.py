"""The commands `modsim3d check`: a scene or another file, a run, its repetition, and sources of truth side by side."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli import shared
from modsim3d.cli.run_summary import mode_in_words, traffic_in_words
from modsim3d.cli.shared import option
from modsim3d.cli.terminal import open_console, say_json, tell, tell_files, timed, warn
from modsim3d.cli.terminal_tables import print_document, print_table
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import in_percent, listed

if TYPE_CHECKING:
    from modsim3d.detector.model import DetectorModel
    from modsim3d.runs.repeat_run import RepeatedFile, Repetition
    from modsim3d.scene.scene import Scene

# ---- `modsim3d check scene` ----


def check_scene_command(
    context: typer.Context,
    scene: shared.SceneArgument,
    detector: shared.DetectorOption = None,
    settings: shared.SetOption = None,
    state: shared.StateOption = None,
    state_from: shared.FromOption = None,
    out: Annotated[
        Path | None,
        option("FILE", "File to draw a map of the scene in.", "--out", "--map", show_default="nothing drawn"),
    ] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Read a scene, a campaign or a detector with every file that it names; list what is wrong, and what it means.

    Shows each camera at the first step, each kind of vessel, and the detector's states. Warns of what is probably not
    meant: cameras that see no vessel, paths through obstacles, vessels in one place, sizes and speeds that no vessel
    has, meshes that do not fit, keys that nothing reads.

    Example: modsim3d check scene strait --map strait.png
    """
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings
    from modsim3d.view.scene_check import check_scene

    if (kind := _kind_of_file(scene)) != "scene":
        if settings or state or (detector, state_from, out) != (None, None, None):
            raise ModsimError(f"--detector, --set, --state, --from and --map are for scenes, and {scene} is a {kind}")
        (_check_campaign if kind == "campaign" else _check_detector)(Path(scene))
        return
    with timed("reading the scene"):
        loaded = load_scene(**shared.arguments(context, load_scene, settings=read_settings(settings or ())))
    tell_files(loaded.copy.read)
    with timed("looking at it"):
        report = check_scene(loaded, out, overwrite=overwrite)
    shared.print_line(open_console(), f"{loaded.path}: {_outcome(report.warnings)}")
    print_table(open_console(), "", _rows(loaded, [*map(str, report.cameras)], [*map(str, report.vessel_types)]))
    for warning in report.warnings:
        warn(warning)
    if report.map is not None:
        shared.print_path(open_console(), "map", report.map)
    facts = {"camera_facts": [*map(asdict, report.cameras)], "vessel_types": [*map(asdict, report.vessel_types)]}
    states = {"states": _state_facts(loaded.detector), "map": report.map}
    say_json({**_check_json(loaded, report.warnings), **facts, **states})


def _kind_of_file(name: str) -> str:
    """`campaign` or `detector` if a file has keys that only they have, else `scene`."""
    from modsim3d.io.strict_text import load_yaml

    if Path(name).suffix not in (".yaml", ".yml") or not Path(name).is_file():
        return "scene"
    try:
        keys = {*load_yaml(Path(name), "file")}
    except (ModsimError, TypeError):
        return "scene"  # whose reader says what is wrong
    return "campaign" if "trackers" in keys else "detector" if {"labels", "states"} <= keys else "scene"


def _check_campaign(path: Path) -> None:
    from modsim3d.cli.campaign_run import introduced, read
    from modsim3d.cli.campaign_text import requirement_in_words

    setup = read(str(path))
    warnings, keys = introduced(setup), setup.file.keys
    facts = {"format": 1, "command": "check scene", "path": path, "runs": len(setup.plan), "warnings": warnings}
    required = [*map(requirement_in_words, keys.require)]
    say_json({**facts, "trackers": [tracker.label for tracker in keys.trackers], "required": required})


def _check_detector(path: Path) -> None:
    from modsim3d.detector.file.reading import load_detector
    from modsim3d.detector.file.unread_keys import dead_lines

    detector = load_detector(path)
    warnings = list(dead_lines(detector))
    shared.print_line(open_console(), f"{path}: {detector.in_words()}; {_outcome(warnings)}")
    print_table(open_console(), "", _state_rows(detector))
    for warning in warnings:
        warn(warning)
    facts = {"format": 1, "command": "check scene", "path": path, "labels": detector.labels}
    say_json({**facts, "states": _state_facts(detector), "warnings": warnings})


def _outcome(warnings: list[str]) -> str:
    return f"no errors, {len(warnings)} warning{'s' if len(warnings) > 1 else ''}" if warnings else "no problems found"


def _rows(scene: Scene, cameras: list[str], types: list[str]) -> list[tuple[str, str]]:
    drawn = f", {scene.drawn_vessels} of them drawn" if scene.drawn_vessels else ""
    obstacles = [("obstacles", f"{len(scene.obstacles)}: {listed([obstacle.name for obstacle in scene.obstacles])}")]
    return [
        ("vessels", f"{len(scene.vessels)}{drawn}"),
        *(("", text) for text in types),
        ("cameras", f"{len(scene.cameras)}{', at the first step:' if cameras else ''}"),
        *(("", text) for text in cameras),
        *(obstacles if scene.obstacles else ()),
        ("traffic", traffic_in_words(scene)),
        ("steps", "as they come" if scene.live else str(scene.steps)),
        ("annotation", f"mode {mode_in_words(scene)}; source {scene.annotation.source}"),
        *_state_rows(scene.detector),
    ]


def _state_facts(detector: DetectorModel) -> list[dict[str, Any]]:
    """Mean miss rate of the labels and false positives of each state: in an image, or, where they follow the vessels,
    for each vessel detected in one."""
    shares, facts = detector.stationary_shares, []
    for state in detector.states:
        rate = state.false_discovery_rate
        alarms = state.false_positives_per_image if math.isnan(rate) else rate / (1 - rate)
        miss = float(state.confusion[-1].mean())
        facts.append({"name": state.name, "share": shares.get(state.name), "miss_rate": miss, "false_alarms": alarms})
    return facts


def _state_rows(detector: DetectorModel) -> list[tuple[str, str]]:
    shares, facts, rows, mean = detector.stationary_shares, _state_facts(detector), [], ""
    if len(shares) > 1:
        unforced = ", while no schedule forces one" if detector.performance.schedule else ""
        named = ", ".join(f"{state} {in_percent(share, 1)}" for state, share in shares.items())
        rows.append(("states", f"in the long run {named}{unforced}"))
        mean = f", {in_percent(sum(state['share'] * state['miss_rate'] for state in facts), 1)} in the long run"
    missed = ", ".join(f"{state['name']} {in_percent(state['miss_rate'], 1)}" for state in facts)
    alarms = ", ".join(f"{state['name']} {state['false_alarms']:.2g}" for state in facts)
    empty = detector.false_positives.numbers.empty_frames
    per = "an image" if empty else "for each vessel detected in an image"
    return [*rows, ("missed", f"{missed}{mean}"), ("false positives", f"{alarms} {per}")]


def _check_json(scene: Scene, warnings: list[str]) -> dict[str, Any]:
    return {
        "format": 1,
        "command": "check scene",
        "scene": scene.name,
        "path": scene.path,
        "files": list(scene.copy.read),
        "vessels": [vessel.name for vessel in scene.vessels],
        "cameras": [camera.name for camera in scene.cameras],
        "steps": None if scene.live else scene.steps,
        "traffic_seed": scene.traffic_seed,
        "mode": scene.annotation.mode,
        "source": scene.annotation.source,
        "stationary_shares": scene.detector.stationary_shares,
        "warnings": warnings,
    }


# ---- `modsim3d check run` ----


def check_run_command(
    context: typer.Context,
    run: shared.FinishedRunArgument,
    detector: Annotated[
        Path | None, option("FILE", "Detector file to hold the run against.", show_default="the run's own")
    ] = None,
    out: Annotated[Path | None, option("DIR", "Folder for verify.json and verify.html.", show_default="RUN")] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Check that a run obeys its detector file: every parameter as given and as measured, with a verdict.

    Exit status 1 if a verdict is against the run.

    Example: modsim3d check run runs/first
    """
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.verify import verify_run as verify_report
    from modsim3d.verify.verify_run import verify_run

    with timed("opening the run"):
        opened = open_run(run)
    folder = run if out is None else out
    paths = [folder / name for name in verify_report.FILES]
    read = [*read_of_run(run), *([detector] if detector else [])]
    tell_files(read)
    with claimed(paths, overwrite=overwrite, inputs=read):
        with timed("checks"):
            verified = verify_run(opened, detector)
        with timed("files"):
            verify_report.write_report(verified, folder, shared.typed_command(context))
    verification = verified.verification
    print_document(open_console(), verify_report.document(verified))
    shared.print_written(open_console(), paths)
    notes = [f"{name}: {note}" for name, note in verify_report.named_notes(verification)]
    facts = {"conclusion": verify_report.conclusion(verification), "notes": notes}
    say_json({"command": "check run", **verify_report.report_data(verified), **facts, "written": paths})
    if not verification.obeys:
        raise typer.Exit(1)


# ---- `modsim3d check truth` ----


def check_truth_command(
    context: typer.Context,
    scene: shared.SceneArgument,
    steps: shared.StepsOption = None,
    settings: shared.SetOption = None,
    every: shared.EveryOption = 1,
    out: Annotated[
        Path | None, option("DIR", "Folder for compare.json and compare.html.", show_default="nothing written")
    ] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Check the rendered truth of a scene against ID buffers and geometry, and the idealised rectangle rule against it.

    Exit status 1 if a difference is unexplained.

    Example: modsim3d check truth harbour --every 5 --out runs/compared
    """
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings
    from modsim3d.verify.sources.report import check_truth, document

    with timed("reading the scene"):
        loaded = load_scene(scene, steps=steps, source="rendered", settings=read_settings(settings or ()))
    tell_files(loaded.copy.read)
    bar = shared.progress(loaded.name, None if loaded.live else -(-loaded.steps // every))
    with timed("comparison"), bar as advance:
        given = shared.arguments(context, check_truth, scene=loaded, call=shared.typed_command(context))
        comparison = check_truth(**given, named=scene, progress=advance)
    tell("OpenGL", comparison.renderer)
    print_document(open_console(), document(comparison, loaded))
    shared.print_written(open_console(), comparison.written)
    say_json({"command": "check truth", **asdict(comparison.figures), "written": comparison.written})
    if comparison.figures.unexplained:
        raise typer.Exit(1)


# ---- `modsim3d check repeat` ----


def check_repeat_command(run: shared.FinishedRunArgument, workers: shared.WorkersOption = 1) -> None:
    """Repeat a run from the copy of its scene into a temporary folder, and compare every file, byte by byte.

    Also checks that the stored files are still what run.json lists. Exit status 1 if a byte differs.

    Example: modsim3d check repeat runs/first
    """
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.repeat_run import check_repeat
    from modsim3d.runs.stored_run import read_finished

    with timed("opening the run"):
        scene = read_finished(run).scene  # damage to the tables is for the comparison to tell
    tell_files(read_of_run(run))
    with timed("repetition"), shared.progress(scene.name, scene.steps) as advance:
        repetition = check_repeat(run, workers=workers, progress=advance)
    _print_repetition(repetition)
    say_json({"format": 1, "command": "check repeat", "folder": run, "same": repetition.same, **asdict(repetition)})
    if not repetition.same:
        raise typer.Exit(1)


def _print_repetition(repetition: Repetition) -> None:
    console = open_console()
    print_table(console, "files", [(file.name, _file_outcome(file, repetition.listed)) for file in repetition.files])
    versions = [(item.name, f"then {item.then or 'none'}", f"now {item.now or 'none'}") for item in repetition.versions]
    print_table(console, "made with other versions", versions)
    wrong, files = sum(not file.same for file in repetition.files), f"{len(repetition.files)} files are"
    if wrong:
        shared.print_line(console, f"\n{wrong} of {files} not the same", "bold red")
    else:
        shared.print_line(console, f"\nall {files} the same", "bold")


def _file_outcome(file: RepeatedFile, listed: bool) -> str:
    """Outcome for one file."""
    same = "the bytes that were written" if file.stored else "the same bytes"
    made = "" if file.is_input else f"repeated: {file.repeated or same}"
    if file.name == "run.json" and not file.repeated:
        made = "repeated: the same, versions aside"
    stored = f"stored: {file.stored}" if file.stored else "as written" if file.is_input and listed else ""
    if file.is_input and not listed and not stored:
        stored = "not listed in run.json, which an older version wrote"
    return "; ".join(filter(None, [stored, made]))
