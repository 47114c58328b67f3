"""The tables of a finished run, checked when they are opened and as their rows are read."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.core.arrays import NOBODY, Indices, positions
from modsim3d.core.boxes import corner_form
from modsim3d.core.errors import RunDirectoryError
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, MERGED, CameraFrames, Detections, Targets
from modsim3d.runs.files import table_columns, tables
from modsim3d.runs.files.block_files import OWN_SHIP, schemas_of
from modsim3d.runs.files.overwrite import RUN_FILE
from modsim3d.runs.files.row_checks import TableRows, check_detections, check_frames, check_together, check_truth
from modsim3d.runs.files.run_file import FileEntry, check_content
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import Truth


def truth_of(table: pa.Table, scene: Scene) -> Truth:
    """The truth in rows of the table `truth` of a run, which does not say what intersects: `intersections` is empty."""
    occluders = tables.Occluders.of(table, scene.occluder_names)
    return Truth(
        step=tables.integer_column(table, "step"),
        camera=tables.indices(table, "camera", [camera.name for camera in scene.cameras]),
        vessel=tables.indices(table, "vessel", scene.vessel_names),
        full_boxes_px=tables.truth_boxes_px(table, "full"),
        visible_boxes_px=tables.truth_boxes_px(table, "visible"),
        **{name: tables.number_column(table, name) for name in table_columns.TRUTH_NUMBERS},
        occluder_offsets=occluders.offsets,
        occluder=occluders.name,
        occluder_px=occluders.px,
        annotated=tables.flags(table, "annotated"),
        drawn=np.zeros(len(table), dtype=bool),
        intersections=np.empty((0, 4), dtype=np.int64),
    )


def detections_of(
    rows: Mapping[str, pa.Table], model: DetectorModel, frames: CameraFrames, targets: Targets
) -> Detections:
    """The detections of a camera in a run, whose detector was given these targets, the annotated vessels in all frames
    of the camera at some steps; `rows` are those of `frames`, `truth` and `detections` of the same steps. The detector
    need not be the run's. The tables do not say which box errors were resampled, so `redrawn` is false. They do not say
    which vessels the limit on the number of detections or the operating threshold removed either, so `gated` knows only
    the other gates. Raises RunDirectoryError if the model does not know a state or a label in the tables."""
    chosen = {name: table.filter(pc.equal(table["camera"], frames.camera)) for name, table in rows.items()}
    table = chosen["detections"]
    frame = np.searchsorted(frames.steps, tables.integer_column(table, "step"))
    kind = tables.indices(table, "kind", KINDS)
    count, vessel = len(targets.vessel_ids), tables.indices(table, "vessel", targets.vessel_ids)
    wanted = np.where(vessel == NOBODY, NOBODY, frame * count + vessel)
    target = positions(targets.frame * count + targets.vessel, wanted)
    return Detections(
        states=_known_indices(chosen["frames"], "state", [state.name for state in model.states]),
        frame=frame,
        target=target,
        partner=_partners(chosen["truth"], targets, frame, target, kind),
        kind=kind,
        label=_known_indices(table, "label", model.labels),
        confidence=tables.number_column(table, "confidence"),
        boxes_px=tables.detection_boxes_px(table),
        errors_px=np.column_stack([tables.number_column(table, name) for name in table_columns.ERRORS]),
        redrawn=np.zeros(len(table), dtype=bool),
        gated=~model.gates.passed(frames, targets),
    )


def _partners(truth: pa.Table, targets: Targets, frame: Indices, target: Indices, kind: Indices) -> Indices:
    """Row of the second target of each merged box, else −1, shape (m,). The second targets of a frame are those that
    were detected and have no box of their own. The tables do not say which of them belongs to which of several merged
    boxes of a frame, so they are assigned in order."""
    partner = np.full(len(frame), -1)
    merged = np.flatnonzero(kind == MERGED)
    without_box = tables.flags(truth, "detected")[tables.flags(truth, "annotated")]
    without_box[target[target >= 0]] = False
    rows = np.flatnonzero(without_box)
    for where in np.unique(frame[merged]):
        partner[merged[frame[merged] == where]] = rows[targets.frame[rows] == where]
    return partner


def _known_indices(table: pa.Table, name: str, names: Sequence[str]) -> Indices:
    """A column of names as indices; a name that the detector does not know is an error."""
    indices = tables.indices(table, name, names)
    unknown = np.flatnonzero(indices == NOBODY)
    if len(unknown):
        raise RunDirectoryError(
            f"the run has the {name} '{table[name][int(unknown[0])]}', which is not one of the detector file's "
            f"({', '.join(names)}): this detector cannot have made this run"
        )
    return indices


_CENTRE_FORM = dict(zip(table_columns.CENTRE_FORM, ("x_px", "y_px", "width_px", "height_px"), strict=True))
BEFORE_IOU = pa.schema([field for field in tables.DETECTIONS if field.name != "iou"])
FORMAT_1_DETECTIONS = pa.schema(
    [
        field.with_name(_CENTRE_FORM.get(field.name, field.name)).remove_metadata()
        for field in BEFORE_IOU
        if field.name not in table_columns.BOX_SIDES
    ]
)


def from_former(table: pa.Table) -> pa.Table:
    """Rows of a former table as rows of today's, without IoU; corners of format 1 are rounded as the centres were."""
    columns = dict(zip(table.column_names, table.columns, strict=True)) | {"iou": pa.nulls(len(table), pa.float64())}
    if table.column_names == FORMAT_1_DETECTIONS.names:
        boxes_px = corner_form(np.column_stack([tables.number_column(table, name) for name in _CENTRE_FORM.values()]))
        columns |= {name: columns[former] for name, former in _CENTRE_FORM.items()}
        columns |= {side: pa.array(boxes_px[:, i], from_pandas=True) for i, side in enumerate(table_columns.BOX_SIDES)}
    return pa.table([columns[name] for name in tables.DETECTIONS.names], schema=tables.DETECTIONS)


CHECKS: dict[str, Callable[[TableRows, Scene], object]] = {
    "frames": check_frames,
    "truth": check_truth,
    "detections": check_detections,
}


class StoredTable:
    """A table of a finished run, whose footer has been checked; its rows are checked as they are read."""

    def __init__(self, folder: Path, name: str, scene: Scene) -> None:
        """Check the footer: the columns and their types, and the steps of each row group. Raises RunDirectoryError if
        the file is not the table that a run of the scene has written."""
        self.path = folder / f"{name}.parquet"
        self._name, self._scene, self._run = name, scene, _identity(folder / RUN_FILE)
        self._kept: tuple[tuple[int, int], pa.Table] | None = None
        with damage_named(self.path):
            self._metadata = pq.read_metadata(self.path)
            footer, wanted = self._metadata.schema.to_arrow_schema(), schemas_of(scene)[name]
            former = [FORMAT_1_DETECTIONS, BEFORE_IOU] if name == "detections" else []
            self._former = next((schema for schema in former if schema.names == footer.names), None)
            _check_schema(self.path, footer, wanted if self._former is None else self._former)
            self._steps = self._steps_of_groups()
        rows = [self._metadata.row_group(i).num_rows for i in range(self._metadata.num_row_groups)]
        self._first_row = np.concatenate([[0], np.cumsum(rows, dtype=np.int64)])
        self._check_steps()

    def __len__(self) -> int:
        """Number of rows."""
        return int(self._metadata.num_rows)

    def groups(self) -> Iterator[pa.Table]:
        """The rows, about a row group at a time: the table of a long run is larger than memory. A step that is in two
        row groups comes whole. Raises RunDirectoryError if a row is not what a run has written."""
        first = 0
        for stop in (self._steps[:, 1] + 1).tolist():
            if stop > first:
                yield self.rows(first, stop).table
                first = stop

    def rows(self, first: int, stop: int) -> TableRows:
        """The rows of steps first to stop − 1; only the row groups are read that may hold such rows. Raises
        RunDirectoryError if a row is not what a run has written."""
        here = np.flatnonzero((self._steps[:, 1] >= first) & (self._steps[:, 0] < stop))
        begin, end = (int(here[0]), int(here[-1]) + 1) if len(here) else (0, 0)
        return self._checked(begin, end, first, stop)

    def _checked(self, begin: int, end: int, first: int, stop: int) -> TableRows:
        """The checked rows of steps first to stop − 1 in row groups begin to end − 1."""
        whole = TableRows(self.path, int(self._first_row[begin]), self._groups(begin, end), first, stop)
        steps = whole.integers("step")
        whole.refuse("step", np.diff(steps, prepend=-1) < 0, "in ascending order")
        low, high = np.searchsorted(steps, (first, stop)).tolist()
        rows = TableRows(self.path, whole.first_row + low, whole.table.slice(low, high - low), first, stop)
        CHECKS[self._name](rows, self._scene)
        return rows

    def _groups(self, begin: int, end: int) -> pa.Table:
        """The rows of row groups begin to end − 1; a single one is kept, as many readers ask for a few steps a time."""
        with self._of_one_run(), damage_named(self.path):
            if self._kept is not None and self._kept[0] == (begin, end):
                return self._kept[1]
            with pq.ParquetFile(self.path, metadata=self._metadata) as file:
                table = file.read_row_groups(range(begin, end), use_threads=False).combine_chunks()
            table.validate()
        if self._former is not None:
            table = from_former(table)
        self._kept = ((begin, end), table) if end == begin + 1 else None
        return table

    @contextmanager
    def _of_one_run(self) -> Iterator[None]:
        """Tell a run that is replaced while it is read from one that is damaged."""
        try:
            yield
        finally:
            if _identity(self.path.with_name(RUN_FILE)) != self._run:
                folder = self.path.parent
                raise RunDirectoryError(f"{folder} was replaced by another run while it was read: open it again")

    def _steps_of_groups(self) -> Indices:
        """The least and the greatest step of each row group, shape (groups, 2)."""
        column = self._metadata.schema.names.index("step")
        ranges = []
        for group in range(self._metadata.num_row_groups):
            stats = self._metadata.row_group(group).column(column).statistics
            if stats is not None and stats.has_min_max:
                ranges.append((stats.min, stats.max))
                continue
            with pq.ParquetFile(self.path) as file:
                steps = file.read_row_group(group, columns=["step"], use_threads=False)["step"].drop_null().to_numpy()
            if len(steps):
                ranges.append((steps.min(), steps.max()))
            else:
                ranges.append(ranges[-1] if ranges else (0, 0))
        return np.array(ranges, dtype=np.int64).reshape(-1, 2)

    def _check_steps(self) -> None:
        stop = self._scene.steps
        for group, (least, greatest) in enumerate(self._steps.tolist()):
            if least < 0 or greatest >= stop:
                step = least if least < 0 else greatest
                raise RunDirectoryError(
                    f"{self.path} is not what a run has written: column 'step' has {step} in rows "
                    f"{self._first_row[group]} to {self._first_row[group + 1] - 1}; the run has steps 0 to {stop - 1}"
                )
            if group and least < self._steps[group - 1, 1]:
                raise RunDirectoryError(
                    f"{self.path} is not what a run has written: column 'step' has {least} after "
                    f"{self._steps[group - 1, 1]}, at or after row {self._first_row[group]}; steps must ascend"
                )


class StoredTables:
    """The tables `frames`, `truth` and `detections` of a finished run."""

    def __init__(self, folder: Path, scene: Scene, listed: Mapping[str, FileEntry] | None = None) -> None:
        """Check the footers of all tables. The detector of the scene need not be the run's; `listed` is the list of
        files in `run.json`, None if it has none or was compared before. Raises RunDirectoryError if a table is missing,
        or is not what a run of the scene has written."""
        self._scene, self._listed = scene, listed or {}
        self.by_name = {name: StoredTable(folder, name, scene) for name in CHECKS}
        self._own_ship = folder / f"{OWN_SHIP}.parquet"
        if OWN_SHIP in schemas_of(scene):
            with damage_named(self._own_ship):
                footer, wanted = pq.read_schema(self._own_ship), schemas_of(scene)[OWN_SHIP]
                former = footer.names == table_columns.BEFORE_ATTITUDE.names
                _check_schema(self._own_ship, footer, table_columns.BEFORE_ATTITUDE if former else wanted)

    def check_counts(self, counts: dict[str, float]) -> None:
        """Raise RunDirectoryError if a table has another number of rows than by the counts of `run.json`."""
        expected = {
            "frames": counts["frames"],
            "truth": counts["vessel_frames"],
            "detections": counts["detected"] - counts["merged"] + counts["false_positives"],
        }
        for name, rows in expected.items():
            if len(table := self.by_name[name]) != rows:
                raise RunDirectoryError(f"{table.path} has {len(table)} rows, but {rows:g} by the counts of run.json")

    def truth(self, first: int, stop: int) -> pa.Table:
        """The truth of steps first to stop − 1. Raises RunDirectoryError if a row is not what a run has written."""
        return self.by_name["truth"].rows(first, stop).table

    def rows_of(self, name: str) -> pa.Table:
        """All rows of one table. Raises RunDirectoryError if a row is not what a run has written, or the table is not
        the one that the run has listed."""
        self._check_checksum(self.by_name[name].path)
        return self.by_name[name].rows(0, self._scene.steps).table

    def own_ship(self) -> pa.Table:
        """All rows of the table of vessels with cameras. Raises RunDirectoryError if the run has listed another."""
        self._check_checksum(self._own_ship)
        with damage_named(self._own_ship):
            table = pq.read_table(self._own_ship)
        former = table.column_names == table_columns.BEFORE_ATTITUDE.names
        return table_columns.with_attitude(table) if former else table

    def rows(self, first: int, stop: int) -> dict[str, pa.Table]:
        """The rows of steps first to stop − 1 by the table's name. Raises RunDirectoryError if a row is not what a run
        has written, two tables contradict each other, or, once all rows are read, the run has listed another."""
        rows = {name: table.rows(first, stop) for name, table in self.by_name.items()}
        check_together(rows["frames"], rows["truth"], rows["detections"], self._scene)
        if stop - first == self._scene.steps:
            self.check_checksums()
        return {name: part.table for name, part in rows.items()}

    def check_checksums(self) -> None:
        """Raise RunDirectoryError if a table has not the checksum in `run.json`, where this lists it."""
        for table in self.by_name.values():
            self._check_checksum(table.path)

    def _check_checksum(self, path: Path) -> None:
        if entry := self._listed.get(path.name):
            check_content(path, entry.sha256, RUN_FILE)


def _identity(run_file: Path) -> tuple[int, int] | None:
    """Identity of a `run.json`: it is the first file to go and the last to come when a run is replaced."""
    try:
        status = run_file.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def _check_schema(path: Path, schema: pa.Schema, wanted: pa.Schema) -> None:
    """Raise RunDirectoryError if a column of a table is missing, is not known, or has another type or place."""
    if schema.equals(wanted):  # names and types in their order; tenfold as fast as to ask for each
        return
    problems = [f"column '{name}' is missing" for name in wanted.names if name not in schema.names]
    problems += [f"column '{name}' is there twice" for name in wanted.names if schema.names.count(name) > 1]
    problems += [f"column '{name}' is unknown" for name in schema.names if name not in wanted.names]
    problems += [
        f"column '{field.name}' has type {field.type}, not {wanted.field(field.name).type}"
        for field in schema
        if field.name in wanted.names and field.type != wanted.field(field.name).type
    ]
    if not problems and schema.names != wanted.names:
        problems = [f"its columns are in another order: {', '.join(schema.names)}"]
    if problems:
        more = f", and {len(problems) - 1} more" if len(problems) > 1 else ""
        raise RunDirectoryError(f"{path} is not what a run has written: {problems[0]}{more}")


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Errors of reading a table as one error that names its file: RunDirectoryError if the file is missing, cannot be
    read, or is not the table that a run has written."""
    try:
        yield
    except FileNotFoundError:
        raise RunDirectoryError(f"{path} is missing: a finished run has it; copy the whole run directory") from None
    except PermissionError as error:
        raise RunDirectoryError(f"{path} cannot be read: {error.strerror or error}") from None
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        text = str(error).splitlines() or [type(error).__name__]
        raise RunDirectoryError(f"{path} is not what a run has written: {text[0]}") from None
