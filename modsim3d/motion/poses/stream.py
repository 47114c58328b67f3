"""Poses as JSON Lines from standard input or from a file that is still being written: one line, one time step."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Annotated, Any, ClassVar

from pydantic import Field, model_validator

from modsim3d.errors import InputError
from modsim3d.inputs.validation import Strict, shown
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys
from modsim3d.motion.poses.live import LivePoses, Step
from modsim3d.motion.poses.replay import fill_step, read_line, time_problems

STANDARD_INPUT = "-"
TIMEOUT_S = 10.0
POLL_S = 0.02
MAX_LINE_BYTES = 1 << 26


class StreamKeys(SourceKeys, Strict):
    """Source of the lines, and how long to wait for a file to grow."""

    generated: ClassVar[bool] = False
    drawn: ClassVar[bool] = False

    file: str
    timeout_s: Annotated[float, Field(strict=True, ge=0, le=1e9)] = TIMEOUT_S

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, keys: Any) -> Any:
        if isinstance(keys, str):
            return {"file": keys}
        if not isinstance(keys, dict):
            raise ValueError(f"a file, '-' for standard input, or a mapping of keys is needed (got {shown(keys)})")
        return keys

    @property
    def files(self) -> tuple[str, ...]:
        """The file, if it is one."""
        return () if self.file == STANDARD_INPUT else (self.file,)

    def build(self, request: PoseRequest) -> LivePoses:
        """A stream that has not been read yet."""
        path = None if self.file == STANDARD_INPUT else request.folder / self.file
        source = "poses from standard input" if path is None else f"poses from {path}"
        if path is not None and (problem := _unreadable(path)):
            raise InputError(source, [problem])
        names = request.names or ()
        return LivePoses(read_steps(_lines(path, self.timeout_s, source), source, names), len(names), source)


def read_steps(lines: Iterable[bytes], source: str, names: Sequence[str]) -> Iterator[Step]:
    """Each step when its line arrives; an empty line is the end. `source` is named in errors.

    Raises:
        InputError: A line is wrong; the message names its number.
    """
    columns = {name: column for column, name in enumerate(names)}
    before: list[str] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            return
        if len(line) > MAX_LINE_BYTES:
            raise InputError(source, [f"line {number}: is longer than {MAX_LINE_BYTES} bytes"])
        try:
            text = line.decode("utf-8-sig").strip()
        except UnicodeDecodeError as error:
            raise InputError(source, [f"line {number}: is not UTF-8 text (byte {error.start})"]) from None
        timestamp, entries = read_line(text, source, number)
        poses = Poses.absent(1, len(names))
        if problems := time_problems([*before, timestamp]) + fill_step(poses, 0, timestamp, entries, columns):
            raise InputError(source, [f"line {number}: {problem}" for problem in problems])
        before = [timestamp]
        yield timestamp, poses


def _unreadable(path: Path) -> str | None:
    try:
        if path.is_dir():
            return "this is a folder, a file was expected"
        if not path.exists():
            return "no such file: it must exist before the run begins, even if it is empty"
    except (OSError, ValueError) as error:
        return f"cannot be read: {error}"
    return None if os.access(path, os.R_OK) else "cannot be read: permission denied"


def _lines(path: Path | None, timeout_s: float, source: str) -> Iterator[bytes]:
    if path is not None:
        with path.open("rb") as file:
            yield from follow(file, timeout_s if path.is_file() else None)
    elif sys.stdin is None:
        raise InputError(source, ["there is no standard input"])
    else:
        yield from follow(sys.stdin.buffer, None)


def follow(file: IO[bytes], timeout_s: float | None) -> Iterator[bytes]:
    """The lines of a file as they are written; at the end what is left without a line break, if anything is.

    At the end of a file the next line is waited for, for `timeout_s`; None is for a pipe, which really ends.
    """
    line, since = b"", time.monotonic()
    while True:
        piece = file.readline(MAX_LINE_BYTES + 1 - len(line))
        line += piece
        if line.endswith(b"\n") or len(line) > MAX_LINE_BYTES:
            yield line
            line, since = b"", time.monotonic()
        elif not piece:
            if timeout_s is None or time.monotonic() - since >= timeout_s:
                break
            time.sleep(POLL_S)
    if line:
        yield line
