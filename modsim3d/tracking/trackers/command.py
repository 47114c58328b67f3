"""A program as a tracker: lines of JSON to its standard input, one line back for each. docs/tracker_command.md has
them, and tracker_command.json of `modsim3d.plugins`."""

import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import orjson
from pydantic import Field, ValidationError

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.formats.writing.csv import rounded
from modsim3d.io.coprocess import Coprocess, quote
from modsim3d.io.input_files import file_sha256
from modsim3d.io.validation import NeedText, Number, Probability, Strict, describe
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stream_lines import header_of
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.interface import TrackedFrame
from modsim3d.tracking.trackers.world_input import facts_of, world_steps
from modsim3d.tracking.trackers.world_interface import AisReport, Navigation, WorldFrame, WorldStep, WorldTrackedStep

PROTOCOL = 1
DEFAULT_TIMEOUT_S = 30.0
CHECKSUM = "sha256 "  # before the checksum of a file, among the versions of what decides tracks
UNITS = {"length": "m", "angle": "rad", "time": "s", "box": "px"}


class CommandTracker(Strict):
    """A program that is run anew for each run."""

    command: tuple[str, ...]  # its name and arguments
    folder: Path  # in which it is started
    timeout_s: float = DEFAULT_TIMEOUT_S  # for each answer
    settings: dict[str, Any] = Field(default_factory=dict)  # that it is given
    files: tuple[str, ...] = ()  # that decide what it does, beside its own

    @property
    def program(self) -> str:
        """The file that is run. Raises InputError if there is none, or it may not be run."""
        name = self.command[0] if self.command else ""
        path = str(self.folder / name) if "/" in name else name
        if (binary := shutil.which(path)) is not None:
            return str(Path(binary).absolute())
        place = Path(path)
        problem = "is not a program that may be run: chmod +x" if place.is_file() else "there is no such program"
        raise InputError("--command", [f"command: '{name}': {problem}"])

    def paths(self) -> dict[str, Path]:
        """The program's file and the others by their names. Raises as `program` does, and if one is not there."""
        program = Path(self.program)
        paths = {self.command[0]: program, **{name: self.folder / name for name in self.files}}
        if missing := [name for name, path in paths.items() if not path.is_file()]:
            raise InputError("--command", [f"files: '{missing[0]}': no such file in {self.folder}"])
        return paths

    def checksums(self) -> dict[str, str]:
        """SHA-256 of these files."""
        return {name: f"{CHECKSUM}{file_sha256(path)}" for name, path in self.paths().items()}


RUNS_OTHERS = re.compile(
    r"(ba|da|k|z)?sh|(python|pypy)[0-9.]*|perl|ruby|node|java|julia|Rscript|lua|php|env|timeout|nice"
)
"""Names of programs that run what their arguments name."""


def argument_files(command: Sequence[str], folder: Path) -> list[str]:
    """The files that are there among the arguments of a program, also after an equals sign."""
    names = dict.fromkeys(argument.rpartition("=")[2] for argument in command[1:])
    return [name for name in names if os.path.isfile(folder / name)]  # noqa: PTH113 (which raises for what is too long)


TrackNumber = Annotated[int, Field(strict=True, ge=-(2**63), lt=2**63)]
Two = tuple[Number, Number]
Four = tuple[Number, Number, Number, Number]


class Choice(Strict):
    """The answer to the first line: what it is given a line for, and where its tracks are."""

    answers: Literal["frames", "steps"]
    tracks: Literal["image", "world"]


class ImageTrack(Strict):
    """A track in an image."""

    track: TrackNumber
    box_px: Four
    camera: str | None = None  # of the image, where lines are of steps
    label: str | None = None
    confidence: Probability | None = None
    covariance_px2: tuple[Two, Two] | None = None


_COVARIANCE = NeedText("2 rows of 2 numbers (of the position), or 4 of 4 (and the velocity) are needed")


class WorldTrack(Strict):
    """A track in the world."""

    track: TrackNumber
    position_m: Two
    velocity_m_s: Two | None = None
    covariance: Annotated[tuple[Two, Two] | tuple[Four, Four, Four, Four] | None, _COVARIANCE] = None


class ImageAnswer(Strict):
    """The answer to a line, with tracks in images."""

    step: Annotated[int, Field(strict=True)]
    camera: str | None = None  # that of a frame
    tracks: tuple[ImageTrack, ...]


class WorldAnswer(ImageAnswer):
    """The answer to a line, with tracks in the world."""

    tracks: tuple[WorldTrack, ...]  # type: ignore[assignment]


def parsed(model: type[Any], line: bytes) -> Any:
    """A line of a program. Raises ModsimError if it is no such answer."""
    try:
        return model.model_validate_json(line)
    except ValidationError as error:
        problems, first = describe(error, model), error.errors()[0]
        if first["type"] == "json_invalid":
            problems = [f"this is no JSON: {first['ctx']['error'].replace(' at line 1', ' at')}"]
        if not line.lstrip().startswith(b"{"):
            problems = ["a line of JSON is needed"]
        raise ModsimError(f"it answered {quote(line)}: {'; '.join(problems[:3])}") from None


def image_frames(answer: ImageAnswer, cameras: Sequence[str], labels: Sequence[str]) -> dict[str, TrackedFrame]:
    """The tracks in the image of each camera of a line. Raises ModsimError for an unknown label or camera."""
    parts: dict[str, list[ImageTrack]] = {name: [] for name in cameras}
    for track in answer.tracks:
        if track.label is not None and track.label not in labels:
            raise ModsimError(f"track {track.track}: there is no label '{track.label}'")
        if (name := answer.camera if track.camera is None else track.camera) not in parts:
            raise ModsimError(f"track {track.track}: its camera must be {' or '.join(cameras)}, not '{name}'")
        parts[name].append(track)
    return {name: _image_frame(tracks, labels) for name, tracks in parts.items()}


def _image_frame(tracks: Sequence[ImageTrack], labels: Sequence[str]) -> TrackedFrame:
    unknown = ((np.nan, np.nan), (np.nan, np.nan))
    return TrackedFrame(
        np.array([track.track for track in tracks], dtype=np.int64),
        np.array([track.box_px for track in tracks], dtype=np.float64).reshape(-1, 4),
        np.array([-1 if track.label is None else labels.index(track.label) for track in tracks], dtype=np.int64),
        np.array([np.nan if track.confidence is None else track.confidence for track in tracks]),
        np.array([track.covariance_px2 or unknown for track in tracks]).reshape(-1, 2, 2),
    )


def world_step_of(tracks: Sequence[WorldTrack]) -> WorldTrackedStep:
    """The tracks at one step."""
    covariance = np.full((len(tracks), 4, 4), np.nan)
    for place, track in enumerate(tracks):
        if track.covariance is not None:
            side = len(track.covariance)
            covariance[place, :side, :side] = track.covariance
    return WorldTrackedStep(
        np.array([track.track for track in tracks], dtype=np.int64),
        np.array([track.position_m for track in tracks], dtype=np.float64).reshape(-1, 2),
        np.array([track.velocity_m_s or (np.nan, np.nan) for track in tracks]).reshape(-1, 2),
        covariance,
    )


def header(scene: Scene, settings: Mapping[str, Any]) -> bytes:
    """The first line: that of a stream, with more of the scene, the settings and the units."""
    facts = facts_of(scene)
    origin = None if facts.origin is None else dict(zip(("latitude_deg", "longitude_deg"), facts.origin, strict=True))
    more = {"sea": facts.sea, "origin": origin, "own_ships": facts.own_ships, "settings": settings, "units": UNITS}
    return _line({"protocol": PROTOCOL, **header_of(scene), **more})


def lines_of(
    moment: WorldStep, scene: Scene, choice: Choice, ais: list[AisReport]
) -> Iterator[tuple[str | None, bytes]]:
    """The line of a step, with None; or the line of each frame, that of a stream, with its camera. In the world they
    have places, own ships and AIS too: reports that have arrived go into the first line, and are taken off `ais`."""
    world, when = choice.tracks == "world", {"time_s": moment.time_s, "step": moment.step}
    carriers = {camera.name: camera.mount.vessel for camera in scene.cameras}
    attitudes = {reading.vessel: {"attitude_rad": reading.attitude_rad} for reading in moment.navigation}
    lines = list[tuple[str | None, dict[str, Any]]]()
    frames = []
    for frame in moment.frames:
        attitude = attitudes.get(carriers[frame.camera] or "", {})
        place = {"position_m": rounded(frame.position_m)} if world else {}
        detections = {"detections": _detections(frame, scene.detector.labels, world)}
        first = {"camera": frame.camera, "frames_in_step": len(moment.frames)}
        lines.append((frame.camera, {**first, **attitude, **when, **place, **detections}))
        frames.append({"camera": frame.camera, **attitude, **place, **detections})
    if choice.answers == "steps":
        lines = [(None, {**when, "frames": frames})] if frames or world else []
    for camera, content in lines:
        if world:
            own = {reading.vessel: _fields(reading, "vessel") for reading in moment.navigation}
            content |= {"ais": [_fields(report) for report in ais], "own_ships": own}
            ais.clear()
        yield camera, _line(content)


_LOCATED = (
    *("bearing_rad", "bearing_std_rad", "inverse_range_per_m", "inverse_range_std_per_m", "covariance_rad_per_m"),
    *("position_m", "position_covariance_m2"),
)
"""Keys of the fields of `Locations`, in their order."""


def _detections(frame: WorldFrame, labels: Sequence[str], world: bool) -> list[dict[str, Any]]:
    sensed, keys = frame.sensed, ("box_px", "label", "confidence", *(_LOCATED if world else ()))
    located = [_finite_items(rounded(value)) for value in vars(frame.located).values()] if world else []
    named = [labels[label] for label in sensed.label.tolist()]
    rows = zip(sensed.boxes_px.tolist(), named, sensed.confidence.tolist(), *located, strict=True)
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _finite_items(values: Array) -> list[Any]:
    """A list of n things, with None for those that are not wholly known."""
    return [row if np.isfinite(row).all() else None for row in values.tolist()]


def _fields(values: AisReport | Navigation, but: str = "") -> dict[str, Any]:
    content = {key: value for key, value in vars(values).items() if value is not None and key != but}
    return {key: rounded(value) if isinstance(value, np.ndarray) else value for key, value in content.items()}


def _line(content: Mapping[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS) + b"\n"


class Exchange:
    """A program at work on a run."""

    def __init__(self, program: Coprocess, rows: RunRows) -> None:
        """Say nothing yet."""
        self._program, self._rows = program, rows
        self.seconds: list[float] = []  # its time for each line so far, but the first
        self.at = "at its start"  # where it is, for errors

    def tracks(
        self, settings: Mapping[str, Any], progress: Callable[[int], None]
    ) -> list[WorldTrackedStep] | dict[str, list[TrackedFrame]]:
        """Its tracks at each step, the last answer of several frames; or in the images of each camera, by its name.
        Raises ModsimError if it fails, or answers what is wrong."""
        scene, ais = self._rows.scene, list[AisReport]()
        choice: Choice = self._ask(Choice, header(scene, settings))
        self.seconds.clear()
        world, labels = choice.tracks == "world", scene.detector.labels
        steps, images = list[WorldTrackedStep](), {camera.name: list[TrackedFrame]() for camera in scene.cameras}
        for moment in world_steps(self._rows, bare=not world):
            ais += moment.ais
            step = WorldTrackedStep.empty()
            for camera, line in lines_of(moment, scene, choice, ais):
                self.at = ("" if camera is None else f"camera '{camera}' ") + f"at {moment.time_s:g} s"
                answer = self._answer(WorldAnswer if world else ImageAnswer, line, moment.step, camera)
                if world:
                    step = world_step_of(answer.tracks)
                    continue
                names = [frame.camera for frame in moment.frames] if camera is None else [camera]
                for name, frame in image_frames(answer, names, labels).items():
                    images[name].append(frame)
            steps.append(step)
            progress(len(moment.frames))
        self.at = "at its end"
        self._program.finish()
        return steps if world else images

    def _answer(self, model: type[Any], line: bytes, step: int, camera: str | None) -> Any:
        answer = self._ask(model, line)
        if (answer.step, answer.camera) != (step, camera):
            reply, given = (_name(*pair) for pair in ((answer.step, answer.camera), (step, camera)))
            raise ModsimError(f"it answered {reply}, and was given {given}")
        return answer

    def _ask(self, model: type[Any], line: bytes) -> Any:
        answer = self._program.ask(line)
        self.seconds.append(self._program.seconds)
        return parsed(model, answer)


def _name(step: int, camera: str | None) -> str:
    return f"step {step}" + ("" if camera is None else f" of camera '{camera}'")
