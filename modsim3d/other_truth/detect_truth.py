"""Runs a detector over the truth of somebody's labelled video, and writes what a tracker and an evaluator read."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.detector.file.reading import content_of
from modsim3d.detector.file.unread import dead_lines
from modsim3d.detector.model import DetectorModel
from modsim3d.display import key_table
from modsim3d.errors import InputError, ModsimError, OutputError
from modsim3d.formats.horizon import half_plane
from modsim3d.formats.labelled import FileIds, LabelledSet
from modsim3d.formats.reading.builder import ReadOptions, check_whole
from modsim3d.formats.reading.pair import read_truth
from modsim3d.inputs.opening import inputs_noted, open_input
from modsim3d.other_truth.detecting import Part, count_part, detected_parts
from modsim3d.other_truth.files import class_numbers, coco_results, mot_files, tracker_files
from modsim3d.other_truth.labels import FileClasses, to_labels
from modsim3d.other_truth.needs import check_needs
from modsim3d.other_truth.sought import Sought, sought_in
from modsim3d.other_truth.tables import tables_of
from modsim3d.other_truth.videos import Video, videos_of
from modsim3d.outputs.claims import claimed
from modsim3d.outputs.placing import write_files
from modsim3d.outputs.same_file import identities, identity
from modsim3d.paths import StrPath, as_path
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.replacing import RUN_FILE, is_of_a_run, read_json, remove_files, safe_names
from modsim3d.runs.run import VERSIONED
from modsim3d.scene.detector_choice import choose_detector

FORMAT = 1
SUMMARY = "detect.json"
"""The file with settings, hashes and counts."""


@dataclass(frozen=True, repr=False)
class TruthResult:
    """What a detector made of a labelled video, from `detect_truth`.

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
        """Where it is, and its counts, in a line."""
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
        """What happened in all sequences."""
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
    if frame_rate_hz is not None and not 0 < frame_rate_hz < math.inf:
        raise InputError("--frame-rate", [f"must be above 0 (got {frame_rate_hz:g})"])
    if seed < 0:
        raise InputError("--seed", [f"must be 0 or more (got {seed})"])
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
            counts = _counts(work, parts)
            hashes = {path.name: _hash(path) for path in sorted(set(read))}
            contents[SUMMARY] = _dump(
                {**work.summary(seed, counts), "inputs": hashes, "files": {n: _sha(c) for n, c in contents.items()}}
            )
            _put(folder, contents, read)
    return TruthResult(
        folder,
        work.kind,
        counts,
        work.occlusion(),
        work.notes,
        tuple(folder / name for name in names),
        time.perf_counter() - started,
    )


@dataclass(frozen=True, eq=False)
class _Work:
    """What is to be detected, by which detector.

    Attributes:
        to_label: The detector's label of each class, −1 for none, shape (k,).
        horizon: The half-plane of the sea, shape (3,); None if it is not known.
    """

    kind: str
    model: DetectorModel
    ids: FileIds
    classes: FileClasses
    to_label: Indices
    videos: list[Video]
    sought: Sought
    horizon: Array | None
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
        """Read the truth, and check that the detector can work on it.

        Raises:
            ModsimError: It cannot, or the truth is wrong.
        """
        labelled, kind = read_truth(truth, options)
        source = f"ground truth {truth}"
        ids = _ids(labelled, source)
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

    def contents(self, truth: Path, parts: Sequence[Part]) -> dict[str, bytes]:
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
        """Where visible fractions come from."""
        from_overlap = int(self.sought.from_overlap.sum())
        return {"from_file": len(self.sought) - from_overlap, "from_overlap": from_overlap}

    def summary(self, seed: int, counts: Mapping[str, Counts]) -> dict[str, Any]:
        """What `detect.json` says, but for the files."""
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


def _ids(labelled: LabelledSet, source: str) -> FileIds:
    ids = labelled.ids
    if ids is None:
        raise ModsimError(f"{source}: its images and tracks have no names")
    check_whole((str(name) for name in (*ids.images, *ids.sequences, *ids.identities)), source)
    return ids


def _counts(work: _Work, parts: Sequence[Part]) -> dict[str, Counts]:
    counts = {video.name: Counts() for video in work.videos}
    for part in parts:
        counts[part.video.name] += count_part(part, work.sought)
    return counts


def _put(folder: Path, contents: Mapping[str, bytes], read: Sequence[Path]) -> None:
    """Write all files, and remove those that an earlier result had and this one has not."""
    before = read_json(folder / SUMMARY)
    listed = before.get("files") if isinstance(before, dict) else None
    write_files({folder / name: content for name, content in contents.items()})
    old = safe_names(listed) - contents.keys() if isinstance(listed, dict) else set[str]()
    inputs = identities(read)
    remove_files(folder, {name for name in old if identity(folder / name) not in inputs})


def _dump(content: Mapping[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_NON_STR_KEYS) + b"\n"


def _hash(path: Path) -> str:
    return _sha(path.read_bytes())


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
