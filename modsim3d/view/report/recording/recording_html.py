"""A recording as parts of an HTML page: elements that hold data, and that no browser runs."""

from __future__ import annotations

import orjson

from modsim3d.view.report.recording.packing import as_text
from modsim3d.view.report.recording.recorder import Recording


def recording_html(recording: Recording, folder: str | None = None) -> str:
    """The elements from which `openRecording(name)` of the player has its recording.

    They are `facts-NAME`, `overview-NAME` and, unless the parts are in files in a folder beside the page, `part-NAME-0`
    and so on.
    """
    name, facts = recording.name, recording.facts | ({"folder": folder} if folder else {})
    elements = [
        f'<script type="application/json" id="facts-{name}">{json_in_html(facts)}</script>',
        data_element(f"overview-{name}", recording.overview),
        *(data_element(f"part-{name}-{i}", part) for i, part in enumerate(recording.parts) if folder is None),
    ]
    return "\n".join(elements)


def part_files(recording: Recording) -> dict[str, str]:
    """A script for each part, by the name of its file: it hands the part over, as a page on a disk can read no data."""
    return {
        f"{recording.name}-{i}.js": f'takePart("part-{recording.name}-{i}", "{as_text(part)}");\n'
        for i, part in enumerate(recording.parts)
    }


def data_element(element: str, data: bytes) -> str:
    """An element that holds packed columns."""
    return f'<script type="application/octet-stream" id="{element}">{as_text(data)}</script>'


def json_in_html(value: object) -> str:
    """JSON that no HTML parser finds a tag in."""
    text = orjson.dumps(value).decode("utf-8")
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
