"""A live step is one frame of few vessels: its time is that of many small calls, whose number does not vary."""

import cProfile
import pstats
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d import Scene, load_scene
from modsim3d.render.id_pass import Region
from modsim3d.runs.pipeline import open_renderer, simulate_blocks, truth_block

BUSY, EMPTY = 110, 20  # steps of Simulation 2 with four vessels in the image, as in those after it, and with none
COUNTED = 5
PACKAGE = Path(modsim3d.__file__).parent


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("simulation_2", steps=BUSY + COUNTED)


def our_calls(profile: cProfile.Profile) -> int:
    """Calls by the package's modules; what libraries call in turn differs by their versions."""
    entries = pstats.Stats(profile).stats.values()  # type: ignore[attr-defined]
    by_caller = [(caller[0], numbers[0]) for entry in entries for caller, numbers in entry[-1].items()]
    return sum(count for file, count in by_caller if Path(file).is_relative_to(PACKAGE))


def test_a_step_of_four_vessels_takes_few_calls_and_one_without_fewer_and_no_renderer(scene: Scene) -> None:
    assert not len(truth_block(scene, EMPTY, EMPTY + COUNTED, renderer=None))
    blocks, done = simulate_blocks(scene, 1), 0
    for first, vessels, most_calls in ((EMPTY, 0, 470), (BUSY, 4, 1130)):
        for _ in range(done, first):
            next(blocks)
        profile = cProfile.Profile()
        counted = [profile.runcall(next, blocks) for _ in range(COUNTED)]
        assert [len(block.cameras[0].truth) for block in counted] == [vessels] * COUNTED
        assert our_calls(profile) / COUNTED < most_calls
        done = first + COUNTED


def test_a_renderer_that_is_prepared_draws_as_fast_the_first_time_as_later(scene: Scene) -> None:
    corners, region = np.array([[[0.0, 0.0], [30.0, 5.0], [10.0, 40.0]]]), Region(0, 0, 30, 40)
    with open_renderer(scene) as renderer:
        assert renderer is not None
        renderer.prepare()
        calls = []
        for _ in range(2):
            profile = cProfile.Profile()
            profile.runcall(renderer.draw, corners, np.ones((1, 3)), np.ones(1, dtype=np.int64), region)
            calls.append(pstats.Stats(profile).total_calls)
    assert calls[0] == calls[1]


LOADED_LATE = """
import sys
from modsim3d.runs.pipeline import simulate_blocks
from modsim3d.scene.reading import load_scene
blocks = simulate_blocks(load_scene("simulation_2", steps=115), 1)
next(blocks)
loaded = set(sys.modules)
list(blocks)
print(sorted(set(sys.modules) - loaded))
"""


def test_no_step_waits_for_a_library() -> None:
    assert subprocess.check_output([sys.executable, "-c", LOADED_LATE], text=True, timeout=60).split() == ["[]"]
