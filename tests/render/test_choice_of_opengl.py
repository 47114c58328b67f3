"""Which OpenGL is taken, and what is said where there is none or an environment gives no usable one."""

import ctypes
import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from modsim3d.core.errors import RendererError
from modsim3d.render import context
from modsim3d.render.context import library_found
from modsim3d.render.id_pass import MAX_REGION_PX, Region
from modsim3d.render.shaded_pass import LitFaces, ShadedRenderer


def said_by(function, *arguments) -> str:
    with pytest.raises(RendererError) as caught:
        function(*arguments)
    return str(caught.value)


@pytest.fixture
def plain(monkeypatch):
    """An environment that says nothing of OpenGL."""
    for name in [*os.environ]:
        if name.startswith((*context.MESA_OBEYS, "MODSIM3D_")):
            monkeypatch.delenv(name)
    return monkeypatch


def test_the_backend_is_the_one_asked_for_or_the_first_whose_library_is_found(plain):
    there = {"osmesa", "egl"}
    plain.setattr(context, "library_found", lambda backend: backend in there)
    assert context.choose_backend() == "osmesa"
    plain.setenv("MODSIM3D_GL", "EGL")
    assert context.choose_backend() == "egl"
    there.remove("egl")
    assert "(egl)" in said_by(context.choose_backend)
    plain.setenv("MODSIM3D_GL", "auto")
    assert context.choose_backend() == "osmesa"
    there.clear()
    assert "(OSMesa or EGL)" in said_by(context.choose_backend)
    plain.setenv("MODSIM3D_GL", "glx")
    assert said_by(context.choose_backend) == "MODSIM3D_GL='glx': use one of osmesa, egl, auto"
    plain.undo()
    loads: set[str] = set()

    def load(name):
        if name not in loads:
            raise OSError(name)

    plain.setattr(context.ctypes, "CDLL", load)
    for backend, library, named, there in (
        ("osmesa", "libOSMesa.so.6", None, True),
        ("osmesa", "libOSMesa.so.7", "libOSMesa.so.7", True),
        ("osmesa", "libEGL.so.1", "libOSMesa.so.7", False),
        ("egl", "libEGL.so.1", None, True),
        ("egl", "libOSMesa.so.6", None, False),
    ):
        loads = {library}
        plain.setattr(context.ctypes.util, "find_library", {"OSMesa" if backend == "osmesa" else "EGL": named}.get)
        assert context.library_found(backend) is there, (backend, library)


def test_device_is_one_of_those_that_there_are_and_the_first_without_a_number(plain):
    plain.setattr(context, "_is_software", lambda device: device == "llvmpipe")
    devices = ["card", "card", "llvmpipe"]
    assert context._number(devices) == 0
    plain.setenv("MODSIM3D_EGL_DEVICE", "2")
    assert context._number(devices) == 2
    for wrong in ("3", "-1", "card"):
        plain.setenv("MODSIM3D_EGL_DEVICE", wrong)
        assert said_by(context._number, devices) == (
            f"MODSIM3D_EGL_DEVICE={wrong!r}: use a number from 0 to 2 (graphics cards here: 2, software renderers: 1)"
        )


class _Egl:
    """EGL with two graphics cards and a software renderer between them, which notes what is called."""

    EGLint, EGLConfig, EGLDeviceEXT = ctypes.c_int, ctypes.c_int, ctypes.c_int
    devices: ClassVar = {1: b"EGL_EXT_device_drm", 2: b"EGL_MESA_device_software", 3: None}

    def __init__(self):
        self.called = []

    def __getattr__(self, name):
        if name.startswith("EGL_"):
            return len(name)
        return lambda *arguments: self.called.append((name, arguments)) or 70 + len(self.called)

    def eglQueryDevicesEXT(self, size, devices, count):
        devices[: len(self.devices)], count[0] = [*self.devices], len(self.devices)
        return True

    def eglQueryDeviceStringEXT(self, device, _):
        return self.devices[device]

    def eglChooseConfig(self, display, wanted, config, size, count):
        config[0] = 5
        return True


def test_egl_gives_a_context_of_the_first_card_with_the_config_it_chose_and_takes_it_back(plain, renderer):
    import OpenGL

    egl = _Egl()
    plain.setattr(OpenGL, "EGL", egl, raising=False)
    plain.setitem(sys.modules, "OpenGL.platform", SimpleNamespace(PLATFORM=SimpleNamespace(EGL=egl)))
    for name in ("EXT.platform_base", "EXT.device_enumeration", "EXT.device_query"):
        plain.setitem(sys.modules, f"OpenGL.EGL.{name}", egl)
    assert context._devices() == [1, 3, 2]
    plain.setenv("MODSIM3D_GL", "egl")
    with context.egl_context():
        (display, asked), *_, (made, (of, config, *_)), (current, arguments) = egl.called
        assert (display, asked[1]) == ("eglGetPlatformDisplayEXT", 1)
        assert (made, of, config, current) == ("eglCreateContext", 71, 5, "eglMakeCurrent")
        opened = arguments[-1]
        count = len(egl.called)
    (released, last), (destroyed, which) = egl.called[count:]
    assert (released, last[-1], destroyed, which) == ("eglMakeCurrent", 14, "eglDestroyContext", (71, opened))


def test_variables_with_which_mesa_ends_the_process_are_refused_and_named_in_a_failure(plain):
    for name, value, backend, said in (
        ("GALLIUM_DRIVER", "softpipe", "osmesa", "OSMesa has llvmpipe only"),
        ("GALLIUM_DRIVER", "softpipe", "egl", ""),
        ("GALLIUM_DRIVER", "llvmpipe", "osmesa", ""),
        ("MESA_GLSL_VERSION_OVERRIDE", "449", "egl", "OpenGL 4.5 has 450"),
        ("MESA_GLSL_VERSION_OVERRIDE", "450", "egl", ""),
        ("MESA_EXTENSION_OVERRIDE", "+GL_a -GL_b", "osmesa", "takes away"),
        ("MESA_EXTENSION_OVERRIDE", "+GL_a", "osmesa", ""),
    ):
        with plain.context() as patch:
            patch.setenv(name, value)
            if said:
                assert f"{name}={value!r}" in (problem := said_by(context._refuse_crashes, backend)) and said in problem
            else:
                context._refuse_crashes(backend)

    def fail(*_):
        raise OSError("no such library")

    for name, stand_in in {"_open_here": None, "choose_backend": lambda: "egl", "_make_context": fail}.items():
        plain.setattr(context, name, stand_in)
    plain.setattr(context, "prepare_environment", lambda backend: None)
    opened = context.open_context()
    assert said_by(opened.__enter__) == "the egl renderer cannot be used: no such library"
    for name in ("MESA_A", "LIBGL_DRIVERS_PATH", "OTHER"):
        plain.setenv(name, "1")
    hint = " (the environment has MESA_A='1', LIBGL_DRIVERS_PATH='1': try without)"
    assert said_by(context.open_context().__enter__).endswith(f"no such library{hint}")


def test_the_description_has_backend_and_version_and_what_is_too_large_is_an_error(renderer):
    name, version = re.fullmatch(r"(?:osmesa|egl): (.+), OpenGL (4\.[5-9].*)", renderer.context.description).groups()
    assert not name.startswith("4.") and name != version
    corners, size = np.array([[[0.0, 0.0], [0.0, 9.0], [9e4, 0.0]]]), (MAX_REGION_PX, 3)
    assert renderer.draw(corners, np.ones((1, 3)), np.ones(1, int), Region(0, 0, *size)).sum() == 3 * MAX_REGION_PX
    for region in (Region(0, 0, size[0] + 1, 3), Region(0, 0, 3, size[0] + 1)):
        said = said_by(renderer.draw, corners, np.ones((1, 3)), np.ones(1, int), region)
        assert said.endswith(f"is too large: at most {MAX_REGION_PX} px a side")
    faces = LitFaces(np.ones((1, 3, 3)), np.ones((1, 3)), np.ones((1, 3)))
    shaded = SimpleNamespace()  # which draws nothing before it looks at the size
    said = said_by(ShadedRenderer.draw, shaded, faces, np.eye(3), 0.5, (3, size[0] + 1), (), (1, 1, 1))
    assert said.startswith(f"a picture of 3 × {size[0] + 1} px is too large: at most {size[0]} px a side")
    said = said_by(context.make_framebuffer, _NoFramebuffer(), (64, 32), 7, "a picture")
    assert said == "the renderer cannot draw a picture of 64 × 32 px with float depth"


class _NoFramebuffer:
    """OpenGL that cannot draw into a buffer."""

    def __getattr__(self, name):
        return name if name.startswith("GL_") else lambda *_: (name, name)


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
    said = json.loads(subprocess.check_output(words, env=environment, text=True, timeout=240))
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
    said = subprocess.check_output([sys.executable, "-c", script], env=environment, text=True, timeout=240)
    assert said == "False\n"
