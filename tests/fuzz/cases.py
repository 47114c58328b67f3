"""A case: the files that a reader's name and a number stand for."""

import gzip
import random
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import PurePosixPath

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
_LARGEST, _LARGEST_PACKED = 2_000_000, 30_000
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
        files[name] = changed if changed is None or len(changed) <= _LARGEST else content


def _changed(rng: random.Random, name: str, content: bytes, others: list[bytes]) -> bytes | None:
    if rng.random() < _SPOILS_ALL:
        return rng.choice((change_whole, change_whole, change_whole, change_packed))(rng, content, others)
    path = PurePosixPath(name)
    packed = path.suffix == ".gz"
    if packed and len(content) > _LARGEST_PACKED:
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
