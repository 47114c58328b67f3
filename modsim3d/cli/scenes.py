"""The commands `modsim3d check` and `modsim3d scenes`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from modsim3d.cli.run_summary import scene_warnings, traffic_in_words
from modsim3d.cli.shared import (
    FromOption,
    JsonOption,
    QuietOption,
    SceneArgument,
    SetOption,
    StateOption,
    VerboseOption,
    print_line,
    print_rows,
)
from modsim3d.cli.terminal import open_console, print_prose, say_json, tell_files, timed, warn

if TYPE_CHECKING:
    from modsim3d.detector.model import DetectorModel
    from modsim3d.scene.scene import Scene


def check_command(
    scene: SceneArgument,
    settings: SetOption = None,
    state: StateOption = None,
    state_from: FromOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Read a scene and every file that it names, and list everything that is wrong.

    Warns of cameras that see no vessel in their first frames, nor in some others over the whole scene, and of
    vessels for which drawn traffic has no room, of meshes that do not fit their vessels, and of keys of the detector
    file that nothing reads.

    Example: modsim3d check strait
    """
    from modsim3d.runs.camera_sequences import blind_at_first
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings

    with timed("reading the scene"):
        loaded = load_scene(scene, settings=read_settings(settings or ()), state=state, state_from=state_from)
    tell_files(loaded.copy.read)
    console = open_console()
    warnings = [*scene_warnings(loaded), *blind_at_first(loaded)]
    found = f"no errors, {len(warnings)} warning{'s' if len(warnings) > 1 else ''}" if warnings else "no problems found"
    print_line(console, f"{loaded.path}: {found}")
    print_rows(console, "", _rows(loaded))
    for warning in warnings:
        warn(warning)
    say_json(_check_json(loaded, warnings))


def _rows(scene: Scene) -> list[tuple[str, str]]:
    return [
        ("vessels", f"{len(scene.vessels)}{_drawn(scene)}"),
        ("cameras", f"{len(scene.cameras)}: {', '.join(camera.name for camera in scene.cameras)}"),
        ("traffic", traffic_in_words(scene)),
        ("steps", "as they come" if scene.live else str(scene.steps)),
        ("annotation", f"mode {scene.annotation.mode}, source {scene.annotation.source}"),
        *_state_rows(scene.detector),
    ]


def _state_rows(detector: DetectorModel) -> list[tuple[str, str]]:
    shares = detector.stationary_shares
    if len(shares) < 2:
        return []
    unforced = ", while no schedule forces one" if detector.performance.schedule else ""
    named = ", ".join(f"{state} {share:.1%}" for state, share in shares.items())
    return [("states", f"in the long run {named}{unforced}")]


def _drawn(scene: Scene) -> str:
    return f", {scene.drawn_vessels} of them drawn" if scene.drawn_vessels else ""


def _check_json(scene: Scene, warnings: list[str]) -> dict[str, Any]:
    return {
        "format": 1,
        "command": "check",
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


def scenes_command(json: JsonOption = False) -> None:
    """List the shipped scenes, and the detection conditions for --state NAME --from conditions.

    Example: modsim3d scenes
    """
    from modsim3d.io.validation import CONDITIONS, conditions_in
    from modsim3d.scene.reading import draws_traffic, shipped_scenes

    console, entries = open_console(), []
    for name, path in shipped_scenes().items():
        with path.open(encoding="utf-8") as file:
            title = file.readline().strip("# \n")
        drawn = draws_traffic(path)
        entries.append({"name": name, "title": title, "path": path, "traffic_drawn": drawn})
        print_line(console, name, "bold")
        print_prose(console, title, indent=4)
        print_line(console, f"    traffic: {'drawn from the seed' if drawn else 'this traffic only'}")
        print_line(console, f"    {path}", "dim")
    print_line(console, f"--from {CONDITIONS}", "bold")
    print_prose(console, ", ".join(conditions_in()), indent=4)
    say_json({"format": 1, "command": "scenes", "scenes": entries, "conditions": list(conditions_in())})
