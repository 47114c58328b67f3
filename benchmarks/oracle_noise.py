"""Noise of the smoother of the oracle-association reference, fitted to a run, for script/make_oracle_noise."""

import numpy as np
from scipy.optimize import minimize

from modsim3d.core.arrays import Array
from modsim3d.core.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.oracle import BoxSequences, DetectionSources, IdentitySpans, SmootherNoise, filtered
from modsim3d.tracks.true_tracks import TrueTracks

LIMITS = {
    "noise_share": (1e-3, 1.0),
    "noise_x_px": (0.05, 500.0),
    "noise_y_px": (0.05, 500.0),
    "size_noise": (0.3, 5.0),
    "velocity_change_px_s": (0.01, 1000.0),
    "growth_change_px_s": (0.01, 1000.0),
}
_DIGITS = 3


def fitted_noise(rows: RunRows, truth: TrueTracks) -> SmootherNoise:
    """The most likely noise, from the innovations of detections that are associated by where they came from. Raises
    ModsimError if no vessel is detected twice."""
    provenance = DetectionSources.of(rows, truth)
    if np.bincount(provenance.identity, minlength=1).max() < 2:
        raise ModsimError(f"{rows.scene.name}: no vessel is detected twice, so there is no motion to fit noise to")
    return most_likely_noise(IdentitySpans.of(rows, provenance).sequences)


def log_likelihood(sequences: BoxSequences, noise: SmootherNoise) -> float:
    """Log-likelihood of all detections after the first of each sequence, from the innovations of the filter."""
    return sum(each.log_likelihood for each in filtered(sequences, noise))


def most_likely_noise(sequences: BoxSequences) -> SmootherNoise:
    """The noise under which the boxes of sequences are most likely, by maximum likelihood over its logarithms."""

    def noise_of(logarithms: Array) -> SmootherNoise:
        """Numbers with few digits: an optimum is flat, and its last ones depend on the processor."""
        values = (float(f"{value:.{_DIGITS}g}") for value in np.exp(logarithms).tolist())
        return SmootherNoise(**dict(zip(LIMITS, values, strict=True)))

    def unlikeliness(logarithms: Array) -> float:
        values = dict(zip(LIMITS, np.exp(logarithms).tolist(), strict=True))
        return -log_likelihood(sequences, SmootherNoise(**values)) / int(sequences.present.sum())

    limits = np.log(list(LIMITS.values()))
    start = np.log([getattr(SmootherNoise(), name) for name in LIMITS])
    found = minimize(unlikeliness, start, method="L-BFGS-B", bounds=limits, options={"maxiter": 60})
    return noise_of(found.x)
