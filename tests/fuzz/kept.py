"""Inputs that failed once, kept in `kept/READER.json`: what differs from a good input, and why it failed."""

import base64
import gzip
import json
from pathlib import Path
from typing import Any

from tests.fuzz.cases import base_number, files_of
from tests.fuzz.corpora import Files
from tests.fuzz.readers import READERS

FOLDER = Path(__file__).parent / "kept"
LARGEST = 20_000
"""A larger input is not kept."""


def kept_inputs(reader: str) -> list[dict[str, Any]]:
    """What is kept of a reader."""
    path = FOLDER / f"{reader}.json"
    return list(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else []


def files_of_kept(reader: str, entry: dict[str, Any]) -> Files:
    """The files of an input that is kept."""
    good = READERS[reader].bases()[entry["base"]]
    files = {name: content for name, content in good.items() if name not in entry["gone"]}
    return {**files, **{name: _unpacked(content) for name, content in entry["files"].items()}}


def keep(reader: str, cause: str, numbers: list[int]) -> None:
    """Keep the smallest of some cases that failed for one cause, unless such a one is kept."""
    entries = kept_inputs(reader)
    found = sorted((_entry(reader, number, cause) for number in numbers), key=_size)
    if _size(found[0]) > LARGEST or any(entry["cause"] == cause for entry in entries):
        return
    FOLDER.mkdir(exist_ok=True)
    lines = ",\n".join(map(json.dumps, [*entries, found[0]]))  # an input a line
    (FOLDER / f"{reader}.json").write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def _entry(reader: str, number: int, cause: str) -> dict[str, Any]:
    base, files = base_number(reader, number), files_of(reader, number)
    good = READERS[reader].bases()[base]
    changed = {name: _packed(content) for name, content in files.items() if name not in good or good[name] != content}
    return {"cause": cause, "base": base, "gone": [name for name in good if name not in files], "files": changed}


def _size(entry: dict[str, Any]) -> int:
    return len(json.dumps(entry))


def _packed(content: bytes | None) -> Any:
    """Text as it is, other content packed and in base 64, a folder as None."""
    if content is None:
        return None
    try:
        return content.decode("ascii")
    except UnicodeDecodeError:
        return {"gzip_base64": base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()}


def _unpacked(content: Any) -> bytes | None:
    if content is None:
        return None
    return content.encode() if isinstance(content, str) else gzip.decompress(base64.b64decode(content["gzip_base64"]))
