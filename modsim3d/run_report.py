"""The page of a run: joins what a run directory holds with the page that shows it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.errors import RunDirectoryError
from modsim3d.report_rows import NOBODY, RunRows, indices, numbers
from modsim3d.scene import Scene
from modsim3d.stored_run import StoredRun
from modsim3d.view import palette
from modsim3d.view.report.page import Page, report_page
from modsim3d.view.report.recording import NONE, Column, Recording, in_250ths, in_quanta, quantum_px, starts
from modsim3d.view.report.silhouettes import shapes

REPORT_FILE = "report.html"
RELATED = {"verify.html": "verification", "compare.html": "comparison of sources"}
"""Pages that other commands write into a run directory, and what they are."""
NO_STATE, ALL_SEA = 255, (0.0, 0.0, 1.0)
"""What stands for the state and the horizon of a camera that has not taken a frame yet."""
SIGHT_STEPS = 250
"""Steps whose geometry is made together: few calls, little memory."""


def write_report(
    run: StoredRun, out: Path | None = None, every: int = 1, progress: Callable[[int], None] = lambda steps: None
) -> Path:
    """Write the page of a run.

    Args:
        run: A finished or an interrupted one.
        out: The file; `report.html` in the run directory if None.
        every: Show every K-th step; the tables count all of them.
        progress: Called with the number of shown steps done since its last call.

    Returns:
        The file.

    Raises:
        RunDirectoryError: An interrupted run has kept nothing yet, or the file cannot be written.
    """
    if not run.steps:
        raise RunDirectoryError(
            f"{run.folder} was interrupted before its first steps were finished: there is nothing to show; "
            "go on with modsim3d run --resume"
        )
    out = run.folder / REPORT_FILE if out is None else out
    rows, scene = RunRows.of(run), run.scene
    count_tables = rows.count_tables()
    page = Page(
        name=scene.name,
        recording=_recording(rows, every, progress),
        settings=run.settings,
        overall=count_tables.overall(),
        by_vessel=count_tables.by_vessel(scene.vessel_names),
        by_state=count_tables.by_state([state.name for state in scene.detector.states]),
        steps=run.steps,
        planned_steps=scene.steps,
        finished=run.finished,
        every=every,
        related=_related(run.folder, out),
    )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(report_page(page), encoding="utf-8")
    except OSError as error:
        raise RunDirectoryError(f"{out} cannot be written: {error.strerror or error}") from error
    return out


def _related(folder: Path, out: Path) -> list[tuple[str, str]]:
    """Links, as seen from the page, to what other commands have written into the run directory, and what they are."""
    base = Path(os.path.relpath(folder.resolve(), out.parent.resolve()))
    return [((base / name).as_posix(), text) for name, text in RELATED.items() if (folder / name).is_file()]


@dataclass(frozen=True, eq=False)
class _Sights:
    """What the tables do not hold.

    Attributes:
        horizons: Sea half plane of each frame, shape (F, 3).
        frame: Index of the frame of each shape, ascending, shape (s,).
        owner: Of each shape, as an index into the scene's occluder names, shape (s,).
        outline: Of each shape, as an index into the outlines; what stands still before a camera ashore needs one.
        lines: Of each outline, shape (o,).
        corner_count: Of each line, shape (l,).
        corners: Of the lines, one after the other, in quanta, shape (k, 2).
    """

    horizons: Array
    frame: Indices
    owner: Indices
    outline: Indices
    lines: Indices
    corner_count: NDArray[np.uint32]
    corners: NDArray[np.uint16]


def _sights(rows: RunRows, taken: Indices, frames: Indices, quantum: float, progress: Callable[[int], None]) -> _Sights:
    """Horizons and silhouettes.

    Args:
        rows: Of the run.
        taken: When the frame was taken that each camera shows at each shown step, shape (steps, cameras).
        frames: Numbers of those frames, ascending, shape (F,).
        quantum: Of lengths in the image.
        progress: Called with the number of steps done.
    """
    scene, cameras, owners = rows.scene, len(rows.scene.cameras), len(rows.scene.occluder_names)
    horizons = np.empty((len(frames), 3))
    hides = _hides(rows, owners)
    done = [NOBODY] * cameras
    outlines: dict[tuple[bytes, bytes], int] = {}
    drawn: list[tuple[int, int, int]] = []
    for first in range(0, len(taken), SIGHT_STEPS):
        some = taken[first : first + SIGHT_STEPS]
        for index, camera in enumerate(scene.cameras):
            looked_at = np.unique(some[:, index])
            looked_at = looked_at[looked_at > done[index]]
            if not len(looked_at):
                continue
            done[index] = int(looked_at[-1])
            sight = scene.sight(camera, looked_at)
            here = np.searchsorted(frames, looked_at * cameras + index)
            horizons[here] = camera.intrinsics.sea_half_plane(sight.camera_poses.camera_R_world)
            before = sight.outlines(camera.intrinsics, scene.vessels)
            numbered = replace(before, frame=(looked_at * cameras + index)[before.frame])
            for shape in shapes(numbered, camera.intrinsics, quantum, owners, hides):
                key = shape.count.tobytes(), shape.corners.tobytes()
                drawn.append((shape.frame, shape.owner, outlines.setdefault(key, len(outlines))))
        progress(len(some))
    table = np.array(drawn, dtype=np.int64).reshape(-1, 3)
    number, owner, outline = table[np.argsort(table[:, 0], kind="stable")].T
    lines = np.array([len(count) // 4 for count, _ in outlines], dtype=np.int64)
    counts, corners = (b"".join(part) for part in zip(*outlines, strict=True)) if outlines else (b"", b"")
    return _Sights(
        horizons,
        np.searchsorted(frames, number),
        owner,
        outline,
        lines,
        np.frombuffer(counts, np.uint32),
        np.frombuffer(corners, np.uint16),
    )


def _hides(rows: RunRows, owners: int) -> Indices:
    """What hides what in the truth, as `shapes` wants it."""
    occluders = rows.occluders()
    frame, hidden = rows.truth_frame[occluders.hidden], rows.truth_vessel[occluders.hidden]
    keys: Indices = (frame * owners + hidden) * owners + occluders.name
    return keys


def _recording(rows: RunRows, every: int, progress: Callable[[int], None]) -> Recording:
    scene, cameras = rows.scene, len(rows.scene.cameras)
    steps = np.arange(0, rows.steps, every)
    taken = rows.last_taken(steps)
    numbered = np.where(taken == NOBODY, NOBODY, taken * cameras + np.arange(cameras)).ravel()
    frames = np.unique(numbered[numbered != NOBODY])
    quantum = quantum_px([camera.intrinsics.image_size_px for camera in scene.cameras])
    order = np.lexsort((-rows.numbers("depth_m"), rows.truth_frame))
    shown = order[np.isin(rows.truth_frame[order], frames)]
    drawn = np.flatnonzero(np.isin(rows.drawn_frame, frames))
    occluders = rows.occluders()
    main_hider = np.full(len(order), NONE)
    least_first = np.argsort(occluders.px, kind="stable")
    main_hider[occluders.hidden[least_first]] = occluders.name[least_first]  # what is written last stays
    sights = _sights(rows, taken, frames, quantum, progress)
    state, horizons, pages = rows.states_of(frames), sights.horizons, len(frames)
    if np.any(numbered == NOBODY):  # what a camera shows before its first frame
        state, horizons, pages = np.append(state, NO_STATE), np.vstack([horizons, ALL_SEA]), pages + 1
    columns: dict[str, Column] = {
        "state": state.astype(np.uint8),
        "horizon": horizons.astype(np.float32),
        "shapeStart": starts(sights.frame, pages),
        "owner": sights.owner.astype(np.uint16),
        "outline": sights.outline.astype(np.uint32),
        "lineCount": sights.lines.astype(np.uint32),
        "cornerCount": sights.corner_count,
        "corners": sights.corners,
        "truthStart": starts(np.searchsorted(frames, rows.truth_frame[shown]), pages),
        "vessel": rows.truth_vessel[shown].astype(np.uint16),
        "flags": (rows.annotated[shown] + 2 * rows.detected[shown]).astype(np.uint8),
        "fraction": in_250ths(rows.numbers("visible_fraction")[shown]),
        "depth": rows.numbers("depth_m")[shown].astype(np.float32),
        "hider": main_hider[shown].astype(np.uint16),
        "full": in_quanta(rows.boxes_px("full")[shown], quantum),
        "visible": in_quanta(rows.boxes_px("visible")[shown], quantum),
        "drawnStart": starts(np.searchsorted(frames, rows.drawn_frame[drawn]), pages),
        "drawnVessel": np.where(rows.drawn_vessel < 0, NONE, rows.drawn_vessel)[drawn].astype(np.uint16),
        "label": indices(rows.drawn, "label", scene.detector.labels)[drawn].astype(np.uint16),
        "confidence": np.rint(1000 * numbers(rows.drawn, "confidence")[drawn]).astype(np.uint16),
        "box": in_quanta(rows.drawn_boxes_px()[drawn], quantum),
    }
    if len(frames) < numbered.size:  # some are shown more than once
        columns["frame"] = np.where(numbered == NOBODY, len(frames), np.searchsorted(frames, numbered)).astype(
            np.uint32
        )
        columns["taken"] = taken.ravel().astype(np.int32)
    return Recording(_facts(scene, steps, quantum), columns)


def _facts(scene: Scene, steps: Indices, quantum: float) -> dict[str, Any]:
    """What the numbers mean."""
    timestamps = scene.timestamps(0, int(steps[-1]) + 1)
    times_s = scene.times_s(0, int(steps[-1]) + 1)
    return {
        "quantum": quantum,
        "mode": scene.annotation.mode,
        "steps": steps.tolist(),
        "timestamps": [timestamps[step] for step in steps],
        "times": np.round(times_s[steps], 6).tolist(),
        "states": [state.name for state in scene.detector.states],
        "labels": list(scene.detector.labels),
        "occluders": list(scene.occluder_names),
        "vessels": [{"name": v.name, "label": v.label} for v in scene.vessels],
        "cameras": [
            {"name": camera.name, "size": list(camera.intrinsics.image_size_px), "carrier": camera.mount.vessel}
            for camera in scene.cameras
        ],
        "colours": {
            "vessels": [_css(palette.vessel_colour(index)) for index in range(len(scene.vessels))],
            "owners": [_css(palette.darker(colour)) for colour in map(palette.vessel_colour, range(len(scene.vessels)))]
            + [_css(palette.obstacle_colour(index)) for index in range(len(scene.obstacles))],
            "sea": _css(palette.SEA),
            "sky": _css(palette.SKY),
            "truth": _css(palette.TRUTH),
            "alarm": _css(palette.ALARM),
            "ink": _css(palette.INK),
        },
    }


def _css(colour: palette.Colour) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in colour)
