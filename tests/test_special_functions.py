"""A run takes the functions of SciPy that it needs, and SciPy is whole for whoever wants more of it."""

import os
import subprocess
import sys
from pathlib import Path

CODE = """
import sys
import modsim3d.runs.run
from modsim3d.special_functions import special

print("scipy.special" in sys.modules, "numpy.testing" in sys.modules)
import scipy.special
import scipy.stats

names = ("ndtr", "ndtri", "log_ndtr", "gammaincinv", "pdtr", "pdtrik", "xlogy", "expit", "logit", "exp2", "log1p")
print(all(getattr(scipy.special, name) is getattr(special, name) for name in names), scipy.stats.norm.cdf(0.0))
"""
PACKAGE_FIRST = """
import scipy.special
from modsim3d.special_functions import special

print(special is scipy.special)
"""
OTHER_THREADS = """
import threading

threading.Thread(target=threading.Event().wait, daemon=True).start()
from modsim3d.special_functions import special

print(special.__name__)
"""


OTHER_LAYOUT = {
    "scipy/__init__.py": "",
    "scipy/special/__init__.py": "loaded = True\nfrom scipy.special._ufuncs import ndtri",
    "scipy/special/_ufuncs.py": "from scipy import special\nspecial.loaded\nndtri = abs",
}
OTHER_SCIPY = """
import scipy
from modsim3d.special_functions import special

print(special.__name__, special.ndtri(-3), special is scipy.special)
"""


def said(code: str, first_path: Path | str = "") -> list[str]:
    paths = os.pathsep.join(filter(None, (str(first_path), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": paths}
    return subprocess.check_output([sys.executable, "-c", code], text=True, timeout=60, env=environment).split()


def test_run_does_not_import_the_whole_package() -> None:
    assert said(CODE) == ["False", "False", "True", "0.5"]


def test_package_that_is_there_is_used() -> None:
    assert said(PACKAGE_FIRST) == ["True"]


def test_package_is_whole_for_other_threads() -> None:
    """One that imports it at the same time would find the stand-in, which has no functions."""
    assert said(OTHER_THREADS) == ["scipy.special"]


def test_package_is_used_where_the_ufuncs_need_something_of_it(tmp_path: Path) -> None:
    for name, text in OTHER_LAYOUT.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert said(OTHER_SCIPY, tmp_path) == ["scipy.special", "3", "True"]
