"""What a scene folder and its report are written from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from modsim3d.ais.gathering import FileTally
from modsim3d.ais.options import Options
from modsim3d.ais.time_grid import TimeGrid
from modsim3d.ais.vessel_track import VesselTrack
from modsim3d.ais.viewpoint import Viewpoint


@dataclass(frozen=True, eq=False)
class Traffic:
    """The vessels of a scene, and how they came about.

    Attributes:
        options: What the user chose.
        files: What was found in each file.
        dropped: Reason → number of messages left out, in all files and afterwards.
        origin: Latitude and longitude of w1 = w2 = 0.
        grid: The steps.
        vessels: Those that are there at some step, by identity.
        elsewhere: Identities of vessels with usable positions that are there at no step.
        camera: A place to look from.
    """

    options: Options
    files: list[FileTally]
    dropped: Counter[str]
    origin: tuple[float, float]
    grid: TimeGrid
    vessels: list[VesselTrack]
    elsewhere: list[int]
    camera: Viewpoint

    def label(self, vessel: VesselTrack) -> str:
        """The label of a vessel."""
        return self.options.label(vessel.hull.group)
