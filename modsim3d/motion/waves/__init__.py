"""How vessels move in waves: an interface, and a module for each model."""

from modsim3d.motion.waves.base import GRAVITY_M_S2, Motion, Passage, WaveMotion
from modsim3d.motion.waves.floating import FloatingVessels
from modsim3d.motion.waves.hull import Hull
from modsim3d.motion.waves.jonswap import PEAKEDNESS, STEEPEST, Sea, jonswap_sea
from modsim3d.motion.waves.second_order import (
    AXES,
    LEVELS,
    SMALL_SIGMA_RAD,
    Axis,
    SecondOrderWaves,
    level_axes,
    second_order,
)

__all__ = [
    "AXES",
    "GRAVITY_M_S2",
    "LEVELS",
    "PEAKEDNESS",
    "SMALL_SIGMA_RAD",
    "STEEPEST",
    "Axis",
    "FloatingVessels",
    "Hull",
    "Motion",
    "Passage",
    "Sea",
    "SecondOrderWaves",
    "WaveMotion",
    "jonswap_sea",
    "level_axes",
    "second_order",
]
