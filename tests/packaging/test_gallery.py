"""The script that makes the pictures of the documents."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from PIL import Image

REPOSITORY = Path(__file__).resolve().parents[2]
GALLERY = REPOSITORY / "script" / "gallery"


def gallery(*arguments: object) -> str:
    finished = subprocess.run(
        [sys.executable, GALLERY, *map(str, arguments)], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    return finished.stdout


def test_every_picture_of_the_documents_is_made_by_the_gallery() -> None:
    pages = [REPOSITORY / "README.md", *(REPOSITORY / "docs").glob("*.md")]
    shown = {
        (page.parent / name).resolve()
        for page in pages
        for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text())
    }
    assert {path.parent for path in shown} == {REPOSITORY / "docs"}
    assert {path.name for path in shown} <= set(gallery("--list").split())
    assert all(path.is_file() for path in shown)


def test_gallery_draws(tmp_path: Path) -> None:
    """Those that take little time; a change of what the script calls is noticed here."""
    written = gallery("--out", tmp_path, "looks.png", "map.png")
    assert written.count("kB") == 2
    for name in ("looks.png", "map.png"):
        with Image.open(tmp_path / name) as picture:
            assert min(picture.size) > 500
