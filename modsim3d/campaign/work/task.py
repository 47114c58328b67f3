"""A task: some runs that one worker does after another, and the file with their rows."""

import hashlib
import os
import platform
import time
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import TRACKER, Condition, PlannedRun, layer_of
from modsim3d.campaign.work.layers import CACHE_FOLDER, RunLayers
from modsim3d.campaign.work.row import CRASHED, SAID, crashed_row, error_and_said, row_of, table_of
from modsim3d.campaign.work.scenes import changed_files, digest
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.detector.file.unread_keys import unread_settings
from modsim3d.detector.model import DetectorModel
from modsim3d.io.plugins import changed_plugins
from modsim3d.io.validation import shown

PLAN = "plan.json"  # in the folder of a campaign: its plan
DONE_FOLDER = "done"  # in the folder of a campaign that is not finished: the rows that are done, a file for each task
ROWS_PATTERN = "[0-9]*.rows"  # the names of these files
_REPORT = b"modsim3d"
_CHECKSUM_BYTES = hashlib.sha256().digest_size


@dataclass(frozen=True)
class Work:
    """Settings that all tasks of a campaign have in common."""

    keys: CampaignKeys
    base: str  # folder that the paths of the campaign file are relative to
    folder: str  # of the campaign, which every worker can reach
    plan_sha256: str
    cache: str | None = None  # folder of layers on the disk; None: `cache` in that of the campaign
    files: Mapping[str, str] = field(default_factory=dict)  # checksums of those that scenes and detectors are made of
    plugins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # checksums of the files of each

    @property
    def layers(self) -> Path:
        """The folder of layers on the disk."""
        return Path(self.cache) if self.cache is not None else Path(self.folder) / CACHE_FOLDER


def with_cache(work: Work, cache: Path | None) -> Work:
    """Work with another folder of layers; None: that of the campaign."""
    return replace(work, cache=None if cache is None else str(cache.resolve()))


@dataclass(frozen=True)
class Task:
    """Some runs of a campaign."""

    work: Work
    runs: tuple[PlannedRun, ...]  # those with the same truth follow each other

    @property
    def path(self) -> Path:
        """The file with its rows, named by what is in it."""
        numbers = [run.number for run in self.runs]
        return Path(self.work.folder, DONE_FOLDER, name_of_rows(self.work.plan_sha256, numbers))


def name_of_rows(plan_sha256: str, numbers: Sequence[int]) -> str:
    """The name of the file with the rows of some runs of a plan."""
    return f"{numbers[0]:09d}_{digest(plan_sha256, list(numbers))[:16]}.rows"


@dataclass(frozen=True)
class TaskReport:
    """Cost of a task."""

    runs: int
    crashed: int  # number of runs that failed
    wall_s: float  # by the clock
    cpu_s: float  # of the processor
    host: str  # name of the machine
    process: int  # number of the process


class Worker:
    """Does tasks in one process, with one OpenGL context, in one thread."""

    def __init__(self) -> None:
        """Open nothing yet."""
        self._layers: tuple[str, RunLayers] | None = None

    def close(self) -> None:
        """Close what was opened."""
        if self._layers is not None:
            self._layers[1].close()
            self._layers = None

    def do(self, task: Task, begin: Callable[[int], None] = lambda number: None) -> TaskReport:
        """Do a task, unless its file is there, and write its file. `begin` is called with the number of each run before
        it is made. Raises OutputError if the file cannot be written, and ModsimError if a file that runs are made of is
        not as it was when the campaign was planned."""
        if (report := stored_report(task.path)) is not None:
            return report
        started, cpu = time.perf_counter(), time.process_time()
        rows = [self._row(run, task.work, begin) for run in task.runs]
        _check_unchanged(task.work)
        crashed, wall_s = sum(row["status"] == CRASHED for row in rows), time.perf_counter() - started
        report = TaskReport(len(rows), crashed, wall_s, time.process_time() - cpu, platform.node(), os.getpid())
        store(task.path, table_of(rows), report)
        return report

    def _row(self, run: PlannedRun, work: Work, begin: Callable[[int], None]) -> dict[str, object]:
        """Row of a run; one that fails, for whatever reason, has a row too. OutputError if a layer cannot be kept."""
        begin(run.number)
        try:
            return row_of(run.number, self._layers_of(work).layers_of(run), work.keys.score, work.keys.lookout)
        except OutputError:  # the disk is full: that says nothing about the run
            raise
        except Exception as error:
            problem, message = error_and_said(error)
            return crashed_row(run.number, problem, **({SAID: message} if message and work.keys.timed else {}))

    def _layers_of(self, work: Work) -> RunLayers:
        made_of = f"{work.plan_sha256} {work.layers}"
        if self._layers is None or self._layers[0] != made_of:
            self.close()
            self._layers = (made_of, RunLayers(work.keys, Path(work.base), work.layers))
        return self._layers[1]


def changes(work: Work) -> list[str]:
    """Changes of the files and plug-ins of a campaign, one line for each file."""
    return [*changed_files(work.files, Path(work.base)), *changed_plugins(work.plugins, "the campaign was planned")]


def _check_unchanged(work: Work) -> None:
    if problems := changes(work):
        own = "; what a program writes itself is not to be in its files"
        written = own if any(tracker.command is not None for tracker in work.keys.trackers) else ""
        raise ModsimError(f"{'; '.join(problems)}: put it back to go on, or choose another folder{written}")


def store_crashed(task: Task, error: str) -> None:
    """Write the file of a task whose runs ended their workers. Raises OutputError if it cannot be written, and
    ModsimError if a file that runs are made of is not as it was when the campaign was planned."""
    _check_unchanged(task.work)
    rows = [crashed_row(run.number, error) for run in task.runs]
    store(task.path, table_of(rows), TaskReport(len(rows), len(rows), 0.0, 0.0, "", 0))


def store(path: Path, table: pa.Table, report: TaskReport) -> None:
    """Write rows whole, under a name of their own until they are; another process may write the same file. It is a
    Parquet file, and after it comes its SHA-256, so that any damage is noticed before it is read. Raises OutputError if
    it cannot be written. So it is when the folder is gone: the campaign has ended without it."""
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    table = table.replace_schema_metadata({_REPORT: orjson.dumps(asdict(report))})
    content = pa.BufferOutputStream()
    pq.write_table(table, content, compression="zstd")
    written = content.getvalue().to_pybytes()
    try:
        with partial.open("wb") as out:
            out.write(written + hashlib.sha256(written).digest())
            out.flush()
            os.fsync(out.fileno())
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def read_rows(path: Path) -> pa.Table | None:
    """The rows of a task's file, with its report; None if there is no such file, or it is damaged."""
    try:
        content = memoryview(path.read_bytes())
    except OSError:
        return None
    written, checksum = content[:-_CHECKSUM_BYTES], content[-_CHECKSUM_BYTES:]
    if hashlib.sha256(written).digest() != checksum:
        return None
    return pq.ParquetFile(pa.BufferReader(written)).read(use_threads=False)


def stored_report(path: Path) -> TaskReport | None:
    """Report on its task in a file of rows; None if there is no such file, or it is damaged."""
    table = read_rows(path)
    return None if table is None else TaskReport(**orjson.loads(table.schema.metadata[_REPORT]))


_OPTIONS = {"state": "--state", "from": "--from", "detector": "--detector"}
"""Keys of a condition that messages of scenes call by the option of a command."""


def condition_problems(condition: Condition, error: ModsimError, section: str = "vary") -> Iterator[str]:
    """Problems of a condition, each with the key that it is about, or with all varied ones, by what its scene, its
    detector or a tracker said. `section` is where its keys are in the file."""
    if not isinstance(error, InputError):
        yield f"{_in_words(condition)}: {error}"
        return
    for problem in error.problems:
        text = f"{error.source}: {problem}"
        longest_first = sorted(condition.all_values, key=len, reverse=True)
        key = next((key for key in longest_first if _is_about(key, problem, text)), None)
        if key is None:
            yield f"{_in_words(condition)}: {text}"
        else:
            source = f" ({error.source})" if layer_of(key) == "tracks" else ""
            place = section if key in condition.values else "set"
            rest = problem.removeprefix(_option_of(key))
            rest = rest.removeprefix(":").strip() if rest.startswith((":", " ")) else rest
            yield f"{place}: {key} {shown(condition.all_values[key])}: {rest}{source}"


def key_readings(condition: Condition, detector: DetectorModel, searched: Collection[str]) -> Iterator[tuple[str, str]]:
    """Each key of a condition's detector, and why that does not read it; empty if it does."""
    values = condition.all_values
    paths = {key.removeprefix("detector."): key for key in values if key.startswith("detector.")}
    reasons = unread_settings(detector, paths, [key.removeprefix("detector.") for key in searched]) if paths else {}
    for path, key in paths.items():
        place = "set" if key in condition.fixed else "search.over" if key in searched else "vary"
        yield key, f"{place}: {key} {shown(values[key])}: {reasons[path]}" if path in reasons else ""


def tracker_problems(place: int, error: ModsimError) -> Iterator[str]:
    """The problems of a tracker, with its place in the file."""
    for problem in error.problems if isinstance(error, InputError) else (str(error),):
        yield f"trackers[{place}]: {problem.removeprefix('--set ')}"


def _is_about(key: str, problem: str, text: str) -> bool:
    """Whether a problem, or what is said with its source, is about a key."""
    if layer_of(key) == "tracks":
        return problem.startswith(f"{_option_of(key)}:")
    return _option_of(key) in text


def _option_of(key: str) -> str:
    if key in _OPTIONS:
        return _OPTIONS[key]
    return key.removeprefix(f"{TRACKER}.") if layer_of(key) == "tracks" else f"--set {key}"


def _in_words(condition: Condition) -> str:
    values = ", ".join(f"{key} {shown(value)}" for key, value in condition.values.items())
    return f"{condition.scene} with {values}" if values else condition.scene
