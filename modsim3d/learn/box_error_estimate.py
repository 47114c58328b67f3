"""Box error: its unit and law in each state, and how long errors persist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.class_estimate import kept_share
from modsim3d.learn.entries import Entry, Key, nested
from modsim3d.learn.error_laws import LAWS, ErrorSample, LearnedLaw, heavy_tails
from modsim3d.learn.error_noise import error_lags, latent_share, with_things
from modsim3d.learn.observed import Observed
from modsim3d.learn.pairs import ErrorSource
from modsim3d.learn.persistence_fit import Consecutive
from modsim3d.learn.resampling import Resampling
from modsim3d.learn.vessel_noise import vessel_noise, why_none
from modsim3d.learn.white_errors import WhiteErrors, compared

ERRORS_NEEDED = 20
"""Pairs that the box error of a state needs."""


@dataclass(frozen=True)
class StateErrorForm:
    """The unit of the box error in one state, the pairs it is learned from and the name in `LAWS` of its law."""

    unit: Literal["px", "relative"]
    source: ErrorSource = ErrorSource.OWN_STATE
    law: str = "normal"

    @property
    def relative(self) -> bool:
        """Whether errors are in sides of the box."""
        return self.unit == "relative"


@dataclass(frozen=True)
class BoxErrorForm:
    """The model of the box error in each state, and the rough correlation time of errors, 0 if they do not persist.

    `things_keep` says whether each thing keeps a share of the errors for as long as it is seen.
    """

    states: tuple[StateErrorForm, ...]
    box_s: float
    notes: tuple[str, ...]
    things_keep: bool = False

    @property
    def relative(self) -> bool:
        """Whether errors are in sides of the box in every state."""
        return all(form.relative for form in self.states)

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedBoxErrors:
        """The law of each state and the correlation time of errors."""
        box_s, share, white = None, None, white_errors(observed, self.states)
        if self.things_keep:
            noise = vessel_noise(error_lags(observed.labelled, white), resampling, latent_share(white))
            box_s = Entry(Key(("persistence", "box_s")), noise.time_s)
            share = Entry(Key(("persistence", "box_vessel_share")), noise.share)
        elif self.box_s > 0:
            box_s = Entry(Key(("persistence", "box_s")), compared(observed.labelled, white).column(resampling))
        kept, pairs, learned = kept_share(observed, 0.0 if box_s is None else float(box_s.estimate)), observed.pairs, []
        for index, (name, form) in enumerate(zip(observed.states, self.states, strict=True)):
            chosen = pairs.of_source(form.source, form.relative, index)
            errors = pairs.errors(chosen, form.relative)
            sample = ErrorSample(errors, pairs.image[chosen], kept, name, form.unit)
            learned.append(LAWS[form.law].estimate(resampling, sample))
        found = tuple(learned)
        if share is not None:
            found = with_things(found, observed.labelled, white, observed.states, float(share.estimate))
        return LearnedBoxErrors(self, found, box_s, share)


@dataclass(frozen=True, eq=False)
class LearnedBoxErrors:
    """The law of the box error in each state, and the correlation time of errors, None if they do not persist."""

    form: BoxErrorForm
    states: tuple[LearnedLaw, ...]
    box_s: Entry | None
    box_vessel_share: Entry | None = None

    def sections(self) -> dict[str, dict[str, Any]]:
        """The persistence of errors."""
        if self.box_s is None or self.box_s.estimate <= 0:
            return {}
        section = {"box_s": nested(self.box_s.estimate)}
        if self.box_vessel_share is not None:
            section["box_vessel_share"] = nested(self.box_vessel_share.estimate)
        return {"persistence": section}

    def state_section(self, state: int) -> dict[str, Any]:
        """Unit and law of the box error."""
        return {"box_error": {"unit": self.form.states[state].unit, **self.states[state].section()}}


def choose_box_errors(observed: Observed) -> BoxErrorForm:
    """Unit, source and law of the box error of each state, and whether errors persist."""
    notes: list[str] = []
    states = tuple(_state_form(observed, index, notes) for index in range(len(observed.states)))
    box_s = _persistence_s(observed, states, notes)
    states = tuple(_with_law(observed, index, form, box_s, notes) for index, form in enumerate(states))
    things_keep = box_s > 0 and _things_keep(observed, states, notes)
    return BoxErrorForm(states, box_s, tuple(notes), things_keep)


def _state_form(observed: Observed, state: int, notes: list[str]) -> StateErrorForm:
    """Pixels or sides of the box, whichever makes the errors likelier as normal ones."""
    numbers = []
    for source in ErrorSource:
        in_px, in_sides = (observed.pairs.of_source(source, relative, state) for relative in (False, True))
        numbers.append(max(int(in_px.sum()), int(in_sides.sum())))
        if numbers[-1] >= ERRORS_NEEDED:
            break
    if source is not ErrorSource.OWN_STATE:
        edge = ", with boxes at the image's edge" if source is ErrorSource.ALL_PAIRS else ""
        notes.append(
            f"states.{observed.states[state]}.box_error: that of all states{edge}; had {numbers[0]} matches away from "
            f"the image's edge, needs {ERRORS_NEEDED}"
        )
    pairs = observed.pairs
    relative = _likelihood(pairs.error_px[in_sides], pairs.sides_px[in_sides])
    return StateErrorForm("relative" if relative > _likelihood(pairs.error_px[in_px], None) else "px", source)


def _with_law(observed: Observed, state: int, form: StateErrorForm, box_s: float, notes: list[str]) -> StateErrorForm:
    """The form with the law that errors of the state's own follow; normal where those of other states are taken."""
    if form.source is not ErrorSource.OWN_STATE:
        return form
    errors = observed.pairs.errors(observed.pairs.of_source(form.source, form.relative, state), form.relative)
    why = heavy_tails(errors, kept_share(observed, box_s))
    if not why:
        return form
    notes.append(f"states.{observed.states[state]}.box_error: student_t, for {why}")
    return replace(form, law="student_t")


def _likelihood(errors_px: Array, sides_px: Array | None) -> float:
    """Mean log-likelihood of errors (n, 4) as normal ones, in pixels or in sides (n, 4); −∞ from too few."""
    if len(errors_px) < ERRORS_NEEDED:
        return -np.inf
    errors = errors_px if sides_px is None else errors_px / sides_px
    sign, logarithm = np.linalg.slogdet(np.cov(errors.T) + 1e-12 * np.eye(4))
    stretch = 0.0 if sides_px is None else float(np.log(sides_px).sum(axis=1).mean())
    return float(-0.5 * logarithm - stretch) if sign > 0 else np.inf


def _persistence_s(observed: Observed, states: tuple[StateErrorForm, ...], notes: list[str]) -> float:
    """Rough correlation time of errors; 0 with a note if they do not persist, or that is not sure."""
    if not len(observed.steps):
        return 0.0  # which the note on misses says
    consecutive = consecutive_errors(observed, states)
    found = consecutive.correlation()
    if found.persists:
        return consecutive.rough_time_s()
    notes.append(f"persistence.box_s: 0; {found.doubt if len(consecutive) else _why_none(observed, states)}")
    return 0.0


def _things_keep(observed: Observed, states: tuple[StateErrorForm, ...], notes: list[str]) -> bool:
    """Whether each thing surely keeps a share of its errors; a note if not."""
    if "vessels" in observed.without:
        return False
    why = why_none(error_lags(observed.labelled, white_errors(observed, states)))
    if why:
        notes.append(f"persistence.box_vessel_share: 0; {why}")
    return not why


def _why_none(observed: Observed, states: tuple[StateErrorForm, ...]) -> str:
    """Why no two errors can be compared."""
    away = (observed.pairs.of_source(ErrorSource.OWN_STATE, form.relative, k) for k, form in enumerate(states))
    if max(int(chosen.sum()) for chosen in away) < ERRORS_NEEDED:
        return f"no state has {ERRORS_NEEDED} matches away from the image's edge"
    return "nothing has two matches away from the image's edge"


def consecutive_errors(observed: Observed, states: tuple[StateErrorForm, ...]) -> Consecutive:
    """Whitened box errors in consecutive frames."""
    return compared(observed.labelled, white_errors(observed, states))


def white_errors(observed: Observed, states: tuple[StateErrorForm, ...]) -> WhiteErrors:
    """Box errors of states that have enough, whitened by the law of each."""
    pairs = observed.pairs
    white = np.full((len(pairs), 4), np.nan)
    for index, form in enumerate(states):
        chosen = pairs.of_source(ErrorSource.OWN_STATE, form.relative, index)
        if chosen.sum() < ERRORS_NEEDED:
            continue
        white[chosen] = LAWS[form.law].whitened(pairs.errors(chosen, form.relative))
    kept = np.flatnonzero(np.isfinite(white[:, 0]))
    laws = tuple(form.law for form in states)
    return WhiteErrors(pairs.rows[kept], white[kept], pairs.state[kept], laws)
