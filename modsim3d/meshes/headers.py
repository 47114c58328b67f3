"""What a mesh file says of its size, read before any of it is parsed: STL, PLY and OBJ.

Each function takes an open file of a known size and returns what the parser may have: all of it, within the limits.
A hostile file is refused here by counts, so that neither time nor memory grows beyond what the limits allow.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

from modsim3d.meshes.limits import (
    MAX_FACES,
    MAX_SCANNED_BYTES,
    Refused,
    check_faces,
    check_reference,
    check_size,
    check_vertices,
)

CHUNK_BYTES = 2**20
MAX_PARTS = 1000
MAX_LINE_BYTES = 2**16
"""Of a header, and of a face with many corners."""


def _count(file: BinaryIO, word: bytes) -> int:
    """How often a word stands in a file, in lower case, from where it is."""
    found, tail = 0, b""
    while chunk := file.read(CHUNK_BYTES):
        joined = tail + chunk.lower()
        found += joined.count(word)
        tail = joined[-(len(word) - 1) :]  # too short to hold the word again
    return found


def _scan(file: BinaryIO, size: int, word: bytes) -> int:
    """How many faces a text file has, by counting the word that each has once."""
    if size > MAX_SCANNED_BYTES:
        check_size(size)
    file.seek(0)
    return _count(file, word)


def _whole(file: BinaryIO, size: int) -> bytes:
    check_size(size)
    file.seek(0)
    return file.read(size)


def _as_utf8(text: bytes) -> bytes:
    """Text in which what is not UTF-8, in names and comments, is replaced: parsers would guess at it."""
    return text.decode("utf-8", "replace").encode()


def read_stl(file: BinaryIO, size: int) -> bytes:
    """A binary STL file, whose header tells its faces, or one in text.

    Raises:
        Refused: It is neither, or too large.
    """
    header = file.read(84)
    claimed = struct.unpack("<I", header[80:])[0] if len(header) == 84 else None
    if claimed is not None and size == 84 + 50 * claimed:
        check_faces(claimed)
        return _whole(file, size)
    if not header.lstrip().lower().startswith(b"solid"):
        told = "" if claimed is None else f", whose header would mean {claimed} faces in {84 + 50 * claimed} bytes"
        raise Refused(f"is not an STL file: neither text that begins with 'solid' nor {size} bytes of binary{told}")
    check_faces(_scan(file, size, b"endfacet"))
    content = _whole(file, size)
    if (parts := content.lower().count(b"endsolid")) > MAX_PARTS:
        raise Refused(f"has {parts} solids; an STL file may have at most {MAX_PARTS}: join them")
    check_vertices(content.lower().count(b"vertex"))
    return _as_utf8(content)


def read_ply(file: BinaryIO, size: int) -> bytes:
    """A PLY file, text or binary, whose header tells its vertices and faces.

    Text is returned without blank lines and without what follows the rows that the header announces.

    Raises:
        Refused: It is not PLY, or too large.
    """
    header = file.read(MAX_LINE_BYTES)
    end = header.find(b"end_header")
    if not header.startswith(b"ply") or end < 0:
        raise Refused("is not a PLY file: it must begin with 'ply' and a header that ends with 'end_header'")
    counts: dict[str, int] = {}
    for line in header[:end].decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdecimal() or words[1] in counts:
                raise Refused(f"has the line {line[:80]!r} in its header; 'element NAME COUNT' is needed, each once")
            counts[words[1]] = int(words[2])
        elif words[:2] == ["comment", "TextureFile"]:
            check_reference(" ".join(words[2:]), "texture")
    check_faces(counts.get("face", 0))
    for count in counts.values():
        check_vertices(count)
    content = _whole(file, size)
    start = content.find(b"\n", end) + 1 or len(content)
    if b"ascii" not in header[:end]:
        return _as_utf8(content[:start]) + content[start:]
    rows = [row for row in content[start:].splitlines() if row.strip()]
    if len(rows) < sum(counts.values()):
        raise Refused(f"has {len(rows)} rows of the {sum(counts.values())} that its header tells: is it cut off?")
    return _as_utf8(content[:start]) + b"\n".join(rows[: sum(counts.values())]) + b"\n"


def read_obj(file: BinaryIO, size: int) -> bytes:
    """A Wavefront OBJ file, reduced to its vertices and faces; its lines are counted, since it has no header.

    Raises:
        Refused: It is too large, or names a material library outside its folder.
    """
    check_faces(max(1, _scan(file, size, b"\nf ")))  # far too many are not read; indented ones are counted below
    content = _whole(file, size)
    triangles = vertices = 0
    last = (0, 0)  # vertex that a face names, and line
    kept: list[bytes] = []
    for number, line in enumerate(content.replace(b"\\\n", b" ").splitlines(), start=1):
        if len(line) > MAX_LINE_BYTES:
            raise Refused(f"has a line of {len(line)} characters (line {number}): triangulate its faces")
        keyword, _, rest = line.replace(b"\t", b" ").strip().partition(b" ")
        if keyword == b"f":
            corners = rest.split()
            triangles += max(1, len(corners) - 2)
            if triangles <= MAX_FACES:  # what is refused below need not be kept
                indices = [_corner(corner, vertices, number) for corner in corners]
                last = max(last, (max(indices, default=0), number))
                kept.append(b"f " + b" ".join(b"%d" % index for index in indices))
        elif keyword == b"v":
            vertices += 1
            kept.append(b"v " + b" ".join(rest.split()[:3]))
        elif keyword == b"mtllib":
            check_reference(rest.decode("utf-8", "replace").strip(), "mtllib")
    check_faces(triangles)
    check_vertices(vertices)
    if last[0] > vertices:
        raise Refused(f"has the corner '{last[0]}' in line {last[1]}: there is no such vertex, of {vertices}")
    return _as_utf8(b"\n".join([*kept, b""]))


def _corner(corner: bytes, vertices: int, line: int) -> int:
    """The vertex of a corner `vertex/texture/normal`, counted from one; a negative one counts back from the last."""
    try:
        index = int(corner.partition(b"/")[0])
    except ValueError:
        raise Refused(f"has the corner {corner[:40].decode('latin-1')!r} in line {line}; a number is needed") from None
    index = index if index > 0 else vertices + 1 + index
    if index < 1:
        raise Refused(f"has the corner {corner[:40].decode('latin-1')!r} in line {line}: there is no such vertex")
    return index
