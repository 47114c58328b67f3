"""Workers that make the blocks of a run; which of them makes a block changes nothing in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.detector.census import TargetCensus
from modsim3d.processes import Workers, open_workers
from modsim3d.runs.box_sample import BoxSample
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.block_files import BlockFiles, finished_truth, keep_truth
from modsim3d.runs.files.truth_reader import read_truth
from modsim3d.runs.pipeline import Range, Simulation, open_renderer, scene_census, truth_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

IF_KILLED = "what was finished is kept: go on with --resume, perhaps with fewer --workers"


@dataclass(frozen=True, eq=False)
class FinishedBlock:
    """A block as it goes into the files.

    Attributes:
        steps: Number of steps.
        files: Rows of the tables and lines of the JSON files.
        counts: What happened.
        boxes: Some of the boxes that were detected.
        resumed_steps: Number of steps whose truth was taken from an interrupted run: all or none.
        intersecting: Pairs of vessels whose boxes overlap in space: the analytic source cannot tell what is visible of
            them.
    """

    steps: int
    files: BlockFiles
    counts: Counts
    boxes: BoxSample
    resumed_steps: int
    intersecting: frozenset[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class CensusBlock:
    """A block whose truth is made and kept, and whose targets are counted.

    Attributes:
        steps: Number of steps.
        census: Of its targets.
        resumed_steps: Number of steps whose truth was taken from an interrupted run: all or none.
    """

    steps: int
    census: TargetCensus
    resumed_steps: int


class BlockMaker:
    """Makes the blocks of a scene, from truth to files."""

    def __init__(self, scene: Scene, renderer: IdRenderer | None, truth_run: Path | None = None) -> None:
        """Take what all blocks share.

        Args:
            scene: The scene.
            renderer: From `open_renderer`; None with a truth run.
            truth_run: A finished run of the scene whose truth is used; truth is made if None.
        """
        self._scene = scene
        self._renderer = renderer
        self._truth_run = truth_run
        self._simulation: Simulation | None = None
        self.backend = renderer.context.description if renderer else "none"

    def count_targets(self, steps: Range, folder: Path) -> CensusBlock:
        """Count the targets of a block.

        Args:
            steps: First step, and the step after the last.
            folder: Where truth is kept.
        """
        first, stop = steps
        truth, resumed_steps = self._truth(folder, first, stop)
        return CensusBlock(stop - first, scene_census(self._scene, [(truth, first, stop)]), resumed_steps)

    def make(self, steps: Range, folder: Path, census: TargetCensus) -> FinishedBlock:
        """Make a block.

        Args:
            steps: First step, and the step after the last.
            folder: Where truth is kept.
            census: Of the whole scene, the same for all blocks.
        """
        first, stop = steps
        truth, resumed_steps = self._truth(folder, first, stop)
        if self._simulation is None:
            self._simulation = Simulation(self._scene, census)
        block = self._simulation.detect(truth, first, stop)
        return FinishedBlock(
            steps=stop - first,
            files=BlockFiles.of(block, self._scene),
            counts=Counts.of(block, self._scene),
            boxes=BoxSample.of(block, self._scene),
            resumed_steps=resumed_steps,
            intersecting=frozenset((one, other) for one, other in truth.intersections[:, 2:].tolist()),
        )

    def _truth(self, folder: Path, first: int, stop: int) -> tuple[Truth, int]:
        """The truth of some steps, and the number of steps that an interrupted run had kept."""
        if self._truth_run is not None:
            return read_truth(self._truth_run, self._scene, first, stop), 0
        truth = finished_truth(folder, first, stop)
        if truth is not None:
            return truth, stop - first
        truth = truth_block(self._scene, first, stop, self._renderer)
        if not self._scene.live:  # a live run cannot be resumed
            keep_truth(folder, truth, first, stop)
        return truth, 0


BlockWorkers = Workers[BlockMaker]


def open_block_workers(scene: Scene, count: int, truth_run: Path | None = None) -> AbstractContextManager[BlockWorkers]:
    """One worker in this process, or several in processes of their own.

    Args:
        scene: The scene.
        count: Number of workers.
        truth_run: A finished run of the scene whose truth is used, so that no renderer is needed; truth is made if
            None.

    Raises:
        ModsimError: This process cannot start others.
        RendererError: There is no OpenGL library; with several workers, when they are first used.
    """
    return open_workers(count, IF_KILLED, _open_block_maker, scene, truth_run)


def backend_of(workers: BlockWorkers) -> str:
    """What draws the ID images: `none`, or a description of the OpenGL context.

    Raises:
        RendererError: There is no OpenGL library.
    """
    (backend,) = workers.map(_backend, [None])
    return backend


def _backend(maker: BlockMaker, _: None) -> str:
    return maker.backend


@contextmanager
def _open_block_maker(scene: Scene, truth_run: Path | None) -> Iterator[BlockMaker]:
    if truth_run is not None:
        yield BlockMaker(scene, None, truth_run)
        return
    with open_renderer(scene) as renderer:  # in a worker process an OpenGL context of its own
        yield BlockMaker(scene, renderer)
