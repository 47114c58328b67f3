"""A scene with own ship under way in waves, a rolled and distorted camera on its bow, and one ashore."""

from typing import Any

import numpy as np

from modsim3d.scene.scene import Scene
from tests.scenes import camera_keys

STEPS = 30
COVARIANCE = [[30.0, 5, 6, 0], [5, 9, 0, -6], [6, 0, 40, 8], [0, -6, 8, 20]]
OTHER_COVARIANCE = [[60.0, 0, -6, 0], [0, 16, 0, 4], [-6, 0, 90, 0], [0, 4, 0, 50]]
LENS = camera_keys(1280, 800)


def detector(**box_error: Any) -> dict[str, Any]:
    """A detector with two states of different errors, which misses a fifth in one and half in the other."""
    laws = {"clear": ([1, 2, -3, 4], COVARIANCE, 0.8), "haze": ([-4, 5, 2, -2], OTHER_COVARIANCE, 0.5)}
    return {
        "labels": ["Boat", "Ship"], "confidence_threshold": 0.2, "initial_state": "clear",
        "transition_matrix": [[0.9, 0.3], [0.1, 0.7]], "false_positives": {"model": "calibrated"},
        "states": {
            name: {
                "confusion": [[share, 0], [0, share], [1 - share, 1 - share]],
                "false_positive_labels": [0.5, 0.5],
                "false_discovery_rate": 0.2,
                "box_error": {"unit": "px", "mean": mean, "covariance": covariance, **box_error},
                "confidence": {"mean": 0.6, "std": 0.1},
            }
            for name, (mean, covariance, share) in laws.items()
        },
    }  # fmt: skip


def position_scene(**keys: Any) -> Scene:
    """The scene; keys of the scene file replace its own."""
    steps = np.arange(STEPS, dtype=float)
    positions, headings = np.zeros((STEPS, 3, 2)), np.zeros((STEPS, 3))
    positions[:, 0, 0], headings[:, 0] = 4 * steps, 0.2
    positions[:, 1] = np.stack([300 + 2 * steps, 40 + 0 * steps], axis=1)
    positions[:, 2] = [400, 20]
    mount = {"vessel": "flagship", "position_m": [8, 1, 7], "roll_rad": 0.1, "pitch_rad": 0.05, "yaw_rad": 0.1}
    attitude = {"attitude_noise_rad": 0.004, "attitude_bias_rad": 0.003}
    data: dict[str, Any] = {
        "seed": 3,
        "vessels": {
            "flagship": {"length_m": 20, "beam_m": 6, "air_draft_m": 6, "label": "Boat"},
            "mermaid": {"length_m": 12, "beam_m": 4, "air_draft_m": 5, "label": "Boat"},
            "leviathan": {"length_m": 80, "beam_m": 12, "air_draft_m": 20, "label": "Ship"},
        },
        "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 0.5},
        "cameras": {
            "bow": {**LENS, "distortion": {"k1": -0.1, "k2": 0.02, "p1": 0.001}, "mount": mount},
            "shore": {**LENS, "pose": {"position_m": [-50, 30, 20], "pitch_rad": 0.05}},
        },
        "waves": {"spectrum": "jonswap", "significant_height_m": 1.0, "peak_period_s": 5.0, "direction_rad": 1.0},
        "imu": {**attitude, "heading_noise_rad": 0.01, "heading_bias_rad": 0.005},
        "annotation": {"source": "analytic"}, "detector": detector(),
    }  # fmt: skip
    return Scene.from_dict(data | keys)
