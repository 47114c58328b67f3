"""Global nearest neighbour and joint probabilistic data association, as Stone Soup has them."""

import warnings
from collections.abc import Iterable, Iterator
from typing import Annotated

from pydantic import Field

from modsim3d.core.errors import ModsimError
from modsim3d.io.validation import NotNegative, Positive
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker, answers_of

Share = Annotated[float, Field(strict=True, gt=0, lt=1)]
DetectionCount = Annotated[int, Field(strict=True, ge=1, le=1000)]


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
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                from modsim3d.tracking.trackers.stone_soup_parts import ImageTracker
        except ImportError:
            raise ModsimError('Stone Soup trackers need stonesoup: pip install "modsim3d[trackers]"') from None
        tracker = ImageTracker(self, camera, isinstance(self, StoneSoupJpda))
        yield from answers_of(type(self).__name__, tracker.step, frames, camera)


class StoneSoupGnn(StoneSoup):
    """Each detection goes to one track, so that the sum of Mahalanobis distances is smallest."""


class StoneSoupJpda(StoneSoup):
    """Each track is updated with all detections in its gate, weighted by how probably each is its own."""

    detection_probability: Share = 0.9  # probability that a vessel is detected in a frame
    # Mean number of false detections in a frame; they are taken to lie anywhere in the image, with widths and heights
    # up to a quarter of the image's.
    false_alarms_per_frame: Positive = 1.0
