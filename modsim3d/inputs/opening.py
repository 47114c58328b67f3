"""Opens an input file: an ordinary file only, gzipped or not, and no more of it than its budget."""

from __future__ import annotations

import codecs
import gzip
import io
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.errors import InputError
from modsim3d.inputs import budgets

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_GZIP = b"\x1f\x8b"
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_BOMB = (
    "unpacks to more than {ratio} times its own size, as files do that are made to fill the memory: if it is what you "
    "want to read, unpack it first"
)
_FAULTS = (OSError, EOFError, zlib.error, UnicodeDecodeError)


_noted: ContextVar[tuple[list[Path], ...]] = ContextVar("_noted", default=())


@contextmanager
def inputs_noted() -> Iterator[list[Path]]:
    """The list of the input files that are opened within the block, so that none of them is written over."""
    opened: list[Path] = []
    token = _noted.set((*_noted.get(), opened))
    try:
        yield opened
    finally:
        _noted.reset(token)


def note_input(path: Path) -> None:
    """Note that a file is opened; for those who cannot use `open_input`."""
    for opened in _noted.get():
        opened.append(path)


@contextmanager
def open_input(path: Path, what: str, most_bytes: int | None = None) -> Iterator[io.BufferedReader]:
    """The bytes of an input file after its byte order mark, unpacked if it is gzipped; its name does not matter.

    Args:
        path: The file.
        what: What it is, for errors.
        most_bytes: Budget of what comes out; None for a reader that keeps little of it.

    Raises:
        InputError: It is no ordinary file, cannot be read or unpacked, is no UTF-8, or exceeds a budget; also later,
            while it is read and decoded.
    """
    source = f"{what} {path}"
    note_input(path)
    try:
        with _ordinary_file(path, source) as file:
            content: io.BufferedReader = io.BufferedReader(_Budgeted(file, source, most_bytes), budgets.PIECE_BYTES)
            mark = content.peek(len(codecs.BOM_UTF8))
            if mark.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                raise InputError(source, ["is UTF-16 text, must be UTF-8: save it as that (iconv -f UTF-16 -t UTF-8)"])
            if mark.startswith(codecs.BOM_UTF8):
                content.read(len(codecs.BOM_UTF8))
            yield content
    except _FAULTS as error:
        raise InputError(source, [_problem(error)]) from None


def _ordinary_file(path: Path, source: str) -> io.BufferedReader:
    try:
        # Without O_NONBLOCK opening a pipe waits for somebody who writes into it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError:  # it holds a null character or half a character
        raise InputError(source, ["is no valid file name"]) from None
    kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
    if kind != stat.S_IFREG:
        os.close(descriptor)
        raise InputError(source, [f"this is {_KINDS.get(kind, 'something else')}, a file was expected"])
    return os.fdopen(descriptor, "rb")


def _problem(error: Exception) -> str:
    """What to say of an error of the operating system, of unpacking or of decoding."""
    if isinstance(error, gzip.BadGzipFile | EOFError | zlib.error):
        return "is not a complete gzip file"
    if isinstance(error, UnicodeDecodeError):
        return f"is not UTF-8 text (byte {error.start})"
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return f"cannot be read: {getattr(error, 'strerror', None) or error}"


class _Budgeted(io.RawIOBase):
    """The bytes of a file, unpacked if it is gzipped; refuses to give more than the budgets allow."""

    def __init__(self, file: io.BufferedReader, source: str, most_bytes: int | None) -> None:
        """Read nothing yet."""
        self.file, self.source, self.most_bytes = file, source, most_bytes
        self.packed = file.peek(2).startswith(_GZIP)
        self.stream = gzip.GzipFile(fileobj=file) if self.packed else file
        self.count = 0
        self.check(0 if self.packed else os.fstat(file.fileno()).st_size)

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Read the next piece into a buffer, and return its length."""
        count = self.stream.readinto(buffer) or 0  # None where a special file has nothing to say
        self.count += count
        self.check(self.count)
        return count

    def check(self, count: int) -> None:
        """Raise `InputError` if so many bytes exceed a budget."""
        if self.most_bytes is not None and count > self.most_bytes:
            verb = "unpacks to" if self.packed else "has"
            raise InputError(self.source, [f"{verb} more than {self.most_bytes:,} bytes: give a part of it"])
        if self.packed and count > budgets.FREE_UNPACKED_BYTES + budgets.MAX_UNPACK_RATIO * self.file.tell():
            raise InputError(self.source, [_BOMB.format(ratio=budgets.MAX_UNPACK_RATIO)])
