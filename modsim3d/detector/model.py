"""A detector's statistics as the simulation uses them; `schema` has their form in a file."""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from modsim3d.core.arrays import Array, Indices, read_only
from modsim3d.core.document import Document, Result, Table, Text, Where
from modsim3d.core.text import counted, in_percent, listed
from modsim3d.detector.confidence import StateConfidence
from modsim3d.detector.draws import BoxErrorLaw
from modsim3d.detector.dropout import Dropout
from modsim3d.detector.false_positives import FalsePositiveOptions
from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.detector.persistence import Persistence
from modsim3d.detector.records import Gates

# ---- Whether cameras share a chain of performance states ----

_EARLY_S = 1e-9  # a time read from text and one worked out may differ by rounding


@dataclass(frozen=True)
class Performance:
    """Whether each camera has a chain of its own, and which states are forced. The schedule has ascending times in
    seconds and the state forced from each on; −1 returns to the chain."""

    per_camera: bool = False
    schedule: tuple[tuple[float, int], ...] = ()

    def forced(self, times_s: Array, states: Indices) -> Indices:
        """The states at times in seconds, given those of the chain, all of shape (S,)."""
        if not self.schedule:
            return states
        entry = np.searchsorted([time_s for time_s, _ in self.schedule], times_s + _EARLY_S, side="right")
        schedule = np.array([-1, *(state for _, state in self.schedule)])[entry]
        return np.where(schedule >= 0, schedule, states)


ERROR_COMPONENTS = ("e_x", "e_y", "e_w", "e_h")  # order of the box error (Jessen & Mohr (2023), section 5.6.3)
ERROR_PAIRS = tuple(itertools.combinations(range(len(ERROR_COMPONENTS)), 2))
"""Pairs of components, in the order in which files and tables list their correlations."""


@dataclass(frozen=True, eq=False, repr=False)
class PerformanceState:
    """Behaviour of the detector under one kind of conditions, with k labels; equations of Jessen & Mohr (2023)."""

    name: str
    confusion: Array  # (k + 1, k): Pr(detected as i | label j), background last; columns sum to one (eq. 5.25)
    false_positive_labels: Array  # Pr(label i | false positive), shape (k,), sums to one (eq. 5.26)
    false_discovery_rate: float  # false positives over all detections, in [0, 1); NaN if the file has another rate
    box_error: BoxErrorLaw
    confidence: StateConfidence
    false_positives_per_image: float = 0.0  # for the model of false positives that has such a rate

    def __repr__(self) -> str:
        """Its name and its rate of false positives."""
        return f"<PerformanceState {self.name}: {self.false_rate}>"

    @property
    def false_rate(self) -> str:
        """Its rate of false positives in words."""
        if math.isnan(self.false_discovery_rate):
            return f"{self.false_positives_per_image:g} false positives an image"
        return f"false discovery rate {in_percent(self.false_discovery_rate, 1)}"


@dataclass(frozen=True, eq=False, repr=False)
class DetectorModel(Result):
    """Everything that a detector file says: what `load_detector` returns, and what a scene has as `detector`.

    Attributes:
        labels: Names of the classes; arrays give a class as an index into them.
        confidence_threshold: Least confidence of a detection.
        operating_threshold: Detections below it are dropped when all is drawn; None drops none.
        states: The performance states.
        initial_state: Index of the state at the first step.
        transition_matrix: Pr(next is i | now is j), shape (states, states), columns sum to one (Jessen & Mohr (2023),
            eq. 6.1).
        transition_interval_s: Time between transitions; None means one at each step.
    """

    labels: tuple[str, ...]
    confidence_threshold: float
    initial_state: int
    transition_matrix: Array
    states: tuple[PerformanceState, ...]
    transition_interval_s: float | None = None
    dropout: Dropout = field(default_factory=Dropout)
    gates: Gates = field(default_factory=Gates)
    persistence: Persistence = field(default_factory=Persistence)
    false_positives: FalsePositiveOptions = field(default_factory=FalsePositiveOptions)
    merges_and_splits: MergesAndSplits = field(default_factory=MergesAndSplits)
    performance: Performance = field(default_factory=Performance)
    operating_threshold: float | None = None

    def _document(self) -> Document:
        """A table: for each state, how often each label is missed, and the share of false positives."""
        rows = [
            [state.name, *(in_percent(miss, 1) for miss in state.confusion[-1]), state.false_rate]
            for state in self.states
        ]
        header = ["state", *(f"{label}: missed" for label in self.labels), "false positives"]
        words = self.in_words()
        return Document("", [Text(words)], [Table(f"Detector: {words}", header, rows, where=Where.EVERYWHERE)])

    def in_words(self) -> str:
        """Its states and labels, such as `2 states (day, night), 1 label (Vessel)`."""
        states = f"{counted(len(self.states), 'state')} ({listed([state.name for state in self.states])})"
        return f"{states}, {counted(len(self.labels), 'label')} ({listed(self.labels)})"

    @property
    def stationary_shares(self) -> dict[str, float]:
        """Share of time in each state in the long run, by name; empty if it depends on the initial state."""
        names = (state.name for state in self.states)
        return dict(zip(names, stationary_shares(self.transition_matrix).tolist(), strict=False))

    @property
    def needs_target_statistics(self) -> bool:
        """Whether the detector must count all targets of the scene before it can detect any."""
        return self.dropout.anchored or self.false_positives.needs_target_statistics

    def column(self, attribute: str) -> Array:
        """One attribute of every state, stacked: shape (number of states, ...)."""
        return read_only([getattr(state, attribute) for state in self.states])


def stationary_shares(transition_matrix: Array) -> Array:
    """The x with A x = x of sum one, (states,), of a transition matrix A (Jessen & Mohr (2023), eq. 6.19), or empty."""
    states = len(transition_matrix)
    equations = np.vstack([transition_matrix - np.eye(states), np.ones(states)])
    shares, _, rank, _ = np.linalg.lstsq(equations, np.eye(states + 1)[-1])
    return read_only(np.clip(shares, 0, 1) if rank == states else [])
