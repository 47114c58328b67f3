"""Parts of the page that other rooms make; a room that is not there makes none."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def made_by(module: str, name: str) -> Callable[..., Any] | None:
    """A function of a module of campaigns; None if there is none."""
    try:
        return getattr(import_module(f"modsim3d.campaign.{module}"), name, None)
    except ModuleNotFoundError:
        return None
