"""What a scene says about the AIS equipment of its vessels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Ais:
    """AIS equipment, and how good it is.

    Attributes:
        vessels: ID → `A`, `B` or `none`, of the vessels whose class is not chosen by size and label.
        drop_out: Share of the reports that are not received.
        position_noise_m: Standard deviation of a position along each axis.
    """

    vessels: Mapping[str, str] = field(default_factory=dict)
    drop_out: float = 0.05
    position_noise_m: float = 3.0


USUAL_AIS = Ais()
"""Of a scene that says nothing."""
