"""What a folder holds, to be compared with what it should hold."""

from __future__ import annotations

import hashlib
from pathlib import Path

Tree = dict[str, str]
"""SHA-256 of each file by its path; folders end with a slash and have none."""
NOT_COMPARED = ("run.log",)
"""Holds times and the host."""


def tree(folder: Path) -> Tree:
    """The content of a folder; empty if there is none."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() and not path.is_symlink():
            found[f"{name}/"] = ""
        elif path.name not in NOT_COMPARED:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def differences(found: Tree, expected: Tree) -> str:
    """Which files are missing, too many or different; empty if none."""
    missing = [f"{name} is missing" for name in expected if name not in found]
    surplus = [f"{name} should not be there" for name in found if name not in expected]
    other = [f"{name} differs" for name in found if name in expected and found[name] != expected[name]]
    return ", ".join(missing + surplus + other)


def finished_but_not_whole(folder: Path, wholes: list[Tree]) -> str:
    """What is wrong with a folder whose `run.json` says that all is there; empty if nothing.

    Args:
        folder: A run directory; what is in `unfinished/` and hidden files do not count.
        wholes: What it may hold: the old run or the new one.
    """
    if not (folder / "run.json").exists():
        return ""
    found = {name: sha for name, sha in tree(folder).items() if not name.startswith(("unfinished", "."))}
    worst = [differences(found, whole) for whole in wholes]
    return "" if "" in worst else f"run.json is there, but {min(worst, key=len)}"
