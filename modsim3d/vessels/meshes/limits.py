"""Limits of mesh files: their size, and what they may refer to."""

from __future__ import annotations

import re
from urllib.parse import unquote

MAX_FACES = 50_000
MAX_VERTICES = 3 * MAX_FACES
"""As many as faces without common vertices have."""
MAX_BYTES = 2**25
"""Text takes at most about 500 bytes a face."""
MAX_GLB_BYTES = 2**26
"""A GLB file may contain textures, which are not read."""
MAX_SCANNED_BYTES = 2**30
"""Faces of a text file have to be counted; a larger file is refused without."""
MAX_COORDINATE = 1e9
"""Far beyond any vessel in any unit; products of three do not overflow."""


class Refused(Exception):
    """Reason why a file is refused, as text after its name, such as `is empty`."""


def check_faces(count: int) -> None:
    """Raise `Refused` for too many faces, or none."""
    if count > MAX_FACES:
        raise Refused(f"has {count} faces; a mesh may have at most {MAX_FACES}: simplify it")
    if count == 0:
        raise Refused("holds no faces, only points or nothing: a mesh of triangles is needed")


def check_vertices(count: int) -> None:
    """Raise `Refused` for more vertices than the allowed faces can need."""
    if count > MAX_VERTICES:
        raise Refused(f"has {count} vertices; a mesh may have at most {MAX_VERTICES}: simplify it")


def check_size(size: int, most: int = MAX_BYTES) -> None:
    """Raise `Refused` for more bytes than memory should be spent on."""
    if size > most:
        raise Refused(f"has {size / 1e6:.0f} MB; such a file may have at most {most / 1e6:.0f} MB: simplify it")


def leads_outside(reference: str) -> bool:
    """Whether a reference is remote, absolute, or leads through a parent folder."""
    plain = unquote(reference).strip()
    remote_or_drive = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", plain)
    return bool(remote_or_drive) or plain.startswith(("/", "\\", "~")) or ".." in re.split(r"[/\\]", plain)


def check_reference(reference: str, what: str) -> None:
    """Raise `Refused` for a reference that leads out of the file's folder; none is followed, so others do no harm."""
    if leads_outside(reference):
        shortened = reference if len(reference) <= 80 else reference[:77] + "..."
        raise Refused(f"refers to {shortened!r} ({what}), which is remote or outside its folder: remove the reference")
