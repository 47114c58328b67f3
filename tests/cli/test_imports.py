"""What makes the command line start and end fast."""

import subprocess
import sys
from pathlib import Path

NOT_AT_IMPORT = ("numpy", "scipy", "pydantic", "OpenGL", "pyarrow", "shapely", "matplotlib", "PIL", "imageio", "rich")
NOT_IN_A_RUN = (
    *("scipy.stats", "scipy.signal", "scipy.optimize", "scipy.spatial", "scipy.sparse", "scipy.ndimage", "numpy.ma"),
    *("matplotlib", "PIL", "imageio", "imageio.v3", "trimesh", "networkx", "pyarrow.dataset", "pandas"),
)
"""What our modules do not import; what NumPy and SciPy import of themselves is their own choice."""
SCRIPT = f"""
import atexit, builtins, gc, sys, modsim3d
from modsim3d.cli import main as cli
atexit.register(lambda: print(gc.get_freeze_count() > 100_000, len(gc.get_objects()) < 1_000))
print(*[name for name in {NOT_AT_IMPORT} if name in sys.modules])
ours, real_import = set(), builtins.__import__

def record(name, scope=None, local=None, names=(), level=0):
    module = real_import(name, scope, local, names, level)
    if scope and str(scope.get("__name__")).startswith("modsim3d"):
        ours.update([name, *(f"{{name}}.{{part}}" for part in names or ())])
    return module

builtins.__import__ = record
try:
    cli.main()
except SystemExit as ended:
    print(ended.code, *ours.intersection({NOT_IN_A_RUN}), "scipy.special" in ours)
"""


def test_libraries_are_imported_only_where_they_are_used_and_not_searched_for_garbage_at_the_end(tmp_path: Path):
    """Simulation 2 has waves and a camera on board, and all files but the sheet are written."""
    command = ["run", "simulation_2", "--mode", "2", "--steps", "1", "--no-sheet", "--quiet", "--out", tmp_path / "run"]
    done = subprocess.run([sys.executable, "-c", SCRIPT, *command], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.splitlines() == ["", "0 True", "True True"]
