"""The notebook docs/tour.ipynb runs from top to bottom, and its last lines show as they do in Jupyter."""

import ast
import json
from pathlib import Path

import pytest

import modsim3d

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs/tour.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def shown(cell: str, names: dict[str, object]) -> str:
    """What a notebook shows of the last line of a cell, if that is an expression; its names are added."""
    *body, last = ast.parse(cell).body
    value: object = None
    if not isinstance(last, ast.Expr):
        body.append(last)
    exec(compile(ast.Module(body, []), str(NOTEBOOK), "exec"), names)
    if isinstance(last, ast.Expr):
        value = eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)
    return value._repr_html_() if hasattr(value, "_repr_html_") else repr(value)


def test_the_cells_run_in_order_and_show_what_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    said = [shown("".join(each["source"]), names) for each in CELLS if each["cell_type"] == "code"]
    assert [text.count("<img ") + 2 * text.count("<iframe ") for text in said if "tour/first/" in text] == [1, 2]
    assert {each.outcome for each in names["campaign"].verdicts} == {"met"}  # type: ignore[attr-defined]
    assert modsim3d.open_run("tour/second").scene.detector.labels == names["learned"].detector.labels  # type: ignore[attr-defined]


def test_it_is_a_notebook_of_version_4_without_outputs() -> None:
    """As nbformat's schema has it, which checked the file when it was made."""
    keys = {"code": {"execution_count", "outputs"}, "markdown": set()}
    assert all(each.keys() == {"cell_type", "id", "metadata", "source"} | keys[each["cell_type"]] for each in CELLS)
    assert len({each["id"] for each in CELLS}) == len(CELLS) and not any(each.get("outputs") for each in CELLS)
