"""A detector for the labels of a scene, made from one with a single label."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.text_files import read_text

NOTE = """\
# The detector of {name}, spread over several labels: the same chance to miss a vessel whatever it is, none to take
# it for another, and false positives of all labels alike. That is an assumption; put measured numbers in their place.
"""


def detector_text(single: Path, labels: Sequence[str]) -> str:
    """The text of a detector file.

    Args:
        single: A detector file with one label.
        labels: The scene's.

    Returns:
        The file as it is if its label is the scene's only one, else one with a confusion matrix for all of them.
    """
    text = read_text(single, "detector file")
    data: dict[str, Any] = load_yaml(single, "detector file")
    if list(labels) == data["labels"]:
        return text
    data["labels"] = list(labels)
    for state in data["states"].values():
        (found,), (missed,) = state["confusion"]
        own = [[found if row == column else 0.0 for column in range(len(labels))] for row in range(len(labels))]
        state["confusion"] = [*own, [missed] * len(labels)]
        state["false_positive_labels"] = [1 / len(labels)] * len(labels)
    note = NOTE.format(name=single.name)
    return note + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
