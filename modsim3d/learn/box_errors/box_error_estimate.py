"""Box error: its unit and law in each state, and how long errors persist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.learn.box_error_fits.error_fits import ErrorFits
from modsim3d.learn.box_error_fits.error_model import LEAST_DEGREES, ErrorModel, Unit
from modsim3d.learn.box_errors.error_choice import ChosenLaw, choose_law, plain_unit
from modsim3d.learn.box_errors.error_laws import ErrorSample, LearnedErrors, learned_errors
from modsim3d.learn.box_errors.error_noise import error_lags, latent_share, with_things
from modsim3d.learn.box_errors.error_persistence import WhiteErrors, consecutive_errors, white_errors
from modsim3d.learn.box_errors.error_usage import UsedMatches
from modsim3d.learn.numbers.entries import Entry, Key, nested
from modsim3d.learn.numbers.resampling import Resampling
from modsim3d.learn.observed.frames import kept_share
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.observed.pairs import ErrorSource
from modsim3d.learn.persistence.persistence_fit import Consecutive
from modsim3d.learn.persistence.vessel_noise import vessel_noise, why_none

ERRORS_NEEDED = 20
"""Pairs with all sides in the image that the box error of a state needs."""


@dataclass(frozen=True)
class StateErrorForm:
    """The unit of the box error in one state, the pairs it is learned from and the name in `LAWS` of its law."""

    unit: Unit
    source: ErrorSource = ErrorSource.OWN_STATE
    law: str = "normal"


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
        return all(form.unit == "relative" for form in self.states)

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedBoxErrors:
        """The law of each state and the correlation time of errors."""
        fits = [observed.pairs.fits(form.source, index) for index, form in enumerate(self.states)]
        found = [each.chosen(form.unit, form.law != "normal") for each, form in zip(fits, self.states, strict=True)]
        persistence = self._persistence(observed, fits, resampling) if self.box_s > 0 else ErrorPersistence()
        box_s = 0.0 if persistence.box_s is None else float(persistence.box_s.estimate)
        kept, learned, used = kept_share(observed, box_s), [], []
        for index, (name, form) in enumerate(zip(observed.states, self.states, strict=True)):
            edges, fit = fits[index].edges, found[index]
            errors = edges.errors_px / (edges.sides_px if form.unit == "relative" else 1.0)
            learned.append(learned_errors(resampling, ErrorSample(errors, edges.image, kept, name, form.unit, fit)))
            used.append(UsedMatches.of(name, observed.pairs, index, edges, fit))
        states = tuple(learned)
        if persistence.white is not None and persistence.vessel_share is not None:
            share = float(persistence.vessel_share.estimate)
            states = with_things(states, observed.labelled, persistence.white, observed.states, share)
        return LearnedBoxErrors(states, persistence.box_s, persistence.vessel_share, tuple(used))

    def _persistence(self, observed: Observed, fits: Sequence[ErrorFits], resampling: Resampling) -> ErrorPersistence:
        consecutive, models = _consecutive(observed, fits, self.states)
        time, share = Key(("persistence", "box_s")), Key(("persistence", "box_vessel_share"))
        if not self.things_keep:
            return ErrorPersistence(Entry(time, consecutive.column(resampling)))
        white = white_errors(observed, models)
        noise = vessel_noise(error_lags(observed.labelled, white), resampling, latent_share(white))
        return ErrorPersistence(Entry(time, noise.time_s), Entry(share, noise.share), white)


@dataclass(frozen=True, eq=False)
class ErrorPersistence:
    """The correlation time of errors and the share that things keep, None for none; and the errors that show both."""

    box_s: Entry | None = None
    vessel_share: Entry | None = None
    white: WhiteErrors | None = None


def _consecutive(
    observed: Observed, fits: Sequence[ErrorFits], forms: Sequence[StateErrorForm]
) -> tuple[Consecutive, list[ErrorModel | None]]:
    """Errors in consecutive frames by the law of each state, by the plain one if its tails leave nothing to use.

    And those laws.
    """
    heavy = [form.law != "normal" for form in forms]
    models: list[ErrorModel | None] = []
    for tails in (heavy, [False] * len(heavy)):
        models = [
            _own_model(each, form.source, form.unit, tail) for each, form, tail in zip(fits, forms, tails, strict=True)
        ]
        found = consecutive_errors(observed, models)
        if len(found):
            break
    return found, models


def _own_model(fits: ErrorFits, source: ErrorSource, unit: Unit, heavy: bool = False) -> ErrorModel | None:
    """The likeliest distribution of a state's own errors; None where it has too few."""
    fit = fits.chosen(unit, heavy) if source is ErrorSource.OWN_STATE else None
    return None if fit is None else fit.model


@dataclass(frozen=True, eq=False)
class LearnedBoxErrors:
    """The law of the box error in each state, and how errors persist.

    Attributes:
        states: The law in each state.
        box_s: The correlation time of errors, None if they do not persist.
        box_vessel_share: The share that each thing keeps, None if there is none.
        used: Which matches count.
    """

    states: tuple[LearnedErrors, ...]
    box_s: Entry | None
    box_vessel_share: Entry | None
    used: tuple[UsedMatches, ...]

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
        return {"box_error": self.states[state].section()}


def choose_box_errors(observed: Observed) -> BoxErrorForm:
    """Unit, source and law of the box error of each state, and whether errors persist."""
    notes: list[str] = []
    sources = [_source(observed, index, notes) for index in range(len(observed.states))]
    fits = [observed.pairs.fits(source, index) for index, source in enumerate(sources)]
    box_s = _persistence_s(observed, sources, fits, notes)
    kept, forms = kept_share(observed, box_s), []
    for name, source, each in zip(observed.states, sources, fits, strict=True):
        law = ChosenLaw(plain_unit(each, observed.without))
        if source is ErrorSource.OWN_STATE:
            law = choose_law(each, kept, observed.without)
        kind = "student_t" if law.heavy else law.unit
        notes += [f"states.{name}.box_error: {kind}, for {' and '.join(law.reasons)}"] if law.reasons else []
        fit = each.chosen(law.unit, law.heavy)
        if fit is not None and not fit.settled:
            notes.append(
                f"states.{name}.box_error: as if matching cut off nothing; too many boxes fail the matching to tell "
                "how far errors spread beyond it"
            )
        if law.heavy and fit is not None and fit.model.freedom <= LEAST_DEGREES * (1 + 1e-3):
            notes.append(
                f"states.{name}.box_error: degrees_of_freedom at the least that is fitted, {LEAST_DEGREES:g}; tails so "
                "heavy leave the spread of the errors uncertain"
            )
        forms.append(StateErrorForm(law.unit, source, "student_t" if law.heavy else "normal"))
    things_keep = box_s > 0 and _things_keep(observed, fits, forms, notes)
    return BoxErrorForm(tuple(forms), box_s, tuple(notes), things_keep)


def _source(observed: Observed, state: int, notes: list[str]) -> ErrorSource:
    """The first source with enough pairs that have all sides in the image."""
    pairs = observed.pairs
    whole = pairs.edges.whole
    own, every = int(np.count_nonzero(whole & (pairs.state == state))), int(np.count_nonzero(whole))
    name = observed.states[state]
    if own >= ERRORS_NEEDED:
        ours = pairs.state == state
        unused = ours & ~pairs.edges.usable
        hidden = 0 if pairs.unsure is None else int(np.count_nonzero(unused & pairs.unsure))
        if count := int(np.count_nonzero(unused)):
            matches = int(np.count_nonzero(ours))
            why = [f"{count - hidden:,} with all sides cut by the image's edge"] if count > hidden else []
            why += [f"{hidden:,} partly hidden, where positions are not surely known"] if hidden else []
            notes.append(
                f"states.{name}.box_error: from {matches - count:,} of {matches:,} matches; {' and '.join(why)}"
            )
        return ErrorSource.OWN_STATE
    source = ErrorSource.ALL_STATES if every >= ERRORS_NEEDED else ErrorSource.ALL_PAIRS
    cut = ", with sides that the image's edge cuts" if source is ErrorSource.ALL_PAIRS else ""
    surely = "" if pairs.unsure is None or not pairs.unsure.any() else " and surely not hidden"
    notes.append(
        f"states.{name}.box_error: that of all states{cut}; had {own} matches with all sides inside the image{surely}, "
        f"needs {ERRORS_NEEDED}"
    )
    return source


def _persistence_s(observed: Observed, sources: list[ErrorSource], fits: list[ErrorFits], notes: list[str]) -> float:
    """Rough correlation time of errors; 0 with a note if they do not persist, or that is not sure."""
    if not len(observed.steps) or "persistence" in observed.without:
        return 0.0  # which the note on misses says
    models = [
        _own_model(each, source, plain_unit(each, observed.without)) for source, each in zip(sources, fits, strict=True)
    ]
    consecutive = consecutive_errors(observed, models)
    found = consecutive.correlation()
    if found.persists:
        return consecutive.rough_time_s()
    notes.append(f"persistence.box_s: 0; {found.doubt if len(consecutive) else _why_none(sources)}")
    return 0.0


def _things_keep(
    observed: Observed, fits: Sequence[ErrorFits], forms: Sequence[StateErrorForm], notes: list[str]
) -> bool:
    """Whether each thing surely keeps a share of its errors; a note if not."""
    if "vessels" in observed.without:
        return False
    white = white_errors(observed, _consecutive(observed, fits, forms)[1])
    why = why_none(error_lags(observed.labelled, white))
    if why:
        notes.append(f"persistence.box_vessel_share: 0; {why}")
    return not why


def _why_none(sources: list[ErrorSource]) -> str:
    """Why no two errors can be compared."""
    if ErrorSource.OWN_STATE not in sources:
        return f"no state has {ERRORS_NEEDED} matches with all sides inside the image"
    return "nothing has two matches with the same side far inside the image"
