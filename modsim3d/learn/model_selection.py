"""Base of all parts of a learned detector: a form that the data can carry, then its numbers."""

from collections.abc import Iterable
from typing import Any, Protocol

from modsim3d.core.errors import InputError
from modsim3d.io.validation import nearest, shown
from modsim3d.learn.bootstrap import Resampling
from modsim3d.learn.matches import Observed

RICHER = (
    *("relative", "mixed", "student_t", "effects", "persistence", "score", "vessels", "components", "sizes"),
    *("places", "lasting", "confidence", "slopes", "duplicates", "merges", "splits"),
    "on_vessels",
)
"""What learning may add to the plain model, and can be told to leave out. Box errors that grow with the box, or partly
do; heavy tails; effects on misses; persistence of misses, box errors, confidence and merges; one score
behind misses and confidence; the share of misses and box errors that each vessel keeps; a memory of each component of
box errors; sizes and places of false positives, and how long they last; confidence of true and false detections apart;
its slopes; duplicates, merges and splits; false positives on vessels."""


class LearnedPart(Protocol):
    """The numbers of one part of the detector; its fields hold `Entry` objects."""

    def sections(self) -> dict[str, dict[str, Any]]:
        """Entries of the part outside the states, by section of the detector file."""

    def state_section(self, state: int) -> dict[str, Any]:
        """Entries of the part in the section of a state, given its index."""


class PartForm(Protocol):
    """The model of one part that the data can carry."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Reason why it is not a richer one: how much data there was, and how much is needed."""

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedPart:
        """The numbers of the model, with replicates for the weights of the resampling."""


def left_out(names: Iterable[str], where: str) -> frozenset[str]:
    """The models of `RICHER` that are to be left out, by their names; `where` is the option or argument. Raises
    InputError if one is not known."""
    chosen = frozenset(names)
    unknown = sorted(chosen - set(RICHER))
    if unknown:
        hints = [f"{shown(name)} ({nearest(name, RICHER)})" for name in unknown]
        raise InputError(where, [f"must be some of {', '.join(RICHER)} (got {', '.join(hints)})"])
    return chosen
