"""Blocks made in this process or in several; which one makes it changes nothing in a block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from modsim3d.annotate.truth_record import Truth
from modsim3d.box_sample import BoxSample
from modsim3d.counts import Counts
from modsim3d.detector.reference import Reference
from modsim3d.errors import ModsimError
from modsim3d.formats.block_files import BlockFiles, finished_truth, keep_truth
from modsim3d.formats.table_reader import read_truth
from modsim3d.processes import in_order, open_pool, result_of
from modsim3d.scene import Scene
from modsim3d.simulate import Simulation, open_renderer, survey, truth_block

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

DIED = "what was finished is kept: go on with --resume, perhaps with fewer --workers"

Range = tuple[int, int]


@dataclass(frozen=True, eq=False)
class FinishedBlock:
    """A block as it goes into the files.

    Attributes:
        steps: Number of its steps.
        files: Rows and lines.
        counts: What happened in it.
        boxes: Some of the boxes that were detected.
        resumed: Whether its truth was taken from an interrupted run.
        intersecting: Pairs of vessels whose boxes overlap in space, of which the analytic source knows nothing.
    """

    steps: int
    files: BlockFiles
    counts: Counts
    boxes: BoxSample
    resumed: bool
    intersecting: frozenset[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class SurveyedBlock:
    """A block whose truth is made and kept.

    Attributes:
        steps: Number of its steps.
        reference: What the detector must know of it.
        resumed: Whether its truth was taken from an interrupted run.
    """

    steps: int
    reference: Reference
    resumed: bool


class BlockMaker:
    """Makes blocks of a scene, each from truth to files."""

    def __init__(self, scene: Scene, renderer: IdRenderer | None, truth_run: Path | None = None) -> None:
        """Set up the detector.

        Args:
            scene: The scene.
            renderer: For the rendered source.
            truth_run: A finished run of the scene whose truth is taken; it is made anew if None.
        """
        self._scene = scene
        self._renderer = renderer
        self._truth_run = truth_run
        self._simulation: Simulation | None = None
        self.backend = renderer.context.description if renderer else "none"

    def survey(self, folder: Path, first: int, stop: int) -> SurveyedBlock:
        """What the detector must know of steps first to stop − 1 before it can begin.

        Args:
            folder: Where truth is kept.
            first: First step.
            stop: The step after the last.
        """
        truth, resumed = self._truth(folder, first, stop)
        return SurveyedBlock(stop - first, survey(self._scene, truth, first, stop), resumed)

    def make(self, folder: Path, first: int, stop: int, reference: Reference | None = None) -> FinishedBlock:
        """The block of steps first to stop − 1.

        Args:
            folder: Where truth is kept for runs that go on.
            first: First step.
            stop: The step after the last.
            reference: What the detector must know of the scene, the same for all blocks.
        """
        truth, resumed = self._truth(folder, first, stop)
        if self._simulation is None:
            self._simulation = Simulation(self._scene, reference)
        block = self._simulation.detect(truth, first, stop)
        counts = Counts.of(block, self._scene)
        boxes = BoxSample.of(block, self._scene)
        intersecting = frozenset((first, second) for first, second in truth.intersections[:, 2:].tolist())
        return FinishedBlock(stop - first, BlockFiles.of(block, self._scene), counts, boxes, resumed, intersecting)

    def _truth(self, folder: Path, first: int, stop: int) -> tuple[Truth, bool]:
        """The truth of some steps, and whether an interrupted run had it already."""
        if self._truth_run is not None:
            return read_truth(self._truth_run, self._scene, first, stop), False
        truth = finished_truth(folder, first, stop)
        if truth is not None:
            return truth, True
        truth = truth_block(self._scene, first, stop, self._renderer)
        if not self._scene.live:  # its steps do not come twice
            keep_truth(folder, truth, first, stop)
        return truth, False


class Workers(Protocol):
    """Something that makes blocks in order."""

    backend: str

    def surveys(self, folder: Path, ranges: Iterable[Range]) -> Iterator[SurveyedBlock]:
        """What the detector must know of the ranges, in their order."""

    def blocks(
        self, folder: Path, ranges: Iterable[Range], reference: Reference | None = None
    ) -> Iterator[FinishedBlock]:
        """The blocks of the ranges, in their order."""


class ThisProcess:
    """Makes blocks one after another."""

    def __init__(self, maker: BlockMaker) -> None:
        """Use a maker."""
        self._maker = maker
        self.backend = maker.backend

    def surveys(self, folder: Path, ranges: Iterable[Range]) -> Iterator[SurveyedBlock]:
        """What the detector must know of the ranges, in their order."""
        return (self._maker.survey(folder, *steps) for steps in ranges)

    def blocks(
        self, folder: Path, ranges: Iterable[Range], reference: Reference | None = None
    ) -> Iterator[FinishedBlock]:
        """The blocks of the ranges, in their order."""
        return (self._maker.make(folder, *steps, reference) for steps in ranges)


class Processes:
    """Makes blocks in several processes, each with an OpenGL context of its own, made after it has started."""

    def __init__(self, pool: ProcessPoolExecutor, count: int) -> None:
        """Use a pool of `count` processes."""
        self._pool = pool
        self._count = count
        self.backend = result_of(pool.submit(_backend), DIED)

    def surveys(self, folder: Path, ranges: Iterable[Range]) -> Iterator[SurveyedBlock]:
        """What the detector must know of the ranges, in their order.

        Raises:
            ModsimError: A worker died.
        """
        return in_order(self._pool, self._count, _survey, ((folder, *steps) for steps in ranges), DIED)

    def blocks(
        self, folder: Path, ranges: Iterable[Range], reference: Reference | None = None
    ) -> Iterator[FinishedBlock]:
        """The blocks of the ranges, in their order.

        Raises:
            ModsimError: A worker died.
        """
        return in_order(self._pool, self._count, _make, ((folder, *steps, reference) for steps in ranges), DIED)


@contextmanager
def open_workers(scene: Scene, count: int, truth_run: Path | None = None) -> Iterator[Workers]:
    """This process for one worker, or that many others.

    Args:
        scene: The scene.
        count: How many.
        truth_run: A finished run of the scene whose truth is taken, without a renderer; it is made anew if None.

    Raises:
        RendererError: There is no OpenGL library.
    """
    if count == 1:
        with _block_maker(scene, truth_run) as maker:
            yield ThisProcess(maker)
        return
    with open_pool(count, _start, scene, truth_run) as pool:
        yield Processes(pool, count)


@contextmanager
def _block_maker(scene: Scene, truth_run: Path | None) -> Iterator[BlockMaker]:
    if truth_run is not None:
        yield BlockMaker(scene, None, truth_run)
        return
    with open_renderer(scene) as renderer:
        yield BlockMaker(scene, renderer)


_maker: BlockMaker | ModsimError | None = None
_open = ExitStack()


def _start(scene: Scene, truth_run: Path | None) -> None:
    """Set a worker up once; its context lives as long as it does."""
    global _maker
    try:
        _maker = _open.enter_context(_block_maker(scene, truth_run))
    except ModsimError as error:
        _maker = error  # an error here would break the pool, and nobody would learn what it was


def _this_maker() -> BlockMaker:
    if isinstance(_maker, BlockMaker):
        return _maker
    raise _maker or ModsimError("this process was not set up as a worker")


def _backend() -> str:
    return _this_maker().backend


def _survey(piece: tuple[Path, int, int]) -> SurveyedBlock:
    return _this_maker().survey(*piece)


def _make(piece: tuple[Path, int, int, Reference | None]) -> FinishedBlock:
    return _this_maker().make(*piece)
