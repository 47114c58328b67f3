"""Registration: how a camera and its detector's clock differ from what a scene says, from the detections themselves.

`register` is the way through. `search` makes first guesses, `starts` chooses among them, `aligning` matches detections
with vessels and fits in turn, and `determined` finds what the data cannot tell apart. `estimating` fits the rest
together with what is wrong with single vessels, whose positions are `drifting`. `covariance` says how well it is known.
"""

from modsim3d.voyage.registration.boxes_at_times import BoxesAtTimes
from modsim3d.voyage.registration.registering import register
from modsim3d.voyage.registration.registration import Estimate, Registration

__all__ = ["BoxesAtTimes", "Estimate", "Registration", "register"]
