"""An OpenGL context by EGL, without a surface: of the software renderer, or of the graphics card that is asked for."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from modsim3d.errors import RendererError

GetAddress = Any
"""A ctypes function that gives the address of an OpenGL function."""

_PLATFORM_SURFACELESS_MESA, _PLATFORM_DEVICE = 0x31DD, 0x313F
_MOST_DEVICES = 64


@contextmanager
def egl_context() -> Iterator[GetAddress]:
    """Make a context current; `MODSIM3D_GL=egl` asks for that of a device, `MODSIM3D_EGL_DEVICE` says which.

    Raises:
        RendererError: There is no such device, no display or no OpenGL 4.5.
    """
    from OpenGL import EGL
    from OpenGL.EGL.EXT.platform_base import eglGetPlatformDisplayEXT as get_display
    from OpenGL.platform import PLATFORM

    asked = os.environ.get("MODSIM3D_GL", "").lower() == "egl"
    devices = _devices() if asked else []
    if devices:
        display = _result(get_display, _PLATFORM_DEVICE, devices[_number(devices)], None)
    else:
        display = _result(get_display, _PLATFORM_SURFACELESS_MESA, None, None)
    if not display or not _result(EGL.eglInitialize, display, None, None):
        raise RendererError("EGL gave no display without a surface: Mesa's EGL (libegl-mesa0) is needed")
    _result(EGL.eglBindAPI, EGL.EGL_OPENGL_API)
    wanted = (EGL.EGLint * 5)(
        EGL.EGL_SURFACE_TYPE, EGL.EGL_PBUFFER_BIT, EGL.EGL_RENDERABLE_TYPE, EGL.EGL_OPENGL_BIT, EGL.EGL_NONE
    )
    config, count = (EGL.EGLConfig * 1)(), ctypes.c_long()
    _result(EGL.eglChooseConfig, display, wanted, config, 1, count)
    version = (EGL.EGLint * 7)(
        *(EGL.EGL_CONTEXT_MAJOR_VERSION, 4, EGL.EGL_CONTEXT_MINOR_VERSION, 5),
        *(EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL.EGL_NONE),
    )
    context = _result(EGL.eglCreateContext, display, config[0], EGL.EGL_NO_CONTEXT, version)
    if not context:
        raise RendererError("EGL gave no OpenGL 4.5 context: Mesa 18 or a newer driver of the card is needed")
    try:
        if not _result(EGL.eglMakeCurrent, display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, context):
            raise RendererError("EGL did not accept its context without a surface: Mesa's EGL (libegl-mesa0) is needed")
        yield PLATFORM.EGL.eglGetProcAddress
    finally:
        _result(EGL.eglMakeCurrent, display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
        EGL.eglDestroyContext(display, context)


def _result(function: Any, *arguments: Any) -> Any:
    """Result of a function of EGL; None where PyOpenGL has an error for it, or no such function."""
    from OpenGL.error import Error

    try:
        return function(*arguments)
    except Error:
        return None


def _devices() -> list[Any]:
    """The devices that EGL knows, cards before the software renderer; none where it cannot list them."""
    from OpenGL import EGL
    from OpenGL.EGL.EXT.device_enumeration import eglQueryDevicesEXT

    found, count = (EGL.EGLDeviceEXT * _MOST_DEVICES)(), (EGL.EGLint * 1)()
    if not _result(eglQueryDevicesEXT, _MOST_DEVICES, found, count):
        return []
    return sorted(found[: count[0]], key=_is_software)


def _is_software(device: Any) -> bool:
    from OpenGL import EGL
    from OpenGL.EGL.EXT.device_query import eglQueryDeviceStringEXT

    return b"EGL_MESA_device_software" in (_result(eglQueryDeviceStringEXT, device, EGL.EGL_EXTENSIONS) or b"")


def _number(devices: list[Any]) -> int:
    """Place of the device that is asked for.

    Raises:
        RendererError: There is none with this number.
    """
    text = os.environ.get("MODSIM3D_EGL_DEVICE", "0")
    if text.isdecimal() and int(text) < len(devices):
        return int(text)
    cards = len(devices) - sum(map(_is_software, devices))
    raise RendererError(
        f"MODSIM3D_EGL_DEVICE={text!r}: use a number from 0 to {len(devices) - 1} "
        f"(graphics cards here: {cards}, software renderers: {len(devices) - cards})"
    )
