"""MOT challenge text: `gt.txt` and `det.txt`. A line of truth is frame, identity, x, y, width, height, flag (0 is
ignored), class, visibility. A line of detections is frame, −1, x, y, width, height, confidence, and a class if the
eighth number is 1 or more; if no line has a class, there is only one label. A confidence of −1 in every line means that
none is given. Frames and pixels count from 1: a box that begins at the left edge of the image has x = 1 (Milan et al.
(2016), "MOT16", data format). Both count from 0 in both files where one of them has a frame 0, as in FVessel's: boxes
that its image of 2560 columns cuts begin at 0 and end at 2559. A `seqinfo.ini` beside or above the truth gives the size
of the images, their number and the frame rate. Lines of ten numbers may have others in the last three: places in the
world (MOT15), or class, truncation and occlusion (VisDrone, whose class 0 is a region to be ignored). These are
recognised, and not read as class or visibility."""

import configparser
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import from_top_left
from modsim3d.core.errors import InputError
from modsim3d.core.text import number_in
from modsim3d.formats.labelled import FileIds, LabelledSet
from modsim3d.formats.reading import builder
from modsim3d.formats.reading.builder import NO_OPTIONS, Confidences, LabelledRow, Problems, ReadOptions, is_number
from modsim3d.io.input_files import FRAMES_A_ROW, FREE_FRAMES, MAX_FRAMES, MAX_LINE_CHARACTERS, read_text
from modsim3d.io.misreadings import LOST, has_lost_digits, no_commas
from modsim3d.io.validation import shown

_LOOKED_AT_LINES = 20


def number_lines(
    path: Path, what: str, separator: str | None, least: int, problems: Problems
) -> Iterator[tuple[str, list[float]]]:
    """Lines of numbers, each with its place in the file; empty ones are skipped, wrong ones added to the problems. The
    `separator` stands between numbers, and perhaps at the end of a line; white space if None. A line must have at least
    so many numbers. Raises InputError if the file cannot be read, or its first lines hold no number at all."""
    text = read_text(path, what)
    lines = text.splitlines()
    whole = {line.count(separator) for line in lines[-_LOOKED_AT_LINES:-1] if line.strip()} if separator else set()
    if not text.endswith("\n") and len(whole) == 1 and lines[-1].count(separator or "") < min(whole):
        problems.add(f"{path.name} line {len(lines)}: has fewer numbers than the others: is the file cut off here?")
    begin = list(islice(filter(str.strip, lines), _LOOKED_AT_LINES))
    cells = (cell for line in begin for cell in line[:MAX_LINE_CHARACTERS].split(separator))
    if begin and all(math.isnan(number_in(cell)) for cell in cells):
        form = "white space" if separator is None else f"'{separator}'"
        fault = f"its first lines hold no numbers, must be numbers with {form} between them{_why(begin[0], separator)}"
        raise InputError(f"{what} {path}", [fault])
    for index, line in enumerate(lines):
        if not line.strip():
            continue
        where = f"{path.name} line {index + 1}"
        if len(line) > MAX_LINE_CHARACTERS:
            problems.add(f"{where}: has {len(line):,} characters, must have at most {MAX_LINE_CHARACTERS:,}")
            continue
        try:
            parts = line.strip().removesuffix(separator or "").split(separator)
            numbers = [float(part) for part in parts]
        except ValueError:
            problems.add(f"{where}: must be numbers (got {shown(line)}){_why(line, separator)}")
            continue
        if len(numbers) < least:
            problems.add(f"{where}: has {len(numbers)} numbers, must have at least {least} (got {shown(line)})")
        elif separator and has_lost_digits(parts[1]):  # of MOT, whose second number is an identity
            problems.add(f"{where}: identity {LOST} (got {shown(parts[1])})")
        elif not all(map(math.isfinite, numbers)):
            problems.add(f"{where}: must be finite (got {shown(line)})")
        else:
            yield where, numbers


def _why(line: str, separator: str | None) -> str:
    """Reason why the numbers of a line cannot be read, to be added to a message; empty if that is not known."""
    return no_commas(line) if separator else ": commas stand neither between nor in them" * ("," in line)


_MAX_CLASSES = 10_000  # a larger number is no class but something else
_TINY = 1e-6
_UNKNOWN = -1
_MANY_EMPTY = 2  # a sequence so many times longer than what has boxes may not be annotated to its end
_SIDE_PX = (_TINY, builder.MAX_PX)
_RANGES = {"imWidth": _SIDE_PX, "imHeight": _SIDE_PX, "frameRate": (_TINY, 1e6), "seqLength": (0.0, MAX_FRAMES)}
"""Least and largest value of each key of a `seqinfo.ini`."""


@dataclass(frozen=True)
class SequenceInfo:
    """Size of the images, number of frames (0 if not known), frame rate and name of a sequence."""

    size_px: tuple[float, float]
    frames: int
    rate_hz: float | None
    name: str | None = None


@dataclass(frozen=True)
class _Columns:
    """Columns that lines may name: a class where those of `classed` do, and a frame; and remarks on columns."""

    to_label: Mapping[int, int]
    classed: str
    most_frames: int
    remarks: Sequence[str]
    first: int  # number of the first frame, and of the first pixel


Line = tuple[str, list[float]]
Lines = list[Line]  # where each line is, and its numbers


@dataclass(frozen=True)
class SequenceLines:
    """Lines of a sequence in the form of MOT; those of truth may have a distance in metres and the share of the box
    inside the image after the visibility."""

    annotated: Lines
    detected: Lines | None  # None if there is no such file
    regions: Lines  # of truth that are to be ignored, whatever the class
    names: dict[int, str]  # of classes by number; none if there is one label alone
    first: int  # number of the first frame, and of the first pixel
    remarks: Sequence[str]


def read_mot(condition: str, truth: Path, detections: Path | None, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition, a sequence of frames, from `gt.txt` and `det.txt`, or from `gt.txt` alone. Without
    detections, all classes up to the largest number are labels, if the truth names any. A frame rate that is given
    overrides that of `seqinfo.ini`; if neither gives one, frames have no times. Raises InputError if the files are
    wrong; each problem names its line."""
    problems, wrong = problems_of(truth, detections, options)
    written = list(number_lines(truth, "ground truth", ",", 6, problems))
    annotated, notes = plain_lines(written, truth.name, problems)
    visdrone, detected = _is_visdrone(written), None
    regions = [line for line in annotated if visdrone and _class_of(line[1]) == 0]
    columns = 11 if visdrone else 9
    annotated = [(where, numbers[:columns]) for where, numbers in annotated if not visdrone or _class_of(numbers) != 0]
    if detections is not None:
        lines = number_lines(detections, "detections", ",", 7, wrong)
        detected, remarks = plain_lines(lines, detections.name, wrong)
        notes += remarks
    first, from_0 = _first_frame([(truth, annotated), (detections, detected or [])], options.first_frame)
    names = _class_names(annotated, detected, options.labels)
    notes += [*from_0, *_said_of_columns(annotated, names, truth.name, detected is not None, visdrone)]
    lines_of = SequenceLines(annotated, detected, regions, names, first, notes)
    return sequence_set(condition, truth, lines_of, options, problems, wrong)


def problems_of(truth: Path, detections: Path | None, options: ReadOptions) -> tuple[Problems, Problems]:
    """Problems of a pair of files, of which there are none so far."""
    return Problems(f"ground truth {truth}", options.skip_bad), Problems(f"detections {detections}", options.skip_bad)


def sequence_set(
    condition: str, truth: Path, lines: SequenceLines, options: ReadOptions, problems: Problems, wrong: Problems
) -> LabelledSet:
    """The labelled set of a sequence; `wrong` are the problems of detections."""
    annotated, detected, names, first = lines.annotated, lines.detected or [], lines.names, lines.first
    info = sequence_info(truth, options.image_size_px, problems.source)
    spanned = max(info.frames, FREE_FRAMES + FRAMES_A_ROW * (len(annotated) + len(detected)))
    own = {name: number for number, name in reversed(names.items())}  # several numbers may have one name
    order = list(dict.fromkeys(names.values()))
    to_label = {number: order.index(name) for number, name in names.items()}
    facts = _Columns(
        to_label, "detections" if detected else "other lines", min(spanned, MAX_FRAMES), lines.remarks, first
    )
    annotations = _annotations(annotated, facts, problems)
    labels = len(order) if detected else 1  # detections may be matched label by label
    _add_regions(lines.regions, labels or 1, facts, annotations, problems)
    confidences = Confidences.of(((where, numbers[6]) for where, numbers in detected), options.confidence_scale, wrong)
    results = _results(detected, facts, confidences, wrong)
    notes = problems.settle() + wrong.settle() + confidences.notes
    rate_hz = options.frame_rate_hz or info.rate_hz
    if rate_hz is None:
        notes.append(f"{condition}: the frame rate is not known, so frames have no times: give --frame-rate")
    images = builder.ImageRows()
    last = max((place.image + 1 for place in annotations.places + results.places), default=0)
    if 0 < info.frames < last or info.frames > _MANY_EMPTY * last > 0:
        notes.append(f"seqinfo.ini says {info.frames:,} frames (seqLength), and the last with a box is {last:,}")
    for frame in range(max(info.frames, last)):
        time_s = math.nan if rate_hz is None else frame / rate_hz
        images.add(f"{condition} frame {frame + first}", info.size_px, time_s=time_s)
    notes += lines.remarks
    if options.image_size_px and options.image_size_px != info.size_px:
        notes.append("--image-size is not used: seqinfo.ini says {:g} x {:g}".format(*info.size_px))
    only = (options.labels[0] if options.labels else "object",)
    frames = tuple(range(first, len(images.names) + first))
    ids = FileIds(frames, tuple(own[name] for name in order) or (0,), (info.name,), annotations.identities, first)
    return builder.labelled_set(condition, tuple(order) or only, images, annotations, results, notes, ids)


def _first_frame(files: Iterable[tuple[Path | None, Lines]], given: int | None) -> tuple[int, list[str]]:
    """Number of the first frame of files; and a remark if it is not given, and a file has a frame 0."""
    at_0 = [path.name for path, lines in files if path and any(numbers[0] == 0 for _, numbers in lines)]
    if given is not None or not at_0:
        return 1 if given is None else given, []
    return 0, [f"frames and pixels count from 0: there is a frame 0 in {' and '.join(at_0)} (or give --first-frame)"]


def plain_lines(lines: Iterable[Line], file: str, problems: Problems) -> tuple[Lines, list[str]]:
    """Lines whose eighth number, if any, is a class and whose ninth is a visibility; and remarks on those that are not.
    Classes that are no whole numbers are problems, unless most are none in lines of ten: these are not read."""
    lines = list(lines)
    classed = [(where, numbers) for where, numbers in lines if len(numbers) > 7]
    broken = [(where, numbers) for where, numbers in classed if numbers[7] != int(numbers[7])]
    wide = len(classed) > 0 and all(len(numbers) > 9 for _, numbers in classed)
    if wide and 2 * len(broken) > len(classed):
        where, got = broken[0][0], ", ".join(f"{number:g}" for number in broken[0][1][7:10])
        note = f"{file}: columns eight to ten are places in the world, as in MOT15 ({where}: {got})"
        return [(where, numbers[:7]) for where, numbers in lines], [f"{note}: neither class nor visibility is read"]
    for where, numbers in broken:
        problems.add(f"{where}: class must be a whole number (got {numbers[7]:g})")
    lines = [(where, numbers) for where, numbers in lines if len(numbers) < 8 or numbers[7] == int(numbers[7])]
    ends = {(numbers[8], numbers[9]) for _, numbers in classed} if wide else {(-1.0, -1.0)}
    note, cut = f"{file}: columns nine and ten are", [(where, numbers[:8]) for where, numbers in lines]
    if not all(truncation in (0, 1) and occlusion in (0, 1, 2) for truncation, occlusion in ends):
        return lines, []
    if ends == {(1, 1)}:
        return cut, [f"{note} 1 in every line, and not read as visibility"]
    if _is_visdrone(lines):
        lines = [(where, _visdrone_row(row) if len(row) > 9 else row) for where, row in lines]
        inside = "truncation 1 stands for 0.75 of a vessel inside the image"
        return lines, [f"{note} truncation and occlusion, as in VisDrone: {OCCLUSION}; {inside}"]
    zeros = f"(the ninth is 0 in {sum(numbers[8] == 0 for _, numbers in classed):,} of {len(classed):,} lines)"
    return cut, [f"{note} truncation and occlusion, as in VisDrone, and not read as visibility {zeros}"]


def _visdrone_row(row: list[float]) -> list[float]:
    """Numbers of VisDrone up to the class, then visible fraction, distance, which is not known, and share inside."""
    truncation, occlusion = map(int, row[8:10])
    return [*row[:8], VISIBLE_FRACTIONS[occlusion], math.nan, VISIBLE_FRACTIONS[truncation]]


VISIBLE_FRACTIONS = (1.0, 0.75, 0.25, _UNKNOWN)
"""Visible fraction of each class of occlusion: nothing hidden, up to half, more than half, not known. They are the
middles of VisDrone's classes, which are in per cent; KITTI calls its own partly and largely. The classes of truncation
have the same shares inside the image."""


OCCLUSION = "a visible fraction of 0.75 stands for boxes up to half hidden, and 0.25 for those that are hidden more"
_VISDRONE_CLASSES = range(12)  # 0 is a region to be ignored, 11 is `others`


def _is_visdrone(lines: Lines) -> bool:
    """Whether lines of ten numbers end with a class, a truncation and an occlusion of VisDrone, not all the same."""
    ends = {tuple(numbers[7:10]) for _, numbers in lines if len(numbers) > 7}
    forms = all(
        len(end) == 3 and end[0] in _VISDRONE_CLASSES and end[1] in (0, 1) and end[2] in (0, 1, 2) for end in ends
    )
    return forms and len({end[2] for end in ends}) > 1


def _said_of_columns(
    annotated: Lines, names: Mapping[int, str], file: str, paired: bool, occlusion: bool
) -> Iterator[str]:
    """Remarks on how the eighth and ninth column of the truth are read, if there are any."""
    most = max((len(numbers) for _, numbers in annotated), default=0)
    classes = ", ".join(f"{number} is {shown(name)}" for number, name in list(names.items())[:8])
    used = f"where {classes}" if names else "not used" + ", because no detection has a class" * paired
    if most > 7:
        ninth = "; the ninth is the visibility" * (most > 8 and not occlusion)
        yield f"{file}: the eighth column is the class, {used}{ninth}"


def _class_of(numbers: list[float]) -> int:
    """The class of a line, −1 where it has none."""
    return int(numbers[7]) if len(numbers) > 7 else -1


def _class_names(annotated: Lines, detected: Lines | None, labels: tuple[str, ...]) -> dict[int, str]:
    """Names of the classes by number; none if detections name no classes. Without detections those of all from 1 to the
    largest number; none if no line names a class."""
    codes = {_class_of(numbers) for _, numbers in (*annotated, *(detected or ()))}
    classes: Iterable[int] = sorted(number for number in codes if 1 <= number <= _MAX_CLASSES)
    if detected is None:
        classes = range(1, max(classes, default=0) + 1)
    elif not any(_class_of(numbers) >= 1 for _, numbers in detected):
        classes = ()
    return {number: labels[number - 1] if number <= len(labels) else f"class_{number}" for number in classes}


def _annotations(lines: Lines, facts: _Columns, problems: Problems) -> builder.AnnotationRows:
    rows = builder.AnnotationRows(partial(_corners, first=facts.first))
    for where, numbers in lines:
        if not is_number(numbers[1], builder.NOT_GIVEN) or numbers[1] != int(numbers[1]):
            low = "-1 or more" if numbers[1] < builder.NOT_GIVEN else f"at most {builder.MAX_NUMBER:g}"
            wanted = "a whole number" if is_number(numbers[1], builder.NOT_GIVEN) else low
            problems.add(f"{where}: identity must be {wanted} (got {numbers[1]:g})")
            continue
        identity = int(numbers[1]) if numbers[1] >= 0 else None
        if rows.has(int(numbers[0]) - facts.first, identity):
            problems.add(f"{where}: identity {identity} is in frame {numbers[0]:g} already")
            continue
        place = _place(where, numbers, problems, facts)
        if place is not None:
            before = problems.count
            visible, flag = (numbers[k] if len(numbers) > k and numbers[k] != _UNKNOWN else None for k in (8, 6))
            if visible is not None and not 0 <= visible <= 1 + _TINY:
                problems.add(f"{where}: visibility must be from 0 to 1, or -1 if it is not known (got {visible:g})")
                problems.hint = "a visibility in per cent must be divided by 100; another ninth column must be left out"
            considered = flag is None or builder.read_flag(flag, "the seventh number, the flag,", where, problems)
            if problems.count > before and identity is None:
                problems.hint = "this may be a file of detections, whose boxes have no track"
            elif flag is not None and 0 < flag < 1:
                problems.hint = "the seventh column may be confidences: in truth it is 1, or 0 for what is left out"
            if problems.count == before:
                visible = math.nan if visible is None else visible
                rows.add(place, not considered, False, identity, visible, *numbers[9:11])
    return rows


def _add_regions(lines: Lines, labels: int, facts: _Columns, rows: builder.AnnotationRows, problems: Problems) -> None:
    """Append regions that are to be ignored, for each of so many labels: half of a detection inside is enough."""
    for where, numbers in lines:
        place = _place(where, [*numbers[:6], 0, next(iter(facts.to_label), 0)], problems, facts)
        for label in range(labels):
            if place is not None:
                rows.add(replace(place, label=label), ignored=True, crowd=True)


def _results(lines: Lines, facts: _Columns, confidences: Confidences, problems: Problems) -> builder.ResultRows:
    rows = builder.ResultRows(partial(_corners, first=facts.first))
    for where, numbers in lines:
        confidence = confidences.read(numbers[6], where, problems)
        place = None if confidence is None else _place(where, numbers, problems, facts)
        if place is not None and confidence is not None:
            rows.add(place, confidence)
    return rows


def _corners(boxes_px: Array, first: int) -> Array:
    """Boxes with pixels counted from 0, of those of a file that counts from `first`, shapes (n, 4)."""
    return from_top_left(boxes_px) - first


def _place(where: str, numbers: list[float], problems: Problems, facts: _Columns) -> LabelledRow | None:
    """Image, label and box of a line; None with a problem if it has none."""
    frame, number, to_label = numbers[0], _class_of(numbers), facts.to_label
    if not facts.first <= frame <= facts.most_frames or frame != int(frame):
        span = f"from {facts.first} to {facts.most_frames}"
        problems.add(f"{where}: frame must be a whole number {span} (got {frame:.15g})")
        if facts.most_frames < frame:
            spanned = f"so few lines may span {facts.most_frames:,} frames"
            problems.hint = f"{spanned}, and up to {MAX_FRAMES:,} where seqLength in a seqinfo.ini says so"
    elif number > _MAX_CLASSES:
        problems.add(f"{where}: class must be at most {_MAX_CLASSES} (got {numbers[7]:g})")
    elif to_label and number not in to_label:
        got = f"{numbers[7]:g}" if len(numbers) > 7 else "none"
        problems.add(f"{where}: has no class in its eighth column, but {facts.classed} have (got {got})")
        problems.hint = next((note for note in facts.remarks if note.startswith(where.partition(" line ")[0])), "")
    elif builder.valid_box(numbers[2:6], where, problems):
        return LabelledRow(int(frame) - facts.first, to_label[number] if to_label else 0, numbers[2:6])
    return None


def sequence_info(truth: Path, size_px: tuple[float, float] | None, source: str) -> SequenceInfo:
    """Content of `seqinfo.ini` beside or above a file, or the given size of the images and nothing else. Raises
    InputError if it is wrong, or the size is not known."""
    for folder in (truth.parent, truth.parent.parent):
        path = folder / "seqinfo.ini"
        if not path.is_file():
            continue
        section = _section(path)
        problems = [
            f"{key}: must be {'above 0, and at most' if least else 'from 0 to'} {most:g} (got {shown(section[key])})"
            for key, (least, most) in _RANGES.items()
            if key in section and not least <= number_in(section[key]) <= most
        ]
        if problems:
            raise InputError(f"sequence {path}", problems)
        width, height, rate, frames = (number_in(section.get(key, "0")) for key in _RANGES)
        return SequenceInfo((width, height), int(frames), rate or None, section.get("name") or None)
    if size_px is None:
        problem = "the size of the images is not known: give --image-size, or put seqinfo.ini beside or above it"
        raise InputError(source, [problem])
    return SequenceInfo(size_px, 0, None)


def _section(path: Path) -> Mapping[str, str]:
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(read_text(path, "sequence"))
        section = parser["Sequence"]
        missing = [key for key in ("imWidth", "imHeight") if key not in section]
    except (configparser.Error, KeyError):
        missing = ["[Sequence]"]
    if missing:
        needed = "needs imWidth and imHeight under [Sequence]"
        raise InputError(f"sequence {path}", [f"{needed}: {' and '.join(missing)} is missing, or cannot be read"])
    return section
