"""What the viewer shows when it opens a recording: the cameras, the world, and plots over the whole time."""

from __future__ import annotations

from typing import Any

from modsim3d.view import palette
from modsim3d.view.rerun.boxes import FALSE, FALSE_TRACKS, MISSED, TRACKS
from modsim3d.view.rerun.log import TIME, Log, image_path
from modsim3d.view.rerun.space import Eye

PICTURES, PLOTS, LANE = 6.0, (1.9, 1.3), 0.5
"""Heights of the rows, as shares: cameras and world, a plot where there is one and where there are two, and a lane of
states beside its title and axis."""
BEHIND = (12, 14, 16)
"""Behind the world and around the cameras' images."""


def blueprint(log: Log, eye: Eye, last_step: int, *, tracks: bool) -> Any:
    """The blueprint of a recording, for the SDK.

    Args:
        log: The recording.
        eye: From where the world is looked at.
        last_step: The last step of the recording.
        tracks: Whether it has tracks.
    """
    from rerun import blueprint as parts

    scene = log.scene
    cameras = [_camera(log, parts, camera.name) for camera in scene.cameras]
    pictures = cameras[0] if len(cameras) == 1 else parts.Tabs(*cameras)
    end_s = float(scene.times_s(last_step, last_step + 1)[0])
    rows = [
        parts.Horizontal(pictures, _world(log, parts, eye), column_shares=[3, 2]),
        _plot(log, parts, "missed and false", (MISSED, FALSE), end_s),
    ]
    if tracks:
        rows.append(_plot(log, parts, "tracks, and those on nothing", (TRACKS, FALSE_TRACKS), end_s))
    shares = [PICTURES, *[PLOTS[tracks]] * (len(rows) - 1)]
    lanes = [camera.name for camera in scene.cameras[: None if scene.detector.performance.per_camera else 1]]
    rows.append(
        parts.StateTimelineView(
            origin="detector",
            contents=[_path(log, ["detector", name]) for name in lanes],
            name="performance state of the detector",
            time_view=_whole(log, parts, end_s),
        )
    )
    return parts.Blueprint(
        parts.Vertical(*rows, row_shares=[*shares, LANE * (1 + len(lanes))]),
        parts.TimePanel(timeline=TIME, state="collapsed"),
        parts.SelectionPanel(state="hidden"),
        parts.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _camera(log: Log, parts: Any, name: str) -> Any:
    return parts.Spatial2DView(origin=_path(log, image_path(name)), name=f"camera {name}", background=BEHIND)


def _world(log: Log, parts: Any, eye: Eye) -> Any:
    """The world, with the cameras' pictures in it and no boxes on these."""
    hidden = [f"- {_path(log, [*image_path(camera.name), '**'])}" for camera in log.scene.cameras]
    shown = [f"+ {_path(log, [*image_path(camera.name), 'scene'])}" for camera in log.scene.cameras]
    lenses = [f"+ {_path(log, image_path(camera.name))}" for camera in log.scene.cameras]
    return parts.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", *hidden, *lenses, *shown],
        name="world",
        background=palette.BLACK,
        eye_controls=parts.EyeControls3D(position=eye.position_m, look_target=eye.target_m, eye_up=(0, 0, 1)),
    )


def _plot(log: Log, parts: Any, title: str, counts: tuple[str, ...], end_s: float) -> Any:
    """A plot of counts of all cameras."""
    lines = [_path(log, ["counts", camera.name, count]) for camera in log.scene.cameras for count in counts]
    return parts.TimeSeriesView(
        origin="counts",
        contents=lines,
        name=title,
        axis_x=_whole(log, parts, end_s),
        plot_legend=parts.Corner2D.RightTop,
    )


def _whole(log: Log, parts: Any, end_s: float) -> Any:
    """An axis of the whole time."""
    ends = (log.sdk.TimeRangeBoundary.absolute(seconds=time) for time in (0.0, end_s))
    return parts.TimeAxis(view_range=log.sdk.encodings.TimeRange(*ends))


def _path(log: Log, parts: list[str]) -> str:
    """A path as text, with what has a meaning in it escaped."""
    return str(log.sdk.new_entity_path(parts))
