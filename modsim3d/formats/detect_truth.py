"""Runs a detector over the truth of somebody's labelled video, and writes what a tracker and an evaluator read."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import orjson

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.core.document import Result
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import content_of, parse_detector
from modsim3d.detector.file.unread_keys import dead_lines
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import FileIds, LabelledSet, half_plane
from modsim3d.formats.reading.builder import ReadOptions, check_whole
from modsim3d.formats.reading.pair import file_kind, read_pair, read_truth
from modsim3d.formats.video_labels import check_needs, given_detector, labels_of
from modsim3d.formats.video_targets import NO_TARGET, FileClasses, TargetBoxes, Video, sought_in, to_labels, videos_of
from modsim3d.formats.writing.mot import detection_text, sequence_text
from modsim3d.io.atomic_write import json_text, write_files
from modsim3d.io.input_files import file_sha256, inputs_noted, open_input
from modsim3d.io.overwrite_guard import check_not_read, claimed
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.overwrite import DETECT_FILE, LOG_FILE, RUN_FILE, made_of_run, read_json
from modsim3d.runs.pipeline import Simulation, scene_statistics, truth_block
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.runs.tracker_view import BOX_DECIMALS, TrackerDetections
from modsim3d.scene.from_dict import scene_from_dict
from modsim3d.scene.scene import Scene
from modsim3d.scene.settings import choose_detector
from modsim3d.world.poses.labelled import LABELS

ONE_FRAME_HZ = 1.0  # the frame rate that is written of a video of one frame


def class_numbers(classes: FileClasses, to_label: Sequence[int], labels: Sequence[str]) -> dict[str, int]:
    """The number of each of the detector's labels in the file: that of the first class that it stands for, or one that
    the file does not use where it stands for none."""
    numbers, free = {}, max((0, *classes.numbers)) + 1
    for index, label in enumerate(labels):
        own = [number for number, to in zip(classes.numbers, to_label, strict=True) if to == index and number]
        numbers[label] = own[0] if own else free
        free += not own
    return numbers


def mot_files(truth: bytes, video: Video, detections: TrackerDetections, numbers: Sequence[int]) -> dict[str, bytes]:
    """A MOT sequence: the truth as it was read, detections, and `seqinfo.ini`. Detections name their class where the
    detector has several labels, whose numbers are given. Frames of `detections` are places of their images."""
    count, duration_s = len(video.images), float(video.times_s[-1] - video.times_s[0])
    rate_hz = (count - 1) / duration_s if count > 1 else ONE_FRAME_HZ
    text = detection_text(detections, np.array(numbers)[detections.label] if len(numbers) > 1 else None)
    info = sequence_text(video.name, video.size_px, rate_hz, count)
    return {"gt/gt.txt": truth, "det/det.txt": text.encode(), "seqinfo.ini": info.encode()}


def coco_results(
    parts: Sequence[tuple[Video, TrackerDetections]], images: Sequence[int | str], numbers: Sequence[int]
) -> bytes:
    """COCO results, with image IDs of the truth's file and the category of each label; frames are places of images."""
    entries: list[dict[str, Any]] = []
    for video, part in parts:
        shapes = np.round(np.concatenate([part.boxes_px[:, :2], sizes(part.boxes_px)], axis=1), BOX_DECIMALS)
        rows = video.images[part.frame].tolist()
        columns = rows, part.label.tolist(), shapes.tolist(), part.confidence.tolist()
        entries += [
            {"image_id": images[row], "category_id": numbers[label], "bbox": box, "score": score}
            for row, label, box, score in zip(*columns, strict=True)
        ]
    return orjson.dumps(entries)


FORMAT, SUMMARY = 1, DETECT_FILE


@dataclass(frozen=True, repr=False)
class TruthResult(Result):
    """Detections on a labelled video, from `detect_truth`.

    Attributes:
        folder: The folder with the files.
        kind: What the truth was: `MOT`, `COCO`, `KITTI` or `YOLO`.
        sequence_counts: What happened in the frames of each sequence, by its name.
        occlusion: How many visible fractions came `from_file` and `from_overlap` of boxes.
        notes: What was left out, and what was taken for what, each a sentence.
        files: Paths of the files.
        seconds: Wall-clock time.
    """

    folder: Path
    kind: str
    sequence_counts: dict[str, Counts]
    occlusion: dict[str, int]
    notes: tuple[str, ...]
    files: tuple[Path, ...]
    seconds: float

    def _rows(self) -> dict[str, str]:
        counts = self.counts
        return {
            "sequences": f"{len(self.sequence_counts):,}",
            "frames": f"{counts.frames:,}",
            "annotated vessels": f"{counts.annotated:,}",
            "detected": f"{counts.detected:,}",
            "false positives": f"{counts.false_positives:,}",
        }

    @property
    def counts(self) -> Counts:
        """Counts over all sequences."""
        return Counts.total(self.sequence_counts)


def detect_truth(
    truth: StrPath,
    folder: StrPath,
    *,
    detections: StrPath | None = None,
    truth_alone: bool = False,
    detector: StrPath | None = None,
    seed: int = 0,
    labels: Sequence[str] | None = None,
    image_size_px: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    first_frame: int | None = None,
    horizon: float | Sequence[float] | None = None,
    confidence_scale: tuple[float, float] | None = None,
    skip_bad: bool = False,
    settings: Mapping[str, object] | None = None,
    state: str | None = None,
    state_from: StrPath | None = None,
    overwrite: bool = False,
) -> TruthResult:
    """Make a run of a labelled video: of what a simulated detector makes of its truth, or of what a real one found.

        modsim3d.detect_truth("gt.txt", "out", detector="thesis", seed=7)
        modsim3d.detect_truth("gt.txt", "real", detections="det.txt")

    Args:
        truth: MOT `gt.txt`, COCO ground truth with tracks, KITTI's labels or a folder of YOLO labels with tracks; or a
            folder with a MOT or KITTI file of each sequence.
        folder: The run directory; it is made where it is not there.
        detections: What a real detector found, in the form of the truth, in place of a simulated detector.
        truth_alone: Make a run without detections, to score tracks on.
        detector: A detector file, or the name of a shipped detector.
        seed: Seed of the detector.
        labels: The detector's label of each class in the order of its number (MOT) or of the file (COCO), `-` for one
            that is not to be detected. Needed where the classes are not called as the detector's labels.
        image_size_px: Width and height, for MOT and KITTI without `seqinfo.ini`, and YOLO without images.
        frame_rate_hz: For YOLO, MOT and KITTI without `seqinfo.ini`, and COCO with a `frame_id` and no time.
        first_frame: Number of the first frame and pixel in MOT, 0 or 1; if None, 0 where a file has a frame 0.
        horizon: The row of the horizon, or x and y of two of its points, if false positives are to lie on the sea.
        confidence_scale: Confidences in the detections that stand for 0 and for 1.
        skip_bad: Leave out wrong entries of the files, and say how many.
        settings: Keys below `detector`, as those of `load_scene`.
        state: As that of `load_scene`.
        state_from: As that of `load_scene`, in place of `detector`.
        overwrite: Replace files that are there.

    Raises:
        ModsimError: The truth or the detector is wrong, the detector needs what the truth does not have, or a file
            cannot be written.
        TypeError: The truth, the folder or the detector is neither text nor a path.
    """
    truth, folder = as_path(truth, "truth"), as_path(folder, "folder")
    if seed < 0:
        raise InputError("--detector-seed", [f"must be 0 or more (got {seed})"])
    options = ReadOptions((), image_size_px, skip_bad, frame_rate_hz, 0, confidence_scale, None, first_frame)
    chosen = {"detector": detector, "settings": settings, "state": state, "state_from": state_from}
    given, results = detections is not None or truth_alone, None if truth_alone else detections
    read_videos = partial(_ReadVideos.of_files, truth, options, results, chosen, labels, horizon, given=given)
    return _detected(truth, folder, read_videos, seed, overwrite)


def _detected(
    truth: Path, folder: Path, read_videos: Callable[[], _ReadVideos], seed: int, overwrite: bool
) -> TruthResult:
    """Result of `detect_truth`, of videos that are read here, so that their files are noted."""
    started = time.perf_counter()
    with inputs_noted() as read:
        work = read_videos()
        if work.given and seed:
            raise InputError("--detector-seed", ["is for a simulated detector: leave it out"])
        names, scene = work.file_names(), work.scene(seed)
        notes = tuple(dict.fromkeys((*work.notes, *(scene.labels.notes if scene.labels else ()))))
        for name in {*names, *(made_of_run(folder) if folder.is_dir() else ())}:
            check_not_read(folder / name, read)
        result = run_scene(scene, folder, overwrite=overwrite, thesis_json=False)
        with claimed([folder / name for name in names], overwrite=overwrite, inputs=read):
            contents = work.contents(truth, open_run(folder))
            hashes = {"/".join(path.parts[-3 * truth.is_dir() - 1 :]): file_sha256(path) for path in sorted(set(read))}
            files = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
            contents[SUMMARY] = json_text({**work.summary(), "notes": list(notes), "inputs": hashes, "files": files})
            write_files({folder / name: content for name, content in contents.items()})
    paths = tuple(folder / name for name in (*names, RUN_FILE, LOG_FILE, *read_json(folder / RUN_FILE)["files"]))
    seconds = time.perf_counter() - started
    return TruthResult(folder, work.kind, result.camera_counts, work.occlusion(), notes, paths, seconds)


@contextmanager
def labelled_video(
    truth: StrPath,
    detections: StrPath | None = None,
    *,
    labels: Sequence[str] | None = None,
    image_size_px: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    first_frame: int | None = None,
    confidence_scale: tuple[float, float] | None = None,
    skip_bad: bool = False,
) -> Iterator[StoredRun]:
    """Make a run of a labelled video and of what a real detector found in it, in a folder that is kept as long as the
    run is used: for a tracker or for scores.

        with modsim3d.labelled_video("gt.txt") as run:
            print(modsim3d.score_run(run, "my_tracks.txt"))

    Args:
        truth: As that of `detect_truth`.
        detections: What a real detector found; None for scores of tracks alone.
        labels, image_size_px, frame_rate_hz, first_frame, confidence_scale, skip_bad: As those of `detect_truth`.

    Raises:
        ModsimError: The files are wrong.
        TypeError: One of them is neither text nor a path.
    """
    truth = as_path(truth, "truth")
    given = (truth,) if detections is None else (truth, as_path(detections, "detections"))
    with TemporaryDirectory(prefix="modsim3d_") as folder:
        out = Path(folder) / (truth.stem or "video")
        detect_truth(
            truth,
            out,
            detections=detections,
            truth_alone=detections is None,
            labels=labels,
            image_size_px=image_size_px,
            frame_rate_hz=frame_rate_hz,
            first_frame=first_frame,
            confidence_scale=confidence_scale,
            skip_bad=skip_bad,
        )
        yield replace(open_run(out), made_of=given)


def labelled_scene(
    truth: Path,
    name: str,
    *,
    options: ReadOptions,
    detections: Path | None = None,
    detector: StrPath | None = None,
    settings: Mapping[str, object] | None = None,
    labels: Sequence[str] | None = None,
    horizon: float | Sequence[float] | None = None,
) -> tuple[Scene, tuple[str, ...]]:
    """A scene of labelled videos, of which each seed shows one, and remarks on what was read; for the arguments see
    `detect_truth`. Raises as it does."""
    given = detections is not None
    chosen = {"detector": detector, "settings": {} if given else settings}
    work = _ReadVideos.of_files(truth, options, detections, chosen, labels, horizon, given=given)
    return work.scene(0, by_seed=True, name=name), work.notes


@dataclass(frozen=True, eq=False)
class _ReadVideos:
    """Targets to be detected, and the detector."""

    kind: str
    source: str  # what messages call the file
    stem: str  # its name without ending
    labelled: LabelledSet
    model: DetectorModel
    ids: FileIds
    classes: FileClasses
    pair: bool  # whether a pair of files in the form of the truth is written too, as of MOT and COCO
    to_label: Indices  # the detector's label of each class, −1 for none: (k,)
    videos: list[Video]
    sought: TargetBoxes
    horizon: Array | None  # the half-plane of the sea: (3,); None if it is not known
    given: bool  # whether the detections are a real detector's
    notes: tuple[str, ...]

    @classmethod
    def of_files(
        cls,
        truth: Path,
        options: ReadOptions,
        detections: StrPath | None,
        detector: Mapping[str, Any],
        labels: Sequence[str] | None,
        horizon: float | Sequence[float] | None,
        *,
        given: bool,
    ) -> _ReadVideos:
        """Read the files; `detector` has the arguments of `choose_detector`, and `given` takes the detections in its
        place. Raises ModsimError if they are wrong, or the detector cannot work on them."""
        if options.frame_rate_hz is not None and not 0 < options.frame_rate_hz < np.inf:
            raise InputError("--frame-rate", [f"must be above 0 (got {options.frame_rate_hz:g})"])
        if options.first_frame not in (None, 0, 1):
            raise InputError("--first-frame", [f"must be 0 or 1 (got {options.first_frame})"])
        if not given:
            model, file = choose_detector(**detector)
            return cls.of(*read_truth(truth, options), truth, model, f"detector {file}", labels, horizon, given)
        if any(detector.values()):
            raise InputError("--detections", ["are those of a real detector: leave out what chooses a simulated one"])
        kind = file_kind(truth)
        if detections is None:
            labelled = read_truth(truth, options)[0]
        else:
            labelled = read_pair(truth.stem, truth, detections, options)
        targets = tuple(dict.fromkeys(name for name in labels or labelled.labels if name != NO_TARGET))
        model = parse_detector(given_detector(targets or labelled.labels), "detector")
        return cls.of(labelled, kind, truth, model, "detector", labels, horizon, given)

    @classmethod
    def of(
        cls,
        labelled: LabelledSet,
        kind: str,
        truth: Path,
        model: DetectorModel,
        detector: str,
        labels: Sequence[str] | None,
        horizon: float | Sequence[float] | None,
        given: bool,
    ) -> _ReadVideos:
        """Look at what was read of a truth. Raises ModsimError if the detector cannot work on it."""
        source = f"ground truth {truth}"
        if (ids := labelled.ids) is None:
            raise ModsimError(f"{source}: its images and tracks have no names")
        check_whole((str(name) for name in (*ids.images, *ids.files, *ids.sequences, *ids.identities)), source)
        videos = videos_of(labelled, ids, source)
        classes = FileClasses(kind, labelled.labels, ids.labels)
        considered = np.bincount(labelled.annotations.label[~labelled.annotations.ignored], minlength=len(ids.labels))
        to_label, taken = to_labels(classes, considered > 0, labels, model.labels)
        sought = sought_in(labelled, to_label, ids.identities, source)
        sea = None if horizon is None else half_plane(horizon, {video.size_px for video in videos})
        left_out = check_needs(model, detector, sought.depth_m[sought.visible_fraction > 0], sea)
        notes = (*labelled.notes, *taken, *sought.notes, *left_out, *dead_lines(model))
        pair = truth.is_file() and kind in ("MOT", "COCO")
        stem, members = truth.resolve().stem, (labelled, model, ids, classes, pair, to_label, videos, sought, sea)
        return cls(kind, source, stem, *members, given, notes)

    @property
    def numbers(self) -> dict[str, int]:
        return class_numbers(self.classes, self.to_label.tolist(), self.model.labels)

    def scene(self, seed: int, *, by_seed: bool = False, name: str | None = None) -> Scene:
        """The scene whose truth these labels are; in its copy, `by_seed` lets the seed choose one of the videos."""
        labels = labels_of(
            self.labelled,
            self.videos,
            self.sought,
            self.ids,
            self.model.labels,
            self.to_label,
            self.horizon,
            self.source,
            self.given,
        )
        usual = re.sub("[^A-Za-z0-9_-]", "_", self.videos[0].file_name if len(self.videos) == 1 else self.stem)
        scene = scene_from_dict(
            {"poses": {LABELS: labels, **({"by_seed": True} if by_seed else {})}, "detector": self.model, "seed": seed},
            name=name or usual,
        )
        whole = truth_block(scene, 0, scene.steps, None), 0, scene.steps
        Simulation(scene, scene_statistics(scene, [whole]))  # its errors come before a folder is made
        return scene

    def file_names(self) -> list[str]:
        pair = ["gt/gt.txt", "det/det.txt", "seqinfo.ini"] if self.kind == "MOT" else ["dt.json"]
        return [*pair, SUMMARY] if self.pair else [SUMMARY]

    def contents(self, truth: Path, run: StoredRun) -> dict[str, bytes]:
        if not self.pair:
            return {}
        numbers = list(self.numbers.values())
        cameras = [camera.name for camera in run.scene.cameras]
        parts: dict[str, list[TrackerDetections]] = {name: [] for name in cameras}
        for block in run.blocks():
            for part in block.cameras:
                detections = TrackerDetections.of(part.detections)
                name = cameras[part.camera]
                place = np.searchsorted(run.scene.frame_steps(run.scene.cameras[part.camera], 0, run.steps), part.steps)
                parts[name].append(replace(detections, frame=place[detections.frame]))
        of_videos = [(video, TrackerDetections.join(parts[video.file_name])) for video in self.videos]
        if self.kind == "MOT":
            before = 1 - self.ids.first_frame  # of frames and pixels that the file counts from 0
            ((video, detections),) = of_videos
            detections = replace(detections, frame=detections.frame - before, boxes_px=detections.boxes_px - before)
            with open_input(truth, "ground truth") as file:
                return mot_files(file.read(), video, detections, numbers)
        return {"dt.json": coco_results(of_videos, self.ids.images, numbers)}

    def occlusion(self) -> dict[str, int]:
        from_overlap = self.sought.from_overlap
        return {"from_file": len(self.sought) - from_overlap, "from_overlap": from_overlap}

    def summary(self) -> dict[str, Any]:
        """Content of `detect.json`, but for the files: what `run.json` and the run's scene do not say."""
        names = [self.model.labels[index] if index >= 0 else None for index in self.to_label.tolist()]
        return {
            "format": FORMAT,
            "kind": self.kind,
            "detector": content_of(self.model),
            "labels": dict(zip(self.classes.names, names, strict=True)),
            "class_numbers": self.numbers,
            "horizon": None if self.horizon is None else self.horizon.tolist(),
            "occlusion": self.occlusion(),
        }
