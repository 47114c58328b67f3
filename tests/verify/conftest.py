"""A truth that several tests share, and what is expected of box errors over it, the same for most models."""

import pytest

from modsim3d import ManyDetections, MomentTable, load_scene


@pytest.fixture(scope="session")
def many() -> ManyDetections:
    return ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))


@pytest.fixture(scope="module")  # its last digits depend on the boxes that were asked for together
def table() -> MomentTable:
    return MomentTable()
