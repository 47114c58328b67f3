"""A case: the files that a reader's name and a number stand for; those that failed once are in `kept/READER.json`."""

import base64
import gzip
import json
import random
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from tests.fuzz import binaries
from tests.fuzz.binaries import change_table
from tests.fuzz.corpora import Files
from tests.fuzz.readers import READERS
from tests.fuzz.structures import change_json_line, change_structure
from tests.fuzz.texts import YAML, change_bytes, change_cell, change_line, change_packed, change_whole

Change = Callable[[random.Random, bytes, list[bytes]], bytes | None]

_TEXT: tuple[Change, ...] = (change_cell, change_cell, change_cell, change_line, change_line, change_bytes)
_BY_ENDING: dict[str, tuple[Change, ...]] = {
    ".json": (*[change_structure] * 6, change_bytes, change_line, change_cell),
    ".yaml": (*[partial(change_structure, form=YAML)] * 6, change_bytes, change_line, change_cell),
    ".jsonl": (*[change_json_line] * 5, change_bytes, change_line, change_line, change_cell),
    ".glb": (*[binaries.change_glb] * 5, change_bytes),
    ".stl": (binaries.change_binary_stl, binaries.change_binary_stl, change_bytes, change_cell),
    ".ply": (binaries.change_after_header, change_cell, change_cell, change_line, change_bytes),
    ".nmea": (*[binaries.change_sentence] * 4, change_cell, change_line, change_bytes),
    ".parquet": (*[change_table] * 8, change_bytes),
    ".npz": (*[binaries.change_archive] * 5, change_bytes),
    **dict.fromkeys((".png", ".jpeg", ".bmp", ".webp", ".tiff"), (binaries.change_image,)),
}
_SPOILS_ALL, _FINISHED = 0.05, 0.75
_MAX_BYTES, _MAX_PACKED_BYTES = 2_000_000, 30_000
"""Several changes could repeat a file to gigabytes, and a larger packed file is a bomb already."""


def files_of(reader: str, number: int) -> Files:
    """The files of a case; always the same for the same number."""
    rng = random.Random(f"{reader} {number}")
    files = dict(READERS[reader].bases()[base_number(reader, number)])
    for _ in range(rng.choices((1, 2, 3, 8), (80, 12, 5, 3))[0]):
        _spoil(rng, files)
    if rng.random() < _FINISHED:
        READERS[reader].finish(files)
    return files


def base_number(reader: str, number: int) -> int:
    """Which of the reader's good inputs a case begins with."""
    return number % len(READERS[reader].bases())


def _weight(name: str) -> int:
    """How often a file is changed, against the others of its folder."""
    stem, _, ending = PurePosixPath(name).name.partition(".")
    if stem.startswith(("annotations_", "detections_", "tracker_input_")):  # of a run, which nothing reads again
        return 0
    return 6 if ending in ("parquet", "npz") or stem in ("scene", "live") else 1


def _spoil(rng: random.Random, files: Files) -> None:
    """Change, lose or rename one file."""
    if not files:
        return
    (name,) = rng.choices(list(files), [_weight(name) for name in files])
    chance = rng.random()
    content = files[name]
    if chance < 0.01:
        del files[name]
    elif chance < 0.02:
        files[rng.choice((name + "x", name.upper(), f"{name}.gz"))] = files.pop(name)
    elif content is not None:
        others = [other for other in files.values() if other is not None]
        try:
            changed = _changed(rng, name, content, others)
        except Exception:  # what an earlier change left is nested too deeply, say, to be changed as what it was
            changed = change_bytes(rng, content, others)
        files[name] = changed if changed is None or len(changed) <= _MAX_BYTES else content


def _changed(rng: random.Random, name: str, content: bytes, others: list[bytes]) -> bytes | None:
    if rng.random() < _SPOILS_ALL:
        return rng.choice((change_whole, change_whole, change_whole, change_packed))(rng, content, others)
    path = PurePosixPath(name)
    packed = path.suffix == ".gz"
    if packed and len(content) > _MAX_PACKED_BYTES:
        return content
    if packed and rng.random() < 0.85:
        try:
            inner = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            inner = content
        changed = rng.choice(_BY_ENDING.get(path.with_suffix("").suffix, _TEXT))(rng, inner, others)
        return None if changed is None else gzip.compress(changed, 1, mtime=0)
    changes: Sequence[Change] = (change_bytes,) if packed else _BY_ENDING.get(path.suffix, _TEXT)
    return rng.choice(changes)(rng, content, others)


FOLDER = Path(__file__).parent / "kept"
MAX_SIZE = 20_000
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
    if _size(found[0]) > MAX_SIZE or any(entry["cause"] == cause for entry in entries):
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
