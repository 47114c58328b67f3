"""Workers that make the blocks of a run; which of them makes a block changes nothing in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.core.arrays import Array, read_only
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.records import TRUE
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.detector.truncation import truncated_errors
from modsim3d.io.processes import WorkerCount, Workers, open_workers
from modsim3d.runs.blocks import Block
from modsim3d.runs.counts import Counts, camera_counts
from modsim3d.runs.files.block_files import BlockFiles, finished_truth, kept_truth_path, truth_kept
from modsim3d.runs.files.stored_tables import StoredTable, truth_of
from modsim3d.runs.pipeline import Range, Simulation, open_renderer, scene_statistics, truth_block
from modsim3d.runs.truth_check import TruthCheckError, check_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.crosscheck.comparison import CheckCounts
from modsim3d.truth.record import Truth, annotation_boxes

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

BOXES_A_STATE, POINTS_A_BOX = 32, 1024
"""Few enough that a run hardly takes longer; the standard error beside the mean shows how much so few boxes tell."""
_MIX = np.array([2_654_435_761, 40_503, 97_003], dtype=np.int64)
_RANGE = 2**32
_NO_ROWS = read_only(np.empty((0, 7)))


@dataclass(frozen=True, eq=False)
class BoxSample:
    """Boxes spread evenly over a run, the same however it was split into blocks. Each box has a key, a hash of its
    step, vessel and camera. Of each state the boxes with the least keys are kept."""

    rows: Array = field(default_factory=lambda: _NO_ROWS)
    """Key, state, camera and annotated box in pixels, in order of state and key, shape (n, 7)."""
    counts: Counter[int] = field(default_factory=Counter)  # state → number of detections of a vessel in it

    @classmethod
    def of(cls, block: Block, scene: Scene) -> BoxSample:
        """Sample the boxes of a block."""
        pieces, counts = [_NO_ROWS], Counter[int]()
        for part in block.cameras:
            detections, truth = part.detections, part.truth
            hits = np.flatnonzero(detections.kind == TRUE)
            rows, state = part.truth_row[hits], detections.states[detections.frame[hits]]
            keys = np.stack([truth.step[rows], truth.vessel[rows], truth.camera[rows]], axis=1) @ _MIX % _RANGE
            boxes = annotation_boxes(truth, scene.annotation.mode)[rows]
            pieces.append(np.column_stack([keys, state, truth.camera[rows], boxes]))
            counts.update(state.tolist())
        return cls(_least(np.concatenate(pieces)), counts)

    def __add__(self, other: BoxSample) -> BoxSample:
        """Keep the least keys of both."""
        return BoxSample(_least(np.concatenate([self.rows, other.rows])), self.counts + other.counts)

    def truncation(self, scene: Scene) -> dict[str, dict[str, Any]]:
        """Shift of the box errors by resampling, by name of the state, as `run.json` has it. In the units of the
        detector file, averaged over the sampled boxes: the share of first draws that are resampled, the mean and
        covariance after resampling, and the standard error of that mean."""
        source = BoxErrorSource.from_model(scene.detector)
        report = {}
        for index, performance in enumerate(scene.detector.states):
            own_rows = self.rows[self.rows[:, 1] == index]
            if not len(own_rows):
                continue
            kept = []
            for number, camera in enumerate(scene.cameras):
                boxes, image = own_rows[own_rows[:, 2] == number, 3:], camera.intrinsics.image_size_px
                kept.append(truncated_errors(source, index, boxes, image, in_file_units=True, points=POINTS_A_BOX))
            means = np.concatenate([part.means for part in kept])
            mean = means.mean(axis=0)
            covariance = np.concatenate([part.second_moments for part in kept]).mean(axis=0) - np.outer(mean, mean)
            report[performance.name] = {
                "unit": performance.box_error.unit,
                "detections": self.counts[index],
                "boxes": len(own_rows),
                "redrawn": _rounded(1 - np.concatenate([part.accepted for part in kept]).mean()),
                "mean": _rounded(mean),
                "mean_shift": _rounded(mean - performance.box_error.mean),
                "mean_standard_error": _rounded(means.std(axis=0) / np.sqrt(len(means))),
                "covariance": _rounded(covariance),
            }
        return report


def _least(rows: Array) -> Array:
    kept = [_NO_ROWS]
    for state in np.flatnonzero(np.bincount(rows[:, 1].astype(np.int64))):  # np.unique imports masked arrays
        own_rows = rows[rows[:, 1] == state]
        if len(own_rows) > BOXES_A_STATE:  # few rows are sorted faster than many
            own_rows = own_rows[own_rows[:, 0] <= np.partition(own_rows[:, 0], BOXES_A_STATE - 1)[BOXES_A_STATE - 1]]
        kept.append(own_rows[np.lexsort((*own_rows.T[:1:-1], own_rows[:, 0]))][:BOXES_A_STATE])
    return np.concatenate(kept)


def _rounded(values: Any) -> Any:
    """Round to six digits: as precise as the integration, and coarse enough to hide the order of sums."""
    rows = np.asarray(values).tolist()
    return [_rounded(row) for row in rows] if isinstance(rows, list) else float(f"{rows:.6g}")


IF_KILLED = "what was finished is kept: go on with --resume, perhaps with fewer --workers"


@dataclass(frozen=True, eq=False)
class BlockTally:
    """Counts over one or more blocks; tallies can be added."""

    steps: int = 0
    resumed_steps: int = 0  # whose truth was taken from an interrupted run
    damaged_blocks: int = 0  # whose truth an interrupted run had kept in a file that is damaged
    camera_counts: dict[str, Counts] = field(default_factory=dict)  # by name of the camera
    boxes: BoxSample = field(default_factory=BoxSample)
    intersecting: frozenset[tuple[int, int]] = frozenset()
    """Pairs of vessels or obstacles whose hulls intersect: the analytic source cannot tell what is visible of them."""
    checked: CheckCounts = field(default_factory=CheckCounts)

    def __add__(self, other: BlockTally) -> BlockTally:
        """Both together."""
        return BlockTally(
            self.steps + other.steps,
            self.resumed_steps + other.resumed_steps,
            self.damaged_blocks + other.damaged_blocks,
            {name: self._of(name) + other._of(name) for name in {**self.camera_counts, **other.camera_counts}},
            self.boxes + other.boxes,
            self.intersecting | other.intersecting,
            self.checked + other.checked,
        )

    def _of(self, camera: str) -> Counts:
        return self.camera_counts.get(camera, Counts())


class BlockMaker:
    """Makes the blocks of a scene, from truth to the rows and lines of files."""

    def __init__(self, scene: Scene, renderer: IdRenderer | None, stored: StoredTable | None = None) -> None:
        """Take the renderer of the truth, or the table of a finished run of the scene to take the truth from."""
        self._scene = scene
        self._renderer = renderer
        self._stored = stored
        self._simulation: Simulation | None = None
        self.backend = renderer.context.description if renderer else "none"

    def count_targets(self, steps: Range, folder: Path) -> tuple[BlockTally, TargetStatistics]:
        """The statistics of a block's targets, with a tally of its steps; its truth is kept in the folder."""
        first, stop = steps
        with self._truth(folder, first, stop) as (truth, resumed_steps, damaged):
            tally = BlockTally(stop - first, resumed_steps, damaged, checked=self._check(truth, first, stop))
            return tally, scene_statistics(self._scene, [(truth, first, stop)])

    def make(
        self, steps: Range, folder: Path, statistics: TargetStatistics, kinds: Sequence[str]
    ) -> tuple[BlockTally, BlockFiles]:
        """Make a block of `steps`, the first and the one after the last: its counts, and what it adds to the files.
        Truth is kept in `folder`; `statistics` are of the whole scene's targets; for `kinds` see `line_kinds`."""
        first, stop = steps
        with self._truth(folder, first, stop) as (truth, resumed_steps, damaged_blocks):
            checked = CheckCounts() if self._scene.detector.needs_target_statistics else self._check(truth, first, stop)
            if self._simulation is None:
                self._simulation = Simulation(self._scene, statistics)
            block = self._simulation.detect(truth, first, stop)
            tally = BlockTally(
                steps=stop - first,
                resumed_steps=resumed_steps,
                damaged_blocks=damaged_blocks,
                camera_counts=camera_counts(block, self._scene),
                boxes=BoxSample.of(block, self._scene),
                intersecting=frozenset((one, other) for one, other in truth.intersections[:, 2:].tolist()),
                checked=checked,
            )
            return tally, BlockFiles.of(block, self._scene, kinds)

    def _check(self, truth: Truth, first: int, stop: int) -> CheckCounts:
        """The cross-check of a block's truth, before the detector sees it; also of a truth that was kept."""
        return check_block(self._scene, truth, first, stop, self._renderer)

    @contextmanager
    def _truth(self, folder: Path, first: int, stop: int) -> Iterator[tuple[Truth, int, int]]:
        """The truth of some steps, the number of steps that an interrupted run had kept, and of damaged blocks. Truth
        that is new is kept, at the latest when the context ends, unless the cross-check finds it wrong."""
        try:
            with self._truth_and_kept(folder, first, stop) as truth:
                yield truth
        except TruthCheckError:
            kept_truth_path(folder, first, stop).unlink(missing_ok=True)
            raise

    @contextmanager
    def _truth_and_kept(self, folder: Path, first: int, stop: int) -> Iterator[tuple[Truth, int, int]]:
        if self._stored is not None:
            yield truth_of(self._stored.rows(first, stop).table, self._scene), 0, 0
            return
        truth = finished_truth(folder, self._scene, first, stop)
        if truth is not None:
            yield truth, stop - first, 0
            return
        damaged = kept_truth_path(folder, first, stop).exists()
        truth = truth_block(self._scene, first, stop, self._renderer)
        # A live run cannot be resumed.
        with nullcontext() if self._scene.live else truth_kept(folder, truth, first, stop):
            yield truth, 0, int(damaged)


BlockWorkers = Workers[BlockMaker]


def open_block_workers(
    scene: Scene, workers: WorkerCount, truth_run: Path | None = None
) -> AbstractContextManager[BlockWorkers]:
    """One worker in this process, and more in others, see `BlockMaker`. Raises RendererError without OpenGL."""
    return open_workers(workers, IF_KILLED, _open_block_maker, scene, truth_run, here_too=True)


def backend_of(workers: BlockWorkers) -> str:
    """A description of the OpenGL context that draws the ID images, or `none`. Raises RendererError without OpenGL."""
    (backend,) = workers.map(_backend, [None])
    return backend


def _backend(maker: BlockMaker, _: None) -> str:
    return maker.backend


@contextmanager
def _open_block_maker(scene: Scene, truth_run: Path | None) -> Iterator[BlockMaker]:
    if truth_run is not None:
        yield BlockMaker(scene, None, StoredTable(truth_run, "truth", scene))
        return
    with open_renderer(scene) as renderer:  # in a worker process an OpenGL context of its own
        yield BlockMaker(scene, renderer)
