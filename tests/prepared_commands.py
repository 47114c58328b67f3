"""A `modsim3d` that starts in milliseconds: its commands are forks of one process that has imported everything.

    python -m tests.prepared_commands FOLDER

writes an executable `modsim3d` into the folder and serves it until its standard input ends. A command has the
arguments, folder, environment, files and file size limit of its client, and gets the signals that end the client. If
the variable `FIRST` names a file of Python, that is run first, in the process of the command.
"""

import atexit
import contextlib
import functools
import gc
import json
import os
import resource
import select
import signal
import socket
import sys
import threading
from pathlib import Path
from typing import NoReturn

import typer

import modsim3d
from benchmarks.faults.commands import prepare
from modsim3d.cli import main as cli
from modsim3d.io.validation import Strict
from modsim3d.render.context import choose_backend, prepare_environment

LIBRARIES = (
    *("OpenGL.GL", "PIL.ImageDraw", "PIL.ImageFont", "PIL.PngImagePlugin", "PIL.JpegImagePlugin"),
    *("trimesh", "pyrender", "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg"),
    *("mpl_toolkits.mplot3d", "imageio.v2", "imageio_ffmpeg", "rosbags.rosbag2", "trackers", "trackeval", "optuna"),
    *("pyarrow.dataset", "rich.live", "rich.progress", "rich.table"),
)
"""What commands import when they need it. Rerun is left out: it starts threads, and a fork needs a single one."""

CLIENT = """\
#!{python} -IS
import json, os, resource, signal, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({address!r})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    asked = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ), limits]).encode()
    socket.send_fds(server, [len(asked).to_bytes(8, "big")], [0, 1, 2])
    server.sendall(asked)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: server.sendall(bytes([number])))
    sys.exit(int(server.recv(8) or b"1"))
"""


def serve(folder: Path) -> None:
    """Answer each client with the exit status of its command, which has the client's arguments, folder and files."""
    inherited = frozenset(os.environ)
    prepare()
    backend = choose_backend()
    prepare_environment(backend)
    for name in (*LIBRARIES, "OpenGL.EGL" if backend == "egl" else "OpenGL.osmesa", *modules()):
        __import__(name)
    sys.modules["modsim3d.learn.self_check"].SEEDS = 2  # as in the process of the tests, and so is
    os.fsync = lambda _: None
    models = [Strict]
    for model in models:
        models += model.__subclasses__()
        model.model_rebuild()
    typer.main.get_command = functools.cache(typer.main.get_command)
    commands = [typer.main.get_command(cli._app_for(name.split()[0])) for _, name, *_ in cli.COMMANDS]
    for command in commands:
        commands += getattr(command, "commands", {}).values()  # of a group, which come after all others
        for parameter in command.params:
            parameter.get_runtime_param()
    prepare()  # once more, because it makes sure that no library has started a thread
    gc.freeze()  # what is imported stays, and no command looks through it
    with socket.socket(socket.AF_UNIX) as listening:
        address = str(folder / "socket")
        listening.bind(address)
        listening.listen()
        client = folder / "modsim3d"
        client.write_text(CLIENT.format(python=sys.executable, address=address), encoding="utf-8")
        client.chmod(0o755)
        print("ready", flush=True)
        while sys.stdin not in select.select([sys.stdin, listening], [], [])[0]:
            connection = listening.accept()[0]
            if os.fork() == 0:
                listening.close()
                answer(connection, inherited)
            connection.close()
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass


def modules() -> list[str]:
    """The modules of the package, without those that only keep old names alive."""
    package = Path(modsim3d.__file__).parent
    names = [path.relative_to(package.parent).with_suffix("").parts for path in package.rglob("*.py")]
    return sorted(".".join(name) for name in names if not name[-1].startswith("__"))


def answer(connection: socket.socket, inherited: frozenset[str]) -> None:
    """Run the command of a client in a process of its own; a client that goes away takes it along. Of the environment
    of this process the command has only what preparing has added to the variables `inherited`."""
    length, files, _, _ = socket.recv_fds(connection, 8, 3)
    arguments, folder, environment, limits = json.loads(
        connection.recv(int.from_bytes(length, "big"), socket.MSG_WAITALL)
    )
    command = os.fork()
    if command == 0:
        for place, file in enumerate(files):
            os.dup2(file, place)
        encoding = environment.get("PYTHONIOENCODING")
        sys.stdin, sys.stdout, sys.stderr = (
            open(place, mode, encoding=encoding, closefd=False)  # noqa: SIM115
            for place, mode in enumerate("rww")
        )
        connection.close()
        os.chdir(folder)
        for name in inherited - environment.keys():
            os.environ.pop(name, None)
        os.environ.update(environment)
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        sys.argv = ["modsim3d", *arguments]
        if first := environment.get("FIRST"):
            exec(Path(first).read_text(encoding="utf-8"), {})
        try:
            cli.main()
        except SystemExit as ended:
            leave(int(ended.code or 0))
    for file in (0, 1, 2, *files):  # a reader of the command's output waits until nobody can write to it
        os.close(file)
    ended = os.pidfd_open(command)
    while ended not in select.select([connection, ended], [], [])[0]:
        number = connection.recv(1)
        os.kill(command, number[0] if number else signal.SIGTERM)
        if not number:
            break
    status = os.waitstatus_to_exitcode(os.waitpid(command, 0)[1])
    with contextlib.suppress(BrokenPipeError):
        connection.sendall(str(status if status >= 0 else 128 - status).encode())
    os._exit(0)


def leave(status: int) -> NoReturn:
    """End as Python does, but leave the memory of all modules to the system: a fork would copy what it frees."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
