"""The page about detector files knows every key, and its examples are right."""

import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.file.schema import DetectorFile
from modsim3d.detector.records import KINDS
from tests.detector.detector_builders import detector_data

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "detector.md").read_text(encoding="utf-8")


def sections(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in typing.get_args(annotation):
        yield from sections(part)


def keys(model: type[BaseModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield name
        for section in sections(field.annotation):
            yield from keys(section)


def test_every_key_of_a_detector_file_is_in_the_table_and_every_kind_of_detection_is_explained() -> None:
    table = PAGE.split("## Every key")[1].split("\n## ")[0]
    words = set(re.findall(r"[a-z_]+", " ".join(re.findall(r"`([^`]+)`", table))))
    assert not set(keys(DetectorFile)) - words
    assert all(f"`{kind}`" in PAGE for kind in KINDS)


def test_the_example_of_dropout_is_right() -> None:
    (block,) = re.findall(r"```yaml\n(dropout:\n.*?)```", PAGE, flags=re.DOTALL)
    model = parse_detector(detector_data(**yaml.safe_load(block)))
    assert model.dropout.anchored and len(model.dropout.effects) == 2


def test_the_example_file_is_as_long_as_the_page_says() -> None:
    lines = len((ROOT / "scenes" / "detectors" / "rich.yaml").read_text().splitlines())
    assert f"in {lines} lines" in PAGE
