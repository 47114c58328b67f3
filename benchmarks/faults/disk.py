"""A model of a disk that loses power: what a trace of system calls leaves on it, after the last of them or before.

A file holds what was in it when it was last fsynced, and perhaps more. A folder lists what it listed when it was last
fsynced; what was done to it since (files made, renamed and removed) may be there or not. A rename is there wholly or
not at all, once either of its folders is fsynced for good.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from benchmarks.faults.tracing import Call

FD = re.compile(r"^(?:AT_FDCWD|-?\d+)(?:<(.*?)>)?$", re.DOTALL)
QUOTED = re.compile(r'^"((?:\\x[0-9a-f]{2})*)"(?:\.\.\.)?$')


@dataclass(eq=False)
class File:
    """A file: what is in it, and what of that is on the disk."""

    content: bytearray = field(default_factory=bytearray)
    durable: bytes = b""


@dataclass(eq=False)
class Folder:
    """A folder: what it lists, and what it lists on the disk."""

    entries: dict[str, File | Folder] = field(default_factory=dict)
    durable: dict[str, File | Folder] = field(default_factory=dict)


Node = File | Folder
Change = tuple[Folder, str, Node | None]
"""A folder, a name in it, and what the name now means; None if it is removed."""


class Lost(Enum):
    """What becomes of changes that were not fsynced."""

    UNDONE = "all undone"
    KEPT = "all kept"
    LATEST = "the latest undone"
    SOME = "some undone"


class Disk:
    """The files of a folder, while a trace is replayed."""

    def __init__(self, root: Path) -> None:
        """Take what the folder `root` holds as it is now; all of it is on the disk."""
        self.root = root
        self.top = _load(root) if root.is_dir() else Folder()
        self.pending: list[tuple[Change, ...]] = []
        self._made = root.is_dir()
        self._open: dict[tuple[int, int], tuple[Node, int, bool]] = {}

    def crash(self, chance: random.Random, lost: Lost, target: Path) -> None:
        """Write what is left into an empty folder `target`, if the folder itself is left."""
        changes = list(self.pending)
        if lost is Lost.UNDONE:
            changes = []
        elif lost is Lost.LATEST:
            changes = changes[: chance.randint(0, len(changes))]
        elif lost is Lost.SOME:
            changes = [change for change in changes if chance.random() < 0.5]
        entries: dict[Folder, dict[str, Node]] = {}
        for change in changes:
            _apply(change, lambda folder: entries.setdefault(folder, dict(folder.durable)))
        if self._made:
            _write(self.top, target, entries, chance)

    def replay(self, call: Call) -> None:
        """Do what a call did."""
        handler = HANDLERS.get(call.name)
        if handler is not None and call.result >= 0:
            handler(self, call, split(call.arguments))

    # What the calls do.

    def openat(self, call: Call, arguments: list[str]) -> None:
        path = self._path(arguments[0], text(arguments[1]))
        if path is None:
            return
        flags = arguments[2]
        node = self._find(path)
        if node is None:
            node = File()
            self._change((*self._parent(path), node))
        if isinstance(node, File) and "O_TRUNC" in flags:
            node.content.clear()
        self._open[call.pid, call.result] = (node, 0, "O_APPEND" in flags)

    def write(self, call: Call, arguments: list[str]) -> None:
        self._put(call, arguments[0], data(arguments[1])[: call.result])

    def writev(self, call: Call, arguments: list[str]) -> None:
        parts = re.findall(r'iov_base="((?:\\x[0-9a-f]{2})*)"', call.arguments)
        self._put(call, arguments[0], b"".join(map(unescape, parts))[: call.result])

    def pwrite64(self, call: Call, arguments: list[str]) -> None:
        self._put(call, arguments[0], data(arguments[1])[: call.result], int(arguments[3]))

    def sendfile(self, call: Call, arguments: list[str]) -> None:
        source = FD.match(arguments[1])
        begin = int(arguments[2].strip("[]").split("]")[0]) if arguments[2] != "NULL" else 0
        if source and source[1]:
            content = Path(plain(source[1])).read_bytes()
            self._put(call, arguments[0], content[begin : begin + call.result])

    def lseek(self, call: Call, arguments: list[str]) -> None:
        if (key := self._key(call, arguments[0])) is not None:
            node, _, append = self._open[key]
            self._open[key] = node, call.result, append

    def close(self, call: Call, arguments: list[str]) -> None:
        if (key := self._key(call, arguments[0])) is not None:
            del self._open[key]

    def ftruncate(self, call: Call, arguments: list[str]) -> None:
        node = self._node(call, arguments[0])
        if isinstance(node, File):
            size = int(arguments[1])
            node.content[:] = node.content[:size].ljust(size, b"\0")

    def fsync(self, call: Call, arguments: list[str]) -> None:
        node = self._node(call, arguments[0])
        if isinstance(node, File):
            node.durable = bytes(node.content)
        elif isinstance(node, Folder):
            for change in [change for change in self.pending if any(folder is node for folder, _, _ in change)]:
                _apply(change, lambda folder: folder.durable)
                self.pending.remove(change)

    def rename(self, call: Call, arguments: list[str]) -> None:
        pairs = arguments if len(arguments) == 2 else [arguments[1], arguments[3]]
        bases = ["AT_FDCWD", "AT_FDCWD"] if len(arguments) == 2 else [arguments[0], arguments[2]]
        old, new = (self._path(base, text(name)) for base, name in zip(bases, pairs, strict=True))
        if old is None or new is None:
            raise RuntimeError(f"a rename across the edge of {self.root}: {call.arguments}")
        moved = self._find(old)
        self._change((*self._parent(old), None), (*self._parent(new), moved))

    def mkdir(self, call: Call, arguments: list[str]) -> None:
        path = self._path("AT_FDCWD", text(arguments[0]))
        if path is not None and path.parts:
            self._change((*self._parent(path), Folder()))
        self._made |= path is not None

    def unlink(self, call: Call, arguments: list[str]) -> None:
        path = self._path("AT_FDCWD", text(arguments[0]))
        if path is not None and path.parts:
            self._change((*self._parent(path), None))

    def unlinkat(self, call: Call, arguments: list[str]) -> None:
        path = self._path(arguments[0], text(arguments[1]))
        if path is not None and path.parts:
            self._change((*self._parent(path), None))

    # Names and bytes.

    def _path(self, base: str, name: str) -> Path | None:
        """A path relative to the folder; None if it is elsewhere."""
        match = FD.match(base)
        folder = Path(plain(match[1])) if match and match[1] else Path("/")
        path = folder / name
        return path.relative_to(self.root) if path.is_relative_to(self.root) else None

    def _find(self, path: Path) -> Node | None:
        node: Node | None = self.top
        for part in path.parts:
            node = node.entries.get(part) if isinstance(node, Folder) else None
        return node

    def _parent(self, path: Path) -> tuple[Folder, str]:
        parent = self._find(path.parent)
        if not isinstance(parent, Folder):
            raise RuntimeError(f"{path.parent} is no folder in the model of {self.root}")
        return parent, path.name

    def _change(self, *change: Change) -> None:
        _apply(change, lambda folder: folder.entries)
        self.pending.append(change)

    def _key(self, call: Call, argument: str) -> tuple[int, int] | None:
        """The process and the descriptor with which a file was opened; it may have been another thread."""
        fd = number(argument)
        match = FD.match(argument)
        path = self._path(argument, "") if match and match[1] else None
        if path is None:
            return None
        if (call.pid, fd) in self._open:
            return call.pid, fd
        return next((key for key in self._open if key[1] == fd), None)

    def _node(self, call: Call, argument: str) -> Node | None:
        key = self._key(call, argument)
        return None if key is None else self._open[key][0]

    def _put(self, call: Call, argument: str, content: bytes, at: int | None = None) -> None:
        key = self._key(call, argument)
        if key is None:
            return
        node, offset, append = self._open[key]
        if not isinstance(node, File):
            return
        begin = at if at is not None else (len(node.content) if append else offset)
        if len(content) != call.result:
            raise RuntimeError(f"the trace does not hold what was written: {call.arguments[:80]}")
        node.content.extend(bytes(max(begin - len(node.content), 0)))
        node.content[begin : begin + len(content)] = content
        if at is None:
            self._open[key] = node, begin + len(content), append


HANDLERS: dict[str, Callable[[Disk, Call, list[str]], None]] = {
    "openat": Disk.openat,
    "write": Disk.write,
    "writev": Disk.writev,
    "pwrite64": Disk.pwrite64,
    "sendfile": Disk.sendfile,
    "lseek": Disk.lseek,
    "close": Disk.close,
    "ftruncate": Disk.ftruncate,
    "fsync": Disk.fsync,
    "fdatasync": Disk.fsync,
    "rename": Disk.rename,
    "renameat": Disk.rename,
    "renameat2": Disk.rename,
    "mkdir": Disk.mkdir,
    "unlink": Disk.unlink,
    "rmdir": Disk.unlink,
    "unlinkat": Disk.unlinkat,
}


def _load(path: Path) -> Node:
    if path.is_dir():
        entries = {entry.name: _load(entry) for entry in path.iterdir()}
        return Folder(entries, dict(entries))
    content = path.read_bytes()
    return File(bytearray(content), content)


def _apply(change: Sequence[Change], entries_of: Callable[[Folder], dict[str, Node]]) -> None:
    for folder, name, node in change:
        if node is None:
            entries_of(folder).pop(name, None)
        else:
            entries_of(folder)[name] = node


def _write(folder: Folder, target: Path, changed: dict[Folder, dict[str, Node]], chance: random.Random) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for name, node in changed.get(folder, folder.durable).items():
        if isinstance(node, Folder):
            _write(node, target / name, changed, chance)
        else:
            (target / name).write_bytes(_left(node, chance))


def _left(file: File, chance: random.Random) -> bytes:
    """What is left of a file: only what was fsynced, or the rest too, or zeros or nothing in its place."""
    content, durable = bytes(file.content), file.durable
    if content == durable:
        return durable
    choice = chance.randrange(4)
    if choice == 0:
        return durable
    if choice == 1:
        return content
    same = next((i for i, (a, b) in enumerate(zip(content, durable, strict=False)) if a != b), len(durable))
    same = min(same, len(content))
    if choice == 2:
        return content[:same] + bytes(len(content) - same)
    return content[: chance.randint(same, len(content))]


def split(arguments: str) -> list[str]:
    """The arguments of a call; commas in quotes and in brackets of any kind divide nothing."""
    parts, depth, quoted = [""], 0, False
    for character in arguments:
        quoted ^= character == '"'
        if not quoted:
            depth += (character in "[{<") - (character in "]}>")
        if character == "," and not depth and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def number(argument: str) -> int:
    """The number of a file descriptor."""
    return int(argument.partition("<")[0])


def unescape(content: str) -> bytes:
    """The bytes of a text of which every character is written as its hexadecimal number."""
    return bytes.fromhex(content.replace("\\x", ""))


def data(argument: str) -> bytes:
    """The bytes of a quoted argument."""
    match = QUOTED.match(argument)
    if match is None:
        raise RuntimeError(f"not the bytes of a call: {argument[:80]}")
    return unescape(match[1])


def text(argument: str) -> str:
    """A quoted path."""
    return data(argument).decode()


def plain(path: str) -> str:
    """The path of a file descriptor, whose characters strace may have escaped."""
    return unescape(path).decode() if path.startswith("\\x") else path
