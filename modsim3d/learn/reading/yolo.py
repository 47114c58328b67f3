"""YOLO text folders: a file for each image, a line for each box: class, x, y, width, height in shares of the image.

Lines of detections end with the confidence. An image with no file, or an empty one, is an image with nothing in it, so
the images are those that either folder has a file for; `images.txt` beside the labels, a name a line, adds others.
"""

from __future__ import annotations

import math
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.learn.labelled import Labelled
from modsim3d.learn.reading.builder import Problems, Rows, corners, one_condition
from modsim3d.learn.reading.text_lines import number_lines
from modsim3d.validation import load_yaml, read_text


def read_yolo(
    condition: str,
    truth: Path,
    detections: Path,
    labels: tuple[str, ...] = (),
    image_size_px: tuple[float, float] | None = None,
    skip_bad: bool = False,
) -> Labelled:
    """One condition.

    Args:
        condition: Its name.
        truth: The folder of the labels, or the one that has it as `labels`.
        detections: The folder of the predictions, likewise.
        labels: Names of the classes 0, 1, ...; from `classes.txt` or `data.yaml` if not given.
        image_size_px: Width and height of every image.
        skip_bad: Leave out lines that something is wrong with, and count them.

    Raises:
        InputError: Something is wrong; each problem names its file and line.
    """
    folder, predicted = _folder(truth), _folder(detections)
    if image_size_px is None:
        raise InputError(
            f"ground truth {truth}", ["YOLO's files do not say how large the images are: give --image-size"]
        )
    names = labels or _names(truth) or _names(folder)
    stems = sorted({path.stem for path in (*_files(folder), *_files(predicted))} | _listed(folder) | _listed(truth))
    place = {stem: row for row, stem in enumerate(stems)}
    problems = Problems(f"ground truth {truth}", skip_bad)
    wrong = Problems(f"detections {detections}", skip_bad)
    rows, found = Rows(), Rows()
    for path in _files(folder):
        for where, numbers in number_lines(path, "labels", None, 5, problems):
            if len(numbers) > 5:
                problems.add(f"{where}: has {len(numbers)} numbers, must have 5: class, x, y, width, height")
            elif _row(where, numbers, place[path.stem], image_size_px, problems, rows):
                rows.ignored.append(False)
                rows.crowd.append(False)
                rows.identity.append(None)
                rows.visible_fraction.append(math.nan)
                rows.distance_m.append(math.nan)
    for path in _files(predicted):
        for where, numbers in number_lines(path, "predictions", None, 6, wrong):
            if not 0 <= numbers[5] <= 1:
                wrong.add(f"{where}: confidence must be from 0 to 1 (got {numbers[5]:g})")
            elif _row(where, numbers, place[path.stem], image_size_px, wrong, found):
                found.confidence.append(numbers[5])
                found.probabilities.append(None)
    classes = max([*rows.label, *found.label, len(names) - 1], default=0) + 1
    whole = [names[k] if k < len(names) else f"class_{k}" for k in range(classes)]
    sizes = [image_size_px] * len(stems)
    return one_condition(condition, whole, stems, sizes, rows, found, problems.settle() + wrong.settle())


def _row(
    where: str, numbers: list[float], image: int, size_px: tuple[float, float], problems: Problems, rows: Rows
) -> bool:
    """Put down what truth and predictions have in common."""
    number, x, y, width, height = numbers[:5]
    if not 0 <= number < _MOST_CLASSES or number != int(number):
        problems.add(f"{where}: class must be a whole number from 0 to {_MOST_CLASSES - 1} (got {number:g})")
        return False
    if max(abs(x), abs(y), width, height) > 2:
        problems.add(f"{where}: x, y, width, height must be shares of the image, from 0 to 1 (got {numbers[1:5]})")
        return False
    left, top = (x - width / 2) * size_px[0], (y - height / 2) * size_px[1]
    box = corners([left, top, width * size_px[0], height * size_px[1]], where, problems)
    if box is None:
        return False
    rows.image.append(image)
    rows.label.append(int(number))
    rows.boxes.append(box)
    return True


_MOST_CLASSES = 10_000
"""More is no class but something else."""
_NOT_LABELS = ("classes.txt", "images.txt")


def _folder(path: Path) -> Path:
    if not path.is_dir():
        raise InputError(f"folder {path}", ["no such folder"])
    return path / "labels" if (path / "labels").is_dir() else path


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.txt") if path.name not in _NOT_LABELS)


def _listed(folder: Path) -> set[str]:
    path = folder / "images.txt"
    if not path.is_file():
        return set()
    return {Path(line.strip()).stem for line in read_text(path, "images").splitlines() if line.strip()}


def _names(folder: Path) -> tuple[str, ...]:
    """Names of the classes, where a file beside the labels has them."""
    listed = folder / "classes.txt"
    if listed.is_file():
        return tuple(line.strip() for line in read_text(listed, "classes").splitlines() if line.strip())
    for path in (folder / "data.yaml", folder.parent / "data.yaml"):
        if path.is_file():
            content = load_yaml(path, "data")
            names = content.get("names") if isinstance(content, dict) else None
            if isinstance(names, dict):
                if any(type(key) is not int or not 0 <= key < _MOST_CLASSES for key in names):
                    raise InputError(f"data {path}", [f"names: must be numbered 0, 1, ... (got {list(names)[:5]})"])
                names = [names.get(number, f"class_{number}") for number in range(max(names, default=-1) + 1)]
            if isinstance(names, list):
                return tuple(str(name) for name in names)
    return ()
