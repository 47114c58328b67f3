"""Global nearest neighbour and joint probabilistic data association, as Stone Soup has them, in image and world."""

import warnings
from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import Annotated, Any

from pydantic import Field

from modsim3d.core.errors import ModsimError
from modsim3d.io.validation import NotNegative, Positive, Probability
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker, answers_of
from modsim3d.tracking.trackers.world_interface import WorldFacts, WorldStep, WorldTrackedStep, WorldTracker

Share = Annotated[float, Field(strict=True, gt=0, lt=1)]
DetectionCount = Annotated[int, Field(strict=True, ge=1, le=1000)]


def _parts() -> Any:
    """The module that imports Stone Soup. Raises ModsimError without it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_module("modsim3d.tracking.trackers.stone_soup_parts")
    except ImportError:
        raise ModsimError('Stone Soup trackers need stonesoup: pip install "modsim3d[trackers]"') from None


class StoneSoup(Tracker):
    """Base of two trackers: a Kalman filter of the box's centre, velocity and size, in the image. The centre moves with
    constant velocity, width and height walk at random."""

    # Standard deviations of the error of a detection's centre, and of its width and height: a part in pixels and a part
    # as a share of the detection's width and height, added in squares.
    centre_sigma_px: Positive = 3.0
    centre_sigma_share: NotNegative = 0.1
    size_sigma_px: Positive = 3.0
    size_sigma_share: NotNegative = 0.2
    acceleration_density_px2_s3: Positive = 30.0  # power spectral density of the acceleration of the centre
    size_density_px2_s: Positive = 30.0  # variance that width and height gain each second
    speed_sigma_px_s: Positive = 30.0  # standard deviation of the speed of a new track, in each axis
    gate_probability: Share = 0.997  # share of the true detections that lie in the gate
    minimum_detections: DetectionCount = 3  # that confirm a track; before, it is not reported
    tentative_s: NotNegative = 1.0  # a track that is not yet confirmed is dropped after so long without a detection
    lost_s: NotNegative = 3.0  # a track is dropped after so long without a detection
    coast_s: NotNegative = 1.0  # a track without a detection is reported for so long, at most until it is dropped

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        """Track the detections of one camera. Raises ModsimError without Stone Soup, or if it failed in a frame."""
        tracker = _parts().ImageTracker(self, camera, isinstance(self, StoneSoupJpda))
        yield from answers_of(type(self).__name__, tracker.step, frames, camera)


class StoneSoupGnn(StoneSoup):
    """Each detection goes to one track, so that the sum of Mahalanobis distances is smallest."""


class StoneSoupJpda(StoneSoup):
    """Each track is updated with all detections in its gate, weighted by how probably each is its own."""

    detection_probability: Share = 0.9  # probability that a vessel is detected in a frame
    # Mean number of false positives in a frame; they are taken to lie anywhere in the image, with widths and heights
    # up to a quarter of the image's.
    false_alarms_per_frame: Positive = 1.0


class StoneSoupWorld(WorldTracker):
    """Base of two trackers: an extended Kalman filter of position and velocity on the sea, with nearly constant
    velocity. It measures bearing and inverse range, with the covariances of the detections: that of the detector's box
    errors and of own ship's attitude. Frames of all cameras and reports of AIS are taken in order of time."""

    acceleration_density_m2_s3: Positive = 0.05  # power spectral density of a vessel's acceleration
    speed_sigma_m_s: Positive = 4.0  # standard deviation of the speed of a new track, in each axis
    waterline_m: NotNegative = 4.0  # a vessel's centre lies that far behind its waterline
    extent_m: Positive = 3.0  # standard deviation of what a box's middle and foot are off by, since vessels have sizes
    error_scale: Positive = 1.0  # factor of the standard deviations of detections, above 1 where their errors last
    gate_probability: Share = 0.99  # share of the true detections that lie in the gate
    detection_probability: Share = 0.9  # probability that a vessel is detected in a frame
    false_alarms_per_frame: Positive = 1.0  # mean number of false positives in a frame
    start_confidence: Probability = 0.0  # least confidence of a detection that starts a track
    start_error: Positive = 0.3  # greatest standard deviation of its inverse range, as a share of that
    farthest_m: Positive = 3000.0  # distance beyond which no vessel is expected
    minimum_detections: DetectionCount = 4  # that confirm a track; before, it is not reported
    tentative_s: NotNegative = 1.0  # a track that is not yet confirmed is dropped after so long without a detection
    lost_s: NotNegative = 5.0  # a track is dropped after so long without a detection
    coast_s: NotNegative = 2.0  # a track without a detection is reported for so long, at most until it is dropped
    greatest_std_m: Positive = 50.0  # a track whose position is less well known is not reported
    ais: bool = False  # whether tracks are corrected by AIS
    ais_std_m: Positive = 10.0  # standard deviation of a position from AIS, the antenna's place on board included

    def follow_world(self, steps: Iterable[WorldStep], facts: WorldFacts) -> Iterator[WorldTrackedStep]:
        """Track the vessels around. Raises ModsimError without Stone Soup, or if it failed at a step."""
        tracker = _parts().WorldFilter(self, facts, isinstance(self, WorldJpda))
        yield from answers_of(type(self).__name__, tracker.step, steps)


class WorldGnn(StoneSoupWorld):
    """Each detection goes to one track, so that all together are most likely."""


class WorldJpda(StoneSoupWorld):
    """Each track is updated with all detections in its gate, weighted by how probably each is its own."""
