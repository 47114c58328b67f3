"""Which images COCO results name: by ID, or by file as programs do that know no IDs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from modsim3d.formats.reading.builder import is_number

ID = int | str
_MOST_DIGITS = 18
"""Of a file's name that is a number."""


@dataclass(frozen=True)
class ImageNames:
    """Rows of images by what results may call them.

    Attributes:
        by_image_id: By `image_id`.
        by_file_name: By the `file_name` that a result may have beside it.
        image_ids_are_files: Whether each `image_id` is taken for the name of a file.
        doubt: A remark if every `image_id` can be read as an ID and as a file, and some differ; else empty.
    """

    by_image_id: Mapping[Any, int]
    by_file_name: Mapping[ID, int]
    image_ids_are_files: bool
    doubt: str


def image_names(entries: Sequence[Any], rows_of_ids: Mapping[Any, int], names: Sequence[str]) -> ImageNames:
    """How results name images: the reading of their `image_id` by which more of them are images.

    Args:
        entries: The results as they are in the file.
        rows_of_ids: Row of each image by its ID.
        names: File name of each row.
    """
    results = [entry for entry in entries if isinstance(entry, dict)]
    given: set[Any] = {
        image for entry in results if isinstance(image := entry.get("image_id"), str) or is_number(image)
    }
    files, stems = _by_file(names)
    if len(given & stems.keys()) > len(given & rows_of_ids.keys()):
        return ImageNames(stems, files, True, "")
    doubt = ""
    file_names_decide = any("file_name" in entry for entry in results)
    both = given <= stems.keys() & rows_of_ids.keys()
    if both and not file_names_decide and any(stems[image] != rows_of_ids[image] for image in given):
        doubt = "each image_id of the results is an image's id, and the name of another's file too: taken for the id"
    return ImageNames(rows_of_ids, files, False, doubt)


def _by_file(names: Sequence[str]) -> tuple[dict[ID, int], dict[ID, int]]:
    """Rows of images by file name, and by name without folder and ending; names of several images are left out."""
    files, stems = defaultdict[ID, list[int]](list), defaultdict[ID, list[int]](list)
    for row, name in enumerate(names):
        path = PurePosixPath(name.replace("\\", "/"))
        names_of: set[ID] = {name, str(path), path.name}
        number: set[ID] = {int(path.stem)} if path.stem.isdecimal() and len(path.stem) <= _MOST_DIGITS else set()
        for key in names_of:
            files[key].append(row)
        for key in names_of | {path.stem} | number:
            stems[key].append(row)
    by_file, by_stem = ({key: rows[0] for key, rows in each.items() if len(rows) == 1} for each in (files, stems))
    return by_file, by_stem
