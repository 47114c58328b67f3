"""Coverage by the truth of a run: encounters, ranges, sizes, occlusions, waves. It says nothing of detections or
tracks, so it is the same for all detectors and trackers over one truth."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.kinematics import HullTracks, closest_approach
from modsim3d.runs.pipeline import block_ranges
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, OCCLUDED_BELOW
from modsim3d.tracking.scores.scored_run import frame_lengths_s, stretches
from modsim3d.tracking.world.collision import ENCOUNTER_M
from modsim3d.tracks.true_tracks import DEFAULT_GAP_S, appearances
from modsim3d.world.encounters import Encounter, encounter, hull_tracks
from modsim3d.world.floating_vessels import FloatingVessels
from modsim3d.world.traffic.generate import DrawnTraffic


@dataclass(frozen=True)
class Bins:
    """Bins of a quantity from 0 up; the last one is open, and a value at an edge belongs to the bin above it."""

    prefix: str  # of the names of its columns
    unit: str  # of the edges
    edges: tuple[int, ...]  # between two bins, ascending

    @property
    def names(self) -> tuple[str, ...]:
        """Columns, such as `covered.frames.range_0_100_m` and `covered.frames.range_over_5000_m`."""
        closed = (f"{self.prefix}{low}_{high}_{self.unit}" for low, high in pairwise((0, *self.edges)))
        return *closed, f"{self.prefix}over_{self.edges[-1]}_{self.unit}"

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the bins on a page, such as `0 to 100 m` and `100 m and more`."""
        closed = (f"{low:,} to {high:,} {self.unit}" for low, high in pairwise((0, *self.edges)))
        return *closed, f"{self.edges[-1]:,} {self.unit} and more"

    def place(self, values: Array) -> Indices:
        """Index of the bin of each value, shape (n,)."""
        return np.asarray(np.searchsorted(np.array(self.edges), values, side="right"), dtype=np.int64)

    def counts(self, values: Array) -> dict[str, int]:
        """Number of values in each bin, by the name of its column; those that are not finite are left out."""
        counts = np.bincount(self.place(values[np.isfinite(values)]), minlength=len(self.edges) + 1)
        return dict(zip(self.names, counts.tolist(), strict=True))


RANGES = Bins("covered.frames.range_", "m", (100, 200, 500, 1000, 2000, 5000))
"""Vessel-frames by the distance of the vessel's centre from the camera."""
SIZES = Bins("covered.frames.size_", "px", (8, 16, 32, 64, 128, 256))
"""Vessel-frames by √(width × height) of the box, as the detector's effects of size take it."""
OCCLUSIONS = Bins("covered.occlusions.", "s", LENGTH_EDGES_S)  # occlusions by length, as the scores tell them apart


MET = "met."
COVERED = "covered."
VESSELS = "covered.vessels."  # before a class: how many of its vessels a camera saw
KINDS = {
    Encounter.HEAD_ON: "met.head_on",
    Encounter.GIVES_WAY: "met.crossing_from_starboard",
    Encounter.STANDS_ON: "met.crossing_from_port",
    Encounter.OVERTAKING: "met.own_overtakes",
    Encounter.OVERTAKEN: "met.own_overtaken",
}
"""Column of each kind of encounter, as own ship sees it."""
_ASKED = {
    "head_on": Encounter.HEAD_ON,
    "crossing_from_starboard": Encounter.GIVES_WAY,
    "crossing_from_port": Encounter.STANDS_ON,
    "overtaking": Encounter.OVERTAKEN,
    "overtaken": Encounter.OVERTAKING,
}
"""Kinds of drawn traffic, which names what the other vessel does."""
SEEN = "met.seen"
_COUNTS = ("covered.vessels", "covered.frames.", "covered.occlusions.")
BLOCK_STEPS = 1_000  # of the cameras' poses at a time: the poses of all vessels are worked out with them
_DECIMALS = 6  # of every number that is no count: the last bits of sines and matrix products depend on the processor


def coverage_type(name: str) -> pa.DataType:
    """The type of a column of `coverage_of`: encounters, vessels, vessel-frames and occlusions are counted."""
    return pa.int64() if name.startswith((MET, *_COUNTS)) else pa.float64()


def coverage_of(rows: RunRows) -> dict[str, int | float]:
    """Coverage of a run, by names of columns.

    - `met.KIND`: encounters of own ships, that is of vessels that carry a camera: vessels that came nearer and passed
      within a nautical mile. The kind is that with which drawn traffic planned the encounter; of others it follows from
      the bearings when the vessel is first seen. `met.seen`: those that a camera saw before the closest approach.
      Missing where all cameras are ashore.
    - `covered.closest_approach_m`: the least distance of an own ship from another vessel, of their centres; missing as
      well.
    - `covered.frames.range_LOW_HIGH_m`, `covered.frames.size_LOW_HIGH_px`: vessel-frames with a visible pixel by range
      and by size, with `covered.least_range_m`, `covered.most_range_m`, `covered.least_size_px` and
      `covered.most_size_px`, missing where no camera sees a vessel.
    - `covered.vessels.CLASS`: vessels of a class that a camera saw; `covered.vessels_at_once`: most in one frame.
    - `covered.occlusions.LOW_HIGH_s`: occlusions by length, as the scores define them; `covered.hidden_s`: sum of the
      times for which vessels in the image are wholly hidden. Missing where the source of the truth cannot tell.
    - `covered.wave_height_m`: significant height; 0 for calm water, missing for waves without a height.
    - `covered.camera_roll_rad`: largest angle of the horizon in an image.

    Of a labelled video the last two are missing, and a range is the labels' distance, if they have one.
    """
    visible = rows.numbers("visible_px") != 0  # where it is unknown, a vessel in the image is taken as seen
    synthetic = rows.scene.labels is None
    poses = tuple(_camera_poses(rows)) if synthetic else ()
    numbers = {
        **_encounters(rows, visible),
        **_sights(rows, visible, poses),
        **_occlusions(rows),
        **(_waves(rows.scene) if synthetic else {}),
        **({"covered.camera_roll_rad": max(_roll_rad(pose) for pose in poses)} if synthetic else {}),
    }
    return {name: round(value, _DECIMALS) if isinstance(value, float) else value for name, value in numbers.items()}


def _camera_poses(rows: RunRows) -> Iterator[CameraPoses]:
    """The poses of each camera at all steps; waves are worked out only for vessels that carry one."""
    scene = rows.scene
    motion = replace(scene.motion, moved=scene.own_ships)
    for camera in scene.cameras:
        blocks = [np.arange(first, stop) for first, stop in block_ranges(rows.steps, BLOCK_STEPS)]
        parts = [scene.camera_poses(camera, motion.at(steps), steps) for steps in blocks]
        yield CameraPoses(
            np.concatenate([part.camera_R_world for part in parts]),
            np.concatenate([part.positions_m for part in parts]),
        )


def _roll_rad(poses: CameraPoses) -> float:
    """Largest angle between the horizon and the image's rows; that of a camera that looks straight down is 0."""
    up = poses.camera_R_world[:, :, 2]
    return float(np.abs(np.arctan2(up[:, 0], np.hypot(up[:, 1], 1e-12))).max())


def _sights(rows: RunRows, visible: Mask, poses: tuple[CameraPoses, ...]) -> dict[str, int | float]:
    scene, cameras = rows.scene, len(rows.scene.cameras)
    step, camera = np.divmod(rows.truth_frame[visible], cameras)
    vessel = rows.truth_vessel[visible]
    range_m = rows.numbers("depth_m")[visible]
    if scene.labels is None:
        places_m = np.stack([pose.positions_m[:, :2] for pose in poses])
        centres_m = scene.poses.poses(0, rows.steps).positions_m[..., :2]
        range_m = np.hypot(*(centres_m[step, vessel] - places_m[camera, step]).T)
    box = rows.annotated_boxes_px[visible]
    size_px = np.sqrt((box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1]))
    classes = Counter(dict.fromkeys(sorted({vessel.label for vessel in scene.vessels}), 0))
    classes.update(scene.vessels[index].label for index in np.unique(vessel).tolist())
    at_once = np.bincount(rows.truth_frame[visible]).max(initial=0)
    return {
        "covered.vessels_at_once": int(at_once),
        **{VESSELS + label: count for label, count in classes.items()},
        **RANGES.counts(range_m),
        **SIZES.counts(size_px),
        **_extremes("range_m", range_m[np.isfinite(range_m)]),
        **_extremes("size_px", size_px[np.isfinite(size_px)]),
    }


def _extremes(name: str, values: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return {f"covered.least_{name}": float(values.min()), f"covered.most_{name}": float(values.max())}


def _occlusions(rows: RunRows) -> dict[str, int | float]:
    """Occlusions by length, and the time for which vessels are wholly hidden."""
    fraction = rows.numbers("visible_fraction")
    if len(fraction) and not np.isfinite(fraction).any():
        return {}
    identity, length_s = appearances(rows, DEFAULT_GAP_S), frame_lengths_s(rows, rows.truth_frame)
    time_s = rows.scene.times_s(0, rows.steps)[rows.truth_frame // len(rows.scene.cameras)]
    order = np.lexsort((rows.truth_frame, identity))
    ordinal = np.cumsum(~np.isnan(fraction[order]))  # a vessel without a pixel has no visible fraction
    occluded = np.flatnonzero(fraction[order] < OCCLUDED_BELOW)
    spans = stretches(identity[order][occluded], ordinal[occluded])
    first, last = order[occluded[spans.first]], order[occluded[spans.last]]
    lasted_s = np.round(time_s[last] + length_s[last] - time_s[first], _DECIMALS)
    return {**OCCLUSIONS.counts(lasted_s), "covered.hidden_s": float(length_s[fraction == 0].sum())}


def _waves(scene: Scene) -> dict[str, int | float]:
    if scene.waves is None:
        return {"covered.wave_height_m": 0.0}
    if not isinstance(scene.waves.motion, FloatingVessels):
        return {}
    variance_m2 = float((scene.waves.motion.sea.amplitudes_m**2).sum()) / 2
    return {"covered.wave_height_m": 4 * variance_m2**0.5}


def _encounters(rows: RunRows, visible: Mask) -> dict[str, int | float]:
    """Encounters of own ships by kind, and the closest approach; nothing without an own ship."""
    scene, own_ships = rows.scene, rows.scene.own_ships
    if not own_ships:
        return {}
    hulls = hull_tracks(scene.vessels, scene.poses, rows.steps)
    first_seen = np.full(len(scene.vessels), rows.steps)
    np.minimum.at(first_seen, rows.truth_vessel[visible], rows.truth_frame[visible] // len(scene.cameras))
    counts, nearest_m = Counter(dict.fromkeys((*KINDS.values(), SEEN), 0)), np.inf
    for own in own_ships:
        for vessel in range(len(scene.vessels)):
            if vessel in own_ships:
                continue
            closest_m, closest_s = closest_approach(hulls.times_s, hulls.centres_m[:, own], hulls.centres_m[:, vessel])
            nearest_m = min(nearest_m, closest_m)
            if closest_m > ENCOUNTER_M or not _passed(hulls, own, vessel, closest_s):
                continue
            seen_before = hulls.times_s[first_seen[vessel]] < closest_s if first_seen[vessel] < rows.steps else False
            counts[SEEN] += bool(seen_before)
            counts[KINDS[_kind(scene, hulls, own, vessel, int(first_seen[vessel]) if seen_before else None)]] += 1
    return {**counts, **({"covered.closest_approach_m": nearest_m} if np.isfinite(nearest_m) else {})}


def _together(hulls: HullTracks, own: int, vessel: int) -> Indices:
    """Steps at which both are there, ascending, shape (n,)."""
    return np.flatnonzero(np.isfinite(hulls.centres_m[:, [own, vessel]]).all(axis=(1, 2)))


def _passed(hulls: HullTracks, own: int, vessel: int, closest_s: float) -> bool:
    """Whether they came nearer before the closest approach, and drew away after it."""
    together = _together(hulls, own, vessel)
    return bool(hulls.times_s[together[0]] < closest_s < hulls.times_s[together[-1]])


def _kind(scene: Scene, hulls: HullTracks, own: int, vessel: int, seen: int | None) -> Encounter:
    """The kind that it was planned as, or that of the bearings when it is first seen, or first there."""
    if isinstance(scene.poses, DrawnTraffic):
        names = scene.vessel_names
        for craft in scene.poses.craft:
            if craft.name == names[vessel] and craft.asked is not None and craft.asked.own == names[own]:
                return _ASKED[craft.asked.kind]
    step = int(_together(hulls, own, vessel)[0]) if seen is None else seen
    places_m, headings_rad = hulls.centres_m[step], hulls.headings_rad[step]
    return encounter(places_m[own], float(headings_rad[own]), places_m[vessel], float(headings_rad[vessel]))
