"""Modules that were documented elsewhere are still found there."""

from __future__ import annotations

from importlib import import_module

import pytest


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("modsim3d.poses", "modsim3d.motion.poses", "PosesByTime"),
        ("modsim3d.poses", "modsim3d.motion.poses", "LivePoses"),
        ("modsim3d.waves", "modsim3d.motion.waves", "Axis"),
        ("modsim3d.stored_run", "modsim3d.runs.stored_run", "open_run"),
    ],
)
def test_a_documented_name_is_found_where_it_was(old: str, new: str, name: str) -> None:
    assert getattr(import_module(old), name) is getattr(import_module(new), name)
