"""Box error: its unit and law in each state, and how long errors persist."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.text import in_percent
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn import bootstrap
from modsim3d.learn.box_errors import persistence
from modsim3d.learn.box_errors.fit import ErrorFit
from modsim3d.learn.box_errors.laws import ChosenLaw, ErrorSample, LearnedErrors, choose_law, learned_errors, plain_unit
from modsim3d.learn.box_errors.matched_edges import MIN_DEGREES, ErrorModel, MatchedEdges, Unit
from modsim3d.learn.lags import LagTable, vessel_noise, why_none
from modsim3d.learn.matches import ErrorFits, ErrorSource, Outcomes, Pairs, kept_share
from modsim3d.learn.persistence import Consecutive

# ---- Which matches the box error of a state was learned from ----


@dataclass(frozen=True)
class UsedMatches:
    """Numbers of matches of a state."""

    state: str  # name of the state
    matches: int  # all matches of the state
    used: int  # matches that count, of other states too where the state has too few
    cut: int  # of these, those with a true side that the image's edge cuts
    censored: int  # of these, those with a detected side on the image's edge and the true one inside
    lost: float  # boxes that the distribution says failed the matching, for each that matches
    settled: bool = True  # whether so few failed, or were drawn anew, that the distribution tells how far errors spread

    @classmethod
    def of(cls, state: str, pairs: Pairs, index: int, edges: MatchedEdges, fit: ErrorFit | None) -> UsedMatches:
        """From the boxes that were learned from and the fit."""
        lost = 0.0
        if fit is not None and fit.gate is not None:
            lost = float(np.expm1(-fit.gate.passing(fit.model)[0]).mean())
        return cls(
            state,
            int(np.count_nonzero(pairs.state == index)),
            len(edges),
            int(np.count_nonzero(~edges.counted.all(axis=1))),
            int(np.count_nonzero(edges.censored.any(axis=1))),
            lost,
            fit is None or fit.settled,
        )

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table."""
        share = self.lost / (1 + self.lost)
        return (
            self.state,
            f"{self.matches:,}",
            f"{self.used:,}",
            f"{self.cut:,}",
            f"{self.censored:,}",
            in_percent(share, 1) if share > 5e-4 else "–",
        )


TITLE = "Matches behind the box errors of the detector file"
HEADER = (
    "state",
    "matches",
    "used",
    "with a side cut by the image's edge, left out",
    "with a side detected on the image's edge",
    "boxes that fail the matching, by the fit",
)


# ---- Box errors of which each thing keeps a share for as long as it is seen ----

T = TypeVar("T")
_SHARES = np.linspace(0, 0.99, 100)
_MEAN, _STD, _CORRELATION = "box_error_mean", "box_error_std", "box_error_correlation"


def error_lags(labelled: LabelledSet, errors: persistence.WhiteErrors) -> LagTable:
    """Products of whitened errors at all times between, means over the four components."""
    white = errors.white
    square = (white**2).mean(axis=1)

    def compare(earlier: Indices, later: Indices) -> tuple[Array, Array]:
        return (white[earlier] * white[later]).mean(axis=1), (square[earlier] + square[later]) / 2

    return LagTable.of(labelled, errors.rows, errors.state, compare)


def latent_share(errors: persistence.WhiteErrors) -> Callable[[Array], Array]:
    """Function from the correlation of errors to the share of the latent normal numbers that things keep."""
    heavy = errors.heavy[int(np.bincount(errors.state).argmax())]
    level = _SHARES * persistence.correlation_left(_SHARES, np.full(len(_SHARES), 4)) if heavy else _SHARES
    return lambda correlation: np.interp(correlation, level, _SHARES)


def with_things(
    learned: T, labelled: LabelledSet, errors: persistence.WhiteErrors, states: tuple[str, ...], share: float
) -> T:
    """Learned errors whose replicates spread as far as things that keep a share make the numbers stray: means by the
    share of a variance, spreads and correlations, made of squares, by its square, over as many things as there are."""
    annotations, images = labelled.annotations, labelled.images
    things = errors.state, images.sequence[annotations.image[errors.rows]], annotations.identity[errors.rows]
    keys, count = np.unique(np.column_stack(things), axis=0, return_counts=True)
    squares, whole = (np.bincount(keys[:, 0], count**power, minlength=len(states)) for power in (2, 1))
    crowding = dict(zip(states, squares / np.maximum(whole, 1) ** 2, strict=True))
    stds = {entry.key.state: entry.estimate for entry in bootstrap.entries_of(learned) if entry.key.names == (_STD,)}

    def change(entry: bootstrap.Entry) -> bootstrap.Entry:
        state, name = entry.key.state, entry.key.names[0]
        if state is None or name not in (_MEAN, _STD, _CORRELATION):
            return entry
        extra = {_MEAN: share * stds[state] ** 2, _STD: share**2 / 2, _CORRELATION: share**2}[name]
        column = entry.column
        scaled = bootstrap.to_scale(column.values, column.kind)
        variance = bootstrap.spread(scaled[1:]) ** 2
        usable = np.isfinite(variance) & (variance > 0)
        wider = np.where(usable, np.sqrt(1 + extra * crowding[state] / np.where(usable, variance, 1.0)), 1.0)
        values = bootstrap.from_scale(scaled[0] + wider * (scaled - scaled[0]), column.kind)
        return bootstrap.Entry(entry.key, replace(column, values=values))

    return bootstrap.with_entries(learned, change)


ERRORS_NEEDED = 20  # pairs with all sides in the image that the box error of a state needs


@dataclass(frozen=True)
class StateErrorForm:
    """The unit of the box error in one state, the pairs it is learned from and the name in `LAWS` of its law."""

    unit: Unit
    source: ErrorSource = ErrorSource.OWN_STATE
    law: str = "normal"


@dataclass(frozen=True)
class BoxErrorForm:
    """The model of the box error in each state, and the rough correlation time of errors, 0 if they do not persist.
    `things_keep` says whether each thing keeps a share of the errors for as long as it is seen, and `components`
    whether each component has a memory of its own."""

    states: tuple[StateErrorForm, ...]
    box_s: float
    notes: tuple[str, ...]
    things_keep: bool = False
    components: bool = False

    @property
    def relative(self) -> bool:
        """Whether errors are in sides of the box in every state."""
        return all(form.unit == "relative" for form in self.states)

    def estimate(self, observed: Outcomes, resampling: bootstrap.Resampling) -> LearnedBoxErrors:
        """The law of each state and the correlation time of errors."""
        fits = [observed.pairs.fits(form.source, index) for index, form in enumerate(self.states)]
        pairs = zip(fits, self.states, strict=True)
        best = [state_fits.chosen(form.unit, form.law != "normal") for state_fits, form in pairs]
        persisting = self._persistence(observed, fits, resampling) if self.box_s > 0 else ErrorPersistence()
        box_s = 0.0 if persisting.box_s is None else float(persisting.box_s.estimate)
        kept, learned, used = kept_share(observed, box_s), [], []
        for index, (name, form) in enumerate(zip(observed.states, self.states, strict=True)):
            edges, fit = fits[index].edges, best[index]
            errors = edges.errors_px / (edges.sides_px if form.unit == "relative" else 1.0)
            learned.append(learned_errors(resampling, ErrorSample(errors, edges.image, kept, name, form.unit, fit)))
            used.append(UsedMatches.of(name, observed.pairs, index, edges, fit))
        states = tuple(learned)
        if persisting.white is not None and persisting.vessel_share is not None:
            share = float(persisting.vessel_share.estimate)
            states = with_things(states, observed.labelled, persisting.white, observed.states, share)
        if persisting.memory is not None:
            return LearnedBoxErrors(states, None, None, tuple(used), persisting.memory)
        return LearnedBoxErrors(states, persisting.box_s, persisting.vessel_share, tuple(used))

    def _persistence(
        self, observed: Outcomes, fits: Sequence[ErrorFits], resampling: bootstrap.Resampling
    ) -> ErrorPersistence:
        consecutive, models = _consecutive(observed, fits, self.states)
        time, share = bootstrap.Key(("persistence", "box_s")), bootstrap.Key(("persistence", "box_vessel_share"))
        memory = None
        if self.components:
            memory = persistence.component_memory(*persistence.component_lags(observed, models), resampling)
        if not self.things_keep:
            return ErrorPersistence(bootstrap.Entry(time, consecutive.column(resampling)), memory=memory)
        white = persistence.white_errors(observed, models)
        noise = vessel_noise(error_lags(observed.labelled, white), resampling, latent_share(white))
        return ErrorPersistence(bootstrap.Entry(time, noise.time_s), bootstrap.Entry(share, noise.share), white, memory)


@dataclass(frozen=True, eq=False)
class ErrorPersistence:
    """The correlation time of errors and the share that things keep, None for none; and the errors that show both."""

    box_s: bootstrap.Entry | None = None
    vessel_share: bootstrap.Entry | None = None
    white: persistence.WhiteErrors | None = None
    memory: persistence.ComponentMemory | None = None


def _consecutive(
    observed: Outcomes, fits: Sequence[ErrorFits], forms: Sequence[StateErrorForm]
) -> tuple[Consecutive, list[ErrorModel | None]]:
    """Errors in consecutive frames by each state's law, or the plain one if its tails leave nothing; and those laws."""
    models: list[ErrorModel | None] = []
    for laws in ([form.law for form in forms], ["normal"] * len(forms)):
        models = [
            _own_model(state_fits, form.source, form.unit, law)
            for state_fits, form, law in zip(fits, forms, laws, strict=True)
        ]
        consecutive = persistence.consecutive_errors(observed, models)
        if len(consecutive):
            break
    return consecutive, models


def _own_model(fits: ErrorFits, source: ErrorSource, unit: Unit, law: str = "normal") -> ErrorModel | None:
    """The likeliest distribution of a state's own errors; None where it has too few."""
    fit = fits.chosen(unit, law != "normal") if source is ErrorSource.OWN_STATE else None
    return None if fit is None else fit.model


@dataclass(frozen=True, eq=False)
class LearnedBoxErrors:
    """The law of the box error in each state, and how errors persist."""

    states: tuple[LearnedErrors, ...]  # the law in each state
    box_s: bootstrap.Entry | None  # the correlation time of errors, None if they do not persist
    box_vessel_share: bootstrap.Entry | None  # the share that each thing keeps, None if there is none
    used: tuple[UsedMatches, ...]  # which matches count
    memory: persistence.ComponentMemory | None = None

    def sections(self) -> dict[str, dict[str, Any]]:
        """The persistence of errors."""
        if self.memory is not None:
            return {"persistence": {"box": self.memory.section()}}
        if self.box_s is None or self.box_s.estimate <= 0:
            return {}
        section = {"box_s": bootstrap.nested(self.box_s.estimate)}
        if self.box_vessel_share is not None:
            section["box_vessel_share"] = bootstrap.nested(self.box_vessel_share.estimate)
        return {"persistence": section}

    def state_section(self, state: int) -> dict[str, Any]:
        """Unit and law of the box error."""
        return {"box_error": self.states[state].section()}


def choose_box_errors(observed: Outcomes) -> BoxErrorForm:
    """Unit, source and law of the box error of each state, and whether errors persist."""
    notes: list[str] = []
    sources = [_source(observed, index, notes) for index in range(len(observed.states))]
    fits = [observed.pairs.fits(source, index) for index, source in enumerate(sources)]
    box_s = _persistence_s(observed, sources, fits, notes)
    kept, forms = kept_share(observed, box_s), []
    for name, source, state_fits in zip(observed.states, sources, fits, strict=True):
        law = ChosenLaw(plain_unit(state_fits, observed.without))
        if source is ErrorSource.OWN_STATE:
            law = choose_law(state_fits, kept, observed.without)
        kind = law.unit if law.law == "normal" else law.law
        notes += [f"states.{name}.box_error: {kind}, for {' and '.join(law.reasons)}"] if law.reasons else []
        fit = state_fits.chosen(law.unit, law.heavy)
        if fit is not None and not fit.settled:
            notes.append(
                f"states.{name}.box_error: as if matching cut off nothing; too many boxes fail the matching to tell "
                "how far errors spread beyond it"
            )
        if law.heavy and fit is not None and fit.model.freedom <= MIN_DEGREES * (1 + 1e-3):
            notes.append(
                f"states.{name}.box_error: degrees_of_freedom at the least that is fitted, {MIN_DEGREES:g}; tails so "
                "heavy leave the spread of the errors uncertain"
            )
        forms.append(StateErrorForm(law.unit, source, law.law))
    things_keep = box_s > 0 and _things_keep(observed, fits, forms, notes)
    components = False
    if box_s > 0 and not {"vessels", "components"} & observed.without:
        components = persistence.components_differ(
            persistence.component_lags(observed, _consecutive(observed, fits, forms)[1])[0]
        )
    return BoxErrorForm(tuple(forms), box_s, tuple(notes), things_keep, components)


def _source(observed: Outcomes, state: int, notes: list[str]) -> ErrorSource:
    pairs = observed.pairs
    whole = pairs.edges.whole
    own, every = int(np.count_nonzero(whole & (pairs.state == state))), int(np.count_nonzero(whole))
    name = observed.states[state]
    if own >= ERRORS_NEEDED:
        in_state = pairs.state == state
        unused = in_state & ~pairs.edges.usable
        hidden = 0 if pairs.unsure is None else int(np.count_nonzero(unused & pairs.unsure))
        if count := int(np.count_nonzero(unused)):
            matches = int(np.count_nonzero(in_state))
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


def _persistence_s(observed: Outcomes, sources: list[ErrorSource], fits: list[ErrorFits], notes: list[str]) -> float:
    """Rough correlation time of errors; 0 with a note if they do not persist, or that is not sure."""
    if not len(observed.steps) or "persistence" in observed.without:
        return 0.0  # which the note on misses says
    models = [
        _own_model(state_fits, source, plain_unit(state_fits, observed.without))
        for source, state_fits in zip(sources, fits, strict=True)
    ]
    consecutive = persistence.consecutive_errors(observed, models)
    correlation = consecutive.correlation()
    if correlation.persists:
        return consecutive.rough_time_s()
    notes.append(f"persistence.box_s: 0; {correlation.doubt if len(consecutive) else _why_none(sources)}")
    return 0.0


def _things_keep(
    observed: Outcomes, fits: Sequence[ErrorFits], forms: Sequence[StateErrorForm], notes: list[str]
) -> bool:
    """Whether each thing surely keeps a share of its errors; a note if not."""
    if "vessels" in observed.without:
        return False
    white = persistence.white_errors(observed, _consecutive(observed, fits, forms)[1])
    why = why_none(error_lags(observed.labelled, white))
    if why:
        notes.append(f"persistence.box_vessel_share: 0; {why}")
    return not why


def _why_none(sources: list[ErrorSource]) -> str:
    if ErrorSource.OWN_STATE not in sources:
        return f"no state has {ERRORS_NEEDED} matches with all sides inside the image"
    return "nothing has two matches with the same side far inside the image"
