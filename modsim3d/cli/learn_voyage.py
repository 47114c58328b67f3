"""The options of `modsim3d learn` with which it learns from a voyage, and what they give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.cli.completion import complete_scene
from modsim3d.core.errors import InputError, ModsimError

if TYPE_CHECKING:
    from modsim3d.formats.reading.builder import ReadOptions
    from modsim3d.learn.learn_detector import LearnOptions
    from modsim3d.learn.learned import LearnSettings
    from modsim3d.learn.report import LearnReport
    from modsim3d.learn.voyage.camera_registration import KnownMeans
    from modsim3d.learn.voyage.labelled_voyage import LabelledVoyage
    from modsim3d.learn.voyage.logs.log import Start
    from modsim3d.learn.voyage.non_ais.rates import TimeSpan
    from modsim3d.learn.voyage.report import VoyageReport
    from modsim3d.scene.scene import Scene

SceneOption = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help="Scene of a voyage, whose vessels are the truth of --detections in place of --truth.",
        autocompletion=complete_scene,
    ),
]
CameraOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="Camera of --scene that --detections are of: once for all logs, or for each of them in their order.",
    ),
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
FixedOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME,...",
        help="Parameters of --scene that are not registered: clock, roll, pitch, yaw, height, focal, k1, mean_width, "
        "mean_height; or all.",
    ),
]
KnownOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=VALUE,...",
        help="Means that are known, for registration in --scene: of box errors, mean_x and mean_y in pixels, "
        "mean_width and mean_height as shares; of position reports, delay in seconds.",
        show_default="zero",
    ),
]
StaleOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Least time without an AIS report after which a vessel of --scene that is under way is left out.",
        show_default="60",
    ),
]
EmptyOption = Annotated[
    str | None,
    typer.Option(
        metavar="FROM-TO,...",
        help="Stretches in which nothing floats but the vessels of --scene, by the log's clock, in seconds or UTC.",
    ),
]
PositionNoiseOption = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Standard deviation of each coordinate of positions in --scene.",
        show_default="10 with AIS, else 0",
    ),
]
WriteSceneOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Scene folder to write, --scene with registered cameras."),
]


@dataclass(frozen=True, eq=False)
class AskedVoyage:
    """A scene, what its logs do not say, and how it is learned from."""

    scene: Scene
    cameras: tuple[str | None, ...]
    start: Start | None
    images: Path | None
    attitude: Path | None
    fixed: tuple[str, ...]
    known: KnownMeans
    stretches: tuple[TimeSpan, ...]
    stale_s: float
    position_m: float
    write_scene: Path | None

    def labelled(
        self, logs: Sequence[Path], conditions: Sequence[str], options: ReadOptions, confidence: float | None
    ) -> LabelledVoyage:
        """The logs with the truth of the scene, once its cameras are registered.

        Raises:
            ModsimError: There is no log, not a name for each, a log is wrong, or a camera cannot be registered.
        """
        import numpy as np

        from modsim3d.core.text import counted
        from modsim3d.learn.learn_detector import MIN_CONFIDENCE
        from modsim3d.learn.voyage.attitude import read_attitude
        from modsim3d.learn.voyage.camera_registration import Registering
        from modsim3d.learn.voyage.labelled_voyage import CONDITION, VoyageOptions, joined_voyages, labelled_voyage
        from modsim3d.learn.voyage.log_to_scene import on_scene
        from modsim3d.learn.voyage.logs.log import LogOptions
        from modsim3d.learn.voyage.logs.reading import read_log
        from modsim3d.learn.voyage.non_ais.rates import check_stretches

        if not logs:
            raise ModsimError("nothing to learn from: --scene needs --detections, the log of its camera's detector")
        if conditions and len(conditions) != len(logs):
            raise ModsimError(f"--condition is given {len(conditions)} times, with {len(logs)} logs: name each")
        if len(self.cameras) not in (1, len(logs)):
            given = f"--camera is given {len(self.cameras)} times, with {counted(len(logs), 'log')}"
            raise ModsimError(f"{given}: give it once for all, or for each in their order")
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
        least = MIN_CONFIDENCE if confidence is None else confidence
        registering = Registering(self.fixed, self.position_m, least, attitude, self.known)
        names = conditions or [CONDITION] * len(logs)
        cameras = self.cameras * (len(logs) // len(self.cameras))
        scene_logs, read = [], set()
        for path, camera in zip(logs, cameras, strict=True):
            if (path.resolve(), camera) in read:
                raise ModsimError(f"--detections {path} is given twice: its frames would count twice")
            read.add((path.resolve(), camera))
            scene_logs.append(on_scene(read_log(path, said), self.scene, camera))
        check_stretches(self.stretches, np.concatenate([log.time_s for log in scene_logs]))
        options_of = (VoyageOptions(registering, self.stale_s, attitude, name) for name in names)
        return joined_voyages([labelled_voyage(*each) for each in zip(scene_logs, options_of, strict=True)])

    def learn(
        self, voyage: LabelledVoyage, settings: LearnSettings, options: LearnOptions
    ) -> tuple[LearnReport, VoyageReport]:
        """Learn from the voyage.

        Raises:
            ModsimError: Nothing can be learned.
        """
        from modsim3d.learn.voyage.learn_voyage import learn_from

        return learn_from(voyage, settings, options, self.stretches, self.position_m)

    def scene_files(self, voyage: LabelledVoyage) -> dict[Path, bytes | str]:
        """The scene with its registered cameras, if it is to be written.

        Raises:
            ModsimError: A camera has two registrations.
        """
        from modsim3d.learn.voyage.labelled_voyage import scene_files

        if self.write_scene is None:
            return {}
        return scene_files(self.scene, voyage.registered, self.write_scene)

    def truth(self, logs: Sequence[Path]) -> tuple[Path, ...]:
        """The file that each log's truth is from."""
        return (self.scene.path,) * len(logs)

    def besides(self, logs: Sequence[Path]) -> list[Path]:
        """Files that are read too, and never written over."""
        from modsim3d.learn.voyage.learn_voyage import read_besides

        return [path for log in logs for path in read_besides(self.scene, log)]


def asked_voyage(
    scene: str | None,
    truth: Sequence[Path] | None,
    run: Sequence[Path] | None,
    camera: Sequence[str] | None,
    start: str | None,
    images: Path | None,
    attitude: Path | None,
    fixed: str | None,
    known: str | None,
    empty: str | None,
    stale: float | None,
    position_noise: float | None,
    write_scene: Path | None,
    shift: bool,
) -> AskedVoyage | None:
    """Voyage that the options ask for; None without `--scene`.

    `shift` says whether --bias or --correct is given, which a voyage cannot have.

    Raises:
        ModsimError: Options do not go together, or the scene is wrong.
    """
    if scene is None:
        given: dict[str, object] = {"--camera": camera, "--start": start, "--images": images, "--attitude": attitude}
        given |= {"--fixed": fixed, "--known": known, "--empty": empty, "--stale": stale}
        given |= {"--position-noise": position_noise, "--write-scene": write_scene}
        if stray := [name for name, value in given.items() if value is not None]:
            raise ModsimError(f"{stray[0]} is for --scene: a voyage whose vessels' tracks are known")
        return None
    if truth or run:
        other = "--truth" if truth else "--run"
        raise ModsimError(
            f"--scene makes the truth of --detections: give it without {other}, and learn from both apart"
        )
    from modsim3d.learn.voyage.camera_registration import check_known, parse_fixed, parse_known, position_noise_m
    from modsim3d.learn.voyage.clock import SceneClock
    from modsim3d.learn.voyage.exclusions import stale_limit_s
    from modsim3d.learn.voyage.learn_voyage import NO_SHIFT
    from modsim3d.learn.voyage.non_ais.rates import parse_stretches
    from modsim3d.scene.reading import load_scene

    if shift:
        raise ModsimError(NO_SHIFT)
    loaded = load_scene(scene)
    means = parse_known(known)
    check_known(means, held := parse_fixed(fixed))
    return AskedVoyage(
        loaded,
        tuple(camera or (None,)),
        None if start is None else _start(start),
        images,
        attitude,
        held,
        means,
        parse_stretches(empty, SceneClock.of(loaded).start_s) if empty is not None else (),
        stale_limit_s(loaded, stale),
        position_noise_m(loaded, position_noise),
        write_scene,
    )


def _start(text: str) -> Start:
    """The time of a log's zero."""
    import math

    from modsim3d.io.validation import shown
    from modsim3d.learn.voyage.logs.log import Clock, Start, time_of

    time_s, utc = time_of(text)
    if math.isnan(time_s):
        wanted = "a time such as 2024-01-04T10:00:00.250Z, or seconds since the scene's first step, is needed"
        raise InputError("--start", [f"{wanted} (got {shown(text)})"])
    return Start(time_s, Clock.UTC if utc else Clock.STEP)
