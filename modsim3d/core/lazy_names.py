"""Names of a package that are imported when they are first used."""

import re
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

VERSION = "__version__"
RENAMED = {"Located": "Locations", "RunAgain": "ReproducedRun", "Written": "OutputFiles"}


_PACKAGES: dict[str, "LazyNames"] = {}


def public(name: str) -> Any:
    """Object of a public name, for a method whose work is that of a room above its own: no room imports one above."""
    return _PACKAGES["modsim3d"][name]


class LazyNames:
    """The names of a package, from lines such as `from module import name as name` of the stub beside it."""

    def __init__(self, package: str, file: str) -> None:
        """Read where the names are."""
        stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
        self._package = package
        self._homes = {name: module for module, name in re.findall(r"^from (\S+) import \w+ as (\w+)$", stub, re.M)}
        self.names = sorted(self._homes)
        _PACKAGES[package] = self

    def __getitem__(self, name: str) -> Any:
        """Object of a name, as a module's `__getattr__`. Raises AttributeError if there is no such name."""
        if name == VERSION:
            return version(self._package)
        if name not in self._homes:
            now = f": it is now {RENAMED[name]}" if RENAMED.get(name) in self._homes else ""
            raise AttributeError(f"module {self._package!r} has no attribute {name!r}{now}")
        return getattr(import_module(self._homes[name]), name)

    def listed(self) -> list[str]:
        """All names, as a module's `__dir__`."""
        return [*self.names, VERSION]
