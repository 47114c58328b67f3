"""Where parts of a run are put into a recording, and at which time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from modsim3d.arrays import Indices
from modsim3d.scene.scene import Scene

STEP, TIME = "step", "time"
"""The time lines."""
THIN_PT, THICK_PT = 0.6, 2.5
"""Half the widths on the screen of lines below others, and of lines that must be seen first."""


@dataclass(frozen=True, eq=False)
class Log:
    """A recording that is being written, with the module `rerun` as its SDK."""

    sdk: Any
    stream: Any
    scene: Scene

    def put(self, path: Sequence[str], *what: Any, static: bool = False) -> None:
        """Log something at the step that was set last, or for all time."""
        self.stream.log(list(path), *what, static=static)

    def columns(self, path: Sequence[str], steps: Indices, columns: Any) -> None:
        """Log columns of values at some steps, shape (n,)."""
        seconds = self.scene.times_s(0, int(steps[-1]) + 1)[steps]
        times = [self.sdk.TimeColumn(STEP, sequence=steps), self.sdk.TimeColumn(TIME, duration=seconds)]
        self.stream.send_columns(self.sdk.new_entity_path(list(path)), indexes=times, columns=columns)

    def at(self, step: int) -> None:
        """Set the step of what is logged next."""
        self.stream.set_time(STEP, sequence=step)
        self.stream.set_time(TIME, duration=float(self.scene.times_s(step, step + 1)[0]))

    def thin(self) -> Any:
        """Half the width of a thin line, for the SDK."""
        return self.sdk.Radius.ui_points(THIN_PT)

    def thick(self) -> Any:
        """Half the width of a thick line, for the SDK."""
        return self.sdk.Radius.ui_points(THICK_PT)


def image_path(camera: str) -> list[str]:
    """The entity of a camera's image."""
    return ["world", "cameras", camera, "image"]
