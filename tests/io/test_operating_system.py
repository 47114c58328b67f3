"""Systems without locks, forks or limits: one module knows of them, and commands do without."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import mypy
import pytest

PACKAGE = Path(__file__).parents[2] / "modsim3d"
ONE_MODULE = PACKAGE / "io" / "operating_system.py"
STUBS = Path(mypy.__file__).parent / "typeshed" / "stdlib"
KEYWORDS = {"pass_fds", "preexec_fn", "start_new_session", "startupinfo"}  # of Popen, on some systems only


def names_on(platform: str, statements: list[ast.stmt]) -> Iterator[str]:
    """Names that a stub has on a platform."""
    for statement in statements:
        match statement:
            case ast.If(test=test, body=body, orelse=other):
                system = SimpleNamespace(platform=platform, version_info=(3, 11))
                yield from names_on(platform, body if eval(ast.unparse(test), {"sys": system}) else other)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
                yield name
            case ast.Assign(targets=targets):
                yield from (ast.unparse(target) for target in targets)
            case ast.ImportFrom(names=names) | ast.Import(names=names):
                yield from (each.asname or each.name for each in names)


@cache
def not_everywhere(module: str) -> frozenset[str]:
    """Names of a module of the standard library that Windows or macOS lacks, by the stubs of mypy."""
    stem = STUBS.joinpath(*module.split("."))
    stub = next((path for path in (stem / "__init__.pyi", stem.with_suffix(".pyi")) if path.exists()), None)
    if stub is None:
        return frozenset()
    tree = ast.parse(stub.read_text(encoding="utf-8")).body
    linux, windows, mac = (set(names_on(platform, tree)) for platform in ("linux", "win32", "darwin"))
    return frozenset(linux - (windows & mac))


def only_on_some_systems(text: str) -> Iterator[str]:
    """What a module's text uses that not every system has."""
    tree = ast.parse(text)
    modules = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {each.asname or each.name: each.name for each in node.names}
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=str(module), names=names):
                yield from (f"{module}.{each.name}" for each in names if each.name in not_everywhere(module))
            case ast.Import(names=names):
                yield from (each.name for each in names if each.name in ("fcntl", "resource", "pwd", "grp", "termios"))
            case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                named = f"{modules.get(name)}.{attribute}"
                if attribute in not_everywhere(modules.get(name, "")) or named in ("os.name", "sys.platform"):
                    yield named
            case ast.keyword(arg=str(name)) if name in KEYWORDS:
                yield name
            case ast.Constant(value=str(words)) if words in {"fork", *KEYWORDS} or "/proc/" in words:
                yield words


def test_one_module_has_what_only_some_systems_have() -> None:
    source = "import fcntl, os, signal as s, sys\nos.fork(s.SIGKILL, sys.platform, 'fork', pass_fds=[])"
    names = {"os.fork", "signal.SIGKILL", "fcntl", "sys.platform", "pass_fds", "fork"}
    assert names <= set(only_on_some_systems(source))
    assert "signal.SIGHUP" in only_on_some_systems("from signal import SIGHUP")
    modules = {path: set(only_on_some_systems(path.read_text(encoding="utf-8"))) for path in PACKAGE.rglob("*.py")}
    assert {"fcntl", "resource", "sys.platform", "pass_fds"} <= modules.pop(ONE_MODULE)
    assert {path.name: found for path, found in modules.items() if found} == {}


BARE = """\
import os, sys
sys.modules["fcntl"] = sys.modules["resource"] = None
for name in "fork forkpty killpg wait4 register_at_fork sched_getaffinity pread setpgid O_DIRECTORY O_NONBLOCK".split():
    delattr(os, name)
def without_proc(call):
    def wrapped(path=".", *args, **kwargs):
        if isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith("/proc"):
            raise FileNotFoundError(2, "there is no /proc")
        return call(path, *args, **kwargs)
    return wrapped
for name in "stat lstat open listdir scandir".split():
    setattr(os, name, without_proc(getattr(os, name)))
"""
"""Makes a Python one of a system that has little; run as `sitecustomize`, also in workers."""
COMMANDS = """\
import sys
from modsim3d.cli.main import main
def modsim3d(*words):
    sys.argv[1:] = words
    try:
        main()
    except SystemExit as end:
        assert not end.code, (words, end.code)
modsim3d("run", "simulation_1", "--steps", "4", "--no-sheet", "-q", "--workers", "2", "--out", "run")
modsim3d("track", "run", "--command", sys.executable + " tracker.py", "-q", "--out", "tracks")
modsim3d("campaign", "run", "campaign.yaml", "-q", "--workers", "1", "--out", "campaign")
"""
FILES = {
    "sitecustomize.py": BARE,
    "commands.py": COMMANDS,
    "campaign.yaml": "{scene: simulation_1, steps: 2, seeds: {traffic: 2}, trackers: [reference]}",
    "tracker.py": """\
import json, sys
sys.stdin.readline()
print('{"answers": "frames", "tracks": "image"}', flush=True)
for line in sys.stdin:
    frame = json.loads(line)
    print(json.dumps({"step": frame["step"], "camera": frame["camera"], "tracks": []}), flush=True)
""",
}


@pytest.mark.skipif(os.name != "posix", reason="this system has little by itself")
def test_commands_do_without_locks_forks_and_proc(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])}
    done = subprocess.run(
        [sys.executable, "commands.py"], cwd=tmp_path, env=settings, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "campaign" / "verdicts.json").exists() and (tmp_path / "tracks").is_dir()
