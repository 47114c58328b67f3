"""A scene in a few lines, and as a table in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modsim3d.display import counted, key_table, listed

if TYPE_CHECKING:
    from modsim3d.scene.scene import Scene


def scene_lines(scene: Scene) -> str:
    """Three lines: what is in it; its steps, seed and truth; its detector."""
    cameras = listed([camera.name for camera in scene.cameras])
    return "\n".join(
        [
            f"<Scene {scene.name}: {_vessels(scene)}, {counted(len(scene.cameras), 'camera')} ({cameras})",
            f"  {_steps(scene)}, seed {scene.seed}, truth {scene.annotation.source}, mode {scene.annotation.mode}",
            f"  detector: {scene.detector.in_words()}>",
        ]
    )


def scene_table(scene: Scene) -> str:
    """The same as an HTML table, with sizes of images and all that is there besides."""
    cameras = [
        f"{camera.name} ({camera.intrinsics.image_size_px[0]} × {camera.intrinsics.image_size_px[1]} px, "
        f"{'on ' + camera.mount.vessel if camera.mount.vessel else 'ashore'})"
        for camera in scene.cameras
    ]
    obstacles = listed([obstacle.name for obstacle in scene.obstacles])
    rows = {
        "vessels": _vessels(scene),
        "cameras": listed(cameras),
        "obstacles": f"{len(scene.obstacles)} ({obstacles})" if scene.obstacles else "none",
        "waves": _waves(scene),
        "traffic": scene.traffic,
        "steps": _steps(scene),
        "seed": f"{scene.seed}"
        + ("" if scene.detector_seed == scene.seed else f", of the detector {scene.detector_seed}"),
        "truth": f"{scene.annotation.source}, mode {scene.annotation.mode}",
        "detector": scene.detector.in_words(),
    }
    return key_table(f"Scene {scene.name}", rows)


def _vessels(scene: Scene) -> str:
    return f"{counted(len(scene.vessels), 'vessel')} ({listed(scene.vessel_names)})"


def _waves(scene: Scene) -> str:
    if scene.waves is None:
        return "none"
    return "move every vessel" if scene.waves.apply_to == "all" else "move vessels with a camera"


def _steps(scene: Scene) -> str:
    if scene.live:
        return "steps as they arrive"
    return f"{counted(scene.steps, 'step')} in {scene.times_s(scene.steps - 1, scene.steps)[0]:g} s"
