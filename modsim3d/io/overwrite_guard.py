"""Guards of the files that a command may write: none that another process writes, none that it reads, and none unasked.
A lock on an output, which the system releases when the process ends, lets one writer at a time."""

import os
import platform
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from modsim3d.core.errors import OutputError
from modsim3d.io import operating_system
from modsim3d.io.atomic_write import make_folder, partial_of

LOCK_FILE = ".modsim3d.lock"  # the lock of a folder, inside it
HOLDER_BYTES = 500


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder that is written to; one that is made for it and stays empty is removed again. Raises
    OutputError if another process writes to the folder, and OSError if the folder or the lock in it cannot be made."""
    with _new_folder(folder), _locked(folder / LOCK_FILE, folder):
        yield


def holder_of(folder: Path) -> str | None:
    """The process that writes to a folder; None if there is none. Raises OSError if the lock in it cannot be read."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        operating_system.lock(descriptor, shared=True)
    except BlockingIOError:
        return _holder(descriptor)
    finally:
        os.close(descriptor)
    return None


@contextmanager
def locked_file(path: Path) -> Iterator[None]:
    """Hold the lock of a file that is written; it lies beside the file, whose folder is made as by `locked_folder`.
    Raises OutputError if another process, which the message names, writes the file, and OSError as `locked_folder`."""
    lock = lock_of(path)
    with _new_folder(lock.parent), _locked(lock, path):
        yield


def lock_of(path: Path) -> Path:
    """The lock of a file: hidden, beside it, or beside the file that a link leads to."""
    real = Path(os.path.realpath(path))  # unlike `resolve`, also of a link to itself
    return real.with_name(f".{real.name}.lock")


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
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
    if not operating_system.HAS_LOCKS:
        yield
        return
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
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            operating_system.lock(descriptor)
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
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _holder(descriptor: int) -> str:
    os.lseek(descriptor, 0, os.SEEK_SET)
    text = os.read(descriptor, HOLDER_BYTES).decode(errors="replace").strip()
    return text if text and text.isprintable() else "another process"


def _this_process() -> str:
    command = Path(sys.argv[0]).name or "Python"
    if command in ("modsim3d", "__main__.py", "main.py"):
        command = f"modsim3d {' '.join(sys.argv[1:2])}"
    return f"{command}, process {os.getpid()} on {platform.node()}"


_held: set[int] = set()  # descriptors of the locks that this process holds


def _leave_to_the_parent() -> None:
    """Close the locks in a forked process, which would hold them beyond its parent's end."""
    for descriptor in _held:
        os.close(descriptor)
    _held.clear()


operating_system.after_fork(_leave_to_the_parent)


Identity = tuple[int, int]  # device and number of a file or folder, which all its names share


def identity(path: Path) -> Identity | None:
    """Identity of what a path leads to; None if nothing is there, or if that cannot be told."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def identities(paths: Iterable[Path]) -> set[Identity]:
    """Identities of what some paths lead to; those that lead nowhere are left out."""
    return {inode for path in paths if (inode := identity(path)) is not None}


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path leads into a folder or to it; neither needs to be there."""
    real = Path(os.path.realpath(path))
    if real.is_relative_to(os.path.realpath(folder)):
        return True
    inode = identity(folder)
    return inode is not None and any(identity(above) == inode for above in (real, *real.parents))


@contextmanager
def claimed(paths: Iterable[Path], *, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Check that files may be written, before the work, and hold their locks until they are; folders that are not there
    are made. `inputs` is what the command reads: files, which are never replaced, and folders, in which nothing is
    written. Raises OutputError if one of the files may not be written, or cannot be."""
    inputs = tuple(inputs)
    with _claimed((path, partial(check_free, path, overwrite, inputs)) for path in paths):
        yield


@contextmanager
def claimed_folders(patterns: Mapping[Path, str], *, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Claim folders all of whose files are written; each has the pattern of the names that it may hold. Raises
    OutputError if one of the folders may not be written, or cannot be."""
    inputs = tuple(inputs)

    def check(path: Path, pattern: str) -> None:
        check_not_read(path, inputs)
        check_free_folder(path, pattern, overwrite)

    with _claimed((path, partial(check, path, pattern)) for path, pattern in patterns.items()):
        yield


@contextmanager
def _claimed(checks: Iterable[tuple[Path, Callable[[], None]]]) -> Iterator[None]:
    """Hold the lock of each path, which is checked before and after it is locked."""
    with ExitStack() as locks:
        for path, check in checks:
            check()
            try:
                locks.enter_context(locked_file(path))
            except OSError as error:
                raise OutputError(f"{path} cannot be written to: {error.strerror or error}") from error
            check()  # another process may have ended just now
        yield


def check_free_folder(path: Path, pattern: str, overwrite: bool) -> None:
    """Check that a folder may be written; see `claimed_folders`. Raises OutputError if it is a file, holds other files
    than those of its pattern, or any that are not to be overwritten."""
    if not path.exists() and not path.is_symlink():
        return
    if not path.is_dir():
        raise OutputError(f"{path} is a file, and a folder is to be written there: choose another name")
    names = sorted(entry.name for entry in path.iterdir())
    if strange := [name for name in names if not Path(name).match(pattern)]:
        raise OutputError(f"{path} holds other files than {pattern} ({strange[0]}): choose another folder")
    if names and not overwrite:
        raise OutputError(f"{path} exists: use --overwrite, or choose another name")


def check_free(path: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that a file may be written; see `claimed`. Raises OutputError if it is a folder, a device or a link to
    itself, is an input, or exists and is not to be overwritten."""
    if Path(os.path.realpath(path)).is_symlink():
        raise OutputError(f"{path} is a link that leads to itself: choose another name")
    check_not_read(path, inputs)
    if not path.exists():
        _check_folder(path)
        return
    if path.is_dir():
        raise OutputError(f"{path} is a folder: choose another name")
    if not path.is_file():
        raise OutputError(f"{path} is not a regular file, and only such files are written: choose another name")
    if not overwrite:
        raise OutputError(f"{path} exists: use --overwrite, or choose another name")


def _check_folder(path: Path) -> None:
    ancestor = next((parent for parent in path.parents if parent.exists()), None)
    if ancestor is not None and not ancestor.is_dir():
        raise OutputError(f"{ancestor} is a file, and {path.name} is to be written into a folder: choose another name")


def check_not_read(path: Path, inputs: Iterable[Path]) -> None:
    """Refuse, with OutputError, to write a file or folder that is read, by whatever name."""
    written = {identity(place): place for place in (path, partial_of(path), lock_of(path))}
    for read in inputs:
        if (inode := identity(read)) is not None and inode in written:
            what = path if written[inode] == path else f"{written[inode]}, which is used while {path} is written,"
            raise OutputError(f"{what} is read by this command, so it is not written over: choose another name")
        if not read.is_file() and is_inside(path, read):
            raise OutputError(f"{path} is inside {read}, which this command reads: choose another folder")
