"""Settings of the site that `script/docs` builds with Sphinx out of the Markdown of this repository.

The front page is README.md. A page that is missing from MENU is an error, as is any warning.
"""

from __future__ import annotations

import inspect
import json
import re
from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

import modsim3d

LOGGER = getLogger(__name__)
ROOT = Path(__file__).resolve().parent.parent

MENU = {
    "First steps": ["README", "docs/run", "docs/limits"],
    "Build a scene": [
        "docs/scene",
        "docs/poses",
        "docs/traffic",
        "docs/cameras",
        "docs/waves",
        "docs/shapes",
        "docs/ais",
    ],
    "Look at it": ["docs/pictures", "docs/report"],
    "The detector": [
        *("docs/detector", "docs/knobs", "docs/from_figures", "docs/learn", "docs/voyage", "docs/learned_models"),
        "docs/conditions",
    ],
    "Test a tracker": [
        *("docs/track", "docs/trackers", "docs/tracker_command", "docs/track_files", "docs/score", "docs/scores"),
        *("docs/world_tracks", "docs/closed_loop"),
        *("docs/export", "docs/stream", "docs/positions", "docs/ros", "docs/ais_out", "docs/labelled_video"),
    ],
    "Campaigns": [
        *("docs/campaign", "docs/requirements", "docs/campaign_report", "docs/worst_runs", "docs/search"),
        *("docs/uncertainty", "docs/cluster", "docs/continuous_integration"),
    ],
    "Check it": [
        "docs/verify",
        "docs/stand_in",
        "docs/real_pictures",
        "docs/truth",
        "docs/reliability",
        "docs/assurance",
    ],
    "From Python": ["docs/python", "docs/tour", "docs/python_scenes", "docs/api", "docs/plugins"],
    "Reference": [
        "docs/extras",
        "docs/tables",
        "docs/json",
        "benchmarks/RESULTS",
        "benchmarks/GRAPHICS_CARD",
        "benchmarks/DRAWING",
        "benchmarks/FILMS",
        "benchmarks/REPORT_PAGE",
        "benchmarks/LATENCY",
        "benchmarks/TRACKING",
        "benchmarks/CAMPAIGNS",
    ],
    "The thesis": ["docs/thesis", "docs/simulation_1", "docs/simulation_2", "docs/simulation_3"],
    "About": ["docs/architecture", "CONTRIBUTING", "CHANGELOG"],
}
CAMPAIGNS = [
    *("compare", "fresh", "fuzz", "learn_coverage", "lookout", "mutants", "platforms", "positions", "search"),
    *("sequences", "tracker_scores", "traffic", "verify_changes", "verify_seeds", "voyages"),
]

project = "modsim3d"
root_doc = "README"
include_patterns = ["*.md", "docs/**.md", "docs/tour.ipynb", "benchmarks/*.md"]
exclude_patterns = [".*", "build", "modsim3d", "runs", "tests"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
smartquotes_action = "D"
highlight_language = "text"
suppress_warnings = ["misc.highlighting_failure"]  # a fence without colours is no fault

default_role = "code"
add_module_names = False
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", "Indices", "Mask")}
autodoc_typehints_format = "short"
napoleon_attr_annotations = False  # the signature has the types
napoleon_use_ivar = True
python_maximum_signature_line_length = 80

html_theme = "furo"
html_title = "modsim3d"
html_copy_source = False
html_show_copyright = False


def add_menu(app: Sphinx, page: str, source: list[str]) -> None:
    """Add the menu to the front page, and the campaigns, which the search leaves out, to the page that they are for."""
    if page == root_doc:
        for caption, pages in MENU.items():
            source[0] += _toctree(pages, caption)
    elif page == "docs/reliability":
        source[0] += _toctree([f"docs/campaigns/{name}" for name in CAMPAIGNS])
    elif page.startswith("docs/campaigns/"):
        source[0] = "---\nnosearch: true\n---\n\n" + source[0]


def _toctree(pages: list[str], caption: str = "") -> str:
    """Entries of the menu for those of some pages that exist."""
    existing = [page for page in pages if any((ROOT / f"{page}{each}").is_file() for each in (".md", ".ipynb"))]
    entries = ["Start here <self>" if page == root_doc else f"/{page}" for page in existing]
    options = [":hidden:", f":caption: {caption}"] if caption else [":hidden:"]
    return "\n\n" + "\n".join(["```{toctree}", *options, "", *entries, "```", ""])


def read_notebook(app: Sphinx, page: str, source: list[str]) -> None:
    """Make Markdown of a notebook."""
    if source[0].startswith("{"):
        cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(source[0])["cells"]]
        source[0] = "\n\n".join(text if kind == "markdown" else f"```python\n{text}\n```" for kind, text in cells)


def add_docstrings(app: Sphinx, page: str, source: list[str]) -> None:
    """Add the docstrings of the names in the tables of docs/api.md at its end, and links to them.

    A name that does not exist is warned of, and so is one of `modsim3d.__all__` that no table has.
    """
    if page != "docs/api":
        return
    row = re.compile(r"^\| `(modsim3d\.[\w.]+)`", flags=re.MULTILINE)
    names = row.findall(source[0])
    for name in modsim3d.__all__:
        if f"modsim3d.{name}" not in names:
            LOGGER.warning("no table has modsim3d.%s, which modsim3d.__all__ lists", name, location=page)
    source[0] = row.sub(r"| {py:obj}`\1`", source[0])
    source[0] += "\n\n```{eval-rst}\n" + "\n".join(map(_directive, names)) + "\n```\n"


def _directive(name: str) -> str:
    """The directive that shows a name's docstring."""
    module, _, attribute = name.rpartition(".")
    try:
        value = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        LOGGER.warning("there is no %s: %s", name, error, location="docs/api")
        return ""
    if not inspect.isclass(value):
        return f".. auto{'function' if callable(value) else 'data'}:: {name}"
    kind = "exception" if issubclass(value, Exception) else "class"
    return f".. auto{kind}:: {name}"


def prepare_docstring(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Let what is plain text in a docstring stay so: indented blocks become code, and colons in properties text."""
    for index in range(len(lines) - 1, 1, -1):
        if lines[index].startswith("    ") and not lines[index - 1] and lines[index - 2][:1].strip():
            lines[index:index] = ["::", ""]
    if what == "property":
        lines[:0] = ["..", ""]  # a comment; without it napoleon takes text before a colon for the property's type


def setup(app: Sphinx) -> None:
    """Let the functions above look at pages and docstrings as they are read; the files stay plain Markdown."""
    app.connect("autodoc-process-docstring", prepare_docstring, priority=0)
    app.add_source_suffix(".ipynb", "markdown")
    app.connect("source-read", read_notebook)
    app.connect("source-read", add_menu)
    app.connect("source-read", add_docstrings)
