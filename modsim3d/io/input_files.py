"""Opens an input file: an ordinary file only, gzipped or not, and no more of it than its budget."""

from __future__ import annotations

import codecs
import gzip
import hashlib
import io
import os
import stat
import unicodedata
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.core.errors import InputError
from modsim3d.io.operating_system import INPUT

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

MAX_TEXT_BYTES = 1 << 29  # of a file read as a whole: seven million poses. What is parsed takes up to ten times as much
MAX_UNPACK_RATIO = 100  # a gzipped file may unpack to so many times its size: tables reach 20, one repeated byte 1000
FREE_UNPACKED_BYTES = 1 << 23  # bytes that any gzipped file may unpack to
PIECE_BYTES = 1 << 20  # read at once. A single read would reserve memory for the whole budget
MAX_YAML_BYTES = 1 << 20  # of a scene or detector, two seconds a megabyte; a thousand vessels with tracks need half
MAX_YAML_VALUES = 200_000  # with aliases and merge keys written out, which can multiply ten lines to any size
YAML_CHARACTERS_PER_VALUE = 64  # a long text counts as a value for each so many, since an alias can repeat it too
MAX_JSON_VALUES = 2_000_000  # of vessels or a scene, each up to 100 bytes of memory; a thousand vessels are 10,000
POSE_BYTES_PER_VALUE = 8  # a pose file may have more values if they are as long as those of poses, 12 bytes each
MAX_POSES = 200_000_000  # vessels times steps, present or not, at 33 bytes: 2000 vessels for a day take 173 million
COCO_BYTES_PER_VALUE = 4  # a COCO file may have more values if they are as long as those of its masks, 123.4 and 56
MAX_BAD_ENTRIES = 10_000  # wrong entries of one file after which no more of it is read, unless they are to be left out
MAX_BAD_ROWS = 50_000  # rows without the header's cells in 16 MB of AIS, a third of them, after which no more is read
MAX_LINE_CHARACTERS = 10_000  # of a line of numbers: MOT has ten of them, YOLO six
# Frames that a MOT pair may span, and further ones for each of its lines, where no seqLength says how many there are:
# three hours at 10 Hz, and a vessel every minute and a half in a longer night.
FREE_FRAMES, FRAMES_A_ROW = 100_000, 1_000
MAX_FRAMES = 1_000_000  # of a MOT sequence: nine hours at 30 Hz. Learning takes 2.4 kB for each, with 300 replicates
MAX_PAIRS = 10_000_000  # of detections and annotations that could match: COCO's largest sets have two million
MAX_TABLE_CELLS = 15_000_000  # of all confusion matrices, at 50 bytes each: 220 classes with 300 replicates
MAX_IMAGE_BYTES = 1 << 29  # of an image whose size is to be known: some kinds are read as a whole for it

_GZIP = b"\x1f\x8b"
_DEVICES = dict.fromkeys((stat.S_IFCHR, stat.S_IFBLK), "a device")
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", **_DEVICES}
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
    """The bytes of an input file after its byte order mark, unpacked if it is gzipped; its name does not matter. `what`
    is what errors call it, `most_bytes` the budget of what comes out; None for a reader that keeps little of it. Raises
    InputError, also later while it is read and decoded, if it is no ordinary file, cannot be read or unpacked, is no
    UTF-8, or exceeds a budget."""
    source = f"{what} {path}"
    note_input(path)
    try:
        with _ordinary_file(path, source) as file:
            content: io.BufferedReader = io.BufferedReader(_BudgetedFile(file, source, most_bytes), PIECE_BYTES)
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
        descriptor = os.open(path, INPUT)
    except ValueError:  # it holds a null character or half a character
        raise InputError(source, ["is no valid file name"]) from None
    kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
    if kind != stat.S_IFREG:
        os.close(descriptor)
        raise InputError(source, [f"this is {_KINDS.get(kind, 'something else')}, a file was expected"])
    return os.fdopen(descriptor, "rb")


def _problem(error: Exception) -> str:
    if isinstance(error, gzip.BadGzipFile | EOFError | zlib.error):
        return "is not a complete gzip file"
    if isinstance(error, UnicodeDecodeError):
        return f"is not UTF-8 text (byte {error.start})"
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return f"cannot be read: {getattr(error, 'strerror', None) or error}"


class _BudgetedFile(io.RawIOBase):
    """The bytes of a file, unpacked if it is gzipped; refuses to give more than the budgets allow."""

    def __init__(self, file: io.BufferedReader, source: str, most_bytes: int | None) -> None:
        self.file, self.source, self.most_bytes = file, source, most_bytes
        self.packed = file.peek(2).startswith(_GZIP)
        self.stream = gzip.GzipFile(fileobj=file) if self.packed else file
        self.count = 0
        self.check(0 if self.packed else os.fstat(file.fileno()).st_size)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        count = self.stream.readinto(buffer) or 0  # None where a special file has nothing to say
        self.count += count
        self.check(self.count)
        return count

    def check(self, count: int) -> None:
        """Raise `InputError` if so many bytes exceed a budget."""
        if self.most_bytes is not None and count > self.most_bytes:
            verb = "unpacks to" if self.packed else "has"
            raise InputError(self.source, [f"{verb} more than {self.most_bytes:,} bytes: give a part of it"])
        if self.packed and count > FREE_UNPACKED_BYTES + MAX_UNPACK_RATIO * self.file.tell():
            raise InputError(self.source, [_BOMB.format(ratio=MAX_UNPACK_RATIO)])


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as `sha256sum` prints it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_text(path: Path, what: str, most_bytes: int | None = None) -> str:
    """The text of an input file, unpacked if it is gzipped; its name does not matter. Its lines end with line feeds, it
    has no byte order mark, and letters with accents are one character each (NFC): files of Macs have them apart, so
    that one name would be two. The budget is that of all texts where `most_bytes` is None. Raises InputError as
    `open_input`."""
    with open_input(path, what, most_bytes or MAX_TEXT_BYTES) as file:
        content = bytearray()
        while piece := file.read(PIECE_BYTES):
            content += piece
        return composed(content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n"))


def composed(text: str) -> str:
    """A text or the name of a file with letters and their accents as one character each, as `read_text` has them."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


@cache
def data_folder(kind: str) -> Path:
    """The folder of shipped `scenes` or `meshes`: in the installed package, or at the top of the repository."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "_data" / kind
    return installed if installed.is_dir() else package.parent / kind
