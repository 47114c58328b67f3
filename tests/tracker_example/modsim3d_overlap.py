"""A tracker for modsim3d: a detection continues the track whose last box it overlaps most."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d import TrackedFrame, Tracker
from modsim3d.plugins import iou


class Overlap(Tracker):
    least_iou: float = 0.3

    def follow(self, frames, camera):
        before, begun = TrackedFrame.empty(), 0
        for frame in frames:
            alike = iou(frame.boxes_px[:, None], before.boxes_px)
            i, j = linear_sum_assignment(alike, maximize=True)
            track = np.arange(begun, begun := begun + len(alike))
            track[i] = np.where(alike[i, j] >= self.least_iou, before.track[j], track[i])
            yield (before := TrackedFrame(track, frame.boxes_px, frame.label, frame.confidence))
