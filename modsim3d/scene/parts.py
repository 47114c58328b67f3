"""The parts of a scene file and of the files that it names, each read by itself."""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import orjson
from pydantic import ValidationError

from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import shipped_detectors
from modsim3d.detector.model import DetectorModel
from modsim3d.io.plugins import Plugin
from modsim3d.io.validation import MAX_PROBLEMS, describe, join_path, nearest
from modsim3d.scene.keys import OF_LABELS, LabelledSceneKeys, LookKeys, ObstacleKeys, SceneKeys
from modsim3d.scene.lens import form_problems, resolved
from modsim3d.scene.settings import Setting, Settings
from modsim3d.world.bodies import Obstacle, extruded, placed
from modsim3d.world.mesh_reading import load_mesh, shipped_meshes
from modsim3d.world.poses.base import PoseRequest, PoseSource, SourceKeys
from modsim3d.world.poses.labelled import LABELS, REAL, LabelledPoses
from modsim3d.world.poses.registry import NamedSource, read_source
from modsim3d.world.poses.replay import LivePoses
from modsim3d.world.second_order_waves import Axes, find_level
from modsim3d.world.vessels import Solid, Vessel, find_shape, is_closed, load_mapping, parse_vessels


class SceneMeshes:
    """The meshes that a scene names. Equal entries of one folder share a solid, so that they are handled together."""

    def __init__(self) -> None:
        """Start without meshes."""
        self._solids: dict[bytes, Solid] = {}
        self.files: dict[str, Path] = {}
        """Path in a copy of the scene → original mesh file."""
        self.plugins: list[Plugin] = []
        """Plug-ins that gave shapes."""

    def solid(self, entry: object, folder: Path, source: str, *path: object) -> Solid:
        """The solid of an entry; see `load_mesh`. Raises InputError if the entry or the file is wrong."""
        key = orjson.dumps([str(folder), entry], default=str)
        if key not in self._solids:
            self._solids[key] = self._load(entry, folder, source, *path)
        return self._solids[key]

    def _load(self, entry: object, folder: Path, source: str, *path: object) -> Solid:
        if not isinstance(entry, str) or entry in shipped_meshes() or Path(entry).suffix:
            return load_mesh(entry, folder, source, *path)
        try:
            solid, plugin = find_shape(entry, join_path(*path), tuple(shipped_meshes()))
        except InputError as error:
            raise InputError(source, [f"{error.source}: {problem}" for problem in error.problems]) from error
        self.plugins.append(plugin)
        return replace(solid, convex=False, closed=is_closed(solid.faces))

    def copied(self, entry: object, folder: Path) -> object:
        """The entry as a copy of the scene has it, where meshes lie in a folder of their own."""
        file = entry.get("file") if isinstance(entry, dict) else entry
        if not isinstance(file, str):
            return entry
        if isinstance(entry, str) and entry in shipped_meshes():
            return self._name_of(shipped_meshes()[entry])
        if not Path(file).suffix:
            return entry  # a shape from a plug-in
        name = self._name_of(folder / file)
        return {**entry, "file": name} if isinstance(entry, dict) else name

    def copied_all(self, entries: Mapping[Any, Any], folder: Path) -> dict[Any, Any]:
        """Vessels or obstacles with the mesh names of a copy of the scene."""
        return {
            name: {**entry, "mesh": self.copied(entry["mesh"], folder)} if entry.get("mesh") else entry
            for name, entry in entries.items()
        }

    def _name_of(self, source: Path) -> str:
        """Name of a mesh file in the copy: its own unless that is taken, so that a copy of the copy has the same."""
        name, number = f"meshes/{source.name}", 0
        while self.files.setdefault(name, source) != source:
            number += 1
            name = f"meshes/{number}_{source.name}"
        return name


def mesh_name(entry: object) -> str:
    """The name of the mesh of an entry, without folder and ending: the same in a scene and in its copy."""
    return Path(str(entry.get("file", "") if isinstance(entry, dict) else entry)).stem


def read_obstacle(name: str, keys: ObstacleKeys, meshes: SceneMeshes, folder: Path, scene: str) -> Obstacle:
    """An obstacle of a scene file in a folder, whose mesh is added to those of the scene. Raises InputError if the name
    is not printable, or the mesh cannot be read."""
    where = join_path("obstacles", name)
    if not name or not name.isprintable():
        raise InputError(scene, [f"{where}: an obstacle's name must be printable text (got {name!r})"])
    if keys.polygon_m is not None:
        return Obstacle(name, extruded(np.array(keys.polygon_m), keys.base_m, keys.height_m or 0.0))
    solid = meshes.solid(keys.mesh, folder, scene, "obstacles", name, "mesh")
    return Obstacle(name, (placed(solid, np.array(keys.size_m), np.array(keys.position_m), keys.heading_rad),))


MAX_NAMES = 3


def drawn_vessels(
    source: NamedSource, request: PoseRequest, labels: Sequence[str] | None, meshes: SceneMeshes
) -> tuple[Vessel, ...]:
    """The vessels that a pose source draws for a scene, in its order; most sources draw none. Their meshes are added to
    the scene's. `labels` are the detector's, None if not known. Raises InputError with every problem found; each begins
    with the source's section of the scene file."""
    entries = source.vessels(request)
    if not entries:
        return ()
    section = f"poses.{source.name}"
    vessels = parse_vessels(entries, section)
    # A source of our own and any plug-in may have a key that renames labels.
    key = f": set {section}.labels" if "labels" in getattr(type(source.keys), "model_fields", {}) else ""
    problems = [
        f"draws a vessel '{vessel.name}', and the scene's vessels have one of this name: rename one of them"
        for vessel in vessels
        if vessel.name in (request.names or ())
    ]
    problems += [problem + key for problem in _label_problems(vessels, labels)]
    problems += _file_problems(entries, source.keys.files)
    if problems:
        raise InputError(section, problems[:MAX_PROBLEMS])
    return tuple(_with_mesh(vessel, entries[vessel.name].get("mesh"), request, meshes, section) for vessel in vessels)


def _with_mesh(vessel: Vessel, mesh: object, request: PoseRequest, meshes: SceneMeshes, section: str) -> Vessel:
    if mesh is None:
        return vessel
    solid = meshes.solid(mesh, request.folder, section, vessel.name, "mesh")
    return replace(vessel, solid=solid, shape=mesh_name(mesh))


def _label_problems(vessels: Sequence[Vessel], labels: Sequence[str] | None) -> Iterator[str]:
    """One problem for each label that the detector does not have."""
    if labels is None:
        return
    for label in dict.fromkeys(vessel.label for vessel in vessels if vessel.label not in labels):
        names = [vessel.name for vessel in vessels if vessel.label == label]
        more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        yield (
            f"draws vessels with the label '{label}' ({', '.join(names[:MAX_NAMES])}{more}), which is not one of the "
            f"detector's labels ({nearest(label, labels)})"
        )


def _file_problems(entries: Mapping[str, Mapping[str, object]], files: Sequence[str]) -> Iterator[str]:
    """A copy of the scene has the files that the source names, and no others."""
    for name, entry in entries.items():
        mesh = entry.get("mesh")
        file = mesh.get("file") if isinstance(mesh, dict) else mesh
        if isinstance(file, str) and Path(file).suffix and file not in files:
            yield f"draws '{name}' with the mesh {file}, which is none of the files of the source: {list(files)}"


OTHER_FILES = {
    "trackers": "this is a campaign: modsim3d campaign run takes it",
    "states": "this is a detector: a scene names it under detector, and --detector gives it in place of the scene's",
}
"""What a file with a key is that is no scene."""
T = TypeVar("T")

SCENE_FILE = "scene.yaml"  # a scene in a file of this name is called as its folder is
NO_FILE = Path("scene")  # the path of a scene that is in no file and has no name
CAMERA_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


def title_of(path: Path) -> str:
    """Name of a scene in errors."""
    return "scene" if path == NO_FILE else f"scene {path}"


@dataclass(frozen=True)
class _Location:
    """Place of the mapping of vessels: the file that holds it, for errors; the keys that lead to it in that file; and
    the folder that paths in it are relative to."""

    source: str
    path: tuple[str, ...]
    folder: Path


class SceneParts:
    """The parts of a scene, and everything that is wrong with each. A part that is wrong is None; the others are read
    all the same, so that the user sees every problem at once."""

    def __init__(self, path: Path, data: dict[str, Any], settings: Iterable[Setting] = ()) -> None:
        """Read all parts."""
        self.path, self.settings = path, Settings(settings)
        self.data = self.settings.in_scene(data)  # content of the scene file with what the caller sets
        if self.labelled:
            annotation = self.data.get("annotation") or {}
            self.data = {"vessels": {}, "cameras": {}, **self.data}
            self.data["annotation"] = {**OF_LABELS, **annotation} if isinstance(annotation, dict) else annotation
        self.changed_detector: dict[str, Any] | None = None  # the detector file's with that; None if none is for it
        self.contents: dict[str, bytes] = {}  # path in a copy of the scene → content, of what stands for a file
        self.folder = path.resolve().parent
        self.problems: list[str] = []  # every problem, one line each
        self.meshes = SceneMeshes()
        self.calibrations: list[Path] = []  # files that cameras name
        self.keys = self._keys()
        self.vessels_at = self._vessels_at()
        self.vessel_entries = self._vessel_entries()  # as in their file
        self.source = self._source()
        boxes = self._boxes()
        self.detector = self._detector()
        self.problems += islice(self._mount_problems(), MAX_PROBLEMS)
        self.problems += islice(self._label_problems(), MAX_PROBLEMS)
        self.looks = self._looks()
        self.obstacles = self._obstacles()
        drawn = self._drawn(boxes)
        self.poses = self._poses(boxes, drawn)
        self.wave_level = self._wave_level()
        # Those of the scene file, then those that the pose source draws.
        self.vessels = None if boxes is None else (*map(self._with_mesh, boxes), *(drawn or ()))
        if isinstance(self.poses, LabelledPoses):
            self.vessels = self.poses.as_vessels
            self.problems += self._labelled_problems(self.vessels)
        self.problems = self.settings.problems + self.settings.named(self.problems)

    @property
    def scene_name(self) -> str:
        """The name of the file, or that of its folder if the file is `scene.yaml`."""
        return (self.path.absolute().parent.name if self.path.name == SCENE_FILE else "") or self.path.stem

    @property
    def name(self) -> str:
        """Name of the scene in errors."""
        return title_of(self.path)

    @property
    def read(self) -> tuple[Path, ...]:
        """The scene file, and the files of vessels and poses that it names."""
        entry, files = self.data.get("vessels"), self.source.keys.files if self.source else ()
        named = (self.folder / file for file in ([entry] if isinstance(entry, str) else []) + [*files])
        return (self.path, *named, *self.calibrations)

    @property
    def labelled(self) -> bool:
        """Whether its truth is labels of videos."""
        poses = self.data.get("poses")
        return isinstance(poses, dict) and LABELS in poses

    @property
    def draws_vessels(self) -> bool:
        """Whether its pose source draws vessels beside those of the scene file."""
        return self.source is not None and type(self.source.keys).vessels is not SourceKeys.vessels

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """The plug-ins that parts came from: of poses, waves and shapes."""
        source, level = self.source and self.source.plugin, self.wave_level and self.wave_level[1]
        return tuple(plugin for plugin in (source, level, *self.meshes.plugins) if plugin)

    def _collect(self, read: Callable[[], T]) -> T | None:
        """Result of `read`; if that fails, its problems are kept and None is returned."""
        try:
            return read()
        except InputError as error:
            here = error.source == self.name
            self.problems += [
                problem if here or problem.startswith(error.source) else f"{error.source}: {problem}"
                for problem in error.problems
            ]
            return None

    def _keys(self) -> SceneKeys | None:
        cameras = self.data.get("cameras")
        if wrong := [hint for key, hint in OTHER_FILES.items() if key in self.data and "poses" not in self.data]:
            self.problems += wrong
            return None
        model = LabelledSceneKeys if self.labelled else SceneKeys
        if isinstance(cameras, dict):
            if not cameras and not self.labelled:
                self.problems.append("cameras: no cameras; a scene needs at least one")
            self.problems += [
                f"cameras.{name}: a camera's name goes into file names: at most 100 letters, digits, '_', '-' and '.' "
                "only, the first a letter or digit"
                for name in cameras
                if not CAMERA_NAME.fullmatch(str(name))
            ]
            given = [(name, camera) for name, camera in cameras.items() if isinstance(camera, dict)]
            problems = [f"cameras.{name}{problem}" for name, camera in given for problem in form_problems(camera)]
            self.problems += problems[:MAX_PROBLEMS]
            if len(problems) > MAX_PROBLEMS:
                self.problems.append(f"… and {len(problems) - MAX_PROBLEMS:,} more problems in cameras")
        keys = self._validated(model)
        return keys if self.problems or keys is None else self._with_lenses(keys)

    def _validated(self, model: type[SceneKeys]) -> SceneKeys | None:
        try:
            return model.model_validate(self.data)
        except ValidationError as error:
            self.problems += [problem.removeprefix(": ") for problem in describe(error, model)]
            return None

    def _with_lenses(self, keys: SceneKeys) -> SceneKeys | None:
        """The keys, with cameras in the one form that a copy of the scene has, which the data get too."""
        given, cameras = self.data["cameras"], {}
        for name, camera in keys.cameras.items():
            if camera.calibration is not None:
                self.calibrations.append(self.folder / camera.calibration)
            cameras[name] = self._collect(partial(resolved, name, given[name], camera, self.folder))
        if self.problems or cameras == given:
            return None if self.problems else keys
        self.data = {**self.data, "cameras": cameras}
        return self._validated(type(keys))

    def _vessels_at(self) -> _Location:
        entry = self.data.get("vessels")
        if isinstance(entry, str):
            file = self.folder / entry
            return _Location(f"vessels file {file}", (), file.parent)
        return _Location(self.name, ("vessels",), self.folder)

    def _vessel_entries(self) -> dict[Any, Any] | None:
        entry = self.data.get("vessels")
        if isinstance(entry, str):
            read = partial(load_mapping, self.folder / entry)
            return self._collect(lambda: self.settings.in_file("vessels", read(), self.vessels_at.source))
        return entry if isinstance(entry, dict) else None  # validation of the keys reports it

    def _boxes(self) -> tuple[Vessel, ...] | None:
        entries, place = self.vessel_entries, self.vessels_at
        if entries == {} and (self.draws_vessels or self.labelled):
            return ()
        return None if entries is None else self._collect(lambda: parse_vessels(entries, place.source, *place.path))

    def _with_mesh(self, vessel: Vessel) -> Vessel:
        entry, place = (self.vessel_entries or {}).get(vessel.name, {}).get("mesh"), self.vessels_at
        if entry is None:
            return vessel
        read = partial(self.meshes.solid, entry, place.folder, place.source, *place.path, vessel.name, "mesh")
        solid = self._collect(read)
        return vessel if solid is None else replace(vessel, solid=solid, shape=mesh_name(entry))

    def _obstacles(self) -> tuple[Obstacle, ...]:
        if self.keys is None:
            return ()
        obstacles = []
        for name, entry in self.keys.obstacles.items():
            read = partial(read_obstacle, name, entry, self.meshes, self.folder, self.name)
            obstacles.append(self._collect(read))
        return tuple(obstacle for obstacle in obstacles if obstacle is not None)

    def _detector(self) -> DetectorModel | None:
        entry = self.data.get("detector")
        return self._collect(lambda: self._read_detector(self.detector_file(entry))) if isinstance(entry, str) else None

    def detector_file(self, entry: str) -> Path:
        """The file that the scene's key `detector` stands for: a path from the scene's folder, or a shipped name."""
        file = self.folder / entry
        return shipped_detectors().get(entry, file) if not os.path.lexists(file) else file

    def _read_detector(self, file: Path) -> DetectorModel:
        try:
            self.changed_detector, model = self.settings.detector_of(file)
        except InputError as error:
            if file.suffix or error.problems != ("no such file",):
                raise
            hint = nearest(file.name, shipped_detectors())
            raise InputError(error.source, [f"no such file, and no shipped detector has this name ({hint})"]) from None
        return model

    def _source(self) -> NamedSource | None:
        """The keys of the pose source; None for one that needs the scene's times, where the scene gives none."""
        entry = self.data.get("poses")
        if not isinstance(entry, dict) or not all(isinstance(name, str) for name in entry):
            return None  # validation of the keys reports it
        source = self._collect(lambda: read_source(entry, self.name))
        missing = [key for key in ("steps", "time_step_s") if self.data.get(key) is None]
        if source is not None and source.keys.generated and missing:
            needed = " and ".join(missing)
            self.problems.append(f"poses: {source.name} has no times of its own: give {needed} beside it")
            return None
        return source

    def _request(self, vessels: tuple[Vessel, ...] | None) -> PoseRequest:
        keys, names = self.keys, self.vessel_entries
        return PoseRequest(
            folder=self.folder,
            # Names of all entries, so that one wrong vessel does not keep the poses from being checked.
            names=None if names is None else tuple(map(str, names)),
            vessels=vessels or (),
            steps=keys.steps if keys else None,
            time_step_s=keys.time_step_s if keys else None,
            seed=keys.seed if keys else 0,
            obstacles=self.obstacles,
        )

    def _drawn(self, vessels: tuple[Vessel, ...] | None) -> tuple[Vessel, ...] | None:
        """The vessels that the pose source draws; None if it cannot."""
        source = self.source
        if source is None or not self.draws_vessels:
            return ()
        if vessels is None or self.keys is None:
            return None
        request, labels = self._request(vessels), self.detector.labels if self.detector else None
        drawn = self._collect(lambda: drawn_vessels(source, request, labels, self.meshes))
        if drawn is not None and not (vessels or drawn):
            self.problems.append(
                f"poses.{source.name}: draws no vessel from seed {self.keys.seed}, and vessels has none: a scene needs "
                "at least one"
            )
        return drawn

    def _poses(self, vessels: tuple[Vessel, ...] | None, drawn: tuple[Vessel, ...] | None) -> PoseSource | None:
        source = self.source
        if source is None or drawn is None or (source.keys.generated and (self.keys is None or vessels is None)):
            return None
        request = self._request(vessels)
        if drawn:
            names = (*(request.names or ()), *(vessel.name for vessel in drawn))
            request = replace(request, names=names, vessels=(*request.vessels, *drawn))
        poses = self._collect(lambda: source.build(request))
        if poses is None or isinstance(poses, LivePoses):
            return poses
        steps, available = self.data.get("steps"), len(poses.timestamps)
        if isinstance(steps, int) and steps > available:
            name = "the pose file" if source.name == "file" else f"poses.{source.name}"
            self.problems.append(f"steps: {steps} asked for, but {name} has {available}")
        return poses

    def _labelled_problems(self, vessels: Sequence[Vessel]) -> Iterator[str]:
        real = isinstance(self.poses, LabelledPoses) and self.poses.detections is not None
        if real and self.detector is not None and [state.name for state in self.detector.states] != [REAL]:
            yield (
                f"poses.{LABELS}: has the detections of a real detector, and a detector is given: with "
                f"poses.{LABELS}.simulated: true it works on the labels"
            )
            return
        labels = [vessel.label for vessel in vessels] if self.detector is None else self.detector.labels
        for label in dict.fromkeys(vessel.label for vessel in vessels if vessel.label not in labels):
            yield f"poses.{LABELS}: '{label}' is not one of the detector's labels ({nearest(label, labels)})"

    def _wave_level(self) -> tuple[Axes, Plugin | None] | None:
        waves = self.data.get("waves")
        level = waves.get("level") if isinstance(waves, dict) else None
        return self._collect(lambda: find_level(level)) if isinstance(level, str) else None

    def _mount_problems(self) -> Iterator[str]:
        cameras, names = self.data.get("cameras"), {str(name): None for name in self.vessel_entries or ()}
        named = bool(names) or (self.vessel_entries is not None and self.draws_vessels)
        for name, camera in cameras.items() if named and isinstance(cameras, dict) else ():
            mount = camera.get("mount") if isinstance(camera, dict) else None
            vessel = mount.get("vessel") if isinstance(mount, dict) else None
            if isinstance(vessel, str) and vessel not in names:
                yield f"cameras.{name}.mount.vessel: no vessel '{vessel}' ({nearest(vessel, names)})"

    def _vessel_labels(self) -> Iterator[tuple[Any, str]]:
        for name, entry in (self.vessel_entries or {}).items():
            if isinstance(entry, dict) and isinstance(entry.get("label"), str):
                yield name, entry["label"]

    def _looks(self) -> dict[str, LookKeys]:
        """The looks of the detector's states; in a scene whose detector is replaced, others are of its own states."""
        looks = self.keys.looks if self.keys and self.detector else {}
        states = [state.name for state in self.detector.states] if self.detector else []
        if not self.settings.sets("detector"):
            self.problems += [
                f"looks.{name}: no state '{name}' ({nearest(name, states)})" for name in looks if name not in states
            ]
        return {name: look for name, look in looks.items() if name in states}

    def _label_problems(self) -> Iterator[str]:
        if self.detector is None:
            return
        labels, place = self.detector.labels, self.vessels_at
        unknown = sorted({label for _, label in self._vessel_labels() if label not in labels})
        if unknown and (option := self.settings.option_of("detector")):
            yield (
                f"{option}: this detector has the labels {', '.join(labels)}, and the scene's vessels have "
                f"{', '.join(unknown)}. To change the scene's own detector as much as two conditions differ, use "
                "modsim3d learn --from-condition"
            )
            return
        where = "" if place.path else f"{place.source}: "
        for name, label in self._vessel_labels():
            if label not in labels:
                yield (
                    f"{where}{join_path(*place.path, str(name))}.label: '{label}' is not one of the detector's labels "
                    f"({nearest(label, labels)})"
                )
