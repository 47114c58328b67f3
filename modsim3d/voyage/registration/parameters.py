"""What a registration can change, with units, and how far each may plausibly be from what the scene says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import nearest


@dataclass(frozen=True)
class Parameter:
    """One number of a registration.

    Attributes:
        name: Name with the unit.
        words: What it is, in a sentence.
        unit: Unit in text; empty if it has none.
        plausible: How far it may be from the scene's value; data that know it no better than this do not know it.
    """

    name: str
    words: str
    unit: str
    plausible: float


CAMERA = (
    Parameter("clock_s", "clock: seconds to add to the detector's times", "s", 10.0),
    Parameter("roll_deg", "roll of the camera", "°", 3.0),
    Parameter("pitch_deg", "pitch of the camera", "°", 3.0),
    Parameter("yaw_deg", "yaw of the camera", "°", 5.0),
    Parameter("height_m", "height of the camera", "m", 3.0),
    Parameter("focal_share", "focal length, as a share", "", 0.1),
    Parameter("k1", "lens distortion k1", "", 0.1),
)
MEAN_ERRORS = (
    Parameter("mean_x_px", "mean box error in x", "px", 5.0),
    Parameter("mean_y_px", "mean box error in y", "px", 5.0),
    Parameter("mean_width_share", "mean box error in width, as a share", "", 0.2),
    Parameter("mean_height_share", "mean box error in height, as a share", "", 0.2),
)
OF_A_VESSEL = (
    Parameter("along_m", "antenna, towards the bow of the centre", "m", 20.0),
    Parameter("across_m", "antenna, to port of the centre", "m", 5.0),
    Parameter("delay_s", "delay of its position reports", "s", 5.0),
)
SHARED = (*CAMERA, *MEAN_ERRORS)
SHARED_NAMES = tuple(parameter.name for parameter in SHARED)
SHORT = {name.rsplit("_", 1)[0]: name for name in SHARED_NAMES if "_" in name}
"""Names without their units, which `fixed` takes too: `pitch` for `pitch_deg`."""
PLACE = {name: place for place, name in enumerate(SHARED_NAMES)}


@dataclass(frozen=True, eq=False)
class Values:
    """Values of all parameters: zero is what the scene says.

    Attributes:
        shared: Those of `SHARED`, shape (11,).
        vessels: Those of `OF_A_VESSEL` for each vessel, shape (V, 3).
    """

    shared: Array
    vessels: Array

    @classmethod
    def none(cls, vessels: int) -> Values:
        """What the scene says."""
        return cls(np.zeros(len(SHARED)), np.zeros((vessels, len(OF_A_VESSEL))))

    def __getitem__(self, name: str) -> float:
        """A shared value by its name."""
        return float(self.shared[PLACE[name]])

    def scaled(self, names: Sequence[str]) -> Array:
        """Named shared values in plausible distances, shape (n,)."""
        found: Array = self.shared[[PLACE[name] for name in names]] / plausible(names)
        return found

    def changed(self, **by: float) -> Values:
        """The same with other shared values."""
        shared = self.shared.copy()
        for name, value in by.items():
            shared[PLACE[name]] = value
        return Values(shared, self.vessels)

    def moved(self, name: str, step: float) -> Values:
        """The same with a step added to one shared value, or to one value of all vessels."""
        shared, vessels = self.shared.copy(), self.vessels.copy()
        if name in PLACE:
            shared[PLACE[name]] += step
        else:
            vessels[:, [parameter.name for parameter in OF_A_VESSEL].index(name)] += step
        return Values(shared, vessels)


def plausible(names: Iterable[str]) -> Array:
    """Plausible distances of named parameters from the scene's values, shape (n,)."""
    known = {parameter.name: parameter.plausible for parameter in (*SHARED, *OF_A_VESSEL)}
    return np.array([known[name] for name in names])


def held(names: Iterable[str]) -> Mask:
    """Which shared parameters are named, by their names with or without unit, shape (11,).

    Raises:
        ModsimError: There is no such parameter.
    """
    mask = np.zeros(len(SHARED), dtype=bool)
    for name in names:
        full = SHORT.get(name, name)
        if full not in PLACE:
            raise ModsimError(f"fixed: no parameter '{name}' ({nearest(name, [*SHORT, 'k1'])})")
        mask[PLACE[full]] = True
    return mask
