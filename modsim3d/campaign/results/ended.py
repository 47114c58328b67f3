"""The list of the files of a campaign that has ended, with their sizes and checksums, as `run.json` has it of a run."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import orjson

from modsim3d.errors import ModsimError
from modsim3d.outputs.placing import sync_file
from modsim3d.runs.files.file_list import FileList, ListedFile, file_list, listed

RESULTS, SEARCH = "results", "search"
"""In the folder of a campaign that has ended: its rows, and the trials of a search."""
LIST = "_files.json"
"""In one of these; readers of data sets pass over names that begin so."""
_ROWS = "**/*.parquet"


def write_list(folder: Path, rows: Path, final: str, names: tuple[str, ...], later: Mapping[str, bytes]) -> None:
    """Write the list among the rows before their folder gets its final name, so that no rows are ever without it.

    `names` are other files of the campaign's folder; of those that are written later the content is given.

    Raises:
        OSError: It cannot be written.
    """
    files = file_list(folder, names)
    files |= {f"{final}/{path.relative_to(rows).as_posix()}": listed(path) for path in rows.glob(_ROWS)}
    for name, content in later.items():
        files[name] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    (rows / LIST).write_bytes(orjson.dumps({"files": dict(sorted(files.items()))}, option=orjson.OPT_INDENT_2))
    sync_file(rows / LIST)


def check_ended(folder: Path, later: tuple[str, ...] = ()) -> None:
    """Check that the files of a campaign that has ended are those that it has written; those of `later` may be missing.

    Raises:
        ModsimError: One was changed, is missing or was added, or there is no list.
    """
    for rows in filter(Path.is_dir, (folder / RESULTS, folder / SEARCH)):
        path = rows / LIST
        try:
            read = orjson.loads(path.read_bytes())["files"].items()
            files: FileList = {name: {"bytes": each["bytes"], "sha256": each["sha256"]} for name, each in read}
            names = sorted({*files, *(each.relative_to(folder).as_posix() for each in rows.glob(_ROWS))})
            there = file_list(folder, (name for name in names if (folder / name).is_file()))
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            raise ModsimError(
                f"{path} cannot be read, or a file that it lists: {error}; remove {rows}, and the same command makes "
                "it again"
            ) from None
        for name in names:
            if there.get(name) != files.get(name) and (name in there or name not in later):
                said = f"it {_said(there.get(name))}, and in {path} it {_said(files.get(name))}"
                raise ModsimError(f"{folder / name} was changed after the campaign ended: {said}")


def _said(file: ListedFile | None) -> str:
    return "is missing" if file is None else f"has {file['bytes']} bytes and the checksum {file['sha256']}"
