"""A run that draws nothing does not load the thousand functions of OpenGL, whose import takes a tenth of its time."""

import subprocess
import sys

DRAWS_NOTHING = """
import sys
from modsim3d.runs.pipeline import open_renderer, simulate_blocks, truth_block
from modsim3d.scene.reading import load_scene
scene = load_scene("simulation_1", steps=3)
with open_renderer(scene) as renderer:
    truth = truth_block(scene, 0, 3, renderer)
    assert "OpenGL 4." in renderer.context.description
print(len(truth) > 0, "OpenGL.GL" in sys.modules)
next(simulate_blocks(scene, 1))
print("OpenGL.GL" in sys.modules)
"""


def test_opengl_is_loaded_at_the_first_drawing_and_a_library_missing_beside_egl_told_at_once():
    said = subprocess.check_output([sys.executable, "-c", DRAWS_NOTHING], text=True, timeout=240)
    assert said.split() == ["True", "False", "True"]
    said = subprocess.check_output([sys.executable, "-c", WITHOUT_LIBRARY], text=True, timeout=240)
    assert "libopengl0" in said


WITHOUT_LIBRARY = """
import os
os.environ["MODSIM3D_GL"] = os.environ["PYOPENGL_PLATFORM"] = "egl"
from OpenGL.platform import PLATFORM
PLATFORM.GL = None  # as PyOpenGL has it where no library is found
from modsim3d.core.errors import RendererError
from modsim3d.render.context import open_context
try:
    with open_context():
        pass
except RendererError as error:
    print(error)
"""
