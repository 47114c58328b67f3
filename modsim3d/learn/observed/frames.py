"""What the times of frames say: how long runs of frames usually are, and what noise keeps from frame to frame."""

from __future__ import annotations

import numpy as np

from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.persistence.persistence_fit import frame_interval_s

_USUAL_RUNS = 24


def usual_run_s(observed: Observed) -> float:
    """Length of runs of frames in which misses that persist look independent; 0 where frames are not consecutive."""
    times = observed.labelled.images.time_s
    if not len(observed.steps):
        return 0.0
    return float(np.nanmax(times) - np.nanmin(times)) / _USUAL_RUNS


def kept_share(observed: Observed, correlation_s: float) -> float:
    """Share of noise with a correlation time, 0 if it does not persist, that is kept from one frame to the next."""
    return float(np.exp(-frame_interval_s(observed.labelled) / correlation_s)) if correlation_s > 0 else 0.0
