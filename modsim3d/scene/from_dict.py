"""A scene from a mapping, with what a scene file names standing in it: vessels, poses as arrays, the detector."""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import content_of, detector_text, parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.io.validation import kind_of, shown
from modsim3d.scene.parts import SceneParts
from modsim3d.scene.reading import assembled
from modsim3d.scene.scene import Scene
from modsim3d.scene.settings import Setting, replacing
from modsim3d.world.poses.arrays import FILE, KEYS, ArrayKeys, pose_file
from modsim3d.world.poses.labelled import LABELS, GivenLabels, LabelledPoses, LabelsKeys
from modsim3d.world.poses.registry import NamedSource
from modsim3d.world.poses.replay import RecordedPoses

DETECTOR_FILE = "detector.yaml"  # the file in a copy of the scene that holds a detector from no file
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")


def scene_from_dict(
    data: Mapping[str, Any],
    *,
    name: str = "scene",
    seed: int | None = None,
    steps: int | None = None,
    mode: int | None = None,
    source: str | None = None,
    supersample: int | None = None,
    render: str | None = None,
    detector: object = None,
    detector_seed: int | None = None,
) -> Scene:
    """See `Scene.from_dict`."""
    if not isinstance(data, Mapping):
        raise InputError("scene", [f"a mapping of keys is needed (got {kind_of(data)})"])
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        problem = "it goes into file names: at most 100 letters, digits, '_' and '-', the first a letter or digit"
        raise InputError("scene", [f"name: {problem} (got {shown(name)})"])
    try:
        content = {_plain(key): _plain(value) for key, value in data.items() if key not in ("poses", "detector")}
        arrays = _arrays(content, data)
        inline = _inline(content, data.get("detector") if detector is None else detector)
    except RecursionError:
        raise InputError("scene", ["is nested too deeply"]) from None
    given = {"seed": seed, "steps": steps, "mode": mode, "source": source, "supersample": supersample, "render": render}
    settings = replacing({**given, "detector_seed": detector_seed})
    return assembled(_DictParts(name, content, arrays, inline, settings))


def _arrays(content: dict[str, Any], data: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The section `poses` if it has arrays or labels; otherwise the content gets it."""
    poses = data.get("poses")
    if isinstance(poses, Mapping) and isinstance(poses.get(LABELS), LabelledPoses):
        content["poses"] = {LABELS: {"file": FILE, **{key: entry for key, entry in poses.items() if key != LABELS}}}
        return poses
    if isinstance(poses, Mapping) and any(key in poses for key in KEYS):
        content["poses"] = {"file": FILE}
        return poses
    if "poses" in data:
        content["poses"] = _plain(poses)
    return None


def _inline(content: dict[str, Any], detector: object) -> object:
    """The detector if it is one or its content; None if it is a file, which the content gets."""
    if detector is None:
        return None  # validation of the keys reports it
    plain = detector if isinstance(detector, DetectorModel) else _plain(detector)
    content["detector"] = plain if isinstance(plain, str) else DETECTOR_FILE
    return None if isinstance(plain, str) else plain


def _plain(value: Any) -> Any:
    """A copy of a value as a YAML file would have it: NumPy's numbers and arrays are numbers and lists."""
    if isinstance(value, Mapping):
        return {_plain(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return value.item()
    return os.fspath(value) if isinstance(value, os.PathLike) else value


class _DictParts(SceneParts):
    """The parts of a scene that is in no file; paths in it are relative to the working directory."""

    def __init__(
        self,
        name: str,
        data: dict[str, Any],
        arrays: Mapping[str, Any] | None,
        detector: object,
        settings: Iterable[Setting],
    ) -> None:
        """Read all parts. `data` has plain values, and where something stands for a file, the file of the scene's copy.
        `arrays` is the section `poses` if it has arrays; `detector` is the content of a detector file or a detector
        that was read, None if `data` names a file."""
        self._arrays, self._inline = arrays, detector
        super().__init__(Path(name), data, settings)
        if isinstance(self.poses, LabelledPoses) and arrays is not None:
            self.contents[FILE] = arrays[LABELS].written()
        elif arrays is not None and isinstance(self.poses, RecordedPoses) and self.vessels is not None:
            poses, names = self.poses, [vessel.name for vessel in self.vessels]
            self._keep(FILE, lambda: pose_file(poses, names, self.name))

    def _keep(self, name: str, content: Callable[[], bytes]) -> None:
        if (written := self._collect(content)) is not None:
            self.contents[name] = written

    @property
    def read(self) -> tuple[Path, ...]:
        files = super().read[1:]
        return files if self._arrays is None else tuple(file for file in files if file != self.folder / FILE)

    def _detector(self) -> DetectorModel | None:
        content = self._inline
        if content is None:
            return super()._detector()
        if isinstance(content, DetectorModel) and (content := content_of(content)) is None:
            self.problems.append(
                "detector: was changed, or was not made by load_detector: give the content of its file as a mapping"
            )
            return None
        model = self._collect(lambda: parse_detector(content, "detector"))
        if model is not None and isinstance(content, dict):
            self._keep(DETECTOR_FILE, lambda: detector_text(content).encode())
        return model

    def _source(self) -> NamedSource | None:
        if self._arrays is None:
            return super()._source()
        if LABELS in self._arrays:
            source = super()._source()
            if source is None or not isinstance(source.keys, LabelsKeys):
                return None
            keys = source.keys.model_dump()
            return NamedSource(LABELS, GivenLabels(labels=self._arrays[LABELS], source=self.name, **keys), None)
        return NamedSource("file", ArrayKeys(self._arrays, self.name), None)
