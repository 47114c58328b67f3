"""Wave levels by name, plug-ins included."""

from __future__ import annotations

from modsim3d.errors import InputError
from modsim3d.inputs.plugins import WAVE_LEVELS, Plugin, load_plugin
from modsim3d.motion.waves import AXES, LEVELS, Axis, level_axes

Axes = tuple[Axis, Axis, Axis]
"""Roll, pitch and yaw."""


def find_level(name: str) -> tuple[Axes, Plugin | None]:
    """The axes of a wave level, and the plug-in that it comes from; None if it is built in.

    A plug-in of the group `modsim3d.wave_levels` is a tuple of three `Axis`: roll, pitch and yaw.

    Raises:
        InputError: There is no such level, or the plug-in is no three axes.
    """
    if name in LEVELS:
        return level_axes(name), None
    found, plugin = load_plugin(WAVE_LEVELS, name, "waves.level", LEVELS)
    if isinstance(found, tuple | list) and len(found) == len(AXES) and all(isinstance(axis, Axis) for axis in found):
        roll, pitch, yaw = found
        return (roll, pitch, yaw), plugin
    raise InputError(
        "waves.level", [f"{plugin} must be three modsim3d.motion.waves.Axis, for {', '.join(AXES)}, not {found!r}"]
    )
