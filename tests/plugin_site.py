"""A folder on the path, into which packages with plug-ins are put as an installer would."""

import sys
import tomllib

import pytest


class Site:
    """A folder on the path, into which packages are put as an installer would."""

    def __init__(self, folder, monkeypatch):
        self.folder = folder
        self.monkeypatch = monkeypatch
        monkeypatch.syspath_prepend(str(folder))

    def add(self, package, version, module, source, points):
        """points: group → {name: object reference}."""
        (self.folder / f"{module}.py").write_text(source, encoding="utf-8")
        info = self.folder / f"{package.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(
            "".join(f"[{group}]\n" + "".join(f"{n} = {o}\n" for n, o in each.items()) for group, each in points.items())
        )
        self.monkeypatch.delitem(sys.modules, module, raising=False)

    def add_project(self, folder):
        """The package of a folder with one module."""
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        (module,) = folder.glob("*.py")
        self.add(project["name"], project["version"], module.stem, module.read_text(), project["entry-points"])
        return project


@pytest.fixture
def site(tmp_path, monkeypatch):
    folder = tmp_path / "site"
    folder.mkdir()
    yield Site(folder, monkeypatch)
    for name in [name for name, module in sys.modules.items() if _inside(folder, module)]:
        del sys.modules[name]


def _inside(folder, module):
    return str(getattr(module, "__file__", None) or "").startswith(str(folder))
