"""A headless Chromium, driven over the DevTools protocol through a pair of pipes: no driver, no port, no network."""

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars", "--mute-audio",
         "--disable-background-networking", "--disable-component-update", "--disable-extensions", "--disable-sync",
         "--force-color-profile=srgb", "--disable-renderer-backgrounding", "--disable-backgrounding-occluded-windows",
         "--disable-background-timer-throttling", "--remote-debugging-pipe")  # fmt: skip
PATIENCE_S = 120.0
PLAYER = "Boolean(window.player || document.querySelector('#failure:not([hidden])'))"


def find_browser() -> str:
    """The browser that `CHROMIUM` names, or the first on the path."""
    asked = os.environ.get("CHROMIUM")
    if found := next(filter(None, map(shutil.which, [asked] if asked else NAMES)), None):
        return found
    remedy = "script/setup test installs one where apt has it (Debian); elsewhere install Chromium or Chrome"
    raise FileNotFoundError(f"{asked or 'Chromium'} was not found: {remedy}, or set CHROMIUM to its path")


class Browser:
    """One tab of a browser, and what it has said."""

    def __init__(self, process: subprocess.Popen[bytes], to_browser: int, from_browser: int) -> None:
        self.process = process
        self._to, self._from = to_browser, from_browser
        self._number, self._rest = 0, b""
        self._session: str | None = None
        self.errors: list[str] = []
        self.requests: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call("Page.bringToFront")  # a page behind another is not animated
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while (answer := self._read()).get("id") != self._number:
            self._heed(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def _read(self) -> dict[str, Any]:
        deadline = time.monotonic() + PATIENCE_S
        while b"\0" not in self._rest:
            if not select.select([self._from], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._from, 1 << 20)
            if not part:
                raise RuntimeError("the browser has stopped")
            self._rest += part
        text, _, self._rest = self._rest.partition(b"\0")
        return json.loads(text)

    def _heed(self, event: dict[str, Any]) -> None:
        method, said = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(said["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.errors.append(json.dumps(said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.errors.append(json.dumps(said["entry"]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])

    def open(self, path: Path, size: tuple[int, int] = (1280, 900), hash: str = "", ready: str = PLAYER) -> None:
        """Load a file and wait for its player; the page before must have had nothing to complain of."""
        self.resize(size)
        assert self.errors == []
        self.call("Page.navigate", url="about:blank")
        self.errors.clear()
        self.requests.clear()
        self.call("Page.navigate", url=path.resolve().as_uri() + hash)
        deadline = time.monotonic() + PATIENCE_S
        while not self.run(ready):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the page is not ready: {self.errors}")
            time.sleep(0.02)

    def visit(self, path: Path, size: tuple[int, int]) -> None:
        """Load a file that has no player."""
        self.open(path, size, ready="document.readyState === 'complete' && location.protocol === 'file:'")

    def resize(self, size: tuple[int, int]) -> None:
        shape = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **shape)

    def scheme(self, scheme: str) -> None:
        """What the system prefers: `light` or `dark`."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def run(self, script: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        return str(self.run(f"document.querySelector({json.dumps(selector)}).textContent"))

    def pixels(self, canvas: str = "picture") -> NDArray[np.uint8]:
        """All of what a canvas shows, shape (rows, columns, 4)."""
        data = self.run(f"document.querySelector('#{canvas}').toDataURL()").partition(",")[2]
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            return np.asarray(image.convert("RGBA"))

    def choose(self, select: str, value: str) -> None:
        """Choose a value of a list, as a user does."""
        chosen = f"select.value = {json.dumps(value)}; select.dispatchEvent(new Event('change'));"
        self.run(f"(select => {{ {chosen} }})(document.querySelector('#{select}'))")

    def until(self, condition: str) -> None:
        look = f"const look = () => ({condition}) ? done(1) : setTimeout(look, 10); look();"
        self.run(f"new Promise(done => {{ {look} }})")

    def settle(self) -> None:
        """Let the browser draw, and scroll, what it was asked for."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def press(self, key: str, shift: bool = False) -> None:
        text = {"text": key} if len(key) == 1 else {}
        for kind, more in (("keyDown", text), ("keyUp", {})):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, modifiers=8 if shift else 0, **more)

    def after(self, key: str, script: str) -> Any:
        self.press(key)
        return self.run(script)

    def key(self, name: str, code: int) -> None:
        """Press a key as the browser itself sees it: Tab moves the focus, Escape closes a dialog."""
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    def click(self, selector: str, across: float = 0.5, down: float = 0.5) -> None:
        """Press the mouse on an element, at a share of its width and height."""
        x, y = self.place(selector, across, down)
        self.mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", clickCount=1)

    def hover(self, selector: str, across: float, down: float) -> None:
        self.mouse("mouseMoved", *self.place(selector, across, down))

    def wheel(self, selector: str, by: float, control: bool = False) -> None:
        """Turn the wheel over the middle of an element, with or without the Ctrl key."""
        modifiers = 2 if control else 0
        self.mouse("mouseWheel", *self.place(selector), deltaX=0, deltaY=by, modifiers=modifiers)

    def fingers(self, *places: Sequence[tuple[float, float]]) -> None:
        """Put fingers on the window at the first places, move them to each of the next, and lift them."""
        for number, points in enumerate(places):
            touches = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(points)]
            self.call("Input.dispatchTouchEvent", type="touchMove" if number else "touchStart", touchPoints=touches)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def place(self, selector: str, across: float = 0.5, down: float = 0.5) -> tuple[float, float]:
        """Where an element is that is scrolled into sight, at a share of its width and height."""
        box = self.run(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
            "e.scrollIntoView({block: 'center', behavior: 'instant'});"
            "const b = e.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()"
        )
        return box[0] + across * box[2], box[1] + down * box[3]

    def screenshot(self, path: Path) -> None:
        """What is seen, as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def open_browser() -> Iterator[Browser]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        low_in, our_out = os.pipe()
        our_in, low_out = os.pipe()
        # The protocol wants descriptors 3 and 4; a shell puts them there, from numbers that are out of the way.
        their_in, their_out = (fcntl.fcntl(low, fcntl.F_DUPFD, 10) for low in (low_in, low_out))
        os.close(low_in)
        os.close(low_out)
        start = f'exec "$@" 3<&{their_in} 4>&{their_out}'
        command = ["bash", "-c", start, "bash", find_browser(), *FLAGS, f"--user-data-dir={profile}"]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, pass_fds=(their_in, their_out), **silent) as process:
            os.close(their_in)
            os.close(their_out)
            try:
                yield Browser(process, our_out, our_in)
            finally:
                process.terminate()
                process.wait(timeout=PATIENCE_S)
                os.close(our_out)
                os.close(our_in)


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
