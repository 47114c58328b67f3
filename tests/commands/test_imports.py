"""What makes the command line start and end fast."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

NOT_AT_IMPORT = ("numpy", "scipy", "pydantic", "OpenGL", "pyarrow", "shapely", "matplotlib", "PIL", "rich")
NOT_IN_A_RUN = (
    *("scipy.stats", "scipy.signal", "scipy.optimize", "scipy.spatial", "scipy.sparse", "scipy.ndimage"),
    *("matplotlib", "PIL", "trimesh", "networkx", "pyarrow.dataset"),
)
SCRIPT = f"""
import atexit, gc, sys, modsim3d
from modsim3d import cli
atexit.register(lambda: print(gc.get_freeze_count() > 100_000, len(gc.get_objects()) < 1_000))
print(*[name for name in {NOT_AT_IMPORT} if name in sys.modules])
try:
    cli.main()
except SystemExit as ended:
    print(ended.code, *[name for name in {NOT_IN_A_RUN} if name in sys.modules])
"""


def test_libraries_are_imported_only_where_they_are_used_and_not_searched_for_garbage_at_the_end(tmp_path: Path):
    """Simulation 2 has waves and a camera on board, and all files but the sheet are written."""
    command = ["run", "simulation_2", "--mode", "2", "--steps", "1", "--no-sheet", "--quiet", "--out", tmp_path / "run"]
    done = subprocess.run([sys.executable, "-c", SCRIPT, *command], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.splitlines() == ["", "0", "True True"]
