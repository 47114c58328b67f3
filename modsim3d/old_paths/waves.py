"""Moved to `modsim3d.motion.waves`."""

from modsim3d.motion.waves import *  # noqa: F403
