"""One headless OpenGL context of a software renderer, OSMesa or EGL, or of a graphics card by EGL."""

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

from modsim3d.core.errors import RendererError

# ---- An OpenGL context by EGL, without a surface ----

GetAddress = Any  # a ctypes function that gives the address of an OpenGL function

_PLATFORM_SURFACELESS_MESA, _PLATFORM_DEVICE = 0x31DD, 0x313F
_MAX_DEVICES = 64


@contextmanager
def egl_context() -> Iterator[GetAddress]:
    """Make a context current; `MODSIM3D_GL=egl` asks for that of a device, `MODSIM3D_EGL_DEVICE` says which. Raises
    RendererError if there is no such device, no display or no OpenGL 4.5."""
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

    devices, count = (EGL.EGLDeviceEXT * _MAX_DEVICES)(), (EGL.EGLint * 1)()
    if not _result(eglQueryDevicesEXT, _MAX_DEVICES, devices, count):
        return []
    return sorted(devices[: count[0]], key=_is_software)


def _is_software(device: Any) -> bool:
    from OpenGL import EGL
    from OpenGL.EGL.EXT.device_query import eglQueryDeviceStringEXT

    return b"EGL_MESA_device_software" in (_result(eglQueryDeviceStringEXT, device, EGL.EGL_EXTENSIONS) or b"")


def _number(devices: list[Any]) -> int:
    """Place of the device that is asked for. Raises RendererError if there is none with this number."""
    text = os.environ.get("MODSIM3D_EGL_DEVICE", "0")
    if text.isdecimal() and int(text) < len(devices):
        return int(text)
    cards = len(devices) - sum(map(_is_software, devices))
    raise RendererError(
        f"MODSIM3D_EGL_DEVICE={text!r}: use a number from 0 to {len(devices) - 1} "
        f"(graphics cards here: {cards}, software renderers: {len(devices) - cards})"
    )


BACKENDS = ("osmesa", "egl")
LIBRARIES = {"osmesa": ("OSMesa", ("libOSMesa.so.8", "libOSMesa.so.6")), "egl": ("EGL", ("libEGL.so.1",))}

GL_LOWER_LEFT, GL_ZERO_TO_ONE = 0x8CA1, 0x935F
GL_RENDERER, GL_VERSION, GL_UNSIGNED_BYTE = 0x1F01, 0x1F02, 0x1401

INSTALL_HINT = """no OpenGL software renderer was found ({wanted}). Install one:
  Debian, Ubuntu: apt install libosmesa6 (where that is gone: libegl1 libegl-mesa0 libopengl0)
  Fedora:         dnf install mesa-libOSMesa (or mesa-libEGL)
  conda-forge:    conda install 'mesalib<25.1'
or run without one: --source analytic"""

MESA_OBEYS = ("MESA_", "GALLIUM_", "LIBGL_DRI", "__EGL_")
"""How variables of the environment begin that can leave a machine with OpenGL without it."""


def library_found(backend: str) -> bool:
    """Whether the shared library of a backend can be loaded."""
    short_name, file_names = LIBRARIES[backend]
    if any(map(_loads, file_names)):  # looking for another name starts other programs
        return True
    library = ctypes.util.find_library(short_name)
    return library is not None and _loads(library)


def _loads(file_name: str) -> bool:
    try:
        ctypes.CDLL(file_name)
    except OSError:
        return False
    return True


def _wanted() -> str:
    return os.environ.get("MODSIM3D_GL", "auto").lower()


def choose_backend() -> str:
    """The backend that `MODSIM3D_GL` names, or the first whose library is there. Raises RendererError if the variable
    has another value, or no library is there; the message says what to install."""
    wanted = _wanted()
    if wanted not in ("auto", *BACKENDS):
        raise RendererError(f"MODSIM3D_GL={wanted!r}: use one of osmesa, egl, auto")
    for backend in BACKENDS if wanted == "auto" else (wanted,):
        if library_found(backend):
            return backend
    raise RendererError(INSTALL_HINT.format(wanted="OSMesa or EGL" if wanted == "auto" else wanted))


@dataclass(frozen=True, eq=False)
class GLContext:
    """A current OpenGL context."""

    description: str  # backend, renderer and version, for run.json

    @cached_property
    def gl(self) -> ModuleType:
        """The module of OpenGL functions; many runs draw nothing, and its import takes a tenth of a short one."""
        import OpenGL.GL as gl

        return gl  # type: ignore[no-any-return]


_open_here: GLContext | None = None


@contextmanager
def open_context() -> Iterator[GLContext]:
    """Make the process's one OpenGL context and destroy it at the end. Inside another `open_context` of the same
    process this gives the same context. Raises RendererError without a library, a context or OpenGL 4.5."""
    global _open_here
    if _open_here is not None:
        yield _open_here
        return
    backend = choose_backend()
    prepare_environment(backend)
    with ExitStack() as stack:
        try:
            _open_here = _make_context(backend, stack)
        except (ImportError, AttributeError, OSError, RendererError) as error:
            problem = "" if isinstance(error, RendererError) else f"the {backend} renderer cannot be used: "
            values = ", ".join(f"{name}={text!r}" for name, text in os.environ.items() if name.startswith(MESA_OBEYS))
            hint = f" (the environment has {values}: try without)" if values else ""
            raise RendererError(f"{problem}{error}{hint}") from error
        try:
            yield _open_here
        finally:
            _open_here = None


def _make_context(backend: str, stack: ExitStack) -> GLContext:
    """Make a context current until the stack is closed."""
    get_address = stack.enter_context(_osmesa_context() if backend == "osmesa" else egl_context())
    _check_functions(backend)
    get_address.restype = ctypes.c_void_p
    get_address.argtypes = [ctypes.c_char_p]
    _use_reversed_depth(get_address)
    get_string = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_uint)(get_address(b"glGetString"))
    name, version = (get_string(key).decode() for key in (GL_RENDERER, GL_VERSION))
    return GLContext(f"{backend}: {name}, OpenGL {version}")


def _check_functions(backend: str) -> None:
    """Raise RendererError for EGL without the library of OpenGL's functions, which are loaded at the first drawing."""
    from OpenGL.platform import PLATFORM

    if not hasattr(PLATFORM.GL, "glClearDepth"):  # it may be that of OpenGL ES
        missing = "the library libOpenGL is missing (Debian, Ubuntu: apt install libopengl0)"
        raise RendererError(f"the {backend} renderer cannot be used: {missing}")


def prepare_environment(backend: str) -> None:
    """Set what must be set before OpenGL is imported and Mesa is loaded."""
    platform = sys.modules.get("OpenGL.platform")
    if platform is not None and os.environ.get("PYOPENGL_PLATFORM") != backend:
        used = f"OpenGL was imported before with PYOPENGL_PLATFORM={os.environ.get('PYOPENGL_PLATFORM')!r}"
        raise RendererError(f"{used}; {backend} needs a process of its own")
    _refuse_crashes(backend)
    os.environ["PYOPENGL_PLATFORM"] = backend
    if _wanted() != "egl":
        os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")  # the same pixels with and without a graphics card
    # Rasterising in the calling thread is faster for small regions and keeps workers apart.
    os.environ.setdefault("LP_NUM_THREADS", "0")


def _refuse_crashes(backend: str) -> None:
    """Raise RendererError for variables of the environment with which Mesa ends the process without an error."""
    names = ("GALLIUM_DRIVER", "MESA_GLSL_VERSION_OVERRIDE", "MESA_EXTENSION_OVERRIDE")
    driver, language, extensions = (os.environ.get(name, "") for name in names)
    if driver not in ("", "llvmpipe") and backend == "osmesa":
        raise RendererError(f"GALLIUM_DRIVER={driver!r}: OSMesa has llvmpipe only: unset it, or set MODSIM3D_GL=egl")
    if language.isdecimal() and int(language) < 450:
        raise RendererError(f"MESA_GLSL_VERSION_OVERRIDE={language!r}: OpenGL 4.5 has 450: unset the variable")
    if any(word.startswith("-") for word in extensions.split()):
        raise RendererError(f"MESA_EXTENSION_OVERRIDE={extensions!r} takes away what OpenGL 4.5 needs: unset it")


def _use_reversed_depth(get_address: GetAddress) -> None:
    """Map depth to [0, 1] without the usual halving, so that a float depth near/c3 keeps its relative precision."""
    address = get_address(b"glClipControl")  # PyOpenGL does not resolve it through OSMesa
    if not address:
        raise RendererError("the OpenGL renderer has no glClipControl: OpenGL 4.5 (Mesa 18 or newer) is needed")
    ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint)(address)(GL_LOWER_LEFT, GL_ZERO_TO_ONE)


@contextmanager
def _osmesa_context() -> Iterator[GetAddress]:
    from OpenGL import osmesa
    from OpenGL.platform import PLATFORM

    wanted = [
        *(osmesa.OSMESA_FORMAT, osmesa.OSMESA_RGBA),
        *(osmesa.OSMESA_PROFILE, osmesa.OSMESA_CORE_PROFILE),
        *(osmesa.OSMESA_CONTEXT_MAJOR_VERSION, 4),
        *(osmesa.OSMESA_CONTEXT_MINOR_VERSION, 5, 0),
    ]
    context = osmesa.OSMesaCreateContextAttribs((ctypes.c_int * len(wanted))(*wanted), None)
    if not context:
        raise RendererError("OSMesa gave no OpenGL 4.5 context: Mesa 18 or newer is needed")
    window = (ctypes.c_ubyte * (8 * 8 * 4))()  # OSMesa wants one; drawing goes to framebuffer objects
    try:
        if not osmesa.OSMesaMakeCurrent(context, window, GL_UNSIGNED_BYTE, 8, 8):
            raise RendererError("OSMesa did not accept its context")
        # PyOpenGL's own type is a new object at every call, and no two are equal: its tables and pyrender's programs,
        # which are kept by context, would grow with every picture.
        PLATFORM.GetCurrentContext.restype = ctypes.c_void_p
        yield PLATFORM.OSMesa.OSMesaGetProcAddress
    finally:
        osmesa.OSMesaDestroyContext(context)


def make_framebuffer(gl: Any, size: tuple[int, int], colour_format: int, what: str) -> tuple[Any, Any]:
    """Make and bind a framebuffer of a width and height with a colour buffer and a float depth buffer. `colour_format`
    is OpenGL's number, `what` is drawn into it, for the error. Gives the framebuffer, and the storages of its colours
    and its depth. Raises RendererError if the renderer cannot draw into such a buffer."""
    framebuffer, storages = gl.glGenFramebuffers(1), gl.glGenRenderbuffers(2)
    gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, framebuffer)
    kinds = (colour_format, gl.GL_COLOR_ATTACHMENT0), (gl.GL_DEPTH_COMPONENT32F, gl.GL_DEPTH_ATTACHMENT)
    for storage, (kind, attachment) in zip(storages, kinds, strict=True):
        gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, storage)
        gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, *size)
        gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, attachment, gl.GL_RENDERBUFFER, storage)
    if gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER) != gl.GL_FRAMEBUFFER_COMPLETE:
        raise RendererError(f"the renderer cannot draw {what} of {size[0]} × {size[1]} px with float depth")
    return framebuffer, storages
