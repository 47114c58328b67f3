"""Names of `import modsim3d`, which loads nothing heavy for them, and the Python of docs/python.md."""

import ast
import doctest
import inspect
import pkgutil
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from textwrap import dedent

import pytest

import modsim3d
from modsim3d import plugins

DOCS = Path(__file__).resolve().parents[2] / "docs"
NAMES = {
    *("ModsimError", "Scene", "camera_placement", "detect_run", "detect_truth", "learn_detector", "learn_voyage"),
    "learn_from_figures",
    *("load_detector", "load_scene", "locate", "open_campaign", "open_run", "run_campaign", "run_scene", "score_run"),
    *("simulate_frames", "track_run", "verify_run", "labelled_video", "ais", "check_repeat", "check_truth", "export"),
    *("export_rerun", "plan_campaign", "report", "report_campaign", "reproduce_run", "search_campaign", "view_film"),
    *("view_frame", "view_map", "view_sheet", "check_scene", "guess_detector"),
}
ELSEWHERE = {
    *("closest_approach", "density_per_km2", "encounter", "frame_picture", "hull_tracks", "lane_offsets"),
    *("open_id_renderer", "plot_frame", "read_tracks", "read_world_tracks", "scene_from_dict", "score_world"),
    *("shipped_scenes", "speeds_m_s", "truncated_errors", "verify_evidence"),
}
"""Functions that pages beside docs/python.md show."""
RESULTS = (
    *("detector.model.DetectorModel", "detector.model.PerformanceState", "learn.learning.LearnResult"),
    *("runs.blocks.Frame", "runs.blocks.FrameDetections", "runs.blocks.FrameTruth", "runs.run.RunResult"),
    *("runs.stored_run.StoredRun", "scene.copy.SceneCopy", "scene.sight.Snapshot"),
    *("tracking.track_run.TrackResult", "verify.verify_run.VerifiedRun"),
)
"""Classes of what functions at the top level give."""
HEAVY = ("OpenGL", "matplotlib", "PIL", "pyarrow", "trimesh", "typer", "rich", "supervision")


SIMULATES = f"""
import sys, modsim3d
dir(modsim3d)
print([m for m in {HEAVY} if m in sys.modules])
scene = modsim3d.load_scene("simulation_1", steps=3, source="analytic")
frames = list(modsim3d.simulate_frames(scene))
repr(frames), repr(scene), scene._repr_html_()
print([m for m in ("OpenGL", "matplotlib", "pyarrow", "supervision") if m in sys.modules], len(frames))
"""


def test_dir_lists_the_names_which_are_there_and_import_loads_nothing_heavy_for_them():
    assert NAMES <= set(modsim3d.__all__) == set(dir(modsim3d)) - {"__version__"}
    assert all(getattr(modsim3d, name) is not None for name in dir(modsim3d))
    for text in ("'load_scen'", "'Located': it is now Locations", "'Written': it is now OutputFiles"):
        with pytest.raises(AttributeError, match=f"^module 'modsim3d' has no attribute {text}$"):
            getattr(modsim3d, text.split("'")[1])
    # Importing a module of the same name would put it in the place of the function.
    modules = {module.name for module in pkgutil.iter_modules(modsim3d.__path__)}
    assert {"learn", "verify"} <= modules and set(modsim3d.__all__) & modules == set()
    assert subprocess.check_output([sys.executable, "-c", SIMULATES], text=True).splitlines() == ["[]", "[] 3"]
    assert tuple(doctest.testmod(modsim3d)) == (0, 3)


def public_parts() -> dict[str, object]:
    """All that is reached from the top level: the names, the classes of their results, and the methods of these."""
    parts: dict[str, object] = {name: getattr(modsim3d, name) for name in modsim3d.__all__}
    for module, _, name in (result.rpartition(".") for result in RESULTS):
        parts[name] = getattr(import_module(f"modsim3d.{module}"), name)
    for name, part in list(parts.items()):
        if inspect.isclass(part):
            methods = {key: member for key, member in vars(part).items() if not key.startswith("_")}
            parts |= {f"{name}.{key}": member for key, member in methods.items() if callable(member)}
    return parts


PARTS = public_parts()


def test_docstrings_begin_with_a_noun_or_a_verb_have_an_example_and_say_what_is_raised():
    """A path is taken as text or as any path object."""
    for name, part in PARTS.items():
        assert len(inspect.getdoc(part) or "") > 20, name
        parameters = inspect.signature(part).parameters if inspect.isfunction(part) else {}
        assert not any(re.search(r"\bPath\b", str(value.annotation)) for value in parameters.values()), name
    # One that begins with `What`, `Which` and the like says little to who does not know already.
    asides = re.compile(r"(How|Of|The same|Those|What|Where|Which|Who|Why)\b")
    texts = {
        f"{path.name}: {getattr(node, 'name', 'module')}": ast.get_docstring(node) or ""
        for path in Path(modsim3d.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    }
    assert {name: text for name, text in texts.items() if asides.match(text)} == {}
    for name in (name for name in modsim3d.__all__ if name[0].islower() and name not in ELSEWHERE):
        text = inspect.getdoc(getattr(modsim3d, name)) or ""
        assert "\nRaises:\n" in text and "TypeError:" in text, name
        tree = ast.walk(ast.parse(dedent(text.split("\n\n")[1])))
        used = {node.attr for node in tree if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "modsim3d"}
        assert name in used and used <= NAMES, name


def test_every_public_name_is_in_the_reference_and_documents_show_none_at_an_internal_path():
    rows = set(re.findall(r"^\| `(modsim3d[\w.]*)` \|", (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE))
    own = {f"modsim3d.{name}" for name in modsim3d.__all__}
    assert rows == own | {f"modsim3d.plugins.{name}" for name in set(plugins.__all__) - set(modsim3d.__all__)}
    assert all(getattr(plugins, name) is not None for name in plugins.__all__)
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md") if path.name != "api.md")
    assert [name for name in ELSEWHERE if not re.search(rf"\b{name}(\(|`)", pages)] == []
    # Names in rooms may move; docs/architecture.md is about the rooms themselves.
    rooms = "|".join(module.name for module in pkgutil.iter_modules(modsim3d.__path__) if module.name != "plugins")
    pages = {DOCS.parent / "README.md", *DOCS.glob("*.md"), *DOCS.parent.glob("tests/*_example/*.py")}
    pages.remove(DOCS / "architecture.md")
    shown = {path.name: re.findall(rf"modsim3d\.(?:{rooms})\b", path.read_text(encoding="utf-8")) for path in pages}
    assert len(pages) > 20 and {name: paths for name, paths in shown.items() if paths} == {}


PAGE = Path(__file__).resolve().parents[2] / "docs/python.md"


def blocks() -> list[tuple[int, str]]:
    """The line at which each block begins, and its text."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.finditer(r"```python\n(.*?)```", text, re.S)
    return [(text.count("\n", 0, each.start(1)), each[1]) for each in found]


def printed() -> set[str]:
    """The lines that the page shows as printed: of a scene, from `<` to `>`, and of a run."""
    shown = re.findall(r"```text\n(<.*?>|RunResult .*?)\n```", PAGE.read_text(encoding="utf-8"), re.S)
    return {line for text in shown for line in without_times(text)}


def without_times(text: str) -> list[str]:
    return re.sub(r"time +[0-9.]+ s", "time", text).splitlines()


def test_the_page_runs_from_top_to_bottom(tmp_path: Path) -> None:
    lines = ["from modsim3d.learn import self_check; self_check.SEEDS = 2  # fewer than a user's, to be quick"]
    for first, block in blocks():
        lines += [""] * (first - len(lines)) + block.splitlines()  # a traceback then names the line of the page
    script, empty = tmp_path / "page.py", tmp_path / "empty"
    script.write_text("\n".join(lines), encoding="utf-8")
    empty.mkdir()
    command = [sys.executable, "-W", "error:::__main__", script]
    done = subprocess.run(command, cwd=empty, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    made = {"runs", "checked", "frame.png", "moment.png", "page.html"}
    made |= {"learned.yaml", "learned.html", "learned.uncertainty.json"}
    assert {path.name for path in empty.iterdir()} == made
    assert printed() and printed() <= set(without_times(done.stdout))
    assert "obeys its detector file" in done.stdout


def test_the_page_begins_with_ten_lines_and_names_every_function() -> None:
    text, (_, first) = PAGE.read_text(encoding="utf-8"), blocks()[0]
    assert sum(bool(line.strip()) for line in first.splitlines()) <= 10
    functions = [name for name in modsim3d.__all__ if name[0].islower() and name not in ELSEWHERE]
    assert len(functions) >= 8 and [name for name in functions if f"`{name}(" not in text] == []
