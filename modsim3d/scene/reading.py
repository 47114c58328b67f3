"""Reads a scene file and every file that it names, and reports everything that is wrong with them at once."""

import os
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from stat import S_ISDIR
from typing import Any

import numpy as np

from modsim3d.core.arrays import Indices
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import find_detector
from modsim3d.geometry.camera import Camera, Distortion, Intrinsics
from modsim3d.geometry.camera_poses import Mount
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_json, load_yaml
from modsim3d.io.validation import kind_of, nearest, shown
from modsim3d.scene.copy import copy_scene
from modsim3d.scene.keys import ANGLES, MAX_STEPS, Ais, CameraKeys, WavesKeys
from modsim3d.scene.parts import SCENE_FILE, SceneParts, title_of
from modsim3d.scene.scene import Scene
from modsim3d.scene.settings import replacing, settings_of, state_settings
from modsim3d.scene.sight import Sight
from modsim3d.truth.record import Annotation
from modsim3d.world.bodies import PREFIX
from modsim3d.world.floating_vessels import PEAKEDNESS, FloatingVessels, Hull, jonswap_sea
from modsim3d.world.poses.labelled import LabelledPoses
from modsim3d.world.poses.registry import read_source
from modsim3d.world.poses.replay import LivePoses
from modsim3d.world.second_order_waves import AXES, Axes, Axis, SecondOrderWaves
from modsim3d.world.vessel_motion import PERFECT_IMU, Imu, Waves
from modsim3d.world.vessels import Vessel

CHECKED_STEPS = 1000  # steps whose camera positions are checked together; it bounds the memory


def scene_problems(scene: Scene) -> list[str]:
    """Every problem, each with its path in the scene file."""
    problems = [
        f"cameras.{camera.name}.distortion: {problem}"
        for camera in scene.cameras
        if (problem := camera.intrinsics.lens_problem())
    ]
    problems += [
        f"ais.vessels.{name}: no vessel '{name}' ({nearest(name, scene.vessel_names)})"
        for name in scene.ais.vessels
        if name not in scene.vessel_names
    ]
    if scene.live:
        return problems + _live_problems(scene)
    if scene.labels is not None:
        return problems
    problems += [problem for camera in scene.cameras if (problem := _frame_problem(scene, camera))]
    misplaced: dict[str, tuple[str, ...]] = {}
    for first in range(0, scene.steps, CHECKED_STEPS):
        steps = np.arange(first, min(first + CHECKED_STEPS, scene.steps))
        misplaced.update(place_problems(scene, steps, leave_out=misplaced))
    return problems + [problem for faults in misplaced.values() for problem in faults]


def _live_problems(scene: Scene) -> list[str]:
    """Parts of a scene that need later steps, which a live scene does not know yet."""
    problems = []
    if scene.waves is not None and scene.waves.motion.needs_velocity:
        problems.append(
            "waves.spectrum: the sea needs the velocities of vessels, which a stream gives too late: use a level or "
            "coefficients"
        )
    if scene.detector.dropout.anchored:
        problems.append(
            "detector: holds rates over the whole scene (anchor: state_rate), which a stream does not know beforehand: "
            "use anchor: none"
        )
    if scene.detector.false_positives.needs_target_statistics:
        problems.append(
            "detector: false positives are as large as the scene's vessels, which a stream does not show beforehand: "
            "give false_positives a size"
        )
    return problems


def _frame_problem(scene: Scene, camera: Camera) -> str | None:
    """Problem of a camera that should take more frames than there are steps, or that takes none."""
    if camera.frame_rate_hz is None and not camera.start_offset_s:
        return None
    times_s = scene.times_s(0, scene.steps)
    interval_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0  # a log may have gaps
    rate = camera.frame_rate_hz
    if rate is not None and rate * interval_s > 1 + 1e-6:
        return (
            f"cameras.{camera.name}.frame_rate_hz: {rate:g} frames a second are more than the scene's steps of "
            f"{interval_s:g} s give: at most {1 / interval_s:g}, or leave it out for a frame at every step"
        )
    if not len(scene.frame_steps(camera, 0, scene.steps)):
        return (
            f"cameras.{camera.name}.start_offset_s: the scene ends {times_s[-1]:g} s after its first step, "
            f"before the first frame is due ({camera.start_offset_s:g} s): no frame would be taken"
        )
    return None


def place_problems(scene: Scene, steps: Indices, leave_out: Collection[str] = ()) -> dict[str, tuple[str, ...]]:
    """Problems of each camera's place at some ascending steps of shape (S,): it has no pose, or is inside a body. They
    are by the name of the camera, without cameras that have no problem and those to leave out."""
    problems, calm = {}, None
    for camera in scene.cameras:
        if camera.name not in leave_out:
            try:
                calm = calm or scene.own_motion.at(steps)
                _check_place(scene, scene.sight(camera, steps, calm))
            except InputError as error:
                problems[camera.name] = error.problems
    return problems


def _check_place(scene: Scene, calm: Sight) -> None:
    """Raise an error if the camera is inside a body. In `calm`, waves move only the vessels that carry cameras. Waves
    take time to compute, so those of other vessels are added only for vessels that come within reach of the camera."""
    if scene.annotation.allow_camera_inside:
        return
    sight, motion = calm, scene.motion
    if within_reach := {*calm.vessels_within_reach.tolist()}.intersection(motion.moved):
        moved = tuple(sorted(within_reach.union(scene.own_ships)))
        sight = scene.sight(calm.camera, calm.steps, replace(motion, moved=moved).at(calm.steps))
    inside = sight.body_around()
    if inside is None:
        return
    frame, body = inside
    when = scene.poses.timestamps[int(sight.steps[frame])]
    kind, name = ("vessel", scene.occluder_names[body])
    if body >= len(scene.vessels):
        kind, name = "obstacle", name.removeprefix(PREFIX)
    problem = (
        f"cameras.{sight.camera.name}: is inside {kind} '{name}' at time {when} s: move one of them, or set "
        "annotation.allow_camera_inside: true"
    )
    raise InputError(scene.title, [problem])


def shipped_scenes() -> dict[str, Path]:
    """Scenes that come with the package, by name."""
    return {path.stem: path for path in sorted(data_folder("scenes").glob("*.yaml"))}


def find_scene(scene: StrPath) -> Path:
    """The scene file that a path, a folder with a `scene.yaml`, a run directory or the name of a shipped scene stands
    for. Raises InputError if there is no such file and no such scene; TypeError for what is neither text nor a path."""
    path, shipped = as_path(scene, "scene", "a path or the name of a shipped scene"), shipped_scenes()
    name = os.fspath(scene)
    try:
        # Not `exists()`, which hides some errors from Python 3.14 on.
        exists, folder = True, S_ISDIR(path.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        exists, folder = False, False
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"scene {shown(name)}", [f"cannot be read: {why}"]) from None
    if exists and not (folder and name in shipped):
        in_folder = (path / SCENE_FILE, *(path / "scene" / f"{stem}.json" for stem in _scenes_of_run(path)))
        return next((file for file in in_folder if folder and file.is_file()), path)
    if name in shipped:
        return shipped[name]
    problem = f"no such file, and no shipped scene has this name ({nearest(name, shipped)})"
    raise InputError(f"scene {name}", [problem])


def _scenes_of_run(folder: Path) -> list[str]:
    """The name of the scene in a run directory; none if the folder is no such directory."""
    file = folder / "run.json"
    return [str(load_json(file, "run").get("scene"))] if file.is_file() else []


def draws_traffic(path: Path) -> bool:
    """Whether the traffic of a valid scene file is drawn from the seed."""
    return read_source(load_yaml(path, "scene")["poses"], title_of(path)).keys.drawn


def load_scene(
    scene: StrPath,
    *,
    seed: int | None = None,
    steps: int | None = None,
    mode: int | None = None,
    source: str | None = None,
    supersample: int | None = None,
    render: str | None = None,
    detector: StrPath | None = None,
    detector_seed: int | None = None,
    settings: Mapping[str, object] | None = None,
    state: str | None = None,
    state_from: StrPath | None = None,
    may_be_unread: bool = False,
) -> Scene:
    """Read and validate a scene and every file that it names.

        scene = modsim3d.load_scene("strait", steps=60, seed=7)
        scene = modsim3d.load_scene("my/scene.yaml", detector="my/detector.yaml")

    Args:
        scene: A scene file, or the name of a shipped scene. Each of the following replaces what stands in the file.
        seed: Seed of all random numbers but the detector's.
        steps: Number of time steps.
        mode: Annotation mode, 0 to 2.
        source: Annotation source: `rendered`, `analytic` or `rectangles`.
        supersample: Buffer pixels for each pixel of the image and axis.
        render: What the rendered source draws: `regions` or `full`.
        detector: A detector file, relative to the working directory, or the name of a shipped detector.
        detector_seed: Seed of the detector.
        settings: Any keys of the scene, and below `detector` of the detector file, such as
            `{"waves.level": "large", "detector.operating_threshold": 0.5}`; a list's items have their index as key.
            Files in the values are relative to the scene.
        state: The performance state that the detector is in for the whole scene.
        state_from: A folder of detector files, of which `state` names one that replaces the scene's detector;
            `conditions` is the shipped folder. Or a detector file, which replaces it and has the state.
        may_be_unread: Take settings that change nothing, since the models that the detector chooses do not read them;
            they are problems otherwise.

    Raises:
        InputError: With every problem found, each with its path in the file.
        TypeError: The scene, the detector or `state_from` is neither text nor a path.
    """
    path = find_scene(scene)
    data = (load_json if path.suffix == ".json" else load_yaml)(path, "scene")
    if not isinstance(data, dict):
        needed = f"a mapping of keys is needed (got {kind_of(data)})"
        raise InputError(f"scene {path}", ["the file is empty" if data is None else needed])
    given = {"seed": seed, "steps": steps, "mode": mode, "source": source, "supersample": supersample, "render": render}
    # Absolute, since a scene's paths are relative to it; not resolved, since a pipe resolves to what is no path.
    file = None if detector is None else str(find_detector(detector).absolute())
    wanted = replacing({**given, "detector": file, "detector_seed": detector_seed})
    wanted += state_settings(state, state_from, detector)
    return assembled(SceneParts(path, data, [*wanted, *settings_of(settings or {}, may_be_unread=may_be_unread)]))


def assembled(parts: SceneParts) -> Scene:
    """The scene from its parts, or every problem at once."""
    keys, vessels, detector, poses = parts.keys, parts.vessels, parts.detector, parts.poses
    source = parts.source
    if keys is None or vessels is None or detector is None or source is None or poses is None or parts.problems:
        raise InputError(parts.name, parts.problems)
    copy, level, live = copy_scene(parts, keys), parts.wave_level, isinstance(poses, LivePoses)
    scene = Scene(
        name=parts.scene_name,
        path=parts.path,
        sha256=copy.sha256(),
        seed=keys.seed,
        detector_seed=keys.seed if keys.detector_seed is None else keys.detector_seed,
        traffic_has_seed=source.keys.drawn,
        truth_has_seed=source.keys.drawn or keys.waves_have_seed,
        steps=keys.steps or (MAX_STEPS if live else len(poses.timestamps)),
        vessels=vessels,
        poses=poses,
        cameras=tuple(sequence.camera for sequence in poses.sequences)
        if isinstance(poses, LabelledPoses)
        else tuple(_camera(name, camera) for name, camera in keys.cameras.items()),
        annotation=Annotation(**keys.annotation.model_dump()),
        detector=detector,
        copy=copy,
        sea=keys.sea,
        obstacles=parts.obstacles,
        waves=_waves(keys.waves, keys.seed, vessels, level[0] if level else None),
        imu=Imu(**keys.imu.model_dump()) if keys.imu else PERFECT_IMU,
        origin=(keys.origin.latitude_deg, keys.origin.longitude_deg) if keys.origin else None,
        ais=Ais(**keys.ais.model_dump()),
        looks=parts.looks,
        plugins=parts.plugins,
        drawn_vessels=0 if parts.labelled else len(vessels) - len(parts.vessel_entries or ()),
    )
    problems = scene_problems(scene)
    if keys.imu is not None and not scene.own_ships:
        problems.insert(0, "imu: no camera is mounted on a vessel, so there is no own ship to measure")
    if problems:
        raise InputError(parts.name, parts.settings.named(problems))
    return scene


def _camera(name: str, keys: CameraKeys) -> Camera:
    coefficients = keys.distortion.model_dump() if keys.distortion else {}
    distortion = Distortion(**coefficients) if any(coefficients.values()) else None  # a pinhole's are all zero
    point, size = keys.principal_point_px or (0.0, 0.0), keys.image_size_px or (0, 0)  # which `resolved` has given
    rest = point, size, keys.skew, keys.near_clip_m, distortion
    if keys.focal_px is not None:
        intrinsics = Intrinsics(keys.focal_px, *rest)
    else:
        intrinsics = Intrinsics.from_lens(keys.focal_length_m or 0.0, keys.pixel_size_m or (0.0, 0.0), *rest)
    place = keys.mount or keys.pose
    values: Mapping[str, Any] = {} if place is None else place.model_dump(exclude={f"{angle}_deg" for angle in ANGLES})
    return Camera(name, intrinsics, Mount(**values), keys.frame_rate_hz, keys.start_offset_s)


def _waves(keys: WavesKeys | None, seed: int, vessels: tuple[Vessel, ...], level: Axes | None) -> Waves | None:
    """The waves that a scene file describes, by `level` if it names one; None for calm water."""
    if keys is None or keys.level == "none":
        return None
    if keys.spectrum is not None:
        sea = jonswap_sea(
            keys.significant_height_m or 0.0,
            keys.peak_period_s or 0.0,
            keys.direction_rad or 0.0,
            seed,
            keys.peakedness or PEAKEDNESS,
        )
        hulls = {vessel.name: Hull(vessel.length_m, vessel.beam_m) for vessel in vessels}
        return Waves(FloatingVessels(sea, hulls), keys.apply_to, keys.composition)
    if level is None:
        given = [getattr(keys, name) for name in AXES]
        roll, pitch, yaw = (Axis(**axis.model_dump()) if axis else Axis() for axis in given)
        level = (roll, pitch, yaw)
    return Waves(SecondOrderWaves(level, seed, keys.interval_s), keys.apply_to, keys.composition)
