"""One writer at a time: a lock on an output, which the system releases when the process ends, however it ends."""

from __future__ import annotations

import fcntl
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from modsim3d.core.errors import OutputError
from modsim3d.io.atomic_write import make_folder

LOCK_FILE = ".modsim3d.lock"
"""The lock of a folder, inside it."""
HOLDER_BYTES = 500


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder that is written to; one that is made for it and stays empty is removed again.

    Raises:
        OutputError: Another process, which the message names, writes to the folder.
        OSError: The folder or the lock in it cannot be made.
    """
    with _made_for_it(folder), _locked(folder / LOCK_FILE, folder):
        yield


def holder_of(folder: Path) -> str | None:
    """The process that writes to a folder; None if there is none.

    Raises:
        OSError: The lock in it cannot be read.
    """
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(descriptor)
    finally:
        os.close(descriptor)
    return None


@contextmanager
def locked_file(path: Path) -> Iterator[None]:
    """Hold the lock of a file that is written; it lies beside the file, whose folder is made as by `locked_folder`.

    Raises:
        OutputError: Another process, which the message names, writes the file.
        OSError: The folder or the lock in it cannot be made.
    """
    lock = lock_of(path)
    with _made_for_it(lock.parent), _locked(lock, path):
        yield


def lock_of(path: Path) -> Path:
    """The lock of a file: hidden, beside it, or beside the file that a link leads to."""
    real = Path(os.path.realpath(path))  # unlike `resolve`, also of a link to itself
    return real.with_name(f".{real.name}.lock")


@contextmanager
def _made_for_it(folder: Path) -> Iterator[None]:
    """A folder that is made if it is not there, and removed again if nothing came into it."""
    made = make_folder(folder)
    try:
        yield
    finally:
        with suppress(OSError):  # not empty
            for path in made:
                path.rmdir()


@contextmanager
def _locked(lock: Path, output: Path) -> Iterator[None]:
    descriptor = _acquired(lock, output)
    _held.add(descriptor)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)  # before it is released, so that nobody else's lock is removed
        _held.discard(descriptor)
        os.close(descriptor)


def _acquired(lock: Path, output: Path) -> int:
    """The descriptor of the lock file, which is locked and says who holds it."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(lock, descriptor):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, _this_process().encode(errors="replace"))
                return descriptor
        except BlockingIOError:
            holder = _holder(descriptor)
            os.close(descriptor)
            hint = "wait for it to end, or choose another output"
            raise OutputError(f"{output} is being written by {holder}: {hint}") from None
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the holder before removed the file after it was opened here


def _is_at(path: Path, descriptor: int) -> bool:
    """Whether an open file is still the one at a path."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _holder(descriptor: int) -> str:
    text = os.pread(descriptor, HOLDER_BYTES, 0).decode(errors="replace").strip()
    return text if text and text.isprintable() else "another process"


def _this_process() -> str:
    program = Path(sys.argv[0]).name
    command = (
        f"modsim3d {' '.join(sys.argv[1:2])}"
        if program in ("modsim3d", "__main__.py", "main.py")
        else program or "Python"
    )
    return f"{command}, process {os.getpid()} on {platform.node()}"


_held: set[int] = set()
"""Descriptors of the locks that this process holds."""


def _leave_to_the_parent() -> None:
    """Close the locks in a forked process, which would hold them beyond its parent's end."""
    for descriptor in _held:
        os.close(descriptor)
    _held.clear()


os.register_at_fork(after_in_child=_leave_to_the_parent)
