"""A log on its scene: each frame has a camera of the scene, and each detection one of its labels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.geometry.camera import Camera, Distortion
from modsim3d.io.validation import nearest, shown
from modsim3d.learn.voyage.clock import REGISTRATION, SceneClock, check_overlap, noted_clock_s, on_scene_clock
from modsim3d.learn.voyage.logs.log import Clock, DetectionLog
from modsim3d.learn.voyage.logs.reading import ros_name
from modsim3d.scene.scene import Scene
from modsim3d.tracks.diagnosis import MOT, TOP_LEFT, BoxForm, BoxRows, implausible
from modsim3d.truth.occlusion_order import hull_vertices
from modsim3d.world.vessels import Solid

_MAX_OUTSIDE = 0.01  # share of the boxes that may lie outside the image
ONE_LABEL = "vessel"  # what all vessels are called where a log names no classes and the scene has several
FRAMES_IN_A_ROW = 20  # so many whole numbers in a row may be numbers of frames


@dataclass(frozen=True, eq=False)
class CameraLog:
    """Log of one camera's detector, n frames and m detections: `time_s` from the scene's first step by the log's clock
    and `clock_s`, noted beside the scene, which was added."""

    camera: int  # its number in the scene
    time_s: Array  # ascending, (n,)
    names: tuple[str, ...]  # of the frames, for messages
    frame: Indices  # of each detection, non-decreasing, (m,)
    label: Indices  # into the labels of the `SceneLog`, (m,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, (m, 4)
    confidence: Array  # in [0, 1], nan where not given, (m,)
    clock_s: float = 0.0

    def take(self, frames: Mask) -> CameraLog:
        """Some of its frames, shape (n,), with their detections."""
        place = np.cumsum(frames) - 1
        rows = frames[self.frame]
        names = tuple(name for name, kept in zip(self.names, frames.tolist(), strict=True) if kept)
        columns = self.label[rows], self.boxes_px[rows], self.confidence[rows]
        return CameraLog(self.camera, self.time_s[frames], names, place[self.frame[rows]], *columns, self.clock_s)


@dataclass(frozen=True, eq=False)
class SceneLog:
    """A log on its scene."""

    source: str  # what messages call the log
    scene: Scene
    length_s: float  # time of the scene's last step
    labels: tuple[str, ...]  # of the classes
    vessel_label: Indices  # index into the labels of each vessel of the scene, (V,)
    cameras: tuple[CameraLog, ...]  # those that the log has frames of
    notes: tuple[str, ...]  # what was taken for granted
    form: BoxForm = TOP_LEFT  # of the boxes in the file

    @property
    def time_s(self) -> Array:
        """Times of all frames by the log's own clock, shape (n,)."""
        return np.concatenate([camera.time_s - camera.clock_s for camera in self.cameras])


def on_scene(log: DetectionLog, scene: Scene, camera: str | None = None) -> SceneLog:
    """A log with its scene's cameras, clock and labels, of one camera or all. Raises InputError if it does not fit."""
    if scene.live:
        raise InputError(scene.title, ["its poses arrive while it runs: a scene with all poses is needed"])
    log, numbers = _with_cameras(log, scene, camera)
    _check_sizes(log, scene, numbers)
    odd = _check_boxes(log, scene, numbers)
    labels, of_vessel, of_log, remarks = _labels(log, scene)
    clock = SceneClock.of(scene)
    # What is noted is of the detector's clock, and a run has the scene's.
    clocks_s = [0.0 if log.of_run else noted_clock_s(scene.path, scene.cameras[number].name) for number in numbers]
    times_s = on_scene_clock(log.time_s, log.clock, log.source, scene, clock) + np.array(clocks_s)[log.camera]
    check_overlap(log, times_s, scene, clock)
    label = np.zeros(len(log.label), dtype=np.int64) if of_log is None else of_log[log.label]
    cameras = []
    for index, number in enumerate(numbers):
        frames = np.flatnonzero(log.camera == index)  # follow each other
        if not len(frames):
            continue
        rows = np.flatnonzero((log.frame >= frames[0]) & (log.frame <= frames[-1]))
        name = scene.cameras[number].name
        names = tuple(f"{name} {log.when(time)}" for time in log.time_s[frames].tolist())
        columns = log.frame[rows] - frames[0], label[rows], log.boxes_px[rows], log.confidence[rows]
        cameras.append(CameraLog(number, times_s[frames], names, *columns, clocks_s[index]))
        if clocks_s[index]:
            remarks.append(
                f"{log.source}: {clocks_s[index]:+.3f} s are added to its times of camera '{name}', which is clock_s "
                f"in {REGISTRATION} beside the scene: set that to 0 if the clock has been set right since"
            )
    remarks += _said_of_times(log)
    notes = (*log.notes, f"{log.source}: its frames are known from {log.frames_from}", *remarks, *odd)
    return SceneLog(log.source, scene, clock.length_s, labels, of_vessel, tuple(cameras), notes, log.form)


def _said_of_times(log: DetectionLog) -> Iterator[str]:
    times_s = np.unique(log.time_s)
    if (
        log.clock is not Clock.UTC
        and log.form is not MOT
        and not log.of_run
        and len(times_s) >= FRAMES_IN_A_ROW
        and (times_s == times_s[0] + np.arange(len(times_s))).all()
    ):
        yield f"{log.source}: its times are {len(times_s)} whole numbers in a row: frames, perhaps, must be seconds"


def _with_cameras(log: DetectionLog, scene: Scene, wanted: str | None) -> tuple[DetectionLog, list[int]]:
    """The log of the wanted cameras, and the number in the scene of each of its cameras."""
    names = [camera.name for camera in scene.cameras]
    numbers = {str(number): number for number in range(len(names))}  # as the sequences of `modsim3d export`
    numbers |= {ros_name(name): k for k, name in enumerate(names)} | {name: k for k, name in enumerate(names)}
    if None in log.cameras and len(log.cameras) > 1:
        problem = "some frames or detections name a camera and others do not: name it in all, or none"
        raise InputError(log.source, [problem])
    if wanted is not None:
        if wanted not in names:
            raise InputError("--camera", [f"{scene.title} has no camera {shown(wanted)} ({nearest(wanted, names)})"])
        number = names.index(wanted)
        given = [index for index, name in enumerate(log.cameras) if numbers.get(str(name)) == number]
        if not given and len(log.cameras) > 1:
            cameras = ", ".join(map(shown, log.cameras))
            raise InputError(log.source, [f"has no frame of camera {shown(wanted)} (its cameras: {cameras})"])
        chosen = given[0] if given else 0
        log = log.take(log.camera == chosen)
        return replace(log, cameras=(log.cameras[chosen],), camera=np.zeros_like(log.camera)), [number]
    if log.cameras == (None,):
        if len(names) > 1:
            which = f"does not say which camera of the scene it is of ({', '.join(names)})"
            problem = f"{which}: give --camera, once for all logs or for each in their order"
            raise InputError(log.source, [problem])
        return log, [0]
    if wrong := [str(name) for name in log.cameras if name not in numbers]:
        hint = f"{nearest(wrong[0], names)}; if the log is of one camera, --camera says which"
        raise InputError(log.source, [f"the scene has no camera {shown(wrong[0])} ({hint})"])
    return log, [numbers[str(name)] for name in log.cameras]


def _check_sizes(log: DetectionLog, scene: Scene, numbers: Sequence[int]) -> None:
    """Refuse images of another size than the camera's, whose boxes would be in other pixels."""
    sizes = np.array([scene.cameras[number].intrinsics.image_size_px for number in numbers])[log.camera]
    wrong = np.flatnonzero((np.isfinite(log.size_px) & (log.size_px != sizes)).any(axis=1))
    if len(wrong):
        first = int(wrong[0])
        camera = scene.cameras[numbers[int(log.camera[first])]]
        image, needed = (" × ".join(f"{side:g}" for side in size[first].tolist()) for size in (log.size_px, sizes))
        raise InputError(log.source, [f"has images of {image} px, and camera '{camera.name}' of the scene {needed} px"])


def _check_boxes(log: DetectionLog, scene: Scene, numbers: Sequence[int]) -> list[str]:
    """Refuse boxes in another form or in pixels of larger images; a few may have left the image, as a tracker's do."""
    sizes = np.array([scene.cameras[number].intrinsics.image_size_px for number in numbers])[log.camera[log.frame]]
    outside = np.asarray(((log.boxes_px[:, :2] >= sizes) | (log.boxes_px[:, 2:] <= 0)).any(axis=1))
    rows = BoxRows(log.form.numbers_of(log.boxes_px), log.form, sizes.astype(np.float64), *[log.frame] * 3)
    if (odd := implausible(rows)) and not odd.slight:
        raise InputError(log.source, [odd.sentence])
    if not outside.any() or outside.mean() <= _MAX_OUTSIDE:
        return [f"{log.source}: {odd.sentence}"] if odd else []
    first = int(np.argmax(outside))
    frame = int(log.frame[first])
    camera = scene.cameras[numbers[int(log.camera[frame])]]
    width, height = camera.intrinsics.image_size_px
    left, top, right, bottom = (f"{edge:g}" for edge in log.boxes_px[first].tolist())
    problem = (
        f"{outside.sum():,} of {len(outside):,} boxes lie outside the images of camera '{camera.name}', of {width:g} × "
        f"{height:g} px (first at {log.when(float(log.time_s[frame]))}: {left}, {top} to {right}, {bottom}): give "
        "boxes in pixels of these images"
    )
    raise InputError(log.source, [problem])


def _labels(log: DetectionLog, scene: Scene) -> tuple[tuple[str, ...], Indices, Indices | None, list[str]]:
    """Labels, those of vessels (V,) and of the log's, None if all have the first; and what was taken for granted."""
    labels = scene.detector.labels
    used = tuple(dict.fromkeys(vessel.label for vessel in scene.vessels))
    alike = np.zeros(len(scene.vessels), dtype=np.int64)
    if not log.labels:
        label = labels[0] if len(labels) == 1 else ONE_LABEL
        notes = [] if len(labels) == 1 else [f"{log.source}: names no classes, so all vessels are '{label}'"]
        return (label,), alike, None, notes
    wrong = [name for name in log.labels if name not in labels]
    if not wrong:
        of_vessel = np.array([labels.index(vessel.label) for vessel in scene.vessels], dtype=np.int64)
        return labels, of_vessel, np.array([labels.index(name) for name in log.labels], dtype=np.int64), []
    if len(used) == 1:
        names = ", ".join(map(shown, log.labels[:8]))
        notes = [f"{log.source}: all its classes ({names}) are taken for '{used[0]}', the only one of the scene"]
        return used, alike, None, notes
    problem = (
        f"the scene has no label {shown(wrong[0])} ({nearest(wrong[0], labels)}); its vessels and the detector must "
        "have the same labels, or all vessels one, as modsim3d ais gives them; --labels names the classes of MOT"
    )
    raise InputError(log.source, [problem])


@dataclass(frozen=True)
class Correction:
    """Additions to the values of the scene's camera and of the log; angles turn as those of a scene's camera do."""

    clock_s: float = 0.0  # to the times of the log, to get those of the scene
    roll_deg: float = 0.0
    pitch_deg: float = 0.0  # positive looks further down
    yaw_deg: float = 0.0  # positive looks further to port
    height_m: float = 0.0
    focal_share: float = 0.0  # of the focal length
    k1: float = 0.0  # to the lens's first radial coefficient

    def camera(self, camera: Camera) -> Camera:
        """The camera with the changes; the same one if nothing of it changes."""
        if self == Correction(self.clock_s):
            return camera
        mount, lens = camera.mount, camera.intrinsics
        w1, w2, w3 = mount.position_m
        mount = replace(
            mount,
            position_m=(w1, w2, w3 + self.height_m),
            roll_rad=mount.roll_rad + math.radians(self.roll_deg),
            pitch_rad=mount.pitch_rad + math.radians(self.pitch_deg),
            yaw_rad=mount.yaw_rad + math.radians(self.yaw_deg),
        )
        f1, f2 = (focal * (1 + self.focal_share) for focal in lens.focal_px)
        distortion = lens.distortion
        if self.k1:
            distortion = distortion or Distortion()
            distortion = replace(distortion, k1=distortion.k1 + self.k1)
        return replace(camera, mount=mount, intrinsics=replace(lens, focal_px=(f1, f2), distortion=distortion))


NO_CORRECTION = Correction()


# ---- The vertices of a solid that can make the edges of its box ----

_FEW = 8  # a shoebox has no vertex to spare


def hull_of(solid: Solid) -> Array:
    """The vertices of a solid on its convex hull, in the unit box of VCF, shape (K, 3): no other makes an edge."""
    return solid.vertices if len(solid.vertices) <= _FEW else solid.vertices[hull_vertices(solid)]


def stacked(hulls: Sequence[Array]) -> Array:
    """Hulls of V vessels side by side, the last vertex of each repeated, shape (V, K, 3)."""
    most = max(map(len, hulls))
    return np.stack([np.concatenate([hull, np.repeat(hull[-1:], most - len(hull), axis=0)]) for hull in hulls])
