"""The pose source `traffic`: vessels and poses that the seed draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.inputs.validation import nearest
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys, generated_timestamps
from modsim3d.motion.poses.replay import RecordedPoses, check_pose_count
from modsim3d.motion.poses.traffic.craft import Craft
from modsim3d.motion.poses.traffic.drive import WHERE, Plan, Setting, plan, refused
from modsim3d.motion.poses.traffic.keys import TrafficSections
from modsim3d.random_streams import on_grid
from modsim3d.vessels.vessel import shoebox


@dataclass(frozen=True, eq=False)
class DrawnTraffic(RecordedPoses):
    """The poses of a drive, with what was drawn.

    Attributes:
        craft: The drawn vessels, in their order in the scene.
        left_out: Vessels for which there was no room, by section, such as `lanes.north`.
    """

    craft: tuple[Craft, ...]
    left_out: Mapping[str, int]


class TrafficKeys(SourceKeys, TrafficSections):
    """The section `poses.traffic`; see `TrafficSections` for its keys."""

    def vessels(self, request: PoseRequest) -> dict[str, dict[str, object]]:
        """Entries of the drawn vessels, as in a vessels file."""
        return {craft.name: self._entry(craft) for craft in self._plan(request).craft}

    def build(self, request: PoseRequest) -> DrawnTraffic:
        """The poses of the scene file's vessels and of the drawn ones; a vessel that is neither is always absent."""
        drive = self._plan(request)
        tracks = dict(drive.own) | {craft.name: craft.track for craft in drive.craft}
        steps, interval = request.steps or 0, request.time_step_s or 0.0
        check_pose_count(WHERE, steps, len(request.vessels))
        times_s = np.arange(steps, dtype=np.float64) * interval
        poses = Poses.absent(steps, len(request.vessels))
        for column, vessel in enumerate(request.vessels):
            if (track := tracks.get(vessel.name)) is None:
                continue
            there = track.present(times_s)
            places, headings = track.at(times_s[there])
            poses.present[there, column] = True
            poses.positions_m[there, column, :2] = on_grid(places)
            poses.headings_rad[there, column] = on_grid(headings)
        return DrawnTraffic(generated_timestamps(steps, interval), poses, drive.craft, drive.left_out)

    def _entry(self, craft: Craft) -> dict[str, object]:
        hull, mesh = craft.track.hull, self.kinds[craft.track.hull.kind].mesh
        entry: dict[str, object] = {
            "length_m": hull.length_m,
            "beam_m": hull.beam_m,
            "air_draft_m": hull.air_draft_m,
            "label": self.label(hull.kind),
        }
        return entry if mesh is None else entry | {"mesh": mesh}

    def _plan(self, request: PoseRequest) -> Plan:
        names = [vessel.name for vessel in request.vessels]
        strangers = [name for name in self.own if name not in names]
        problems = [f"own.{name}: no vessel '{name}' in the scene ({nearest(name, names)})" for name in strangers]
        if problems := self.problems() + problems:
            raise refused(problems)
        own = tuple(replace(vessel, solid=shoebox()) for vessel in request.vessels if vessel.name in self.own)
        check_pose_count(WHERE, request.steps or 0, len(request.vessels))
        setting = Setting(own, request.obstacles, request.steps or 0, request.time_step_s or 0.0, request.seed)
        return plan(self.model_dump_json(), setting)
