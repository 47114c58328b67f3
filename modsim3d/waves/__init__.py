"""How vessels move in waves: an interface, and one file for each way of moving."""

from modsim3d.waves.base import Motion, Passage, WaveMotion
from modsim3d.waves.second_order import (
    AXES,
    BLOCK_STEPS,
    LEVELS,
    SMALL_SIGMA_RAD,
    Axis,
    SecondOrderWaves,
    level_axes,
    long_run_deviation,
    second_order,
    second_order_variance,
)

__all__ = [
    "AXES",
    "BLOCK_STEPS",
    "LEVELS",
    "SMALL_SIGMA_RAD",
    "Axis",
    "Motion",
    "Passage",
    "SecondOrderWaves",
    "WaveMotion",
    "level_axes",
    "long_run_deviation",
    "second_order",
    "second_order_variance",
]
