"""Workers that make the blocks of a run; which of them makes a block changes nothing in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.detector.census import TargetCensus
from modsim3d.processes import WorkerCount, Workers, open_workers
from modsim3d.runs.box_sample import BoxSample
from modsim3d.runs.counts import Counts, camera_counts
from modsim3d.runs.files.block_files import BlockFiles, finished_truth, kept_truth_path, truth_kept
from modsim3d.runs.files.reading import truth_of
from modsim3d.runs.files.stored_tables import StoredTable
from modsim3d.runs.pipeline import Range, Simulation, open_renderer, scene_census, truth_block
from modsim3d.runs.truth_check import TruthCheckError, check_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.crosscheck.comparison import Checked
from modsim3d.truth.truth_record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

IF_KILLED = "what was finished is kept: go on with --resume, perhaps with fewer --workers"


@dataclass(frozen=True, eq=False)
class Tally:
    """What happened in one or more blocks; tallies can be added.

    Attributes:
        resumed_steps: Number of steps whose truth was taken from an interrupted run.
        damaged_blocks: Number of blocks whose truth an interrupted run had kept in a file that is damaged.
        camera_counts: What happened, by name of the camera.
        boxes: A sample of the detected boxes.
        intersecting: Pairs of vessels or obstacles whose hulls intersect, as indices: the analytic source cannot tell
            what is visible of them.
        checked: What the cross-check found.
    """

    steps: int = 0
    resumed_steps: int = 0
    damaged_blocks: int = 0
    camera_counts: dict[str, Counts] = field(default_factory=dict)
    boxes: BoxSample = field(default_factory=BoxSample)
    intersecting: frozenset[tuple[int, int]] = frozenset()
    checked: Checked = field(default_factory=Checked)

    def __add__(self, other: Tally) -> Tally:
        """Both together."""
        return Tally(
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

    def count_targets(self, steps: Range, folder: Path) -> tuple[Tally, TargetCensus]:
        """The census of a block's targets, with a tally of its steps; its truth is kept in the folder."""
        first, stop = steps
        with self._truth(folder, first, stop) as (truth, resumed_steps, damaged):
            tally = Tally(stop - first, resumed_steps, damaged, checked=self._check(truth, first, stop))
            return tally, scene_census(self._scene, [(truth, first, stop)])

    def make(self, steps: Range, folder: Path, census: TargetCensus, kinds: Sequence[str]) -> tuple[Tally, BlockFiles]:
        """What happened in a block, and what it adds to the files.

        Args:
            steps: First step, and the step after the last.
            folder: Where truth is kept.
            census: The census of the whole scene, the same for all blocks.
            kinds: The kinds of JSON lines, see `line_kinds`.
        """
        first, stop = steps
        with self._truth(folder, first, stop) as (truth, resumed_steps, damaged_blocks):
            checked = Checked() if self._scene.detector.needs_census else self._check(truth, first, stop)
            if self._simulation is None:
                self._simulation = Simulation(self._scene, census)
            block = self._simulation.detect(truth, first, stop)
            tally = Tally(
                steps=stop - first,
                resumed_steps=resumed_steps,
                damaged_blocks=damaged_blocks,
                camera_counts=camera_counts(block, self._scene),
                boxes=BoxSample.of(block, self._scene),
                intersecting=frozenset((one, other) for one, other in truth.intersections[:, 2:].tolist()),
                checked=checked,
            )
            return tally, BlockFiles.of(block, self._scene, kinds)

    def _check(self, truth: Truth, first: int, stop: int) -> Checked:
        """The cross-check of a block's truth, before the detector sees it; also of a truth that was kept."""
        return check_block(self._scene, truth, first, stop, self._renderer)

    @contextmanager
    def _truth(self, folder: Path, first: int, stop: int) -> Iterator[tuple[Truth, int, int]]:
        """The truth of some steps, the number of steps that an interrupted run had kept, and of damaged blocks.

        Truth that is new is kept, at the latest when the context ends, unless the cross-check finds it wrong.
        """
        try:
            with self._truth_and_kept(folder, first, stop) as found:
                yield found
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
    """One worker in this process, and perhaps more in processes of their own; see `BlockMaker`.

    Raises:
        RendererError: There is no OpenGL library.
    """
    return open_workers(workers, IF_KILLED, _open_block_maker, scene, truth_run, here_too=True)


def backend_of(workers: BlockWorkers) -> str:
    """A description of the OpenGL context that draws the ID images; `none` if nothing is rendered.

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
        yield BlockMaker(scene, None, StoredTable(truth_run, "truth", scene))
        return
    with open_renderer(scene) as renderer:  # in a worker process an OpenGL context of its own
        yield BlockMaker(scene, renderer)
