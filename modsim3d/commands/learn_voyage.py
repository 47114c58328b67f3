"""The options of `modsim3d learn` with which it learns from a voyage, and what they give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.commands.completion import complete_scene
from modsim3d.errors import InputError, ModsimError

if TYPE_CHECKING:
    from modsim3d.formats.labelled import LabelledSet
    from modsim3d.formats.reading.builder import ReadOptions
    from modsim3d.scene.scene import Scene
    from modsim3d.voyage.logs.log import Start

SceneOption = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE",
        help="Scene of a voyage, whose vessels are the truth of --detections in place of --truth.",
        autocompletion=complete_scene,
    ),
]
CameraOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Camera of --scene that --detections are of, where they do not say it."),
]
StartOption = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="Time of the log's zero, for --scene: UTC, or seconds since its first step."),
]
ImagesOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="COCO file with the times of the images that COCO results name, for --scene."),
]
AttitudeOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Table of own ship's roll, pitch and heading by time, for --scene."),
]


@dataclass(frozen=True, eq=False)
class AskedVoyage:
    """A scene, and what its logs do not say."""

    scene: Scene
    camera: str | None
    start: Start | None
    images: Path | None
    attitude: Path | None

    def labelled(self, logs: Sequence[Path], conditions: Sequence[str], options: ReadOptions) -> LabelledSet:
        """The logs with the truth of the scene.

        Raises:
            ModsimError: There is no log, not a name for each, or a log is wrong.
        """
        from modsim3d.formats.labelled import joined
        from modsim3d.voyage.attitude import read_attitude
        from modsim3d.voyage.labelled_voyage import CONDITION, VoyageOptions, labelled_voyage
        from modsim3d.voyage.logs.log import LogOptions
        from modsim3d.voyage.logs.reading import read_log
        from modsim3d.voyage.on_scene import on_scene

        if not logs:
            raise ModsimError("nothing to learn from: --scene needs --detections, the log of its camera's detector")
        if conditions and len(conditions) != len(logs):
            raise ModsimError(f"--condition is given {len(conditions)} times, with {len(logs)} logs: name each")
        for name, value in (("--image-size", options.image_size_px), ("--horizon", options.horizon)):
            if value is not None:
                raise ModsimError(f"{name} is not for --scene, whose camera says it")
        said = LogOptions(
            options.frame_rate_hz,
            self.start,
            self.images,
            options.labels,
            options.confidence_scale,
            options.category_offset,
            options.skip_bad,
        )
        attitude = None if self.attitude is None else read_attitude(self.attitude, self.scene)
        names = conditions or [CONDITION] * len(logs)
        parts = []
        for path, name in zip(logs, names, strict=True):
            log = on_scene(read_log(path, said), self.scene, self.camera)
            parts.append(labelled_voyage(log, VoyageOptions(attitude=attitude, condition=name)))
        return joined(parts)

    def truth(self, logs: Sequence[Path]) -> tuple[Path, ...]:
        """The file that each log's truth is from."""
        return (self.scene.path,) * len(logs)

    def besides(self, logs: Sequence[Path]) -> list[Path]:
        """Files that are read too, and never written over."""
        from modsim3d.voyage.learned import read_besides

        return [path for log in logs for path in read_besides(self.scene, log)]


def asked_voyage(
    scene: str | None,
    truth: Sequence[Path] | None,
    run: Sequence[Path] | None,
    camera: str | None,
    start: str | None,
    images: Path | None,
    attitude: Path | None,
) -> AskedVoyage | None:
    """What the options ask for; None without `--scene`.

    Raises:
        ModsimError: Options do not go together, or the scene is wrong.
    """
    if scene is None:
        given = {"--camera": camera, "--start": start, "--images": images, "--attitude": attitude}
        if stray := [name for name, value in given.items() if value is not None]:
            raise ModsimError(f"{stray[0]} is for --scene: a voyage whose vessels' tracks are known")
        return None
    if truth or run:
        other = "--truth" if truth else "--run"
        raise ModsimError(
            f"--scene makes the truth of --detections: give it without {other}, and learn from both apart"
        )
    from modsim3d.scene.reading import load_scene

    return AskedVoyage(load_scene(scene), camera, None if start is None else _start(start), images, attitude)


def _start(text: str) -> Start:
    """The time of a log's zero."""
    import math

    from modsim3d.inputs.validation import shown
    from modsim3d.voyage.logs.log import Clock, Start
    from modsim3d.voyage.logs.times import time_of

    time_s, utc = time_of(text)
    if math.isnan(time_s):
        wanted = "a time such as 2024-01-04T10:00:00.250Z, or seconds since the scene's first step, is needed"
        raise InputError("--start", [f"{wanted} (got {shown(text)})"])
    return Start(time_s, Clock.UTC if utc else Clock.STEP)
