"""What the README shows must work as shown."""

import re
from pathlib import Path

import pytest
import yaml

from modsim3d.scene.keys import SceneKeys

README = Path(__file__).resolve().parents[2] / "README.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("code", blocks("python"))
def test_python_examples_run(code):
    exec(compile(code, str(README), "exec"), {})


@pytest.mark.parametrize("text", blocks("yaml"))
def test_scene_example_is_valid(text):
    SceneKeys.model_validate(yaml.safe_load(text.replace("e-5", "e-05")))


def test_readme_names_files_that_exist():
    text = README.read_text(encoding="utf-8")
    for path in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (README.parent / path).exists(), path
