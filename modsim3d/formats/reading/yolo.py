"""YOLO text folders: a file for each image, a line for each box: class, x, y, width, height in shares of the image.
Lines of detections end with the confidence, and perhaps the number of a track. Lines of truth may end with the number
of a track, before which a confidence may stand, as ultralytics' trackers write both. The images lie in the folder
`images` beside `labels`, as in `set/images/val` and `set/labels/val`, or beside their labels; their files give their
sizes. Without such files, every file in either folder stands for an image, and `images.txt` beside the labels, a name
on each line, adds others. An image without a file of labels, or with an empty one, has nothing in it."""

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from modsim3d.core.boxes import corner_form
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import FileIds, LabelledSet
from modsim3d.formats.reading import builder
from modsim3d.formats.reading.builder import NO_OPTIONS, Confidences, ImageRows, LabelledRow, Problems, ReadOptions
from modsim3d.formats.reading.mot import number_lines, problems_of
from modsim3d.io.input_files import MAX_IMAGE_BYTES, composed, note_input, read_text
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import shown

ENDINGS = frozenset((".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"))
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "TIFF", "WEBP")
_ORIENTATION, _LYING = 274, (5, 6, 7, 8)  # tag of a photograph on how to rotate it; values that swap width and height


def images_in(folder: Path) -> dict[str, Path]:
    """Image files of a folder, by name without ending. Raises InputError if two images have the same name."""
    images: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in ENDINGS:
            continue
        if (stem := composed(path.stem)) in images:
            raise InputError(f"folder {folder}", [f"{path.name} and {images[stem].name} have the same labels"])
        images[stem] = path
    return images


def image_size_px(path: Path) -> tuple[float, float]:
    """Width and height of the image as it is shown. Raises InputError if it is no image, or too large."""
    from PIL import Image, UnidentifiedImageError

    source = f"image {path}"
    note_input(path)
    if not path.is_file():
        raise InputError(source, ["this is no ordinary file, an image was expected"])
    if (size := path.stat().st_size) > MAX_IMAGE_BYTES:
        raise InputError(source, [f"has {size:,} bytes, an image may have at most {MAX_IMAGE_BYTES:,}"])
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=_FORMATS) as image:
            width, height = image.size
            # PIL looks for the tag of a PNG behind its pixels, and would unpack all of them for it.
            lying = image.format != "PNG" and image.getexif().get(_ORIENTATION) in _LYING
    except UnidentifiedImageError:
        problem = f"cannot be read: no image of a known kind ({', '.join(_FORMATS)}), or a damaged one"
        raise InputError(source, [problem]) from None
    except Image.DecompressionBombError as error:
        raise InputError(source, [f"cannot be read: {error}"]) from None
    except Exception as error:  # PIL lets errors of many kinds through for damaged files
        raise InputError(source, [f"cannot be read: {shown(str(error))}"]) from None
    if not (0 < width <= builder.MAX_PX and 0 < height <= builder.MAX_PX):
        wanted = f"width and height must be from 1 to {builder.MAX_PX:g} pixels"
        raise InputError(source, [f"{wanted} (got {width} and {height})"])
    return (height, width) if lying else (width, height)


def read_yolo(condition: str, truth: Path, detections: Path | None, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition from the folders of labels and predictions, or those that have them as `labels`, or of labels
    alone. Names of the classes that are not given come from a file of `_LISTS` or `_TABLES`, sizes from the images.
    With a frame rate the images are frames of one video, see `_frame_numbers`. Raises InputError if the files are
    wrong; each problem names its file and line."""
    folder, found_in = _folder(truth, needed=True), _folder(detections) if detections else None
    predicted = _files(found_in) if found_in else []
    files = _images(folder, truth)
    if options.image_size_px is None and not files:
        problem = "YOLO's files do not say how large the images are, which are not beside them: give --image-size"
        raise InputError(f"ground truth {truth}", [problem])
    names = options.labels or _names(truth, folder)
    own = {composed(path.stem) for path in (*_files(folder), *predicted)}
    stems = sorted(files or own | _listed(folder) | _listed(truth))
    images, rate_hz = ImageRows(), options.frame_rate_hz
    for stem, frame in zip(stems, _frame_numbers(stems), strict=True):
        size_px = options.image_size_px or image_size_px(files[stem])
        images.add(stem, size_px, time_s=math.nan if rate_hz is None else frame / rate_hz)
    problems, wrong = problems_of(truth, detections, options)
    annotations = _annotations(_files(folder), images, problems)
    results, remarks = _results(predicted, images, options.confidence_scale, wrong)
    notes = problems.settle() + wrong.settle() + remarks
    labels = {place.label for place in annotations.places + results.places}
    numbers = sorted({*range(len(names)), *labels})
    whole = [names[number] if number < len(names) else f"class_{number}" for number in numbers]
    if nameless := [n for k, n in zip(numbers, whole, strict=True) if n == f"class_{k}" and n not in options.labels]:
        notes.append(f"{truth}: no name is known of {', '.join(nameless[:8])}: give --labels or {_LISTS[0]}")
    to_label = {number: label for label, number in enumerate(numbers)}
    for rows in (annotations, results):
        rows.places = [replace(place, label=to_label[place.label]) for place in rows.places]
    ids = FileIds(tuple(images.names), tuple(numbers), (truth.resolve().name or None,), annotations.identities)
    return builder.labelled_set(condition, whole, images, annotations, results, notes, ids)


def _frame_numbers(stems: Sequence[str]) -> list[int]:
    """Number of the frame of each image, from 0: the place of its name. Of names that are alike but for a number at the
    end it is that number, divided by what all differences have in common, so that a frame without a file is a gap."""
    parts = [part for stem in stems if (part := re.fullmatch(r"(.*?)(\d{1,15})", stem))]
    numbers = {int(part[2]): part[1] for part in parts}
    if len(numbers) < len(stems) or len(set(numbers.values())) > 1:
        return list(range(len(stems)))
    apart = math.gcd(*(number - min(numbers) for number in numbers))
    return [(number - min(numbers)) // (apart or 1) for number in numbers]


def _annotations(paths: list[Path], images: ImageRows, problems: Problems) -> builder.AnnotationRows:
    rows = builder.AnnotationRows(corner_form)
    for image, where, numbers in _lines(paths, images, "labels", problems):
        track = numbers[-1] if len(numbers) > 5 else None
        if len(numbers) > 7 or (track is not None and not (0 <= track <= _MAX_TRACK and track == int(track))):
            rule = "must have 5: class, x, y, width, height, and then perhaps a confidence and a track, a whole number"
            problems.add(f"{where}: has {len(numbers)} numbers, {rule} (got {shown(numbers)})")
        elif track is not None and rows.has(image, int(track)):
            problems.add(f"{where}: track {track:g} is in the image already")
        elif (place := _place(where, numbers, image, images.sizes_px[image], problems)) is not None:
            rows.add(place, identity=None if track is None else int(track))
    return rows


def _results(
    paths: list[Path], images: ImageRows, scale: builder.Scale | None, problems: Problems
) -> tuple[builder.ResultRows, list[str]]:
    """The results, and remarks on their confidences."""
    rows, lines = builder.ResultRows(corner_form), list(_lines(paths, images, "predictions", problems))
    given = ((where, numbers[5]) for _, where, numbers in lines if len(numbers) in (6, 7))
    confidences = Confidences.of(given, scale, problems)
    for image, where, numbers in lines:
        if len(numbers) not in (6, 7) or numbers[6:] != [int(number) for number in numbers[6:]]:
            problems.add(f"{where}: has {len(numbers)} numbers, must have 6: class, x, y, width, height, confidence")
            problems.hint = "predictions must come with their confidence (ultralytics: save_txt=True save_conf=True)"
        elif (confidence := confidences.read(numbers[5], where, problems)) is not None and (
            place := _place(where, numbers, image, images.sizes_px[image], problems)
        ) is not None:
            rows.add(place, confidence)
    return rows, confidences.notes


def _lines(
    paths: list[Path], images: ImageRows, what: str, problems: Problems
) -> Iterator[tuple[int, str, list[float]]]:
    """Row of the image, place in the file and numbers of each line of each file that belongs to an image."""
    row_of = {stem: row for row, stem in enumerate(images.names)}
    for path in paths:
        if composed(path.stem) not in row_of:
            problems.add(f"{path.name}: there is no image of this name")
            continue
        for where, numbers in number_lines(path, what, None, 5, problems):
            yield row_of[composed(path.stem)], where, numbers


def _place(
    where: str, numbers: list[float], image: int, size_px: Sequence[float], problems: Problems
) -> LabelledRow | None:
    """Image, label and box of a line; None with a problem if it has none."""
    number, x, y, width, height = numbers[:5]
    box_px = [x * size_px[0], y * size_px[1], width * size_px[0], height * size_px[1]]
    if not 0 <= number < _MAX_CLASSES or number != int(number):
        problems.add(f"{where}: class must be a whole number from 0 to {_MAX_CLASSES - 1} (got {number:g})")
    elif max(abs(x), abs(y), width, height) > 2:
        got = shown(numbers[1:5])
        problems.add(f"{where}: x, y, width, height must be shares of the image, from 0 to 1 (got {got})")
    elif builder.valid_box(box_px, where, problems):
        return LabelledRow(image, int(number), box_px)
    return None


_MAX_CLASSES = 10_000  # a larger number is no class but something else
_MAX_TRACK = 1e15
_LISTS, _TABLES = ("classes.txt", "obj.names"), ("data.yaml", "dataset.yaml")
"""Files that name the classes, beside the labels or above: a name on each line, or all in one; `names` of YAML."""
_LABELS, _NOT_LABELS = ("labels", "obj_train_data"), ("classes.txt", "images.txt")
_LOOKED_AT_FILES = 10_000  # below a folder without labels, for a hint: it may be the root of a disk


def _folder(path: Path, needed: bool = False) -> Path:
    """The folder with text files. Raises InputError if only folders below have any, or none where they are needed."""
    if not path.is_dir():
        raise InputError(f"folder {path}", ["no such folder"])
    folder = next((path / name for name in _LABELS if (path / name).is_dir()), path)
    if not _files(folder):
        entries = islice(folder.rglob("*"), _LOOKED_AT_FILES)
        below = sorted({str(file.parent) for file in entries if file.suffix == ".txt" and file.parent != folder})
        if below:
            raise InputError(f"folder {path}", [f"has no labels itself; those below it have: {', '.join(below[:5])}"])
        if needed:
            raise InputError(f"folder {path}", ["has no labels: no .txt file"])
    return folder


def _images(folder: Path, truth: Path) -> dict[str, Path]:
    """The images of the labels in a folder, by name without ending; none if they are not found."""
    parts = list(folder.parts)
    if "labels" in parts:
        last = len(parts) - 1 - parts[::-1].index("labels")
        images = Path(*parts[:last], "images", *parts[last + 1 :])
        if images.is_dir() and (files := images_in(images)):
            return files
    return images_in(folder) or images_in(truth)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.txt") if path.name not in _NOT_LABELS)


def _listed(folder: Path) -> set[str]:
    """Names of the images that a file beside the labels lists; CVAT's is called otherwise."""
    path = folder / ("train.txt" if (folder / "obj.data").is_file() else "images.txt")
    if not path.is_file():
        return set()
    return {Path(line.strip()).stem for line in read_text(path, "images").splitlines() if line.strip()}


def _names(truth: Path, folder: Path) -> tuple[str, ...]:
    """Names of the classes from the first such file that is there, of YAML also from up to three folders above."""
    for path in (parent / name for parent in (truth, folder, folder.resolve().parent) for name in _LISTS):
        if path.is_file():
            lines = [line.strip() for line in read_text(path, "classes").strip().splitlines()]
            if len(lines) == 1 and "," in lines[0]:  # all in the only line
                lines = [name.strip(" '\"") for name in lines[0].strip("[]").rstrip(",").split(",")]
            return _checked(f"classes {path}", lines)
    above = folder.resolve().parents[:3]
    for path in (parent / name for parent in (truth, folder, *above) for name in _TABLES):
        if path.is_file():
            content = load_yaml(path, "data")
            if isinstance(content, dict) and (names := content.get("names")) is not None:
                return _tabled_names(path, names)
    return ()


def _tabled_names(path: Path, names: Any) -> tuple[str, ...]:
    if isinstance(names, dict):
        if any(type(key) is not int or not 0 <= key < _MAX_CLASSES for key in names):
            raise InputError(f"data {path}", [f"names: must be numbered 0, 1, ... (got {shown(list(names))})"])
        names = [names.get(number, f"class_{number}") for number in range(max(names, default=-1) + 1)]
    wrong = [name for name in names if isinstance(name, dict | list)] if isinstance(names, list) else [names]
    if wrong:
        raise InputError(f"data {path}", [f"names: must be a list of names (got {shown(wrong[0])})"])
    return _checked(f"data {path}", ["" if name is None else str(name) for name in names])


def _checked(source: str, names: list[str]) -> tuple[str, ...]:
    """The names, which must be some, without remarks or numbers that stand before them."""
    if "" in names:
        raise InputError(source, [f"the class {names.index('')}, counted from 0, has no name"])
    if names and (names[0][0] == "#" or all(re.match(rf"{number}[:\s]", name) for number, name in enumerate(names))):
        raise InputError(source, [f"the first class would be {shown(names[0])}: leave remarks, or all numbers, out"])
    return tuple(names)
