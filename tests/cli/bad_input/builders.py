"""A good scene of four files, for tests to spoil."""

import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic_core import _pydantic_core

DELETED = object()
COVARIANCE = [[100.0, 5, 0, 0], [5, 90, 0, 0], [0, 0, 120, 8], [0, 0, 8, 80]]
FILES = {"scene": "scene.yaml", "vessels": "vessels.json", "poses": "poses.json", "detector": "detector.yaml"}


def at(w1: float, w2: float, heading_rad: float = 0.0) -> dict[str, Any]:
    return {"center_position_m": [w1, w2, 0.0], "heading_rad": heading_rad}


def lens(**place: Any) -> dict[str, Any]:
    picture = {"principal_point_px": [320, 240], "image_size_px": [640, 480]}
    return {"focal_length_m": 0.0237, "pixel_size_m": [1.0e-5, 1.0e-5], **picture, **place}


ASHORE = {"position_m": [-60.0, 0.0, 4.0]}
GOOD: dict[str, Any] = {
    "scene": {
        "seed": 1,
        "vessels": "vessels.json",
        "poses": {"file": "poses.json"},
        "cameras": {"C0": lens(mount={"vessel": "vehicle1", "position_m": [4.0, 0, 1]}), "shore": lens(pose=ASHORE)},
        "annotation": {"mode": 2, "source": "rendered"},
        "detector": "detector.yaml",
    },
    "vessels": {
        "vehicle1": {"length_m": 8.0, "beam_m": 4.0, "air_draft_m": 1.0, "label": "Vessel"},
        "vehicle2": {"length_m": 8.0, "beam_m": 4.0, "air_draft_m": 2.0, "label": "Vessel"},
    },
    "poses": {f"{t}.0": {"vehicle1": at(t, 0.0), "vehicle2": at(40.0 - t, 6.0)} for t in range(4)},
    "detector": {
        "labels": ["Vessel"],
        "confidence_threshold": 0.2,
        "initial_state": "clear",
        "transition_matrix": [[0.9, 0.2], [0.1, 0.8]],
        "false_positives": {"model": "calibrated"},
        "states": {
            name: {
                "confusion": [[recall], [1 - recall]],
                "false_positive_labels": [1.0],
                "false_discovery_rate": 0.1,
                "box_error": {"unit": "px", "mean": [0.0, 0, 0, 0], "covariance": COVARIANCE},
                "confidence": {"mean": 0.67, "std": 0.1},
            }
            for name, recall in (("clear", 0.875), ("fog", 0.5))
        },
    },
}
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # where PyYAML has its C library, five times as fast
CIRCULAR = {"circular": {"centre_m": [200, 0], "radius_m": [5, 90], "rotation_rate_rad_s": [0.01, 0.02]}}
# What no message says: the longest piece of each message of pydantic, which speaks to programmers.
FOREIGN = {
    max(re.split(r"\{\w+\}|, |: ", each["message_template_python"]), key=len).strip()
    for each in _pydantic_core.list_all_errors()  # type: ignore[attr-defined]
}
FOREIGN |= {"Input should", "Assertion failed", "function-", "constrained-", "dict[str", "[key]"}


def foreign(text: str) -> list[str]:
    """Words of pydantic's in a message."""
    return [phrase for phrase in FOREIGN if phrase in text]


@dataclass
class Inputs:
    """A good scene of four files, for a test to spoil."""

    folder: Path
    data: dict[str, Any]

    def set(self, file: str, path: str, value: Any) -> None:
        """Put a value at a path; `/` between the keys, which may hold dots."""
        *sections, last = path.split("/")
        section = self.data[file]
        for name in sections:
            section = section[int(name) if isinstance(section, list) else name]
        place = int(last) if isinstance(section, list) else last
        if value is DELETED:
            del section[place]
        else:
            section[place] = value

    def path(self, file: str) -> Path:
        return self.folder / FILES[file]

    def write(self) -> Path:
        self.folder.mkdir(exist_ok=True)
        for file, content in self.data.items():
            text = json.dumps(content, indent=1) if FILES[file].endswith("json") else yaml.dump(content, Dumper=DUMPER)
            self.path(file).write_text(text, encoding="utf-8")
        return self.path("scene")


Call = Callable[..., tuple[int, str]]
Refused = Callable[..., str]


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values in nested mappings and lists."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield (*path, key)
        yield from places(inner, (*path, key))


def content(folder: Path) -> dict[str, bytes]:
    """The bytes of all files below a folder, by their path in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def answer(call: Call, line: Iterable[object], *parts: str, status: int = 0) -> str:
    """Words of a command that ends with a status, 0 where it does its work: no traceback, and some parts."""
    ended, said = call(*line)
    assert ended == status, said
    assert "Traceback" not in said and not foreign(said), said
    for part in parts:
        assert part in said, f"{part!r} not in:\n{said}"
    return said


def refusal(call: Call, line: Iterable[object], *parts: str, kept: Path | None = None) -> str:
    """Words of a refused command: exit status 2, no traceback, and some parts; files of `kept` stay as they are."""
    before = None if kept is None else content(kept)
    said = answer(call, line, *parts, status=2)
    assert kept is None or content(kept) == before
    return said
