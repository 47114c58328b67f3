"""Reads a scene file and every file that it names, and reports everything that is wrong with them at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import nearest, shown
from modsim3d.motion.imu import PERFECT_IMU, Imu
from modsim3d.motion.poses import LivePoses
from modsim3d.scene.checks import scene_problems
from modsim3d.scene.copy import SceneCopy, copy_scene
from modsim3d.scene.keys import MAX_STEPS, SceneKeys
from modsim3d.scene.parts import SceneParts
from modsim3d.scene.scene import Scene
from modsim3d.scene.values import camera_of, waves_of
from modsim3d.truth.modes import Annotation


def shipped_scenes() -> dict[str, Path]:
    """Scenes that come with the package, by name."""
    return {path.stem: path for path in sorted(data_folder("scenes").glob("*.yaml"))}


def find_scene(scene: str | Path) -> Path:
    """The scene file that a path or the name of a shipped scene means.

    Raises:
        InputError: There is neither.
    """
    path, shipped = Path(scene), shipped_scenes()
    try:
        exists, folder = path.exists(), path.is_dir()
    except OSError as error:
        raise InputError(f"scene {shown(str(scene))}", [f"cannot be read: {error.strerror}"]) from None
    if exists and not (folder and str(scene) in shipped):
        return path
    if str(scene) in shipped:
        return shipped[str(scene)]
    raise InputError(
        f"scene {scene}",
        [f"no such file, and no shipped scene has this name ({nearest(str(scene), shipped)})"],
    )


def load_scene(
    scene: str | Path,
    *,
    seed: int | None = None,
    steps: int | None = None,
    mode: int | None = None,
    source: str | None = None,
    supersample: int | None = None,
    render: str | None = None,
    detector: Path | None = None,
    detector_seed: int | None = None,
) -> Scene:
    """Read and validate a scene and every file that it names.

    Args:
        scene: A scene file, or the name of a shipped scene. Each of the following replaces what stands in the file.
        seed: Seed of the scene.
        steps: Number of time steps.
        mode: Annotation mode, 0 to 2.
        source: Annotation source: `rendered`, `analytic` or `rectangles`.
        supersample: Buffer pixels for each pixel of the image and axis.
        render: What the rendered source draws: `regions` or `full`.
        detector: A detector file, relative to the working directory.
        detector_seed: Seed of the detector.

    Raises:
        InputError: With every problem found, each with its path in the file.
    """
    path = find_scene(scene)
    data = (load_json if path.suffix == ".json" else load_yaml)(path, "scene")
    if not isinstance(data, dict):
        raise InputError(f"scene {path}", ["the file is empty" if data is None else "a mapping of keys is needed"])
    overrides: dict[tuple[str, ...], object] = {
        ("seed",): seed,
        ("steps",): steps,
        ("annotation", "mode"): mode,
        ("annotation", "source"): source,
        ("annotation", "supersample"): supersample,
        ("annotation", "render"): render,
        ("detector",): None if detector is None else str(detector.resolve()),  # a scene's paths are relative to it
        ("detector_seed",): detector_seed,
    }
    for keys, value in overrides.items():
        if value is not None:
            _override(data, keys, value)
    return _assembled(SceneParts(path, data))


def _override(data: dict[str, Any], keys: tuple[str, ...], value: object) -> None:
    for key in keys[:-1]:
        inner = data.get(key)
        data[key] = dict(inner) if isinstance(inner, dict) else {} if inner is None else inner
        data = data[key]
    if isinstance(data, dict):
        data[keys[-1]] = value


def _assembled(parts: SceneParts) -> Scene:
    """The scene from its parts, or every problem at once."""
    keys, vessels, detector, poses = parts.keys, parts.vessels, parts.detector, parts.poses
    if keys is None or vessels is None or detector is None or poses is None or parts.problems:
        raise InputError(parts.name, parts.problems)
    copy, level, live = _copy(parts, keys), parts.wave_level, isinstance(poses, LivePoses)
    scene = Scene(
        name=parts.path.stem,
        path=parts.path,
        sha256=copy.sha256(),
        seed=keys.seed,
        detector_seed=keys.seed if keys.detector_seed is None else keys.detector_seed,
        truth_has_seed=keys.truth_has_seed,
        steps=keys.steps or (MAX_STEPS if live else len(poses.timestamps)),
        vessels=vessels,
        poses=poses,
        cameras=tuple(camera_of(name, camera) for name, camera in keys.cameras.items()),
        annotation=Annotation(**keys.annotation.model_dump()),
        detector=detector,
        copy=copy,
        sea=keys.sea,
        obstacles=parts.obstacles,
        waves=waves_of(keys.waves, keys.seed, vessels, level[0] if level else None),
        imu=Imu(**keys.imu.model_dump()) if keys.imu else PERFECT_IMU,
        plugins=parts.plugins,
    )
    if problems := _imu_problems(keys, scene) + scene_problems(scene):
        raise InputError(parts.name, problems)
    return scene


def _imu_problems(keys: SceneKeys, scene: Scene) -> list[str]:
    if keys.imu is None or scene.own_ships:
        return []
    return ["imu: no camera is mounted on a vessel, so there is no own ship to measure"]


def _copy(parts: SceneParts, keys: SceneKeys) -> SceneCopy:
    recorded = None if parts.source is None or isinstance(parts.poses, LivePoses) else parts.source
    return copy_scene(
        parts.path,
        parts.data,
        keys,
        vessels=parts.meshes.copied_all(parts.vessel_entries or {}, parts.vessels_at.folder),
        obstacles=parts.meshes.copied_all(parts.data.get("obstacles") or {}, parts.folder),
        mesh_files=parts.meshes.files,
        pose_files=None if recorded is None else recorded.keys.files,
    )
