"""The command `modsim3d stream`: detections line by line, while a scene is simulated."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import flag, option
from modsim3d.cli.terminal import remark, say, tell, tell_files, timed, warn, write_at_once
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.runs.stream_lines import Address
    from modsim3d.scene.scene import Scene

WAIT_S = 60.0
MAX_WAIT_S = 100_000


def stream_command(
    context: typer.Context,
    scene: shared.SceneArgument,
    to: Annotated[str, option("-|tcp://HOST:PORT", "Where the lines go; - is standard output.", "--to")] = "-",
    realtime: Annotated[
        bool, flag("--realtime", "Let each line leave at its time, not as soon as it is ready.")
    ] = False,
    timeout: Annotated[
        float | None, option("SECONDS", "Time to wait while no reader is connected over TCP.", show_default="60")
    ] = None,
    seed: shared.SeedOption = None,
    detector: shared.DetectorOption = None,
    detector_seed: shared.DetectorSeedOption = None,
    steps: shared.StepsOption = None,
    settings: shared.SetOption = None,
    state: shared.StateOption = None,
    state_from: shared.FromOption = None,
) -> None:
    """Simulate a scene, and give a tracker each camera's detections as one line of JSON for each step.

    Example: modsim3d stream strait --to tcp://127.0.0.1:5000 --realtime
    """
    from modsim3d.runs.stream_lines import header_line
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings

    address = _address(to, timeout)
    with timed("reading the scene"):
        loaded = load_scene(**shared.arguments(context, load_scene, settings=read_settings(settings or ())))
    tell_files(loaded.copy.read)
    with shared.interruptible(), shared.stoppable(), timed("stream"):
        if address is not None:
            _to_readers(loaded, realtime, address, WAIT_S if timeout is None else timeout)
        elif write_at_once(header_line(loaded)):
            _send_steps(loaded, realtime, write_at_once)


def _address(to: str, timeout: float | None) -> Address | None:
    """Address at which readers connect; None for standard output."""
    from modsim3d.runs.stream_lines import STANDARD_OUTPUT, Address

    if timeout is not None and not 0 < timeout <= MAX_WAIT_S:
        raise ModsimError(f"--timeout {timeout:g}: give a number of seconds above 0, at most {MAX_WAIT_S}")
    if to != STANDARD_OUTPUT:
        return Address.parse(to)
    if timeout is not None:
        raise ModsimError("--timeout is for readers that connect to --to tcp://ADDRESS:PORT: leave it out")
    return None


def _to_readers(scene: Scene, realtime: bool, address: Address, wait_s: float) -> None:
    """Serve the lines to readers; the first is waited for before the first step."""
    from modsim3d.runs.stream_lines import header_line
    from modsim3d.runs.stream_server import LineServer, NoReader

    with LineServer(address, wait_s, header_line(scene), warn=warn, tell=lambda text: tell("reader", text)) as server:
        say(f"listening on {server.address}")
        if not address.loopback:
            warn(f"whoever reaches this computer at {server.address} can read this stream")

        def send(lines: bytes) -> bool:
            server.send(lines)
            return True

        server.wait_for_reader()
        try:
            try:
                _send_steps(scene, realtime, send)
            except ModsimError:
                with suppress(NoReader):
                    server.finish(come_back=False)  # readers who are there have the lines from before the error
                raise
            server.finish()
        except NoReader:
            warn("the stream ends: its readers went away before they had all lines, and none has come back")


def _send_steps(scene: Scene, realtime: bool, send: Callable[[bytes], bool]) -> None:
    """Simulate a scene and send the lines of each step, until there are no more or `send` returns False."""
    from modsim3d.runs.stream_lines import Pace, short_collections, step_lines

    pace = Pace() if realtime else None
    with ExitStack() as started:
        for step in step_lines(scene, one_by_one=realtime):
            if pace is not None:
                pace.wait(step.step, step.time_s)
            if not send(b"".join(step.lines)):
                break
            if step.step == 0:  # all libraries are loaded
                started.enter_context(short_collections())
    if pace is not None:
        remark(f"latest: step {pace.latest} left {pace.late_s:.3f} s after its time")
