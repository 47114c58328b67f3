"""Reads a scene file and every file that it names, and says all that is wrong with them at once."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from modsim3d.annotate.modes import Annotation
from modsim3d.detector.loader import load_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError
from modsim3d.imu import PERFECT_IMU, Imu
from modsim3d.obstacles import Obstacle
from modsim3d.plugins import Plugin
from modsim3d.poses import LivePoses, NamedSource, PoseRequest, PoseSource, read_source
from modsim3d.scene import Scene
from modsim3d.scene_checks import scene_problems
from modsim3d.scene_copy import SceneCopy, copy_scene
from modsim3d.scene_file import MAX_STEPS, SceneKeys
from modsim3d.scene_meshes import SceneMeshes, read_obstacle
from modsim3d.scene_values import Axes, camera_of, waves_of
from modsim3d.shipped import data_folder
from modsim3d.strict_json import load_json
from modsim3d.strict_yaml import load_yaml
from modsim3d.validation import describe, join_path, nearest, shown
from modsim3d.vessels import Vessel, load_mapping, parse_vessels
from modsim3d.wave_levels import find_level

T = TypeVar("T")

CAMERA_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
OVERRIDES = {
    "seed": ("seed",),
    "steps": ("steps",),
    "mode": ("annotation", "mode"),
    "source": ("annotation", "source"),
    "supersample": ("annotation", "supersample"),
    "render": ("annotation", "render"),
    "detector": ("detector",),
    "detector_seed": ("detector_seed",),
}
"""What a caller may change in a scene file without editing it, and where it stands."""


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
        scene: A scene file, or the name of a shipped scene.
        seed: In place of the file's.
        steps: In place of the file's.
        mode: In place of the file's annotation mode.
        source: In place of the file's annotation source.
        supersample: In place of the file's.
        render: In place of the file's, `regions` or `full`.
        detector: A detector file, in place of the scene file's.
        detector_seed: In place of the file's.

    Raises:
        InputError: With every problem found, each with its path in the file.
    """
    path = find_scene(scene)
    data = (load_json if path.suffix == ".json" else load_yaml)(path, "scene")
    if not isinstance(data, dict):
        raise InputError(f"scene {path}", ["the file is empty" if data is None else "a mapping of keys is needed"])
    given = {
        "seed": seed,
        "steps": steps,
        "mode": mode,
        "source": source,
        "supersample": supersample,
        "render": render,
        "detector": None if detector is None else str(detector.resolve()),  # a scene's paths are relative to it
        "detector_seed": detector_seed,
    }
    for name, value in given.items():
        if value is not None:
            _override(data, OVERRIDES[name], value)
    return _Reader(path, data).scene()


def _override(data: dict[str, Any], keys: tuple[str, ...], value: object) -> None:
    for key in keys[:-1]:
        inner = data.get(key)
        data[key] = dict(inner) if isinstance(inner, dict) else {} if inner is None else inner
        data = data[key]
    if isinstance(data, dict):
        data[keys[-1]] = value


class _Reader:
    """Reads the parts of a scene one by one and collects what is wrong with each."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self.path = path
        self.data = data
        self.folder = path.resolve().parent
        self.problems: list[str] = []
        self.meshes = SceneMeshes()

    def scene(self) -> Scene:
        """The scene, or every problem at once."""
        keys = self._keys()
        entries = self._vessel_entries()
        vessels = self._vessels(entries)
        detector = self._detector()
        # The names, and not the vessels: one that is wrong must not keep the rest from being looked at.
        names = None if entries is None else [str(name) for name in entries]
        if names:
            self._check_mounts(names)
        if entries is not None and detector is not None:
            self._check_labels(entries, detector)
        source = self._pose_source()
        poses = self._poses(source, keys, names, vessels)
        level = self._wave_level()
        obstacles = self._obstacles(keys) if keys else ()
        if vessels is not None:
            vessels = tuple(
                self._with_mesh(vessel, (entries or {}).get(vessel.name, {}).get("mesh")) for vessel in vessels
            )
        if keys is None or vessels is None or detector is None or poses is None or self.problems:
            raise InputError(f"scene {self.path}", self.problems)
        annotation = keys.annotation
        copy = self._copy(keys, entries or {}, None if isinstance(poses, LivePoses) else source)
        scene = Scene(
            name=self.path.stem,
            path=self.path,
            sha256=copy.sha256(),
            seed=keys.seed,
            detector_seed=keys.seed if keys.detector_seed is None else keys.detector_seed,
            truth_has_seed=keys.truth_has_seed,
            steps=keys.steps or (MAX_STEPS if isinstance(poses, LivePoses) else len(poses.timestamps)),
            vessels=vessels,
            poses=poses,
            cameras=tuple(camera_of(name, camera) for name, camera in keys.cameras.items()),
            annotation=Annotation(**annotation.model_dump()),
            detector=detector,
            copy=copy,
            sea=keys.sea,
            obstacles=obstacles,
            waves=waves_of(keys.waves, keys.seed, vessels, level[0] if level else None),
            imu=Imu(**keys.imu.model_dump()) if keys.imu else PERFECT_IMU,
            plugins=tuple(
                plugin for plugin in (source and source.plugin, level and level[1], *self.meshes.plugins) if plugin
            ),
        )
        if keys.imu is not None and not scene.own_ships:
            self.problems.append("imu: no camera is mounted on a vessel, so that there is no own ship to measure")
        self.problems += scene_problems(scene)
        if self.problems:
            raise InputError(f"scene {self.path}", self.problems)
        return scene

    def _collect(self, read: Callable[[], T]) -> T | None:
        """What `read` gives, or None and its problems kept."""
        try:
            return read()
        except InputError as error:
            here = error.source == f"scene {self.path}"
            self.problems += [
                problem if here or problem.startswith(error.source) else f"{error.source}: {problem}"
                for problem in error.problems
            ]
            return None

    def _keys(self) -> SceneKeys | None:
        cameras = self.data.get("cameras")
        if isinstance(cameras, dict):
            if not cameras:
                self.problems.append("cameras: no cameras; a scene needs at least one")
            self.problems += [
                f"cameras.{name}: a camera's name goes into file names: at most 100 letters, digits, '_', '-' and '.' "
                "only, the first a letter or digit"
                for name in cameras
                if not CAMERA_NAME.fullmatch(str(name))
            ]
        try:
            return SceneKeys.model_validate(self.data)
        except ValidationError as error:
            self.problems += describe(error, SceneKeys)
            return None

    def _vessels_source(self) -> tuple[str, tuple[str, ...]]:
        """What to call the place where the vessels stand, and the path there."""
        entry = self.data.get("vessels")
        if isinstance(entry, str):
            return f"vessels file {self.folder / entry}", ()
        return f"scene {self.path}", ("vessels",)

    def _vessel_entries(self) -> dict[Any, Any] | None:
        """The mapping of vessels as it stands in its file; None if there is no such thing."""
        entry = self.data.get("vessels")
        if isinstance(entry, str):
            return self._collect(lambda: load_mapping(self.folder / entry))
        return entry if isinstance(entry, dict) else None  # the scene's own keys say what is wrong

    def _vessels(self, entries: dict[Any, Any] | None) -> tuple[Vessel, ...] | None:
        if entries is None:
            return None
        source, path = self._vessels_source()
        return self._collect(lambda: parse_vessels(entries, source, *path))

    def _vessels_folder(self) -> Path:
        """The folder that paths in the mapping of vessels start from."""
        entry = self.data.get("vessels")
        return (self.folder / entry).parent if isinstance(entry, str) else self.folder

    def _with_mesh(self, vessel: Vessel, entry: object) -> Vessel:
        if entry is None:
            return vessel
        source, path = self._vessels_source()
        where = (*path, vessel.name, "mesh")
        solid = self._collect(lambda: self.meshes.solid(entry, self._vessels_folder(), source, *where))
        return vessel if solid is None else replace(vessel, solid=solid)

    def _obstacles(self, keys: SceneKeys) -> tuple[Obstacle, ...]:
        found = []
        for name, entry in keys.obstacles.items():
            read = partial(read_obstacle, name, entry, self.meshes, self.path, keys.annotation.source)
            found.append(self._collect(read))
        return tuple(obstacle for obstacle in found if obstacle is not None)

    def _detector(self) -> DetectorModel | None:
        entry = self.data.get("detector")
        return self._collect(lambda: load_detector(self.folder / entry)) if isinstance(entry, str) else None

    def _pose_source(self) -> NamedSource | None:
        """The keys of the pose source; of one that makes its own poses only if the scene gives it times."""
        entry = self.data.get("poses")
        if not isinstance(entry, dict) or not all(isinstance(name, str) for name in entry):
            return None  # the scene's own keys say what is wrong
        source = self._collect(lambda: read_source(entry, f"scene {self.path}"))
        missing = [key for key in ("steps", "time_step_s") if self.data.get(key) is None]
        if source is not None and source.keys.generated and missing:
            needed = " and ".join(missing)
            self.problems.append(f"poses: {source.name} makes its own times: {needed} must be given beside it")
            return None
        return source

    def _poses(
        self,
        source: NamedSource | None,
        keys: SceneKeys | None,
        names: list[str] | None,
        vessels: tuple[Vessel, ...] | None,
    ) -> PoseSource | None:
        if source is None or (source.keys.generated and (keys is None or vessels is None)):
            return None
        request = PoseRequest(
            folder=self.folder,
            names=None if names is None else tuple(names),
            vessels=vessels or (),
            steps=keys.steps if keys else None,
            time_step_s=keys.time_step_s if keys else None,
            seed=keys.seed if keys else 0,
        )
        poses = self._collect(lambda: source.build(request))
        asked = self.data.get("steps")
        known = poses is not None and not isinstance(poses, LivePoses)
        if poses is not None and known and isinstance(asked, int) and asked > len(poses.timestamps):
            which = "the pose file" if source.name == "file" else f"poses.{source.name}"
            self.problems.append(f"steps: {asked} asked for, but {which} has {len(poses.timestamps)}")
        return poses

    def _wave_level(self) -> tuple[Axes, Plugin | None] | None:
        waves = self.data.get("waves")
        level = waves.get("level") if isinstance(waves, dict) else None
        return self._collect(lambda: find_level(level)) if isinstance(level, str) else None

    def _check_mounts(self, names: list[str]) -> None:
        cameras = self.data.get("cameras")
        for name, camera in cameras.items() if isinstance(cameras, dict) else ():
            mount = camera.get("mount") if isinstance(camera, dict) else None
            vessel = mount.get("vessel") if isinstance(mount, dict) else None
            if isinstance(vessel, str) and vessel not in names:
                self.problems.append(f"cameras.{name}.mount.vessel: no vessel '{vessel}' ({nearest(vessel, names)})")

    def _check_labels(self, entries: dict[Any, Any], detector: DetectorModel) -> None:
        source, path = self._vessels_source()
        where = "" if path else f"{source}: "
        for name, entry in entries.items():
            label = entry.get("label") if isinstance(entry, dict) else None
            if isinstance(label, str) and label not in detector.labels:
                self.problems.append(
                    f"{where}{join_path(*path, str(name))}.label: '{label}' is not one of the detector's labels "
                    f"({nearest(label, detector.labels)})"
                )

    def _copy(self, keys: SceneKeys, entries: dict[Any, Any], recorded: NamedSource | None) -> SceneCopy:
        return copy_scene(
            self.path,
            self.data,
            keys,
            vessels=self.meshes.copied_all(entries, self._vessels_folder()),
            obstacles=self.meshes.copied_all(self.data.get("obstacles") or {}, self.folder),
            mesh_files=self.meshes.files,
            pose_files=None if recorded is None else recorded.keys.files,
        )
