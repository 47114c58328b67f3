"""Contrast of colours, also as people with colour-blindness see them."""

import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

CVD = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}
"""Of linear red, green and blue: Machado, Oliveira & Fernandes (2009), severity 1."""


def linear(colour: str | ArrayLike) -> NDArray[np.float64]:
    """Linear red, green and blue of a CSS colour `rgb(r, g, b)`, or of channels from 0 to 255; shape (3,)."""
    channels = re.findall(r"[\d.]+", colour)[:3] if isinstance(colour, str) else colour
    value = np.asarray(channels, dtype=np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(a: str | ArrayLike, b: str | ArrayLike, seen_with: str | None = None) -> float:
    """The contrast ratio of WCAG 2, 1 to 21, as someone with a colour-blindness of `CVD` sees it, or with none."""
    matrix = np.eye(3) if seen_with is None else np.array(CVD[seen_with])
    low, high = sorted(float(np.clip(matrix @ linear(each), 0, 1) @ [0.2126, 0.7152, 0.0722]) for each in (a, b))
    return (high + 0.05) / (low + 0.05)
