"""Tracks with a name, and where they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from modsim3d.tracks.tracks import Tracks


@dataclass(frozen=True)
class Origin:
    """How tracks were made.

    Attributes:
        tracker: Name of the tracker.
        settings: All its settings, as JSON can hold them.
        chosen: Where the settings come from, a sentence.
        package: The package that the tracker is a part of, with its version, such as `modsim3d 0.1.0`.
        versions: Versions of the packages that decide the tracks, by name.
    """

    tracker: str
    settings: dict[str, Any]
    chosen: str
    package: str
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class TrackSet:
    """The tracks of one tracker in a run.

    Attributes:
        name: What tables call it.
        tracks: The tracks.
        origin: How they were made; None for somebody's own file.
        unnamed: Cameras of the run of which the file has no line, though it has lines of others and could say so.
    """

    name: str
    tracks: Tracks
    origin: Origin | None
    unnamed: tuple[str, ...] = ()

    def in_cameras(self, cameras: Sequence[int]) -> Self:
        """The tracks in some cameras, by their indices."""
        return replace(self, tracks=self.tracks.take(np.isin(self.tracks.camera, cameras)))
