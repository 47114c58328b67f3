"""The error of a box's centre and foot, as one who does not know the detector's performance state has to expect it.

The state of a frame is drawn from the share of the time that the chain spends in each, weighted by how often the
detector then sees a vessel: this is the state of a detection picked at random. The mean of the mixture is the mean of
the states' means, and its covariance follows from the law of total variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.model import DetectorModel

FOOT_OF_ERRORS = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0.5]], dtype=np.float64)
"""Centre column, centre row and row of the foot from centre, width and height."""
EDGES_OF_ERRORS = np.array([[1, 0, -0.5, 0], [1, 0, 0.5, 0], [0, 1, 0, 0.5]], dtype=np.float64)
"""Left, right and lower edge from the same."""
_DOUBLINGS = 60


@dataclass(frozen=True, eq=False)
class FootErrors:
    """Errors of the centre's column and row and of the foot's row of n boxes, and of their edges, in pixels.

    Attributes:
        means: Shape (n, 3).
        covariances: Shape (n, 3, 3).
        edge_means: Of the left, right and lower edge, shape (n, 3).
        edge_stds: Their standard deviations, shape (n, 3).
    """

    means: Array
    covariances: Array
    edge_means: Array
    edge_stds: Array

    def take(self, rows: Indices) -> FootErrors:
        """Those of some of the boxes."""
        return FootErrors(*(column[rows] for column in vars(self).values()))


def state_shares(model: DetectorModel) -> Array:
    """Probability of each performance state, given that there is a true detection, shape (states,).

    The long run of the chain from its initial state; a schedule of forced states is not looked at.
    """
    chain = (np.eye(len(model.states)) + model.transition_matrix) / 2  # the same long run, and no period
    for _ in range(_DOUBLINGS):
        chain = chain @ chain
        chain /= chain.sum(axis=0)
    detected = np.array([1 - state.confusion[-1].mean() for state in model.states])
    weights: Array = chain[:, model.initial_state] * detected
    return weights / weights.sum() if weights.sum() > 0 else chain[:, model.initial_state]


def foot_errors(model: DetectorModel, boxes_px: Array) -> FootErrors:
    """What to expect of the errors of detected boxes, shape (n, 4).

    Errors that grow with the box are worked out for the detected size less its mean error: the true one is not known.
    """
    source, shares = BoxErrorSource.from_model(model), state_shares(model)
    observed = np.maximum(sizes(boxes_px), 1.0)
    growth = _mixed(source, shares, observed)[0][:, 2:]
    means, covariances = _mixed(source, shares, np.maximum(observed - growth, 1.0))
    edges = EDGES_OF_ERRORS @ covariances @ EDGES_OF_ERRORS.T
    return FootErrors(
        means @ FOOT_OF_ERRORS.T,
        FOOT_OF_ERRORS @ covariances @ FOOT_OF_ERRORS.T,
        means @ EDGES_OF_ERRORS.T,
        np.sqrt(np.diagonal(edges, axis1=1, axis2=2)),
    )


def _mixed(source: BoxErrorSource, shares: Array, sizes_px: Array) -> tuple[Array, Array]:
    """Mean (n, 4) and covariance (n, 4, 4) over the states."""
    moments = [source.moments_px(np.full(len(sizes_px), state), sizes_px) for state in range(len(shares))]
    mean = sum((share * m for share, (m, _) in zip(shares, moments, strict=True)), np.zeros((len(sizes_px), 4)))
    covariance = np.zeros((len(sizes_px), 4, 4))
    for share, (state_mean, state_covariance) in zip(shares, moments, strict=True):
        apart = state_mean - mean
        covariance += share * (state_covariance + apart[:, :, None] * apart[:, None, :])
    return mean, covariance
