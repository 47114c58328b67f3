"""Names of topics and frames in a bag, after REP 103 and REP 105."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from modsim3d.errors import InputError
from modsim3d.formats.writing.request import ExportRequest

MAP = "map"
"""The world's frame: x = w1, y = w2, z = w3."""


@dataclass(frozen=True)
class BagNames:
    """Names in the bags of an export.

    Attributes:
        cameras: For each camera, by its index, its name in topics and frames.
        vessels: For each vessel that carries one of these, by its index, the prefix of its topics and frames: its name
            and a slash, or nothing if it is the only vessel of the scene that carries cameras.
    """

    cameras: Mapping[int, str]
    vessels: Mapping[int, str]

    def base(self, vessel: int) -> str:
        """The frame of a vessel that carries a camera: x forward, y to port, z up."""
        return f"{self.vessels[vessel]}base_link"

    def imu(self, vessel: int) -> str:
        """The frame of its inertial unit, with the same axes."""
        return f"{self.vessels[vessel]}imu_link"

    def optical(self, camera: int) -> str:
        """The frame of a camera: z forward, x right, y down."""
        return f"{self.cameras[camera]}_optical_frame"


def bag_names(request: ExportRequest) -> BagNames:
    """The names for an export.

    Raises:
        InputError: Two cameras or two vessels have names that are the same in ROS.
    """
    scene = request.run.scene
    carriers = {scene.cameras[index].mount.vessel for index in request.cameras}
    own = [index for index in scene.own_ships if scene.vessel_names[index] in carriers]
    cameras = _tokens("camera", {index: scene.cameras[index].name for index in request.cameras}, scene.title)
    vessels = _tokens("vessel", {index: scene.vessel_names[index] for index in own}, scene.title)
    alone = len(scene.own_ships) == 1
    return BagNames(cameras, {index: "" if alone else f"{token}/" for index, token in vessels.items()})


def _tokens(kind: str, names: Mapping[int, str], source: str) -> dict[int, str]:
    tokens: dict[int, str] = {}
    for index, name in names.items():
        token = _token(kind, name)
        same = [names[other] for other, known in tokens.items() if known == token]
        if same:
            problem = f"{kind}s '{same[0]}' and '{name}' are both called '{token}' in ROS"
            raise InputError(source, [f"{problem}: rename one, or export one at a time with --camera"])
        tokens[index] = token
    return tokens


def _token(kind: str, name: str) -> str:
    """A name of the letters, digits and underscores that ROS takes, beginning with a letter."""
    token = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return token if token[:1].isalpha() else f"{kind}_{token}".rstrip("_")
