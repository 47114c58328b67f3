"""Means that a user knows of what registration cannot tell from a camera and a clock, as given to `--known`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from modsim3d.errors import InputError
from modsim3d.inputs.validation import nearest, shown
from modsim3d.scene.scene import Scene
from modsim3d.voyage.moved_vessels import with_moved_vessels


@dataclass(frozen=True)
class KnownMeans:
    """What is known beforehand; None where nothing is.

        KnownMeans(mean_x_px=1.5, delay_s=2)

    Attributes:
        mean_x_px: Mean error of the boxes' centres in x, in pixels: detected less true.
        mean_y_px: That in y.
        mean_width_share: Mean error of the boxes' widths, as a share of the true ones.
        mean_height_share: That of the heights.
        delay_s: Mean delay of position reports, in seconds: a report says where a vessel was so long before its time.
    """

    mean_x_px: float | None = None
    mean_y_px: float | None = None
    mean_width_share: float | None = None
    mean_height_share: float | None = None
    delay_s: float | None = None

    @property
    def mean_errors(self) -> tuple[float | None, ...]:
        """Those of boxes, in x, y, width and height."""
        return self.mean_x_px, self.mean_y_px, self.mean_width_share, self.mean_height_share

    def given(self) -> dict[str, float]:
        """Those that are known, by the names of the attributes."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) is not None}

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with its vessels where they were, if reports are late; own ships stay."""
        if not self.delay_s:
            return scene
        offsets = np.zeros((len(scene.vessels), 3))
        offsets[:, 2] = self.delay_s
        offsets[list(scene.own_ships), 2] = 0
        return with_moved_vessels(scene, offsets)


NOTHING_KNOWN = KnownMeans()
SHORT = {each.name.rsplit("_", 1)[0]: each.name for each in fields(KnownMeans)}
"""Names as users write them: `mean_x` for `mean_x_px`."""
_FORM = f"must be NAME=VALUE,..., such as mean_x=1.5,delay=2, with the names {', '.join(SHORT)}"


def parse_known(given: str | Mapping[str, float] | KnownMeans | None) -> KnownMeans:
    """Means from a text such as `mean_x=1.5,delay=2`, or a mapping of names to values.

    Raises:
        InputError: A name is unknown or there twice, or a value is no number or too large.
    """
    if given is None or isinstance(given, KnownMeans):
        return given or NOTHING_KNOWN
    known, problems = NOTHING_KNOWN, []
    for name, text in _pairs(given):
        full, value = SHORT.get(name), _number(text)
        if full is None:
            problems.append(f"no mean {shown(name)} ({nearest(name, SHORT)})")
        elif getattr(known, full) is not None:
            problems.append(f"{name}: is given twice")
        elif math.isnan(value) or (full.endswith("_share") and abs(value) >= 1):
            needed = "a share above -1 and below 1, such as 0.02" if full.endswith("_share") else "a number"
            problems.append(f"{name}: must be {needed} (got {shown(text)})")
        else:
            known = replace(known, **{full: value})
    if problems:
        raise InputError("--known", problems)
    return known


def _pairs(given: str | Mapping[str, float]) -> list[tuple[str, object]]:
    if isinstance(given, Mapping):
        return list(given.items())
    pairs = [part.partition("=") for part in given.split(",")]
    if not all(name.strip() and sign for name, sign, _ in pairs):
        raise InputError("--known", [f"{_FORM} (got {shown(given)})"])
    return [(name.strip(), value.strip()) for name, _, value in pairs]


def _number(value: object) -> float:
    """A finite number, NaN if it is none."""
    try:
        number = float(str(value))
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan
