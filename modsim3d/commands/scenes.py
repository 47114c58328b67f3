"""The commands `modsim3d check` and `modsim3d scenes`."""

from __future__ import annotations

from modsim3d.commands.shared import SceneArgument
from modsim3d.commands.terminal import say


def check_command(scene: SceneArgument) -> None:
    """Read a scene and every file that it names, and list everything that is wrong.

    Warns of cameras that see no vessel in their first frames, nor in some others over the whole scene.

    Example: modsim3d check my/scene.yaml
    """
    from modsim3d.runs.blind_cameras import blind_at_first
    from modsim3d.scene.reading import load_scene

    loaded = load_scene(scene)
    steps = "as they come" if loaded.live else loaded.steps
    say(
        f"{loaded.path}: no problems found. Vessels: {len(loaded.vessels)}, cameras: {len(loaded.cameras)}, "
        f"steps: {steps}, annotation mode: {loaded.annotation.mode}, source: {loaded.annotation.source}"
    )
    for warning in blind_at_first(loaded):
        say(f"warning: {warning}")


def scenes_command() -> None:
    """List the shipped scenes.

    Example: modsim3d scenes
    """
    from modsim3d.scene.reading import shipped_scenes

    for name, path in shipped_scenes().items():
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        say(f"{name:<16}{first.lstrip('# ')}\n{'':<16}{path}")
