"""A short run's time is that of its imports: its modules import no package that it does not need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CODE = """
import builtins
import sys

imported = set()
real_import = builtins.__import__


def record(name, scope=None, local=None, names=(), level=0):
    module = real_import(name, scope, local, names, level)
    if scope and str(scope.get("__name__")).startswith("modsim3d") and level == 0:
        imported.update([name, *(f"{name}.{part}" for part in names or () if f"{name}.{part}" in sys.modules)])
    return module


builtins.__import__ = record
import modsim3d
modsim3d.run_scene(modsim3d.load_scene("simulation_1", steps=2), sys.argv[1])
print(*imported)
"""
SCIPY = {"scipy", "scipy.special"}
"""Other parts of SciPy take 0.1 s each. What those that are listed import inside is SciPy's own choice."""
SLOW = ("matplotlib", "numpy.ma", "OpenGL.GL", "pandas", "PIL", "pyrender", "rich", "trimesh", "typer")


def test_modules_of_a_run_import_no_slow_package(tmp_path: Path) -> None:
    said = subprocess.run([sys.executable, "-c", CODE, tmp_path / "run"], capture_output=True, text=True, check=True)
    imported = set(said.stdout.split())
    assert {"numpy", "pyarrow", "scipy.special"} <= imported
    assert {name for name in imported if name.split(".")[0] == "scipy"} <= SCIPY
    assert not imported.intersection(SLOW)
