"""Environments that give no usable OpenGL: one sentence that says what would be right, never a traceback."""

import json
import os
import subprocess
import sys

import pytest

from modsim3d.render.context import library_found

NO_DISPLAY = "EGL gave no display without a surface: Mesa's EGL (libegl-mesa0) is needed"
NO_CONTEXT = "EGL gave no OpenGL 4.5 context: Mesa 18 or a newer driver of the card is needed"
TAKEN_AWAY = " takes away what OpenGL 4.5 needs: unset it"
WORDS = ("-GL_ARB_framebuffer_object", "-GL_ARB_clip_control", "+GL_EXT_abgr -GL_ARB_texture_float")
WITHOUT = [f"MESA_EXTENSION_OVERRIDE={words}" for words in WORDS]
OSMESA_WAYS = {
    "MESA_GL_VERSION_OVERRIDE=3.3": "no OpenGL 4.5 context",
    "MESA_GL_VERSION_OVERRIDE=2.1": "no OpenGL 4.5 context",
    **dict.fromkeys(WITHOUT, TAKEN_AWAY),
    "MESA_GLSL_VERSION_OVERRIDE=130": "OpenGL 4.5 has 450: unset the variable",
    "GALLIUM_DRIVER=nonsense": "OSMesa has llvmpipe only: unset it",
    "GALLIUM_DRIVER=d3d12": "MODSIM3D_GL=egl",
    "GALLIUM_DRIVER=softpipe": "llvmpipe",
}
EGL_WAYS = {
    "MESA_GL_VERSION_OVERRIDE=3.3": NO_CONTEXT,
    "MESA_GL_VERSION_OVERRIDE=2.1": NO_CONTEXT,
    "MESA_GLSL_VERSION_OVERRIDE=130": "OpenGL 4.5 has 450: unset the variable",
    **dict.fromkeys(WITHOUT, TAKEN_AWAY),
    "GALLIUM_DRIVER=nonsense": "EGL gave no ",
    "GALLIUM_DRIVER=softpipe": "EGL gave no ",
    "LIBGL_DRIVERS_PATH=/nonexistent": NO_DISPLAY,
    "__EGL_VENDOR_LIBRARY_DIRS=/nonexistent": NO_DISPLAY,
    "__EGL_VENDOR_LIBRARY_FILENAMES=/dev/null": NO_DISPLAY,
}
HARMLESS = (
    *("PYOPENGL_PLATFORM=nonsense", "PYOPENGL_PLATFORM=glx", "EGL_PLATFORM=x11", "GALLIUM_DRIVER=llvmpipe"),
    "MESA_EXTENSION_OVERRIDE=+GL_EXT_abgr",
)
ATTEMPTS = """
import json, os, sys, traceback
from modsim3d.core.errors import RendererError
from modsim3d.render.context import open_context

def said(setting):
    os.environ.update([setting.split("=", 1)])
    try:
        with open_context() as context:
            return "OpenGL 4." in context.description and "drawn"
    except RendererError as error:
        return str(error)
    except BaseException:
        return traceback.format_exc()

answers = {}
for setting in sys.argv[1:]:  # Mesa reads its variables once a process
    reading, writing = os.pipe()
    if child := os.fork():
        os.close(writing)
        with open(reading) as pipe:
            answers[setting] = pipe.read() or "died"
        os.waitpid(child, 0)
    else:
        with open(writing, "w") as pipe:
            pipe.write(said(setting))
        os._exit(0)
print(json.dumps(answers))
"""


@pytest.mark.parametrize(("backend", "ways"), [("osmesa", OSMESA_WAYS), ("egl", EGL_WAYS)], ids=["osmesa", "egl"])
def test_an_environment_without_opengl_is_one_sentence_that_names_the_variable(backend, ways) -> None:
    ways = ways if library_found(backend) else {}  # Mesa 25.1 and later have no OSMesa
    settings = [*ways, *HARMLESS]  # each in a process of its own
    names = {setting.split("=")[0] for setting in settings}
    environment = {name: value for name, value in os.environ.items() if name not in names} | {"MODSIM3D_GL": backend}
    words = [sys.executable, "-c", ATTEMPTS, *settings]
    said = json.loads(subprocess.check_output(words, env=environment, text=True, timeout=120))
    for way, part in ways.items():
        name, value = way.split("=", 1)
        if said[way] == "drawn" and name == "LIBGL_DRIVERS_PATH":
            continue  # Mesa 24.3 and later have all drivers in one library
        assert part in said[way], (way, said[way])
        assert f"{name}={value!r}" in said[way] and "Traceback" not in said[way] and "\n" not in said[way]
    if ways:
        assert {said[way] for way in HARMLESS} == {"drawn"}


def test_pictures_of_campaigns_are_plain_where_a_library_has_no_driver() -> None:
    script = "from modsim3d.tracking.worst_film import best_style; print(best_style()[0].shaded)"
    environment = {**os.environ, "MODSIM3D_GL": "egl", "__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
    said = subprocess.check_output([sys.executable, "-c", script], env=environment, text=True, timeout=120)
    assert said == "False\n"
