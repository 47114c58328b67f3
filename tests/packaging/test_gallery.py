"""The script that makes the pictures of the documents."""

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from modsim3d.scene import reading

REPOSITORY = Path(__file__).resolve().parents[2]
GALLERY = REPOSITORY / "script" / "gallery"


@pytest.fixture
def gallery(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """The script, run in this process, which has imported most of what it needs; gives what it prints."""

    def run(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(GALLERY), *map(str, arguments)])
        monkeypatch.setattr(sys, "path", list(sys.path))
        try:
            runpy.run_path(str(GALLERY), run_name="__main__")
        except SystemExit as stopped:
            assert not stopped.code
        return capsys.readouterr().out

    return run


def test_every_picture_of_the_documents_is_made_by_the_gallery(gallery: Callable[..., str]) -> None:
    shown = set()
    for page in (REPOSITORY / "README.md", *(REPOSITORY / "docs").glob("*.md")):
        names = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text())
        shown |= {(page.parent / name).resolve() for name in names}
    assert {path.parent for path in shown} == {REPOSITORY / "docs"}
    assert {path.name for path in shown} <= set(gallery("--list").split())
    assert all(path.is_file() for path in shown)


def test_gallery_draws(gallery: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that take little time; a change of what the script calls is noticed here. Both show the first 151 steps."""
    load_scene = reading.load_scene
    monkeypatch.setattr(reading, "load_scene", lambda name, **options: load_scene(name, **options | {"steps": 151}))
    written = gallery("--out", tmp_path, "looks.jpg", "map.png")
    assert written.count("kB") == 2
    for name in ("looks.jpg", "map.png"):
        with Image.open(tmp_path / name) as picture:
            assert min(picture.size) > 500
