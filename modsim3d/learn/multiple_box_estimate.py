"""How often a vessel has a second box or comes out in two parts, and two vessels come out as one box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.learn.believed_kinds import THRESHOLDS, hits_and_trials
from modsim3d.learn.entries import Entry, Key, digits
from modsim3d.learn.form import ratio
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import Column, Resampling


@dataclass(frozen=True)
class MultipleBoxForm:
    """Which of `believed_kinds.NAMES` the data show, with their thresholds, None for one that has none."""

    shown: tuple[tuple[str, float | None], ...]
    notes: tuple[str, ...]

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedMultipleBoxes:
        """The probability of each."""
        entries = []
        for name, _ in self.shown:
            sums = hits_and_trials(observed.kinds.trials[name], resampling)
            share = np.clip(ratio(sums[:, 0], sums[:, 1]), 0, 1)
            entries.append(Entry(Key(("false_positives", name)), Column(share, "share", np.array(sums[0, 1]))))
        return LearnedMultipleBoxes(self, tuple(entries))


@dataclass(frozen=True, eq=False)
class LearnedMultipleBoxes:
    """The probability of each kind that the data show."""

    form: MultipleBoxForm
    shares: tuple[Entry, ...]

    def sections(self) -> dict[str, dict[str, Any]]:
        """Probabilities, and thresholds that are not the defaults."""
        section: dict[str, Any] = {}
        for (name, least), entry in zip(self.form.shown, self.shares, strict=True):
            section[name] = digits(np.nan_to_num(entry.estimate))
            if least is not None and least != THRESHOLDS[name][1]:
                section[THRESHOLDS[name][0]] = least
        return {"false_positives": section} if section else {}

    def state_section(self, state: int) -> dict[str, Any]:
        """Nothing in the states."""
        return {}


def choose_multiple_boxes(observed: Observed) -> MultipleBoxForm:
    """Which kinds the data show."""
    kinds = observed.kinds
    return MultipleBoxForm(tuple((name, kinds.thresholds.get(name)) for name in kinds.trials), kinds.notes)
