"""Repeats a finished run from the copy of its scene, and compares every file with the stored one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.core.arrays import Mask
from modsim3d.core.errors import RunDirectoryError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import listed as named
from modsim3d.io.processes import WorkerCount
from modsim3d.runs.files.block_files import THESIS_LINES
from modsim3d.runs.files.overwrite import POSES_FILE, RUN_FILE, SCENE_FOLDER, FileList, listed_file
from modsim3d.runs.files.stored_tables import damage_named
from modsim3d.runs.files.tables import number_column
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import FinishedRun, StoredRun, read_finished

# ---- How two files of the same name differ, in words ----

_MAX_COLUMNS = 6
SAME_ROWS = "the same rows, stored in other bytes"  # what `difference` says of tables of another writer


def difference(one: Path, other: Path) -> str:
    """Difference between two files of a run that have different bytes."""
    if one.suffix == ".parquet":
        return _of_tables(one, other)
    lines, others = one.read_bytes().splitlines(), other.read_bytes().splitlines()
    if len(lines) != len(others):
        return f"{len(lines)} lines against {len(others)}"
    return f"{sum(a != b for a, b in zip(lines, others, strict=True))} of {len(lines)} lines differ"


def settings_difference(one: bytes, other: bytes, left_out: frozenset[str]) -> str:
    """Entries that differ between two JSON objects, `left_out` aside; empty if none does."""
    first, second = (_flat(orjson.loads(text), left_out) for text in (one, other))
    keys = [key for key in sorted(first | second) if first.get(key) != second.get(key)]
    changes = [f"{key} {_value_text(first, key)} against {_value_text(second, key)}" for key in keys[:_MAX_COLUMNS]]
    return _listed(changes, len(keys))


def _flat(value: object, left_out: frozenset[str], path: str = "") -> dict[str, object]:
    """Values of nested objects by their path with dots."""
    if not isinstance(value, dict):
        return {path: value}
    entries: dict[str, object] = {}
    for key, entry in value.items():
        inner = f"{path}.{key}" if path else key
        if inner not in left_out:
            entries |= _flat(entry, left_out, inner)
    return entries


def _value_text(values: dict[str, object], key: str) -> str:
    return orjson.dumps(values[key]).decode() if key in values else "nothing"


def _of_tables(one: Path, other: Path) -> str:
    try:
        first, second = _rows(one), _rows(other)
    except RunDirectoryError as error:
        return str(error)
    if first.schema != second.schema:
        return "the columns are others"
    if len(first) != len(second):
        return f"{len(first)} rows against {len(second)}"
    columns = {name: _column(first, second, name) for name in first.column_names}
    differs = {name: rows for name, (rows, _) in columns.items() if rows.any()}
    if not differs:
        return SAME_ROWS
    rows = np.logical_or.reduce(list(differs.values())).sum()
    changes = [f"{name} in {mask.sum()}{columns[name][1]}" for name, mask in differs.items()]
    return f"{rows} of {len(first)} rows differ: {_listed(changes[:_MAX_COLUMNS], len(changes))}"


def _rows(path: Path) -> pa.Table:
    with damage_named(path):
        return pq.read_table(path)


def _column(first: pa.Table, second: pa.Table, name: str) -> tuple[Mask, str]:
    """Mask of the rows that differ in a column, shape (n,), and by how much at most."""
    one, other, kind = first[name], second[name], first.schema.field(name).type
    if one.equals(other):
        return np.zeros(len(one), dtype=bool), ""
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        return np.array([a != b for a, b in zip(one.to_pylist(), other.to_pylist(), strict=True)]), ""
    a, b = number_column(first, name), number_column(second, name)
    differs: Mask = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    apart = np.abs(a - b)[differs]
    most = apart[~np.isnan(apart)].max(initial=0.0)
    return differs, f" by {most:.2g} at most" if most else ""


def _listed(texts: list[str], count: int) -> str:
    return "; ".join([*texts, *([f"and {count - len(texts)} more"] if count > len(texts) else [])])


VERSION_KEYS = ("versions", "truth_versions", "plugins", "plugins_sha256", "backend")  # programs in `run.json`
_NOT_REPEATED = frozenset({*VERSION_KEYS, "files"})
_OF_LIVE_RUNS = frozenset({"scene_sha256", "poses_sha256"})  # the copy of a live scene reads its poses from a file


@dataclass(frozen=True)
class RepeatedFile:
    """A file of the stored run."""

    name: str  # path inside the run directory
    stored: str = ""  # what is wrong with the stored file against the list in run.json; empty if nothing is
    repeated: str = ""  # how the repeated run's file differs from the one written; empty if bytes are the same
    is_input: bool = False  # the run is repeated from this file, so that there is nothing to compare

    @property
    def same(self) -> bool:
        """Whether the file is what was written, and was made again."""
        return not (self.stored or self.repeated)


@dataclass(frozen=True)
class VersionDifference:
    """A program that was another when the run was made, such as `numpy`; None where there was or is none."""

    name: str
    then: str | None
    now: str | None


@dataclass(frozen=True, repr=False)
class Repetition:
    """Outcome of repeating a run; `listed` is whether its `run.json` lists its files, as older ones do not."""

    files: tuple[RepeatedFile, ...]
    versions: tuple[VersionDifference, ...]
    listed: bool

    @property
    def same(self) -> bool:
        """Whether every file is the same bytes."""
        return all(file.same for file in self.files)

    def __repr__(self) -> str:
        """The answer, and the names of the files that are not the same."""
        wrong = [file.name for file in self.files if not file.same]
        return f"<Repetition: {f'{named(wrong)} not the same' if wrong else 'the same bytes'}>"


def check_repeat(
    run: StoredRun | StrPath, *, workers: WorkerCount = 1, progress: Callable[[int], None] = lambda steps: None
) -> Repetition:
    """Repeat a run from the copy of its scene in a temporary folder, and compare every file, byte by byte.

        repetition = modsim3d.check_repeat("runs/first")
        repetition.same, [file.name for file in repetition.files if not file.same]

    Args:
        run: A finished run, or its directory.
        workers: Number of processes, or `auto` for one for each CPU.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The run is not finished, is damaged beyond its tables, or cannot be run again.
        TypeError: The run is neither text nor a path.
    """
    stored = read_finished(run.folder if isinstance(run, StoredRun) else as_path(run, "run"))
    with TemporaryDirectory(prefix="modsim3d_repeat_") as folder:
        return repeat_run(stored, Path(folder) / "again", workers=workers, progress=progress)


def repeat_run(
    run: FinishedRun, again: Path, *, workers: WorkerCount = 1, progress: Callable[[int], None] = lambda steps: None
) -> Repetition:
    """Run the scene of a run from `read_finished` into a new folder, and compare. Raises ModsimError if it cannot."""
    folder, content, _, scene = run
    listed: FileList = content.get("files") or {}
    thesis = [name for name in listed if name.startswith(tuple(THESIS_LINES)) and name.endswith(".json")]
    run_scene(scene, again, thesis_json=bool(thesis or not listed), workers=workers, progress=progress)
    made = orjson.loads((again / RUN_FILE).read_bytes())
    names = sorted({name for name in {**listed, **made["files"]} if not _is_input(name)})
    files = [_compared(folder, again, name, listed, made["files"]) for name in names]
    inputs = [name for name in listed if _is_input(name)]
    if not listed:
        inputs = [POSES_FILE] if (folder / POSES_FILE).is_file() else []
        inputs += [f"{SCENE_FOLDER}/{name}" for name in scene.copy.names]
    files += [RepeatedFile(name, _damage(folder, name, listed), is_input=True) for name in sorted(inputs)]
    # Older runs do not say where their traffic came from.
    later = {"traffic_seed", "traffic_sha256", "crosscheck"} - content.keys()
    left_out = _NOT_REPEATED | later | (_OF_LIVE_RUNS if "poses_sha256" in content else frozenset())
    settings = settings_difference((folder / RUN_FILE).read_bytes(), (again / RUN_FILE).read_bytes(), left_out)
    files.append(RepeatedFile(RUN_FILE, repeated=settings))
    return Repetition(tuple(files), tuple(_versions(content, made)), bool(listed))


def _is_input(name: str) -> bool:
    return name == POSES_FILE or name.startswith(f"{SCENE_FOLDER}/")


def _compared(stored: Path, again: Path, name: str, listed: FileList, made: FileList) -> RepeatedFile:
    """A file of the stored run against the list and against the repeated run."""
    damage = _damage(stored, name, listed)
    if name not in made:
        return RepeatedFile(name, damage, "was not made again")
    written = listed.get(name) if listed else _file(stored, name)
    if written == made[name]:
        return RepeatedFile(name, damage)
    if written is None:
        return RepeatedFile(name, damage, "was made now, and is not in the run")
    readable = (stored / name).is_file() and not damage
    return RepeatedFile(name, damage, difference(stored / name, again / name) if readable else "differs")


def _damage(folder: Path, name: str, listed: FileList) -> str:
    """Damage of a stored file; empty if there is none, or if nothing is known of the file."""
    entry = _file(folder, name)
    if entry is None:
        return "is missing" if name in listed or not listed else ""
    if name not in listed or entry == listed[name]:
        return ""
    if entry["bytes"] != listed[name]["bytes"]:
        return f"has {entry['bytes']} bytes, and was written with {listed[name]['bytes']}"
    return "is not what was written: its SHA-256 is another"


def _file(folder: Path, name: str) -> Any:
    return listed_file(folder / name) if (folder / name).is_file() else None


def _versions(then: dict[str, Any], now: dict[str, Any]) -> list[VersionDifference]:
    """Programs that are not the same."""
    before, today = _programs(then), _programs(now)
    truth = {f"{name} (truth)": version for name, version in then.get("truth_versions", {}).items()}
    today |= {name: today.get(name.removesuffix(" (truth)")) for name in truth}
    before |= truth
    names = [name for name in {**before, **today} if before.get(name) != today.get(name)]
    return [VersionDifference(name, before.get(name), today.get(name)) for name in names]


def _programs(settings: dict[str, Any]) -> dict[str, str | None]:
    files = {f"{name} (files)": sha256 for name, sha256 in settings.get("plugins_sha256", {}).items()}
    versions = {**settings.get("versions", {}), **settings.get("plugins", {}), **files}
    versions["renderer"] = settings.get("backend")
    return {name: None if version is None else str(version) for name, version in versions.items()}
