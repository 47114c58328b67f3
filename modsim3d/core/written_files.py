"""Files that a function has written, which a notebook shows."""

import base64
from dataclasses import dataclass
from html import escape
from pathlib import Path

_IMAGE = '<img style="max-width:100%" src="data:image/{kind};base64,{data}">'
_FILM = '<video controls loop style="max-width:100%" src="data:video/mp4;base64,{data}"></video>'
_MAX_BYTES = 50_000_000  # of what a notebook takes in


@dataclass(frozen=True, repr=False)
class OutputFiles:
    """Files that a function has written; a notebook shows the page, the picture or the film among them.

        page = modsim3d.report("runs/first")
        page.path, page.paths, page.notes

    Attributes:
        paths: The files and folders, the one to look at first.
        notes: Remarks on them, each a sentence.
    """

    paths: tuple[Path, ...]
    notes: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The first of the files, for which this stands where a function takes a path."""
        return self.paths[0]

    def __fspath__(self) -> str:
        """Path of the first of the files."""
        return str(self.path)

    def __repr__(self) -> str:
        """Paths and remarks, in a line."""
        return f"<{type(self).__name__} {'; '.join([', '.join(map(str, self.paths)), *self.notes])}>"

    def _repr_html_(self) -> str | None:
        """The page, the picture or the film, above its path and the remarks."""
        path, kind = self.path, self.path.suffix.lower().removeprefix(".").replace("svg", "svg+xml")
        shown = ""
        alone = len(self.paths) == 1 and path.is_file() and path.stat().st_size < _MAX_BYTES
        if alone and kind in ("png", "gif", "svg+xml", "mp4", "html"):
            content = path.read_bytes()
            shown = (_FILM if kind == "mp4" else _IMAGE).format(kind=kind, data=base64.b64encode(content).decode())
            if kind == "html":
                page = escape(content.decode(), quote=True)
                shown = f'<iframe style="width:100%;height:40em;border:0" srcdoc="{page}"></iframe>'
        return shown + "".join(f"<p>{escape(str(line))}</p>" for line in (*self.paths, *self.notes))
