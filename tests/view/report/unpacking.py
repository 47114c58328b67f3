"""Reads the recording of a page as the browser does: slowly, row by row, from the text of the page."""

import base64
import gzip
import json
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any]
# Where the rows of each frame begin, and the columns of these rows.
TABLES = {
    "shapeStart": ("owner",),
    "truthStart": ("vessel", "flags", "fraction", "depth", "hider", "full", "visible"),
    "drawnStart": ("drawnVessel", "label", "confidence", "outcome", "kind", "box"),
    "trackStart": ("trackLane", "trackVessel", "trackFlags", "trackBox"),
}
STILL = 1 << 31


@dataclass(frozen=True)
class Unpacked:
    """A recording whose frames stand one after the other, step by step and camera by camera, each once."""

    facts: dict[str, Any]  # with `steps`, `timestamps` and `times`
    shown: Column  # the frame that each camera shows at each step, −1 for none, shape (steps, cameras)
    taken: Column  # the step at which it was taken, −1 for none, shape (steps, cameras)
    columns: dict[str, Column]  # of the frames
    outlines: list[list[Column]]  # the lines of each shape, arrays of corners
    overview: dict[str, Column]
    stored: int  # number of frames that are stored


def read(page: Path, name: str = "A") -> Unpacked:
    text = page.read_text(encoding="utf-8")

    def inside(element: str) -> str:
        return re.search(rf'id="{element}">(.*?)</script>', text)[1]

    facts, overview = json.loads(inside(f"facts-{name}")), _columns(inside(f"overview-{name}"))
    facts["steps"] = [i * facts["every"] for i in range(facts["length"])]
    _add_times(facts, overview)
    reader = _Reader(facts, _outlines(overview))
    for number in range(facts["parts"]):
        reader.add(number, _columns(inside(f"part-{name}-{number}")))
    return reader.unpacked(overview)


class _Reader:
    def __init__(self, facts: dict[str, Any], still: list[list[Column]]) -> None:
        self._facts, self._still, self._cameras = facts, still, len(facts["cameras"])
        self._rows: defaultdict[str, list[Column]] = defaultdict(list)
        self._outlines: list[list[Column]] = []
        self._numbers: dict[tuple[int, int], int] = {}
        self._shown: list[int] = []
        self._taken: list[int] = []
        self._stored = 0

    def add(self, number: int, part: dict[str, Column]) -> None:
        moving, part_steps = _outlines(part), self._facts["partSteps"]
        self._stored += len(part["state"])
        for each in ("placed", "place", "heading", "cameraPlaced", "cameraPlace", "cameraLooks"):
            self._rows[each].append(part[each])
        steps = self._facts["steps"][number * part_steps :][: len(part["frame"]) // self._cameras]
        taken = part["taken"].tolist() if "taken" in part else np.repeat(steps, self._cameras).tolist()
        self._taken += taken
        for cell, (frame, step) in enumerate(zip(part["frame"].tolist(), taken, strict=True)):
            key = step, cell % self._cameras
            self._shown.append(-1 if step < 0 else self._numbers.setdefault(key, len(self._numbers)))
            if step < 0:
                first, stop = part["truthStart"][frame : frame + 2].tolist()
                assert first == stop
            elif self._shown[-1] == len(self._rows["state"]):
                self._frame(part, frame, moving)

    def _frame(self, part: dict[str, Column], frame: int, moving: list[list[Column]]) -> None:
        self._rows["state"].append(part["state"][frame : frame + 1])
        self._rows["horizon"].append(part["horizon"].reshape(-1, 3)[frame])
        for start in TABLES.keys() & part.keys():
            first, stop = part[start][frame : frame + 2].tolist()
            self._rows[start].append(np.array([stop - first]))
            for column in TABLES[start]:
                width = 4 if column in ("full", "visible", "box", "trackBox") else 1
                self._rows[column].append(part[column][width * first : width * stop])
        first, stop = part["shapeStart"][frame : frame + 2].tolist()
        numbers = part["outline"][first:stop].tolist()
        self._outlines += [self._still[each - STILL] if each >= STILL else moving[each] for each in numbers]

    def unpacked(self, overview: dict[str, Column]) -> Unpacked:
        columns = {column: np.concatenate(values) for column, values in self._rows.items()}
        for start in TABLES.keys() & columns.keys():
            columns[start] = np.concatenate([[0], np.cumsum(columns[start])])
        shown, taken = (np.array(each).reshape(-1, self._cameras) for each in (self._shown, self._taken))
        return Unpacked(self._facts, shown, taken, columns, self._outlines, overview, self._stored)


def _add_times(facts: dict[str, Any], overview: dict[str, Column]) -> None:
    if "clock" not in overview:
        facts["timestamps"] = overview["clockTexts"].tobytes().decode("utf-8").split("\n")
        return
    decimals, units = facts["clock"]["decimals"], facts["clock"]["first"] + np.cumsum(overview["clock"])
    facts["times"] = ((units - units[0]) / 10**decimals).tolist()
    facts["timestamps"] = [str(value) for value in (units / 10**decimals).tolist()]


def _columns(text: str) -> dict[str, Column]:
    data = gzip.decompress(base64.b64decode(text))
    long = int.from_bytes(data[:8], "little")
    columns: dict[str, Column] = {}
    for entry in json.loads(data[8 : 8 + long]):
        begin, length, kind = 8 + long + entry["offset"], entry["length"], np.dtype(entry["type"])
        if "width" not in entry:
            columns[entry["name"]] = np.frombuffer(data, kind, length, begin)
            continue
        planes = np.frombuffer(data, np.uint8, length * kind.itemsize, begin).reshape(kind.itemsize, length)
        zigzag = [int.from_bytes(bytes(each), "little") for each in planes.T]
        signed = [-(each + 1) // 2 if each & 1 else each // 2 for each in zigzag]
        columns[entry["name"]] = _summed(signed, entry, columns, kind)
    return columns


def _summed(signed: list[int], entry: dict[str, Any], columns: dict[str, Column], kind: np.dtype[Any]) -> Column:
    width, most = entry["width"], (1 << 8 * kind.itemsize) - 1
    base = columns[entry["base"]].tolist() if entry["base"] else None
    before = _before(entry["by"], len(signed) // width, columns)
    whole: list[int] = []
    for place, value in enumerate(signed):
        row, column = divmod(place, width)
        was = base[place] if base else whole[before[row] * width + column] if before[row] >= 0 else 0
        whole.append((value + was) & most)
    return np.array(whole, dtype=f"uint{8 * kind.itemsize}").view(kind)


def _before(by: str | None, rows: int, columns: dict[str, Column]) -> list[int]:
    if by is None:
        return [-1] * rows
    if by == "row":
        return list(range(-1, rows - 1))
    before, sizes, begins, last = [], [], [], {}
    if by != "outline":
        for row, key in enumerate(columns[by].tolist()):
            before.append(last.get(key, -1))
            last[key] = row
        return before
    lines = iter(columns["cornerCount"].tolist())
    for outline, (owner, count) in enumerate(zip(columns["outlineOwner"].tolist(), columns["lineCount"], strict=True)):
        size, begin, other = sum(next(lines) for _ in range(count)), len(before), last.get(owner)
        sizes.append(size)
        begins.append(begin)
        last[owner] = outline
        if other is not None and sizes[other] == size:
            before += range(begins[other], begins[other] + size)
        else:
            before += [-1, *range(begin, begin + size - 1)][:size]
    return before


def _outlines(columns: dict[str, Column]) -> list[list[Column]]:
    lines = np.split(columns["corners"].reshape(-1, 2), np.cumsum(columns["cornerCount"])[:-1])
    ends = np.cumsum(columns["lineCount"]).tolist()
    return [lines[first:stop] for first, stop in zip([0, *ends], ends, strict=False)]
