"""The wheel carries all it needs: it runs a shipped scene in an environment that never saw the repository."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLES = [REPOSITORY / "tests" / name for name in ("plugin_example", "tracker_example")]
PLUGINS_PAGE = REPOSITORY / "docs" / "plugins.md"


def run(*command: str | Path, cwd: Path) -> str:
    """The standard output of a command that must succeed, run without this process's Python settings."""
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    finished = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert finished.returncode == 0, f"{command} failed:\n{finished.stdout}\n{finished.stderr}"
    return finished.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = (sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder)
    run(*build, REPOSITORY, cwd=folder)
    return next(folder.glob("modsim3d-*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` folder of an environment with the wheel and this one's other packages, not its modsim3d."""
    folder = tmp_path_factory.mktemp("installed")
    (others := folder / "others").mkdir()
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if "modsim3d" not in entry.name:
            (others / entry.name).symlink_to(entry)
    environment = folder / "environment"
    venv.create(environment, symlinks=True)
    (site_packages,) = environment.glob("lib/python3*/site-packages")
    (site_packages / "others.pth").write_text(f"{others}\n")
    # Without an index, pip fails if the wheel asks for anything that is not there.
    pip = (sys.executable, "-m", "pip", "--python", environment / "bin" / "python")
    run(*pip, "install", "--quiet", "--no-index", "--no-compile", wheel, cwd=folder)
    return environment / "bin"


def files_in(folder: str) -> set[str]:
    """Paths of the files in a folder of the repository, without what Python leaves there."""
    files = (path for path in (REPOSITORY / folder).rglob("*") if path.is_file() and path.name != ".gitkeep")
    return {path.relative_to(REPOSITORY).as_posix() for path in files if "__pycache__" not in path.parts}


def test_wheel_carries_every_file_of_the_package_and_its_data_and_no_other(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        carried = set(archive.namelist())
    data = {f"modsim3d/_data/{name}" for folder in ("scenes", "meshes") for name in files_in(folder)}
    assert data | files_in("modsim3d") <= carried
    suffixes = {Path(path).suffix for path in files_in("modsim3d")}
    assert suffixes >= {".py", ".html", ".css", ".js", ".yaml"} and "modsim3d/py.typed" in carried
    top_level = {Path(name).parts[0] for name in carried}
    assert {name for name in top_level if not name.endswith(".dist-info")} == {"modsim3d"}
    assert not [name for name in carried if name.endswith(".pyc")]


def test_installed_wheel_is_what_python_imports_and_simulates_a_shipped_scene(installed: Path, tmp_path: Path) -> None:
    printed = run(installed / "python", "-c", "import modsim3d; print(modsim3d.__file__)", cwd=tmp_path)
    assert Path(printed.strip()).is_relative_to(installed.parent / "lib")
    out = tmp_path / "run"
    run(installed / "modsim3d", "run", "simulation_1", "--steps", "3", "--out", out, cwd=tmp_path)
    assert isinstance(json.loads((out / "run.json").read_text()), dict)
    assert {len(json.loads(file.read_text())) for file in out.glob("annotations_*.json")} == {3}
    assert all((out / f"{table}.parquet").stat().st_size > 0 for table in ("frames", "truth", "detections"))


def test_installed_wheel_finds_the_parts_of_an_installed_package(installed: Path, tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__")
    plug_ins = [shutil.copytree(example, tmp_path / example.name, ignore=ignored) for example in EXAMPLES]
    pip = (installed / "python", "-m", "pip", "install", "--quiet", "--no-index", "--no-build-isolation", "--no-deps")
    run(*pip, "--no-compile", *plug_ins, cwd=tmp_path)
    tracker_names = "from modsim3d.tracking.trackers.names import tracker_names; print(*tracker_names())"
    assert "overlap" in run(installed / "python", "-c", tracker_names, cwd=tmp_path).split()
    (quoted,) = re.findall(r"```yaml\n(.*?)```", PLUGINS_PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    camera = yaml.safe_load((REPOSITORY / "scenes" / "simulation_2.yaml").read_text(encoding="utf-8"))["cameras"]["C0"]
    camera["mount"] |= {"vessel": "a", "position_m": [14, 0, 5]}
    detector = str(REPOSITORY / "scenes" / "detectors" / "thesis.yaml")
    scene = yaml.safe_load(quoted) | {"cameras": {"C0": camera}, "detector": detector}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    run(installed / "modsim3d", "run", "scene.json", "--out", "run", "--no-sheet", cwd=tmp_path)
    used = json.loads((tmp_path / "run" / "run.json").read_text())["plugins"]
    assert set(used) == {"modsim3d.pose_sources:drift", "modsim3d.wave_levels:swell", "modsim3d.shapes:barge"}
    assert set(used.values()) == {"modsim3d-drift 1.0"}
    *_, own_ship = pq.read_table(tmp_path / "run" / "ownship.parquet").to_pylist()
    assert [own_ship[axis] for axis in ("w1_m", "w2_m")] == pytest.approx([9.9 * 0.5, 9.9 * 0.1])
    assert own_ship["pitch_rad"] != 0
