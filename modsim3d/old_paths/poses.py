"""Moved to `modsim3d.motion.poses`."""

from modsim3d.motion.poses import *  # noqa: F403
