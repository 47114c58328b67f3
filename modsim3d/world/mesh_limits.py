"""Limits of mesh files: their size, and what they may refer to."""

import re
import struct
from typing import BinaryIO
from urllib.parse import unquote

MAX_FACES = 50_000
MAX_VERTICES = 3 * MAX_FACES  # as many as faces without common vertices have
MAX_BYTES = 2**25  # text takes at most about 500 bytes a face
MAX_GLB_BYTES = 2**26  # a GLB file may contain textures, which are not read
MAX_SCANNED_BYTES = 2**30  # faces of a text file have to be counted; a larger file is refused without
MAX_COORDINATE = 1e9  # far beyond any vessel in any unit; products of three do not overflow


class Refusal(Exception):
    """Reason why a file is refused, as text after its name, such as `is empty`."""


def check_faces(count: int) -> None:
    """Raise `Refusal` for too many faces, or none."""
    if count > MAX_FACES:
        raise Refusal(f"has {count} faces; a mesh may have at most {MAX_FACES}: simplify it")
    if count == 0:
        raise Refusal("holds no faces, only points or nothing: a mesh of triangles is needed")


def check_vertices(count: int) -> None:
    """Raise `Refusal` for more vertices than the allowed faces can need."""
    if count > MAX_VERTICES:
        raise Refusal(f"has {count} vertices; a mesh may have at most {MAX_VERTICES}: simplify it")


def check_size(size: int, most: int = MAX_BYTES) -> None:
    """Raise `Refusal` for more bytes than memory should be spent on."""
    if size > most:
        raise Refusal(f"has {size / 1e6:.0f} MB; such a file may have at most {most / 1e6:.0f} MB: simplify it")


def leads_outside(reference: str) -> bool:
    """Whether a reference is remote, absolute, or leads through a parent folder."""
    plain = unquote(reference).strip()
    remote_or_drive = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", plain)
    return bool(remote_or_drive) or plain.startswith(("/", "\\", "~")) or ".." in re.split(r"[/\\]", plain)


def check_reference(reference: str, what: str) -> None:
    """Raise `Refusal` for a reference that leads out of the file's folder; none is followed, so others do no harm."""
    if leads_outside(reference):
        shortened = reference if len(reference) <= 80 else reference[:77] + "..."
        raise Refusal(f"refers to {shortened!r} ({what}), which is remote or outside its folder: remove the reference")


CHUNK_BYTES = 2**20
MAX_PARTS = 1000
MAX_DIGITS = 18  # of a number in a header; Python reads no number of thousands of digits
MAX_LINE_BYTES = 2**16  # greatest length of a header, and of a line with many corners


def _scan(file: BinaryIO, size: int, word: bytes) -> int:
    """Number of faces of a text file, by counting the lower-case word that each has once."""
    if size > MAX_SCANNED_BYTES:
        check_size(size)
    file.seek(0)
    count, tail = 0, b""
    while chunk := file.read(CHUNK_BYTES):
        joined = tail + chunk.lower()
        count += joined.count(word)
        tail = joined[-(len(word) - 1) :]  # shorter than the word
    return count


def _whole(file: BinaryIO, size: int) -> bytes:
    check_size(size)
    file.seek(0)
    return file.read(size)


def _as_utf8(text: bytes) -> bytes:
    """Text whose names and comments are valid UTF-8; parsers would guess the encoding."""
    return text.decode("utf-8", "replace").encode()


def read_stl(file: BinaryIO, size: int) -> bytes:
    """The content of an STL file, binary or text. Raises `Refusal` if it is none, or too large."""
    header = file.read(84)
    claimed = struct.unpack("<I", header[80:])[0] if len(header) == 84 else None
    spare = 50 if claimed else 1  # some programs add a few bytes
    if claimed is not None and 0 <= size - (84 + 50 * claimed) < spare:
        check_faces(claimed)
        return _whole(file, 84 + 50 * claimed)
    if not header.lstrip().lower().startswith(b"solid"):
        claim = "" if claimed is None else f", whose header would mean {claimed} faces in {84 + 50 * claimed} bytes"
        raise Refusal(f"is not an STL file: neither text that begins with 'solid' nor {size} bytes of binary{claim}")
    check_faces(_scan(file, size, b"endfacet"))
    content = _whole(file, size)
    if (parts := content.lower().count(b"endsolid")) > MAX_PARTS:
        raise Refusal(f"has {parts} solids; an STL file may have at most {MAX_PARTS}: join them")
    check_vertices(content.lower().count(b"vertex"))
    return _as_utf8(content)


def read_ply(file: BinaryIO, size: int) -> bytes:
    """The content of a PLY file, text or binary. Raises `Refusal` if it is none, or too large. Text is returned without
    blank lines and without rows beyond those that the header announces."""
    header = file.read(MAX_LINE_BYTES)
    end = header.find(b"end_header")
    if not header.startswith(b"ply") or end < 0:
        raise Refusal("is not a PLY file: it must begin with 'ply' and a header that ends with 'end_header'")
    counts: dict[str, int] = {}
    for line in header[:end].decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            number = words[2] if len(words) == 3 else ""
            if not (number.isdecimal() and len(number) <= MAX_DIGITS) or words[1] in counts:
                raise Refusal(f"has the line {line[:80]!r} in its header; 'element NAME COUNT' is needed, each once")
            counts[words[1]] = int(number)
    check_faces(counts.get("face", 0))
    for count in counts.values():
        check_vertices(count)
    content = _whole(file, size)
    start = content.find(b"\n", end) + 1 or len(content)
    if b"ascii" not in header[:end]:
        return _as_utf8(content[:start]) + content[start:]
    rows = [row for row in content[start:].splitlines() if row.strip()]
    if len(rows) < sum(counts.values()):
        raise Refusal(f"has {len(rows)} rows of the {sum(counts.values())} that its header announces: is it cut off?")
    return _as_utf8(content[:start]) + b"\n".join(rows[: sum(counts.values())]) + b"\n"


def read_obj(file: BinaryIO, size: int) -> bytes:
    """The vertices and faces of a Wavefront OBJ file; its lines are counted, since it has no header. Material libraries
    are passed over, wherever they lie. Raises `Refusal` if it is too large."""
    check_faces(max(1, _scan(file, size, b"\nf ")))  # refuses far too many early; indented ones are counted below
    content = _whole(file, size)
    triangles = vertices = 0
    last = (0, 0)  # greatest vertex that a face names, and its line
    kept: list[bytes] = []
    for number, line in enumerate(content.replace(b"\\\n", b" ").splitlines(), start=1):
        if len(line) > MAX_LINE_BYTES:
            raise Refusal(f"has a line of {len(line)} characters (line {number}): triangulate its faces")
        keyword, _, rest = line.replace(b"\t", b" ").strip().partition(b" ")
        if keyword == b"f":
            corners = rest.split()
            triangles += max(1, len(corners) - 2)
            if triangles <= MAX_FACES:  # the rest is refused below
                indices = [_corner(corner, vertices, number) for corner in corners]
                last = max(last, (max(indices, default=0), number))
                kept.append(b"f " + b" ".join(b"%d" % index for index in indices))
        elif keyword == b"v":
            vertices += 1
            kept.append(b"v " + b" ".join(rest.split()[:3]))
    check_faces(triangles)
    check_vertices(vertices)
    if last[0] > vertices:
        raise Refusal(f"has the corner '{last[0]}' in line {last[1]}: there is no such vertex, of {vertices}")
    return _as_utf8(b"\n".join([*kept, b""]))


def _corner(corner: bytes, vertices: int, line: int) -> int:
    """The vertex of a corner `vertex/texture/normal`, counted from one; a negative one counts back from the last."""
    try:
        index = int(corner.partition(b"/")[0])
    except ValueError:
        raise Refusal(f"has the corner {corner[:40].decode('latin-1')!r} in line {line}; a number is needed") from None
    index = index if index > 0 else vertices + 1 + index
    if index < 1:
        raise Refusal(f"has the corner {corner[:40].decode('latin-1')!r} in line {line}: there is no such vertex")
    return index
