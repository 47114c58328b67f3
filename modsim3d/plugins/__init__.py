"""Names for writers of plug-ins; docs/plugins.md has examples."""

from modsim3d.core.lazy_names import LazyNames

_NAMES = LazyNames(__name__, __file__)
__all__ = _NAMES.names
__getattr__, __dir__ = _NAMES.__getitem__, _NAMES.listed
