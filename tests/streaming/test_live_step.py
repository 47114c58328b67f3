"""A live step is one frame of few vessels: its time is that of many small calls, whose number does not vary."""

from __future__ import annotations

import cProfile
import pstats

import pytest

from modsim3d.runs.pipeline import simulate_blocks, truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

BUSY, EMPTY = 110, 20
"""A step of Simulation 2 with four vessels in the image, as those after it; and one with none."""
COUNTED = 5


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("simulation_2", steps=BUSY + COUNTED)


@pytest.fixture(scope="module")
def calls(scene: Scene) -> dict[int, float]:
    """Calls of Python's and NumPy's functions for a step, from some steps on; by the first of them."""
    blocks, found, done = simulate_blocks(scene, 1), {}, 0
    for first, vessels in ((EMPTY, 0), (BUSY, 4)):
        for _ in range(done, first):
            next(blocks)
        profile = cProfile.Profile()
        counted = [profile.runcall(next, blocks) for _ in range(COUNTED)]
        assert [len(block.cameras[0].truth) for block in counted] == [vessels] * COUNTED
        found[first], done = pstats.Stats(profile).total_calls / COUNTED, first + COUNTED
    return found


def test_a_step_of_four_vessels_takes_few_calls(calls: dict[int, float]) -> None:
    assert calls[BUSY] < 2500


def test_a_step_without_vessels_takes_fewer(calls: dict[int, float]) -> None:
    assert calls[EMPTY] < 1400


def test_where_nothing_is_in_view_nothing_need_be_drawn(scene: Scene) -> None:
    assert not len(truth_block(scene, EMPTY, EMPTY + COUNTED, renderer=None))
