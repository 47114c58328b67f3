"""GOSPA and OSPA in the image: how far the set of tracks is from the set of vessels, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from modsim3d.arrays import Array, extents
from modsim3d.boxes import centres
from modsim3d.tracking.scores.point_sets import distances, mean_gospa, mean_ospa
from modsim3d.tracking.scores.scored import Scored


@dataclass(frozen=True)
class Gospa:
    """Means over frames of GOSPA with α = 2 and of its parts; None without frames.

    Attributes:
        gospa: The distance, in pixels.
        gospa_localisation: What the errors of centres add, in px^p.
        gospa_missed: What missed vessels add, in px^p.
        gospa_false: What false tracks add, in px^p.
    """

    gospa: float | None
    gospa_localisation: float | None
    gospa_missed: float | None
    gospa_false: float | None


@dataclass(frozen=True)
class Ospa:
    """Mean over frames of OSPA, in pixels; None without frames."""

    ospa: float | None


def gospa(scored: Scored) -> Gospa:
    """GOSPA of the centres of boxes, mean over all frames; one without vessels and tracks counts 0.

    The formula is that of `gospa_frame`. Parts are means of p-th powers: with p = 1 they add up to GOSPA.
    """
    rule = scored.rules.set_distance
    parts = mean_gospa(_frames(scored), rule.cutoff, rule.power)
    return Gospa(*parts) if parts else Gospa(None, None, None, None)


def ospa(scored: Scored) -> Ospa:
    """OSPA of the centres of boxes, mean over all frames; one without vessels and tracks counts 0.

    The formula is that of `ospa_frame`.
    """
    rule = scored.rules.set_distance
    return Ospa(mean_ospa(_frames(scored), rule.cutoff, rule.power))


def _frames(scored: Scored) -> Iterator[Array]:
    """Distances in pixels of the vessels' and the tracks' centres in each frame, shapes (n, m)."""
    vessels, tracks = scored.truth, scored.tracks
    a_px, b_px = centres(vessels.boxes_px), centres(tracks.boxes_px)
    places = (column.tolist() for each in (vessels, tracks) for column in extents(each.frame, scored.frames))
    for a, n, b, m in zip(*places, strict=True):
        yield distances(a_px[a : a + n], b_px[b : b + m])
