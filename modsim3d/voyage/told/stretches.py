"""The longest stretches of time without a match: of vessels that were missed, and of detections of nothing known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.ais.options import time_text
from modsim3d.arrays import Array, Indices
from modsim3d.display import counted
from modsim3d.learn.told.tables import Table
from modsim3d.voyage.clock import SceneClock
from modsim3d.voyage.labelled_voyage import LabelledVoyage
from modsim3d.voyage.told.coverage import bearings
from modsim3d.voyage.unseen.judged import Judged
from modsim3d.voyage.unseen.things import Behaviour

LISTED = 8
_HALF = 0.5


@dataclass(frozen=True, eq=False)
class Stretch:
    """Frames of one camera that follow each other.

    Attributes:
        what: The vessel that was missed, or what the detections were taken for.
        camera: Name of the camera.
        time_s: Times of the frames by the log's clock, since the scene's first step, shape (n,).
        image: The frames, shape (n,).
        boxes_px: True or detected box in each, shape (n, 4).
        bearing_deg: Mean bearing from the camera's axis, to the right.
        range_m: Mean range; NaN of detections.
        start_s: Unix time of the scene's first step; None if the scene does not say.
    """

    what: str
    camera: str
    time_s: Array
    image: Indices
    boxes_px: Array
    bearing_deg: float
    range_m: float
    start_s: float | None

    def when(self, place: int) -> str:
        """The time of a frame by the log's clock, as `--empty` takes it: UTC if the scene says when it starts."""
        time_s = float(self.time_s[place])
        return f"{time_s:.1f} s" if self.start_s is None else time_text(self.start_s + time_s)

    @property
    def lasts_s(self) -> float:
        """From the first frame to the last."""
        return float(self.time_s[-1] - self.time_s[0])


def missed_stretches(voyage: LabelledVoyage, judged: Judged) -> list[Stretch]:
    """Stretches in which a vessel was to be detected in each frame that it was in, and was in none, longest first."""
    labelled, matched = voyage.labelled, judged.telling.matched
    identity, found = labelled.annotations.identity, []
    number, start_s = np.full(len(labelled.images), -1), SceneClock.of(voyage.scene).start_s
    for view in voyage.views:
        number[:] = -1
        number[view.images] = np.arange(len(view.images))
        ours = np.flatnonzero(matched.sought & (number[labelled.annotations.image] >= 0))
        for who in np.unique(identity[ours]).tolist():
            rows = ours[identity[ours] == who]
            frame = number[labelled.annotations.image[rows]]
            rows, frame = rows[np.argsort(frame)], np.sort(frame)
            missed = matched.detection[rows] < 0
            apart = np.flatnonzero(np.diff(missed.astype(int)).astype(bool) | (np.diff(frame) > 1)) + 1
            for part in np.split(np.arange(len(rows)), apart):
                if missed[part[0]]:
                    name = voyage.scene.vessel_names[who - view.first_identity]
                    chosen = rows[part]
                    boxes, depth = labelled.annotations.boxes_px[chosen], labelled.annotations.depth_m[chosen]
                    found.append(_stretch(voyage, name, view.camera.name, chosen, boxes, depth, start_s))
    return sorted(found, key=lambda each: (-len(each.image), each.time_s[0]))


def unmatched_stretches(voyage: LabelledVoyage, judged: Judged) -> list[Stretch]:
    """Things that were detected and are no known vessel, those that were detected in most frames first."""
    links, of_view = judged.links, np.full(len(voyage.labelled.images), -1)
    start_s = SceneClock.of(voyage.scene).start_s
    for place, view in enumerate(voyage.views):
        of_view[view.images] = place
    order = np.lexsort((links.time_s, links.link))
    starts = np.searchsorted(links.link[order], np.arange(links.count))
    found = []
    for thing, rows in enumerate(np.split(order, starts[1:]) if links.count else []):
        view = voyage.views[int(of_view[links.image[rows[0]]])]
        boxes = voyage.labelled.results.boxes_px[links.rows[rows]]
        bearing = float(bearings(view.camera, boxes, 1.0)[0].mean())
        likely = judged.lasting[thing]
        against = Behaviour(judged.things.behaviour[thing])
        why = "" if against is Behaviour.LIKE_A_VESSEL else f": {against.in_words}"
        what = f"a vessel without a transponder ({likely:.0%})" if likely >= _HALF else f"false{why}"
        if judged.empty[links.image[rows]].all():
            what = "false, in a stretch that is marked as empty"
        times = links.time_s[rows], links.image[rows]
        found.append(Stretch(what, view.camera.name, *times, boxes, bearing, float("nan"), start_s))
    return sorted(found, key=lambda each: (-len(each.image), each.time_s[0]))


def missed_table(stretches: list[Stretch]) -> Table:
    """The longest stretches in which vessels were missed."""
    rows = tuple(
        (each.what, each.camera, *_times(each), f"{each.range_m:,.0f} m", _degrees(each.bearing_deg))
        for each in stretches[:LISTED]
    )
    title = f"Vessels that were missed for longest{_of(stretches)}"
    return Table(title, ("vessel", "camera", "from", "to", "frames", "range", "from the axis"), rows)


def unmatched_table(stretches: list[Stretch]) -> Table:
    """The things without a match that were detected most often."""
    rows = tuple((each.camera, *_times(each), _degrees(each.bearing_deg), each.what) for each in stretches[:LISTED])
    title = f"Detections of nothing known that lasted longest{_of(stretches)}"
    return Table(title, ("camera", "from", "to", "frames", "from the axis", "taken for"), rows)


def _degrees(bearing: float) -> str:
    return f"{bearing:+.0f}°" if abs(bearing) >= _HALF else "0°"


def _of(stretches: list[Stretch]) -> str:
    return f" ({LISTED} of {counted(len(stretches), 'stretch', 'stretches')})" if len(stretches) > LISTED else ""


def _times(each: Stretch) -> tuple[str, str, str]:
    return each.when(0), each.when(-1), f"{len(each.image):,}"


def _stretch(
    voyage: LabelledVoyage,
    name: str,
    camera: str,
    rows: Indices,
    boxes_px: Array,
    depth_m: Array,
    start_s: float | None,
) -> Stretch:
    image = voyage.labelled.annotations.image[rows]
    eye = next(view.camera for view in voyage.views if view.camera.name == camera)
    bearing, range_m = bearings(eye, boxes_px, depth_m)
    times = voyage.labelled.images.time_s[image]
    return Stretch(name, camera, times, image, boxes_px, float(bearing.mean()), float(range_m.mean()), start_s)
