"""Reads a scene file and every file that it names, and says all that is wrong with them at once."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from modsim3d.annotate.modes import Annotation
from modsim3d.camera import Camera, Intrinsics, Mount
from modsim3d.detector.loader import load_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError
from modsim3d.poses import PoseSource, circular_motion, load_poses, waypoint_tracks
from modsim3d.scene import Scene, Waves
from modsim3d.scene_copy import SceneCopy
from modsim3d.scene_file import AnnotationKeys, CameraKeys, SceneKeys, WavesKeys
from modsim3d.validation import describe, join_path, load_json, load_yaml, nearest, shown
from modsim3d.vessels import Vessel, load_mapping, parse_vessels
from modsim3d.waves import AXES, Axis, SecondOrderWaves, level_axes

Indices = NDArray[np.int64]
T = TypeVar("T")

CAMERA_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
CHECKED_STEPS = 1000
"""Steps whose camera positions are looked at together; it bounds the memory."""
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


def data_folder(kind: str) -> Path:
    """The folder of shipped `scenes` or `meshes`: in the installed package, or at the top of the repository."""
    package = Path(__file__).resolve().parent
    installed = package / "_data" / kind
    return installed if installed.is_dir() else package.parent / kind


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
        poses = self._poses(keys, names, vessels)
        if keys is None or vessels is None or detector is None or poses is None or self.problems:
            raise InputError(f"scene {self.path}", self.problems)
        annotation, copy = keys.annotation, self._copy(keys, entries or {})
        scene = Scene(
            name=self.path.stem,
            path=self.path,
            sha256=copy.sha256(),
            seed=keys.seed,
            detector_seed=keys.seed if keys.detector_seed is None else keys.detector_seed,
            truth_has_seed=keys.truth_has_seed,
            steps=keys.steps or len(poses.timestamps),
            vessels=vessels,
            poses=poses,
            cameras=tuple(_camera(name, camera) for name, camera in keys.cameras.items()),
            annotation=Annotation(**annotation.model_dump()),
            detector=detector,
            waves=_waves(keys.waves, keys.seed),
            copy=copy,
        )
        self._check_places(scene)
        if self.problems:
            raise InputError(f"scene {self.path}", self.problems)
        return scene

    def _collect(self, read: Callable[[], T]) -> T | None:
        """What `read` gives, or None and its problems kept."""
        try:
            return read()
        except InputError as error:
            here = error.source == f"scene {self.path}"
            self.problems += [problem if here else f"{error.source}: {problem}" for problem in error.problems]
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

    def _detector(self) -> DetectorModel | None:
        entry = self.data.get("detector")
        return self._collect(lambda: load_detector(self.folder / entry)) if isinstance(entry, str) else None

    def _poses(
        self, keys: SceneKeys | None, names: list[str] | None, vessels: tuple[Vessel, ...] | None
    ) -> PoseSource | None:
        entry = self.data.get("poses")
        file = entry.get("file") if isinstance(entry, dict) else None
        if isinstance(file, str):
            recorded = self._collect(lambda: load_poses(self.folder / file, names))
            asked = self.data.get("steps")
            if recorded is not None and isinstance(asked, int) and asked > len(recorded.timestamps):
                self.problems.append(f"steps: {asked} asked for, but the pose file has {len(recorded.timestamps)}")
            return recorded
        if keys is None or vessels is None:
            return None
        circular, tracks = keys.poses.circular, keys.poses.tracks
        steps, interval = keys.steps or 0, keys.time_step_s or 0.0
        if tracks is not None:
            return self._collect(lambda: waypoint_tracks(tracks, names or [], steps, interval))
        if circular is None:
            return None
        return self._collect(
            lambda: circular_motion(
                vessels,
                steps,
                interval,
                circular.centre_m,
                circular.radius_m,
                circular.rotation_rate_rad_s,
                keys.seed,
            )
        )

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

    def _check_places(self, scene: Scene) -> None:
        """Whether each camera has a place at each step, and no vessel around it."""
        found: set[str] = set()
        for first in range(0, scene.steps, CHECKED_STEPS):
            steps = np.arange(first, min(first + CHECKED_STEPS, scene.steps))
            for camera in scene.cameras:
                if camera.name in found:
                    continue
                try:
                    _check_place(scene, camera, steps)
                except InputError as error:
                    self.problems += error.problems
                    found.add(camera.name)

    def _copy(self, keys: SceneKeys, entries: dict[Any, Any]) -> SceneCopy:
        """The scene with every file that it names under a plain name beside it."""
        files = {f"detector{Path(keys.detector).suffix}": self.folder / keys.detector}
        document = {**self.data, "vessels": entries, "detector": next(iter(files))}
        if keys.poses.file is not None:
            name = f"poses.json{'.gz' if keys.poses.file.endswith('.gz') else ''}"
            files[name] = self.folder / keys.poses.file
            document["poses"] = {"file": name}
        if document.get("detector_seed") == keys.seed:
            del document["detector_seed"]  # says nothing
        # In one order, whether the caller or the file set a key; vessels and cameras keep theirs, which has a meaning.
        if isinstance(document.get("annotation"), dict):
            document["annotation"] = _ordered(document["annotation"], AnnotationKeys)
        return SceneCopy(self.path.stem, _ordered(document, SceneKeys), files)


def _ordered(keys: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """A section with its keys in the order of its model."""
    return {name: keys[name] for name in model.model_fields if name in keys}


def _check_place(scene: Scene, camera: Camera, steps: Indices) -> None:
    sight = scene.sight(camera, steps)
    inside = None if scene.annotation.allow_camera_inside else sight.vessel_around(scene.vessels)
    if inside is None:
        return
    frame, vessel = inside
    when = scene.poses.timestamps[int(steps[frame])]
    raise InputError(
        f"scene {scene.path}",
        [
            f"cameras.{camera.name}: is inside vessel '{scene.vessels[vessel].name}' at time {when} s: move one of "
            "them, or set annotation.allow_camera_inside: true"
        ],
    )


def _waves(keys: WavesKeys | None, seed: int) -> Waves | None:
    if keys is None or keys.level == "none":
        return None
    if keys.level is not None:
        axes = level_axes(keys.level)
    else:
        given = [getattr(keys, name) for name in AXES]
        roll, pitch, yaw = (Axis(**axis.model_dump()) if axis else Axis() for axis in given)
        axes = (roll, pitch, yaw)
    return Waves(SecondOrderWaves(axes, seed, keys.interval_s), keys.apply_to, keys.composition)


def _camera(name: str, keys: CameraKeys) -> Camera:
    intrinsics = Intrinsics.from_lens(
        keys.focal_length_m,
        keys.pixel_size_m,
        keys.principal_point_px,
        keys.image_size_px,
        keys.skew,
        keys.near_clip_m,
    )
    place = keys.mount or keys.pose
    values: Mapping[str, Any] = place.model_dump() if place is not None else {}
    return Camera(name, intrinsics, Mount(**values))
