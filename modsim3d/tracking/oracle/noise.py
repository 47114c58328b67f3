"""What the smoother of the oracle-association reference takes for the noise of boxes and the motion of vessels."""

from __future__ import annotations

import numpy as np
from pydantic import ValidationError

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import NotNegative, Positive, Strict, describe


class SmootherNoise(Strict):
    """Noise of detected boxes, and how the boxes of vessels move.

    Attributes:
        noise_share: Standard deviation of a detected centre, as a share of the box's width and height.
        noise_x_px: What is added to that across, in pixels.
        noise_y_px: What is added to it down the image, in pixels.
        size_noise: Standard deviation of width and height, over that of the centre.
        velocity_change_px_s: Standard deviation of the change of the centre's velocity in one second.
        growth_change_px_s: Standard deviation of the change, in one second, of the rate at which a box grows.
    """

    noise_share: NotNegative = 0.02
    noise_x_px: NotNegative = 5.0
    noise_y_px: NotNegative = 3.0
    size_noise: NotNegative = 1.5
    velocity_change_px_s: Positive = 5.0
    growth_change_px_s: Positive = 2.0

    def variance_px2(self, size_px: Array) -> Array:
        """Of centre x, centre y, width and height of detections of vessels of a size (..., 2), shape (..., 4)."""
        centre_px = self.noise_share * np.maximum(size_px, 1) + np.array([self.noise_x_px, self.noise_y_px])
        return np.concatenate([centre_px, self.size_noise * centre_px], axis=-1) ** 2

    @property
    def rate_walk_px_s(self) -> Array:
        """Change in one second of the rates of centre x, centre y, width and height, shape (4,)."""
        return np.repeat([self.velocity_change_px_s, self.growth_change_px_s], 2)


class _NoiseFile(Strict):
    """The content of the file: the noise of scenes by their names, and of all others."""

    default: SmootherNoise
    scenes: dict[str, SmootherNoise]


def smoother_noise(scene_name: str) -> SmootherNoise:
    """The noise for a scene, from the file that comes with the package.

    Raises:
        InputError: The file is damaged.
    """
    path = data_folder("scenes") / "trackers" / "oracle.yaml"
    content = load_yaml(path, "smoother noise")
    try:
        found = _NoiseFile.model_validate(content)
    except ValidationError as error:
        raise InputError(f"smoother noise {path}", describe(error, _NoiseFile)) from None
    return found.scenes.get(scene_name, found.default)
