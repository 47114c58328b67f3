"""Names of a package that are imported when they are first used."""

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import version
from typing import Any

VERSION = "__version__"


class LazyNames:
    """The names of a package, by the modules that they are in: module → its names, with spaces between."""

    def __init__(self, package: str, homes: Mapping[str, str]) -> None:
        """Keep where the names are."""
        self._package = package
        self._homes = {name: module for module, names in homes.items() for name in names.split()}
        self.names = sorted(self._homes)

    def __getitem__(self, name: str) -> Any:
        """Object of a name, as a module's `__getattr__`. Raises AttributeError if there is no such name."""
        if name == VERSION:
            return version(self._package)
        if name not in self._homes:
            raise AttributeError(f"module {self._package!r} has no attribute {name!r}")
        return getattr(import_module(self._homes[name]), name)

    def listed(self) -> list[str]:
        """All names, as a module's `__dir__`."""
        return [*self.names, VERSION]
