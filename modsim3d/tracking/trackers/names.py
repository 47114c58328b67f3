"""Names of trackers, found without loading one."""

from typing import NamedTuple

from modsim3d.io.plugins import TRACKERS, plugin_names


class BuiltIn(NamedTuple):
    """Module and class of a built-in tracker, and the packages beside NumPy and SciPy that decide its tracks."""

    module: str
    class_name: str
    packages: tuple[str, ...] = ()


_HERE = "modsim3d.tracking.trackers"
BUILT_IN = {
    "reference": BuiltIn(f"{_HERE}.reference", "ReferenceTracker"),
    "sort": BuiltIn(f"{_HERE}.interface", "SortTracker", ("trackers",)),
    "bytetrack": BuiltIn(f"{_HERE}.interface", "ByteTracker", ("trackers",)),
    "ocsort": BuiltIn(f"{_HERE}.interface", "OcSortTracker", ("trackers",)),
    "stonesoup_gnn": BuiltIn(f"{_HERE}.stone_soup", "StoneSoupGnn", ("stonesoup",)),
    "stonesoup_jpda": BuiltIn(f"{_HERE}.stone_soup", "StoneSoupJpda", ("stonesoup",)),
    "world_gnn": BuiltIn(f"{_HERE}.stone_soup", "WorldGnn", ("stonesoup",)),
    "world_jpda": BuiltIn(f"{_HERE}.stone_soup", "WorldJpda", ("stonesoup",)),
}


def tracker_names() -> tuple[str, ...]:
    """Names of the built-in trackers, and of the installed plug-ins."""
    return tuple(dict.fromkeys((*BUILT_IN, *plugin_names(TRACKERS))))
