"""The commands `modsim3d check` and `modsim3d scenes`."""

from __future__ import annotations

from modsim3d.commands.shared import FromOption, SceneArgument, SetOption, StateOption
from modsim3d.commands.terminal import say


def check_command(
    scene: SceneArgument, settings: SetOption = None, state: StateOption = None, state_from: FromOption = None
) -> None:
    """Read a scene and every file that it names, and list everything that is wrong.

    Example: modsim3d check my/scene.yaml
    """
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings

    loaded = load_scene(scene, settings=read_settings(settings or ()), state=state, state_from=state_from)
    steps = "as they come" if loaded.live else loaded.steps
    say(
        f"{loaded.path}: no problems found. Vessels: {len(loaded.vessels)}, cameras: {len(loaded.cameras)}, "
        f"steps: {steps}, annotation mode: {loaded.annotation.mode}, source: {loaded.annotation.source}"
    )


def scenes_command() -> None:
    """List the shipped scenes, and the detection conditions for --state NAME --from conditions.

    Example: modsim3d scenes
    """
    from modsim3d.inputs.conditions import CONDITIONS, conditions_in
    from modsim3d.scene.reading import shipped_scenes

    for name, path in shipped_scenes().items():
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        say(f"{name:<16}{first.lstrip('# ')}\n{'':<16}{path}")
    say(f"\n--from {CONDITIONS} has: {', '.join(conditions_in())}")
