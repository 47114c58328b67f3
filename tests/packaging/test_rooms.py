"""The tree: imports go one way, no class name stands twice, and a pose enters few rooms on its way."""

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import modsim3d

ROOT = Path(modsim3d.__file__).parent


def test_imports_go_one_way() -> None:
    """Imports in functions, those for type checkers and names that are imported when first used are counted too."""
    imports = _imports()
    assert "modsim3d.runs.frames" in imports["modsim3d.runs.blocks"]  # a circle would be found
    in_a_function = ast.parse("def f():\n    from modsim3d.runs import blocks")
    assert _names(in_a_function) == {"modsim3d.runs", "modsim3d.runs.blocks"}
    while leaves := [name for name, wanted in imports.items() if not wanted]:
        for name in leaves:
            del imports[name]
        for wanted in imports.values():
            wanted.difference_update(leaves)
    in_circles = {name: wanted for name, wanted in imports.items() if any(name in other for other in imports.values())}
    assert not in_circles


def test_no_public_class_name_stands_twice() -> None:
    names = Counter(
        node.name
        for path in ROOT.rglob("*.py")
        for node in ast.parse(path.read_bytes()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert len(names) > 500 and [name for name, count in names.items() if count > 1] == []


RECORDED = """
import sys
from pathlib import Path
import modsim3d
from modsim3d.cli.main import main
root, codes = Path(modsim3d.__file__).parent, set()
sys.settrace(lambda frame, event, value: codes.add(frame.f_code))  # of calls alone: it returns None
try:
    main()
except SystemExit as ended:
    sys.settrace(None)
    paths = {Path(code.co_filename) for code in codes if code.co_name != "<module>"}
    print(ended.code or 0, *sorted({path.relative_to(root).parts[0] for path in paths if path.is_relative_to(root)}))
"""


def test_a_pose_enters_few_rooms_on_its_way_from_the_scene_file_to_detections(tmp_path: Path) -> None:
    command = ["run", "strait", "--steps", "3", "--no-sheet", "-q", "--out", str(tmp_path / "run")]
    done = subprocess.run([sys.executable, "-c", RECORDED, *command], capture_output=True, text=True, check=True)
    status, *rooms = done.stdout.split()
    assert status == "0" and {"cli", "detector", "runs", "scene", "truth", "world"} <= set(rooms)
    assert len(rooms) <= 11, rooms


def _imports() -> dict[str, set[str]]:
    """Modules that each module imports."""
    files = {".".join(("modsim3d", *path.relative_to(ROOT).with_suffix("").parts)): path for path in ROOT.rglob("*.py")}
    files = {name.removesuffix(".__init__"): path for name, path in files.items()}
    names = {name: _names(ast.parse(path.read_bytes())) for name, path in files.items()}
    for name in ("modsim3d", "modsim3d.plugins"):
        names[name] |= _names(ast.parse(files[name].with_suffix(".pyi").read_bytes()))
    return {name: (found & names.keys()) - {name} for name, found in names.items()}


def _names(tree: ast.AST) -> set[str]:
    """Everything that may be a module in the imports of a file."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found
