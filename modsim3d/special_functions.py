"""The ufuncs of `scipy.special`, without the rest of that package.

Importing all of it takes an eighth of a short run's time and 20 MB, for array libraries that are not used here.
"""

from __future__ import annotations

import sys
import threading
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_PACKAGE, _UFUNCS = "scipy.special", "scipy.special._ufuncs"


def _ufuncs() -> ModuleType:
    """The module of the ufuncs.

    It is the whole package where that is loaded anyway, where SciPy is laid out otherwise, and where another thread
    might import it in the moment in which something else is in its place.
    """
    if _PACKAGE in sys.modules or threading.active_count() > 1 or (found := find_spec(_PACKAGE)) is None:
        return import_module(_PACKAGE)
    # A module is looked for in its package: for a moment this is one with the same files that does nothing itself.
    package = ModuleType(_PACKAGE)
    package.__path__ = list(found.submodule_search_locations or ())
    sys.modules[_PACKAGE] = package
    try:
        return import_module(_UFUNCS)
    except Exception:  # not only ImportError: a SciPy whose ufuncs take something of the package does not find it here
        sys.modules.pop(_PACKAGE)
        return import_module(_PACKAGE)
    finally:
        if sys.modules.get(_PACKAGE) is package:
            del sys.modules[_PACKAGE]


special: Any = _ufuncs()
