"""The accessibility checks of axe-core, as the Python package `axe-playwright-python` carries them, in an open page."""

import json
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from tests.view.report.browser import Browser

PACKAGE = "axe_playwright_python"
GRAVE = ("serious", "critical")
LOOK = """axe.run({resultTypes: ['violations']}).then(({violations}) => violations
.filter(({impact}) => %s.includes(impact))
.flatMap(({id, nodes}) => nodes.map(({target, failureSummary}) => `${id}: ${target}: ${failureSummary}`)))"""


@lru_cache(maxsize=1)
def axe_core() -> str:
    """The script of axe-core; the package itself is not imported, as it would ask for Playwright."""
    spec = find_spec(PACKAGE)
    if spec is None or spec.origin is None:
        raise FileNotFoundError(f"{PACKAGE} was not found: script/setup test installs it")
    return (Path(spec.origin).parent / "axe.min.js").read_text(encoding="utf-8")


def grave_violations(browser: Browser) -> list[str]:
    """What axe-core finds serious or critical in the open page: rule, place and remedy."""
    if not browser.run("Boolean(window.axe)"):
        browser.run(axe_core() + "\n0")
    return list(browser.run(LOOK % json.dumps(GRAVE)))
