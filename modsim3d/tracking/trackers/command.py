"""A program as a tracker: lines of JSON to its standard input, one line back for each. docs/tracker_command.md has
them, and tracker_command.schema.json beside this file."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import numpy as np
import orjson
from pydantic import Field, ValidationError

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.random_streams import Streams
from modsim3d.formats.writing.csv import rounded
from modsim3d.io.coprocess import Coprocess, shown_line
from modsim3d.io.input_files import file_sha256
from modsim3d.io.validation import Number, Probability, Strict, describe
from modsim3d.runs.camera_sequences import CameraSequence
from modsim3d.runs.locating import Located
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.streaming.lines import attitudes_of, header_of, with_camera
from modsim3d.runs.tracker_view import detection_lines
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.interface import TrackedFrame
from modsim3d.tracking.trackers.world_input import facts_of, world_steps
from modsim3d.tracking.trackers.world_interface import AisReport, Navigation, WorldFrame, WorldStep, WorldTrackedStep

PROTOCOL = 1
DEFAULT_TIMEOUT_S = 30.0
CHECKSUM = "sha256 "
"""Before the checksum of a file, among the versions of what decides tracks."""
UNITS = {"length": "m", "angle": "rad", "time": "s", "box": "px"}


class CommandTracker(Strict):
    """A program that is run anew for each run."""

    command: tuple[str, ...]  # its name and arguments
    folder: Path  # in which it is started
    timeout_s: float = DEFAULT_TIMEOUT_S  # for each answer
    settings: dict[str, Any] = Field(default_factory=dict)  # that it is given

    @property
    def program(self) -> str:
        """The file that is run. Raises InputError if there is none, or it may not be run."""
        name = self.command[0] if self.command else ""
        path = str(self.folder / name) if "/" in name else name
        if (found := shutil.which(path)) is not None:
            return str(Path(found).absolute())
        place = Path(path)
        problem = "is not a program that may be run: chmod +x" if place.is_file() else "there is no such program"
        raise InputError("--command", [f"command: '{name}': {problem}"])

    def files(self) -> dict[str, Path]:
        """The program's file, and those among its arguments, by their names there. Raises as `program` does."""
        found = {self.command[0]: Path(self.program)}
        for each in self.command[1:]:
            path = self.folder / each.rpartition("=")[2]
            try:
                if path.is_file():
                    found[each] = path
            except OSError:  # too long for a name
                continue
        return found

    def checksums(self) -> dict[str, str]:
        """SHA-256 of these files."""
        return {name: f"{CHECKSUM}{file_sha256(path)}" for name, path in self.files().items()}


# ---- What a program answers ----

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


class WorldTrack(Strict):
    """A track in the world."""

    track: TrackNumber
    position_m: Two
    velocity_m_s: Two | None = None
    covariance: tuple[Two, Two] | tuple[Four, Four, Four, Four] | None = None


class ImageAnswer(Strict):
    """The answer to a line, with tracks in images."""

    step: int
    camera: str | None = None
    tracks: tuple[ImageTrack, ...]


class WorldAnswer(Strict):
    """The answer to a line, with tracks in the world."""

    step: int
    camera: str | None = None
    tracks: tuple[WorldTrack, ...]


def parsed(model: type[Any], line: bytes) -> Any:
    """A line of a program. Raises ModsimError if it is no such answer."""
    try:
        return model.model_validate_json(line)
    except ValidationError as error:
        problems = describe(error, model) if line.lstrip().startswith(b"{") else ["a line of JSON is needed"]
        raise ModsimError(f"it answered {shown_line(line)}: {'; '.join(problems[:3])}") from None


def image_frame(tracks: Sequence[ImageTrack], labels: Sequence[str]) -> TrackedFrame:
    """The tracks in one image. Raises ModsimError for a label that there is not."""
    for each in tracks:
        if each.label is not None and each.label not in labels:
            raise ModsimError(f"track {each.track}: there is no label '{each.label}'")
    unknown = ((np.nan, np.nan), (np.nan, np.nan))
    return TrackedFrame(
        np.array([each.track for each in tracks], dtype=np.int64),
        np.array([each.box_px for each in tracks], dtype=np.float64).reshape(-1, 4),
        np.array([-1 if each.label is None else labels.index(each.label) for each in tracks], dtype=np.int64),
        np.array([np.nan if each.confidence is None else each.confidence for each in tracks]),
        np.array([each.covariance_px2 or unknown for each in tracks]).reshape(-1, 2, 2),
    )


def world_step_of(tracks: Sequence[WorldTrack]) -> WorldTrackedStep:
    """The tracks at one step."""
    covariance = np.full((len(tracks), 4, 4), np.nan)
    for place, each in enumerate(tracks):
        if each.covariance is not None:
            side = len(each.covariance)
            covariance[place, :side, :side] = each.covariance
    return WorldTrackedStep(
        np.array([each.track for each in tracks], dtype=np.int64),
        np.array([each.position_m for each in tracks], dtype=np.float64).reshape(-1, 2),
        np.array([each.velocity_m_s or (np.nan, np.nan) for each in tracks]).reshape(-1, 2),
        covariance,
    )


# ---- What a program is told ----


def header(scene: Scene, settings: Mapping[str, Any]) -> bytes:
    """The first line: that of a stream, with more of the scene, the settings and the units."""
    facts = facts_of(scene)
    origin = None if facts.origin is None else dict(zip(("latitude_deg", "longitude_deg"), facts.origin, strict=True))
    more = {"sea": facts.sea, "origin": origin, "own_ships": facts.own_ships, "settings": settings, "units": UNITS}
    return _line({"protocol": PROTOCOL, **header_of(scene), **more})


def frame_lines(scene: Scene, steps: int, sequences: Sequence[CameraSequence]) -> list[dict[int, bytes]]:
    """The lines of the frames of each sequence by their steps: those of a stream."""
    attitudes, taken = attitudes_of(scene, Streams(scene.seed), 0, steps), Counter[int]()
    for each in sequences:
        taken.update(each.steps.tolist())
    found = []
    for each in sequences:
        name, known = orjson.dumps(each.camera.name), attitudes.get(each.camera.mount.vessel)
        lines = detection_lines(each.detections, scene.detector.labels, each.steps, each.times_s).splitlines(True)
        found.append(
            {
                step: with_camera(line, name, taken[step], None if known is None else known[step])
                for step, line in zip(each.steps.tolist(), lines, strict=True)
            }
        )
    return found


_OF_FRAME = ("camera", "attitude_rad", "detections")
"""Keys of a frame in the line of a step."""


def image_step_line(step: int, time_s: float, lines: Sequence[bytes]) -> bytes:
    """The line of a step from those of its frames."""
    frames = [{key: value for key, value in orjson.loads(line).items() if key in _OF_FRAME} for line in lines]
    return _line({"time_s": time_s, "step": step, "frames": frames})


def world_lines(
    each: WorldStep, scene: Scene, ais: list[AisReport], by_frame: bool
) -> Iterator[tuple[str | None, bytes]]:
    """The line of a step; or by frame the camera and the line of each frame. The reports that have arrived are in the
    first line, and are taken off."""
    carriers = {camera.name: camera.mount.vessel for camera in scene.cameras}
    attitudes = {reading.vessel: reading.attitude_rad for reading in each.navigation}
    frames = [_world_frame(frame, scene, attitudes.get(carriers[frame.camera] or "")) for frame in each.frames]
    own = {reading.vessel: _rounded(reading, "vessel") for reading in each.navigation}
    when = {"time_s": each.time_s, "step": each.step}
    lines = [(None, {**when, "frames": frames})]
    if by_frame:
        lines = [(frame["camera"], {"frames_in_step": len(frames), **when, **frame}) for frame in frames]
    for camera, content in lines:
        yield camera, _line({**content, "ais": [_rounded(report) for report in ais], "own_ships": own})
        ais.clear()


def _world_frame(frame: WorldFrame, scene: Scene, attitude_rad: Array | None) -> dict[str, Any]:
    sensed, labels = frame.sensed, scene.detector.labels
    located = [_known(rounded(value)) for value in vars(frame.located).values()]
    columns = sensed.boxes_px.tolist(), sensed.label.tolist(), sensed.confidence.tolist(), *located
    detections = [
        {"box_px": box, "label": labels[label], "confidence": confidence, **dict(zip(_LOCATED, values, strict=True))}
        for box, label, confidence, *values in zip(*columns, strict=True)
    ]
    attitude = {} if attitude_rad is None else {"attitude_rad": attitude_rad}
    return {"camera": frame.camera, **attitude, "position_m": rounded(frame.position_m), "detections": detections}


_LOCATED = (
    *("bearing_rad", "bearing_std_rad", "inverse_range_per_m", "inverse_range_std_per_m", "covariance_rad_per_m"),
    *("position_m", "position_covariance_m2"),
)
"""Keys of the fields of `Located`, in their order."""
assert len(_LOCATED) == len(Located.__dataclass_fields__)


def _known(values: Array) -> list[Any]:
    """A list of n things, with None for those that are not wholly known."""
    return [each if np.isfinite(each).all() else None for each in values.tolist()]


def _rounded(values: AisReport | Navigation, but: str = "") -> dict[str, Any]:
    """The fields that are not None."""
    said = {key: value for key, value in vars(values).items() if value is not None and key != but}
    return {key: rounded(value) if isinstance(value, np.ndarray) else value for key, value in said.items()}


def _line(content: Mapping[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS) + b"\n"


# ---- The exchange ----


class Exchange:
    """A program at work on a run.

    Attributes:
        seconds: Its time for each line so far, but the first.
        at: Where it is, for errors.
    """

    def __init__(self, program: Coprocess, rows: RunRows) -> None:
        """Say nothing yet."""
        self._program, self._rows = program, rows
        self._times_s = rows.scene.times_s(0, rows.steps).tolist()
        self.seconds: list[float] = []
        self.at = "at its start"

    def begin(self, settings: Mapping[str, Any]) -> Choice:
        """Tell it the first line. Raises ModsimError if it fails, or chooses what it is not given."""
        choice: Choice = self._ask(Choice, header(self._rows.scene, settings))
        self.seconds.clear()
        if choice.tracks == "world":
            self._rows.scene.check_world("a tracker in the world")
        return choice

    def images(
        self, sequences: Sequence[CameraSequence], by_frame: bool, progress: Callable[[int], None]
    ) -> list[list[TrackedFrame]]:
        """Its tracks in each frame of each sequence. Raises ModsimError if it fails, or answers what is wrong."""
        rows, found = self._rows, [list[TrackedFrame]() for _ in sequences]
        labels = rows.scene.detector.labels
        lines = frame_lines(rows.scene, rows.steps, sequences)
        for step in sorted({step for each in lines for step in each}):
            taken = {sequences[place].camera.name: place for place, each in enumerate(lines) if step in each}
            told = {name: lines[place][step] for name, place in taken.items()}
            if by_frame:
                tracks = {name: self._answer(ImageAnswer, line, step, name) for name, line in told.items()}
            else:
                line = image_step_line(step, self._times_s[step], list(told.values()))
                every = self._answer(ImageAnswer, line, step, None)
                if wrong := [each for each in every if each.camera not in taken]:
                    self._refuse(f"track {wrong[0].track} has the camera '{wrong[0].camera}', not one of this step")
                tracks = {name: [each for each in every if each.camera == name] for name in taken}
            for name, place in taken.items():
                found[place].append(self._made(partial(image_frame, tracks[name], labels)))
            progress(len(taken))
        return found

    def world(self, by_frame: bool, progress: Callable[[int], None]) -> list[WorldTrackedStep]:
        """Its tracks at each step; of several frames of a step the last answer. Raises as `images` does."""
        found, ais = list[WorldTrackedStep](), list[AisReport]()
        for each in world_steps(self._rows):
            ais += each.ais
            answer = WorldTrackedStep.empty()
            for camera, line in world_lines(each, self._rows.scene, ais, by_frame):
                answer = world_step_of(self._answer(WorldAnswer, line, each.step, camera))
            found.append(answer)
            progress(len(each.frames))
        return found

    def _answer(self, model: type[Any], line: bytes, step: int, camera: str | None) -> Any:
        where = "" if camera is None else f"camera '{camera}' "
        self.at = f"{where}at {self._times_s[step]:g} s"
        answer = self._ask(model, line)
        if (answer.step, answer.camera) != (step, camera):
            asked, said = (
                f"step {a}" + ("" if b is None else f" of camera '{b}'")
                for a, b in ((step, camera), (answer.step, answer.camera))
            )
            self._refuse(f"it answered {said}, and was given {asked}")
        return answer.tracks

    def _ask(self, model: type[Any], line: bytes) -> Any:
        answer = self._program.ask(line)
        self.seconds.append(self._program.seconds)
        return self._made(partial(parsed, model, answer))

    def _made(self, make: Callable[[], Any]) -> Any:
        try:
            return make()
        except ModsimError as error:
            raise self._program.error(str(error)) from None

    def _refuse(self, problem: str) -> NoReturn:
        raise self._program.error(problem)
