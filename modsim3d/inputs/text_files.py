"""The text of an input file, gzipped or not, within a budget."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import BinaryIO

from modsim3d.errors import InputError

_GZIP = b"\x1f\x8b"
MAX_TEXT_BYTES = 1 << 30
"""Parsed text takes about ten times its size, and a few megabytes can unpack to any size."""
_PIECE_BYTES = 1 << 20


def read_text(path: Path, what: str) -> str:
    """The text of an input file, unpacked if it is gzipped; its name does not matter.

    Raises:
        InputError: There is no such file, it is a folder, it cannot be read or unpacked, it is not UTF-8, or it is too
            large.
    """
    try:
        with path.open("rb") as file:
            packed = file.peek(2).startswith(_GZIP)
            content = _at_most(MAX_TEXT_BYTES + 1, gzip.GzipFile(fileobj=file) if packed else file)
        if len(content) > MAX_TEXT_BYTES:
            unpacked = "unpacks to" if packed else "has"
            raise InputError(f"{what} {path}", [f"{unpacked} more than {MAX_TEXT_BYTES:,} bytes: give a part of it"])
        return content.decode("utf-8")
    except (gzip.BadGzipFile, EOFError, zlib.error):
        problem = "is not a complete gzip file"
    except FileNotFoundError:
        problem = "no such file"
    except IsADirectoryError:
        problem = "this is a folder, a file was expected"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte {error.start})"
    except ValueError:
        problem = "is no valid file name"  # it holds a null character
    raise InputError(f"{what} {path}", [problem])


def _at_most(count: int, stream: BinaryIO | gzip.GzipFile) -> bytearray:
    """At most `count` bytes, read in pieces: a single read would reserve memory for all of them."""
    content = bytearray()
    while len(content) < count and (piece := stream.read(min(_PIECE_BYTES, count - len(content)))):
        content += piece
    return content
