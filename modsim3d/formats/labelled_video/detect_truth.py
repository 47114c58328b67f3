"""Runs a detector over the truth of somebody's labelled video, and writes what a tracker and an evaluator read."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import key_table
from modsim3d.detector.file.reading import content_of
from modsim3d.detector.file.unread import dead_lines
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import FileIds, half_plane
from modsim3d.formats.labelled_video.detecting import VideoChunk, count_part, detected_parts, tables_of
from modsim3d.formats.labelled_video.targets import FileClasses, TargetBoxes, Video, sought_in, to_labels, videos_of
from modsim3d.formats.reading.builder import ReadOptions, check_whole
from modsim3d.formats.reading.pair import read_truth
from modsim3d.formats.writing.mot import detection_text, sequence_text
from modsim3d.io.atomic_write import json_text, write_files
from modsim3d.io.input_files import file_sha256, inputs_noted, open_input
from modsim3d.io.overwrite_guard import claimed, identities, identity
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.overwrite import RUN_FILE, is_of_a_run, read_json, remove_files, safe_names
from modsim3d.runs.run import VERSIONED
from modsim3d.runs.tracker_view import BOX_DECIMALS, TRACKER_INPUT, TrackerDetections, detection_lines
from modsim3d.scene.settings import choose_detector

# ---- What a tracker and an evaluator read ----

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


def tracker_files(parts: Sequence[VideoChunk], model: DetectorModel) -> dict[str, bytes]:
    """`tracker_input_<sequence>.jsonl` of each sequence."""
    files: dict[str, bytes] = {}
    for part in parts:
        name = f"{TRACKER_INPUT}_{part.video.file_name}.jsonl"
        lines = detection_lines(part.detections, model.labels, part.steps, part.times_s)
        files[name] = files.get(name, b"") + lines
    return files


def mot_files(truth: bytes, video: Video, parts: Sequence[VideoChunk], numbers: Sequence[int]) -> dict[str, bytes]:
    """A MOT sequence: the truth as it was read, detections, and `seqinfo.ini`. Detections name their class where the
    detector has several labels, whose numbers are given."""
    count, duration_s = len(video.images), float(video.times_s[-1] - video.times_s[0])
    rate_hz = (count - 1) / duration_s if count > 1 else ONE_FRAME_HZ
    text = ""
    for part in parts:
        found = TrackerDetections.of(part.detections)
        found = replace(found, frame=part.steps[found.frame])
        text += detection_text(found, np.array(numbers)[found.label] if len(numbers) > 1 else None)
    info = sequence_text(video.name, video.size_px, rate_hz, count)
    return {"gt/gt.txt": truth, "det/det.txt": text.encode(), "seqinfo.ini": info.encode()}


def coco_results(parts: Iterable[VideoChunk], images: Sequence[int | str], numbers: Sequence[int]) -> bytes:
    """COCO results, with the image IDs of the truth's file and the category of each label."""
    entries: list[dict[str, Any]] = []
    for part in parts:
        found = TrackerDetections.of(part.detections)
        shapes = np.round(np.concatenate([found.boxes_px[:, :2], sizes(found.boxes_px)], axis=1), BOX_DECIMALS)
        rows = part.video.images[part.steps[found.frame]].tolist()
        columns = rows, found.label.tolist(), shapes.tolist(), found.confidence.tolist()
        entries += [
            {"image_id": images[row], "category_id": numbers[label], "bbox": box, "score": score}
            for row, label, box, score in zip(*columns, strict=True)
        ]
    return orjson.dumps(entries)


# ---- What a detector file asks for that a labelled video may not have ----


def check_needs(model: DetectorModel, source: str, depth_m: Array, horizon: Array | None) -> list[str]:
    """Remarks on what is left out. `source` is what messages call the detector's file, `depth_m` the distance of each
    target, NaN where unknown: (n,), `horizon` the half-plane of the sea: (3,), None if it is not known. Raises
    InputError if the detector asks for what is not known."""
    problems = list(_distance_problems(model, depth_m))
    if horizon is None:
        problems += _horizon_problems(model)
    if problems:
        raise InputError(source, problems)
    placement = model.false_positives.placement
    rates = (getattr(state, model.false_positives.numbers.rate_key) for state in model.states)
    if horizon is not None or placement.density is not None or not any(rate > 0 for rate in rates):
        return []
    return ["false positives lie anywhere in the image, also in the sky: --horizon would keep them on the sea"]


def _distance_problems(model: DetectorModel, depth_m: Array) -> Iterator[str]:
    unknown = int(np.isnan(depth_m).sum())
    if not unknown:
        return
    needed = (
        f"needs the distance of every vessel, which {unknown} of {len(depth_m)} boxes do not have: give distance_m of "
        "each annotation of a COCO file (MOT has no such column), or leave it out with "
    )
    if model.gates.max_range_m is not None:
        yield f"gates.max_range_m: {needed}--set detector.gates.max_range_m=null"
    keys = [] if not any(effect.attribute == "distance_m" for effect in model.dropout.effects) else ["dropout"]
    keys += [
        f"states.{model.states[state].name}.dropout"
        for state, effects in model.dropout.own.items()
        if any(effect.attribute == "distance_m" for effect in effects)
    ]
    if keys:
        without = " ".join(f"--set detector.{key}.distance_m=null" for key in keys)
        if {effect.attribute for effect in model.dropout.every_effect} == {"distance_m"}:
            without += " --set detector.dropout.model=confusion"
        yield f"{keys[0]}.distance_m: {needed}{without}"


def _horizon_problems(model: DetectorModel) -> Iterator[str]:
    placement = model.false_positives.placement
    needed = "needs the horizon: give --horizon ROW, or X1,Y1,X2,Y2 where it is tilted, or leave it out with "
    if placement.band_px is not None:
        without = "--set detector.false_positives.placement=uniform --set detector.false_positives.band_px=null"
        yield f"false_positives.placement: horizon_band {needed}{without}"
    if placement.far_half_px is not None:
        yield f"false_positives.far_half_px: {needed}--set detector.false_positives.far_half_px=null"


FORMAT, SUMMARY = 1, "detect.json"  # the file with settings, hashes and counts


@dataclass(frozen=True, repr=False)
class TruthResult:
    """Detections on a labelled video, from `detect_truth`.

    Attributes:
        folder: The folder with the files.
        kind: What the truth was: `MOT` or `COCO`.
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

    def __repr__(self) -> str:
        """Its folder and its counts, in a line."""
        return f"<TruthResult {self.folder}: {', '.join(f'{key} {value}' for key, value in self._rows().items())}>"

    def _repr_html_(self) -> str:
        """A notebook's table."""
        return key_table(f"Detections {self.folder}", self._rows())

    def _rows(self) -> dict[str, str]:
        counts = self.counts
        return {
            "sequences": f"{len(self.sequence_counts):,}",
            "frames": f"{counts.frames:,}",
            "annotated vessels": f"{counts.annotated:,}",
            "detected": f"{counts.detected:,}",
            "false detections": f"{counts.false_positives:,}",
        }

    @property
    def counts(self) -> Counts:
        """Counts over all sequences."""
        return Counts.total(self.sequence_counts)


def detect_truth(
    truth: StrPath,
    folder: StrPath,
    *,
    detector: StrPath | None = None,
    seed: int = 0,
    labels: Sequence[str] | None = None,
    image_size_px: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    horizon: float | Sequence[float] | None = None,
    skip_bad: bool = False,
    settings: Mapping[str, object] | None = None,
    state: str | None = None,
    state_from: StrPath | None = None,
    overwrite: bool = False,
) -> TruthResult:
    """Run a detector over the truth of a labelled video, which need not be a simulated one.

        modsim3d.detect_truth("gt.txt", "out", detector="thesis", seed=7)

    Args:
        truth: MOT `gt.txt`, or COCO ground truth with tracks.
        folder: Folder for the files; it is made where it is not there.
        detector: A detector file, or the name of a shipped detector.
        seed: Seed of the detector.
        labels: The detector's label of each class in the order of its number (MOT) or of the file (COCO), `-` for one
            that is not to be detected. Needed where the classes are not called as the detector's labels.
        image_size_px: Width and height, for MOT without `seqinfo.ini`.
        frame_rate_hz: For MOT without `seqinfo.ini`, and for COCO whose images have a `frame_id` and no time.
        horizon: The row of the horizon, or x and y of two of its points, if false positives are to lie on the sea.
        skip_bad: Leave out wrong entries of the truth, and say how many.
        settings: Keys below `detector`, as those of `load_scene`.
        state: As that of `load_scene`.
        state_from: As that of `load_scene`, in place of `detector`.
        overwrite: Replace files that are there.

    Raises:
        ModsimError: The truth or the detector is wrong, the detector needs what the truth does not have, or a file
            cannot be written.
        TypeError: The truth, the folder or the detector is neither text nor a path.
    """
    started = time.perf_counter()
    truth, folder = as_path(truth, "truth"), as_path(folder, "folder")
    if frame_rate_hz is not None and not 0 < frame_rate_hz < np.inf:
        raise InputError("--frame-rate", [f"must be above 0 (got {frame_rate_hz:g})"])
    if seed < 0:
        raise InputError("--detector-seed", [f"must be 0 or more (got {seed})"])
    with inputs_noted() as read:
        model, file = choose_detector(detector, settings=settings, state=state, state_from=state_from)
        options = ReadOptions((), image_size_px, skip_bad, frame_rate_hz)
        work = _Work.of(truth, options, model, f"detector {file}", labels, horizon)
        if is_of_a_run(read_json(folder / RUN_FILE)):
            raise OutputError(f"{folder} holds a run: choose another folder")
        names = work.file_names()
        with claimed([folder / name for name in names], overwrite=overwrite, inputs=read):
            parts = list(detected_parts(work.videos, work.sought, work.ids.identities, model, seed, work.horizon))
            contents = work.contents(truth, parts)
            counts = {video.name: Counts() for video in work.videos}
            for part in parts:
                counts[part.video.name] += count_part(part, work.sought)
            hashes = {path.name: file_sha256(path) for path in sorted(set(read))}
            files = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
            contents[SUMMARY] = json_text({**work.summary(seed, counts), "inputs": hashes, "files": files})
            _put(folder, contents, read)
    paths = tuple(folder / name for name in names)
    seconds = time.perf_counter() - started
    return TruthResult(folder, work.kind, counts, work.occlusion(), work.notes, paths, seconds)


@dataclass(frozen=True, eq=False)
class _Work:
    """Targets to be detected, and the detector."""

    kind: str
    model: DetectorModel
    ids: FileIds
    classes: FileClasses
    to_label: Indices  # the detector's label of each class, −1 for none: (k,)
    videos: list[Video]
    sought: TargetBoxes
    horizon: Array | None  # the half-plane of the sea: (3,); None if it is not known
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls,
        truth: Path,
        options: ReadOptions,
        model: DetectorModel,
        detector: str,
        labels: Sequence[str] | None,
        horizon: float | Sequence[float] | None,
    ) -> _Work:
        """Read the truth. Raises ModsimError if it is wrong, or if the detector cannot work on it."""
        labelled, kind = read_truth(truth, options)
        source = f"ground truth {truth}"
        if (ids := labelled.ids) is None:
            raise ModsimError(f"{source}: its images and tracks have no names")
        check_whole((str(name) for name in (*ids.images, *ids.sequences, *ids.identities)), source)
        videos = videos_of(labelled, ids, source)
        classes = FileClasses(kind, labelled.labels, ids.labels)
        considered = np.bincount(labelled.annotations.label[~labelled.annotations.ignored], minlength=len(ids.labels))
        to_label, taken = to_labels(classes, considered > 0, labels, model.labels)
        sought = sought_in(labelled, to_label, ids.identities, source)
        sea = None if horizon is None else half_plane(horizon, {video.size_px for video in videos})
        left_out = check_needs(model, detector, sought.depth_m[sought.visible], sea)
        notes = (*labelled.notes, *taken, *sought.notes, *left_out, *dead_lines(model))
        return cls(kind, model, ids, classes, to_label, videos, sought, sea, notes)

    @property
    def numbers(self) -> dict[str, int]:
        """Number of the class or category of each label in the file."""
        return class_numbers(self.classes, self.to_label.tolist(), self.model.labels)

    def file_names(self) -> list[str]:
        """Paths of all files in the folder."""
        own = ["gt/gt.txt", "det/det.txt", "seqinfo.ini"] if self.kind == "MOT" else ["dt.json"]
        inputs = [f"tracker_input_{video.file_name}.jsonl" for video in self.videos]
        return [*own, *inputs, "frames.parquet", "truth.parquet", "detections.parquet", SUMMARY]

    def contents(self, truth: Path, parts: Sequence[VideoChunk]) -> dict[str, bytes]:
        """The content of each file but the summary."""
        numbers = list(self.numbers.values())
        if self.kind == "MOT":
            with open_input(truth, "ground truth") as file:
                own = mot_files(file.read(), self.videos[0], parts, numbers)
        else:
            own = {"dt.json": coco_results(parts, self.ids.images, numbers)}
        tables = tables_of(parts, self.sought, self.ids.identities, self.ids.images, self.model)
        stored = {f"{name}.parquet": content for name, content in tables.items()}
        return {**own, **tracker_files(parts, self.model), **stored}

    def occlusion(self) -> dict[str, int]:
        """Sources of visible fractions."""
        from_overlap = int(self.sought.from_overlap.sum())
        return {"from_file": len(self.sought) - from_overlap, "from_overlap": from_overlap}

    def summary(self, seed: int, counts: Mapping[str, Counts]) -> dict[str, Any]:
        """Content of `detect.json`, but for the files."""
        names = [self.model.labels[index] if index >= 0 else None for index in self.to_label.tolist()]
        return {
            "format": FORMAT,
            "kind": self.kind,
            "seed": seed,
            "detector": content_of(self.model),
            "labels": dict(zip(self.classes.names, names, strict=True)),
            "class_numbers": self.numbers,
            "horizon": None if self.horizon is None else self.horizon.tolist(),
            "occlusion": self.occlusion(),
            "sequences": {
                video.name: {"frames": len(video.images), "image_size_px": list(video.size_px)} for video in self.videos
            },
            "counts": asdict(Counts.total(counts)),
            "sequence_counts": {name: asdict(each) for name, each in counts.items()},
            "notes": list(self.notes),
            "versions": {name: version(name) for name in VERSIONED},
        }


def _put(folder: Path, contents: Mapping[str, bytes], read: Sequence[Path]) -> None:
    """Write all files, and remove those that an earlier result had and this one has not."""
    before = read_json(folder / SUMMARY)
    listed = before.get("files") if isinstance(before, dict) else None
    write_files({folder / name: content for name, content in contents.items()})
    old = safe_names(listed) - contents.keys() if isinstance(listed, dict) else set[str]()
    inputs = identities(read)
    remove_files(folder, {name for name in old if identity(folder / name) not in inputs})
