"""What comparing the sources of truth finds: parts, each for a camera and a block of steps, and their total."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from modsim3d.truth.modes import SOURCES
from modsim3d.verify.comparison import Agreement, Comparison, concatenate_comparisons
from modsim3d.verify.shoebox_fit import ShoeboxFit
from modsim3d.view.pictures.comparison_picture import SourceBoxes

_Value = TypeVar("_Value", int, float, ShoeboxFit)


@dataclass(frozen=True)
class VesselDifference:
    """A vessel in an image on which sources differ.

    Attributes:
        camera: Index into the scene's cameras.
        step: Step of the scene.
        vessel: Index into the scene's vessels.
        badness: The greater it is, the more it deserves to be shown.
        reason: Why it is shown.
        boxes_px: Its boxes by each source.
    """

    camera: int
    step: int
    vessel: int
    badness: float
    reason: str
    boxes_px: SourceBoxes


@dataclass(frozen=True)
class RectangleRuleCheck:
    """How the thesis's rectangle rule does on vessels that something hides.

    Attributes:
        occluded: Vessel-frames with a hidden pixel.
        off: Number of them that both see and that have a side more than 2 px off.
        kept_hidden: Number of them that are wholly hidden, yet kept by the rule.
        dropped_visible: Number of them that are visible, yet dropped by the rule.
        worst: The vessel whose box is most off; None if none is occluded.
    """

    occluded: int = 0
    off: int = 0
    kept_hidden: int = 0
    dropped_visible: int = 0
    worst: VesselDifference | None = None

    def __add__(self, other: RectangleRuleCheck) -> RectangleRuleCheck:
        """The check of the vessel-frames of both."""
        worst = [difference for difference in (self.worst, other.worst) if difference is not None]
        return RectangleRuleCheck(
            self.occluded + other.occluded,
            self.off + other.off,
            self.kept_hidden + other.kept_hidden,
            self.dropped_visible + other.dropped_visible,
            max(worst, key=lambda difference: difference.badness, default=None),
        )

    @property
    def wrong_share(self) -> float:
        """Share of occluded vessel-frames that the rule gets wrong."""
        wrong = self.off + self.kept_hidden + self.dropped_visible
        return wrong / self.occluded if self.occluded else 0.0


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found in some frames.

    Attributes:
        frames: Number of camera frames.
        differences: Rendered against analytic truth, a row for each vessel in a frame.
        rule: The rectangle rule against the rendered source.
        intersecting: Pair of vessels or obstacles that intersect, as "a and b" → number of frames.
        shoebox_fits: ID of a vessel with a mesh → how well its shoebox fits it.
        seconds: Source of truth → computing time.
        worst: The vessels with the largest differences between rendered and analytic truth, worst first.
    """

    frames: int
    differences: Comparison
    rule: RectangleRuleCheck
    intersecting: Mapping[str, int]
    shoebox_fits: Mapping[str, ShoeboxFit]
    seconds: Mapping[str, float]
    worst: tuple[VesselDifference, ...]

    @classmethod
    def total(cls, parts: Sequence[Findings], most_shown: int) -> Findings:
        """The findings in the frames of all parts.

        Args:
            parts: Findings in different frames, in the order of the frames.
            most_shown: Number of vessels to keep in `worst`.
        """
        shown = [difference for part in parts for difference in part.worst]
        return cls(
            sum(part.frames for part in parts),
            concatenate_comparisons([part.differences for part in parts]),
            sum((part.rule for part in parts), RectangleRuleCheck()),
            _summed([part.intersecting for part in parts]),
            _summed([part.shoebox_fits for part in parts]),
            _summed([dict.fromkeys(SOURCES, 0.0), *(part.seconds for part in parts)]),
            tuple(sorted(shown, key=lambda difference: -difference.badness)[:most_shown]),
        )

    @property
    def unexplained(self) -> int:
        """Number of differences that nothing explains, in full or visible boxes."""
        differences = self.differences
        return sum(int((column == Agreement.UNEXPLAINED).sum()) for column in (differences.full, differences.visible))


def _summed(parts: Sequence[Mapping[str, _Value]]) -> dict[str, _Value]:
    """The sum of the values of each key."""
    total: dict[str, _Value] = {}
    for part in parts:
        for key, value in part.items():
            total[key] = total[key] + value if key in total else value
    return total
