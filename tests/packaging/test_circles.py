"""No module of the package imports, by whatever way, a module that imports it."""

import ast
from pathlib import Path

import modsim3d

ROOT = Path(modsim3d.__file__).parent
LAZY_NAMES = "modsim3d"
"""The names of the package itself are imported when they are first used, from everywhere to everywhere."""


def test_imports_go_one_way() -> None:
    """Imports in functions and those for type checkers are counted too."""
    imports = _imports()
    while leaves := [name for name, wanted in imports.items() if not wanted]:
        for name in leaves:
            del imports[name]
        for wanted in imports.values():
            wanted.difference_update(leaves)
    in_circles = {name: wanted for name, wanted in imports.items() if any(name in other for other in imports.values())}
    assert not in_circles


def test_a_circle_would_be_found() -> None:
    """An import in a function counts."""
    assert "modsim3d.runs.frames" in _imports()["modsim3d.runs.blocks"]
    assert _names(ast.parse("def f():\n    from modsim3d.runs import blocks")) == {
        "modsim3d.runs",
        "modsim3d.runs.blocks",
    }


def _imports() -> dict[str, set[str]]:
    """Modules that each module imports."""
    files = {".".join(("modsim3d", *path.relative_to(ROOT).with_suffix("").parts)): path for path in ROOT.rglob("*.py")}
    files = {name.removesuffix(".__init__"): path for name, path in files.items()}
    names = {name: _names(ast.parse(path.read_bytes())) for name, path in files.items() if name != LAZY_NAMES}
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
