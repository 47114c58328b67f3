"""Can a classifier tell a real detector's output from simulated output of the same films, and by what?

A gradient-boosted classifier is shown frames, or tracks, of both and of the same truth. It is always asked about films
that it did not learn from: a film's real and simulated versions are in the same fold. The AUC is the probability that
of a real row and a simulated one of the same film the real one is taken for the more likely to be real, so that what
films differ in by themselves does not count. 0.5 is a coin's toss. Real and simulated rows have the same weight,
however many seeds there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import norm, rankdata, t

from benchmarks.stand_in.features import Table, frame_features, stacked, track_features
from benchmarks.stand_in.sighted import Sighted
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import LabelledSet

FOLDS, MIN_FILMS = 8, 3
RESAMPLED, LEVEL = 2000, 0.95
PERMUTATIONS = 3
SHARED = np.sqrt(2.0)
"""Each film is judged by a classifier that learned from the others, so chance that two films share helps both: among
detectors that are alike the AUC varies so much more than independent films would let it (24 trials: 1.44)."""
CLASSIFIER = {"max_iter": 120, "learning_rate": 0.06, "max_leaf_nodes": 8, "l2_regularization": 1.0}
"""Settings of HistGradientBoostingClassifier, fixed beforehand."""
MIN_LEAF = {"frames": 40, "tracks": 10}
"""Least number of rows in a leaf."""
SHOWN_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
KINDS = {"frames": frame_features, "tracks": track_features}


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of all films, real and simulated.

    Attributes:
        table: The features, n rows.
        film: Index of the film of each row, shape (n,).
        real: Whether each row is of the real detector, shape (n,).
        films: Number of films.
        seeds: Number of seeds of the simulated detector.
    """

    table: Table
    film: Indices
    real: Mask
    films: int
    seeds: int

    @cached_property
    def film_weight(self) -> Array:
        """Number of real rows of each film, shape (films,)."""
        return np.bincount(self.film[self.real], minlength=self.films).astype(np.float64)


def tell_apart(
    films: Sequence[str],
    real: Mapping[str, LabelledSet],
    simulated: Mapping[str, Sequence[LabelledSet]],
    threshold: float,
    *,
    kinds: Sequence[str] = tuple(KINDS),
    importance: bool = True,
    seed: int = 0,
) -> dict[str, Any]:
    """How well frames and tracks of the real detector can be told from simulated ones of the same films.

    Args:
        films: Names of the films.
        real: Name of a film → its truth with the real detector's output.
        simulated: Name of a film → the same truth with the output of each seed of the simulated detector. Each film
            needs seeds of its own: a seed deals the same noise in every film, which a classifier learns in some and
            knows again in others (by that alone a detector is told from itself with an AUC of 0.60).
        threshold: Least confidence of a detection, the same for both.
        kinds: `frames`, `tracks` or both.
        importance: Whether to say which features tell.
        seed: Of the classifier, the resampling and the permutations.

    Returns:
        For each kind `auc`, its 95 % interval `low` and `high` from resampled films, `films`, `rows` of the
        real detector, and with `importance` also `groups` and `features`, those that tell most first; see `_told_by`.

    Raises:
        ModsimError: There are fewer than three films.
    """
    return {
        kind: _told(_rows(kind, films, real, simulated, threshold), MIN_LEAF[kind], importance, seed) for kind in kinds
    }


def between_seeds(
    films: Sequence[str],
    simulated: Mapping[str, Sequence[LabelledSet]],
    threshold: float,
    *,
    kinds: Sequence[str] = tuple(KINDS),
    seed: int = 0,
) -> dict[str, Any]:
    """The check of the test itself: each seed of a simulated detector against its other seeds, which nothing can tell.

    Returns:
        For each kind the mean `auc`, which is 0.5 but for chance, and the AUC of each seed, `aucs`.
    """
    found: dict[str, list[float]] = {kind: [] for kind in kinds}
    for k in range(len(simulated[films[0]])):
        one = {name: simulated[name][k] for name in films}
        others = {name: [each for j, each in enumerate(simulated[name]) if j != k] for name in films}
        told = tell_apart(films, one, others, threshold, kinds=kinds, importance=False, seed=seed)
        for kind in kinds:
            found[kind].append(told[kind]["auc"])
    return {kind: {"auc": round(float(np.mean(aucs)), 4), "aucs": aucs} for kind, aucs in found.items()}


def _rows(
    kind: str,
    films: Sequence[str],
    real: Mapping[str, LabelledSet],
    simulated: Mapping[str, Sequence[LabelledSet]],
    threshold: float,
) -> Rows:
    """Features of all films; films without a row, as those without a vessel have no track, are left out."""
    tables, film, is_real, number = [], [], [], 0
    for name in films:
        versions = [real[name], *simulated[name]]
        found = [KINDS[kind](Sighted.of(each, threshold)) for each in versions]
        if not len(found[0].values):
            continue
        for k, table in enumerate(found):
            tables.append(table)
            film.append(np.full(len(table.values), number))
            is_real.append(np.full(len(table.values), k == 0))
        number += 1
    if number < MIN_FILMS:
        raise ModsimError(f"at least {MIN_FILMS} films with {kind} are needed to tell them apart (got {number})")
    return Rows(stacked(tables), np.concatenate(film), np.concatenate(is_real), number, len(simulated[films[0]]))


def _told(rows: Rows, least_leaf: int, importance: bool, seed: int) -> dict[str, Any]:
    """The result of one kind of row."""
    folds = list(_folds(rows, least_leaf, seed))
    by_film = _auc_by_film(rows, _scores(rows, folds))
    auc, low, high = _interval(rows, by_film, seed)
    result: dict[str, Any] = {
        "auc": round(auc, 4),
        "low": round(low, 4),
        "high": round(high, 4),
        "films": rows.films,
        "rows": int(rows.real.sum()),
    }
    return result | (_told_by(rows, folds, auc, least_leaf, seed) if importance else {})


@dataclass(frozen=True, eq=False)
class Fold:
    """A classifier and the rows that it did not learn from."""

    classifier: Any
    rows: Indices


def _folds(rows: Rows, least_leaf: int, seed: int, columns: Indices | None = None) -> Iterator[Fold]:
    """A classifier for each fold; films are dealt to folds in turn, so that neighbours in the list are apart.

    Real rows are repeated, a copy for each seed, so that both are as many: `sample_weight` costs 13 times as much.
    On one thread: several wait for each other on tables so small, 15 times as long where the CPUs are busy.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier  # type: ignore[import-untyped]

    # It limits only what is imported before.
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    fold = rows.film % min(FOLDS, rows.films)
    values = rows.table.values if columns is None else rows.table.values[:, columns]
    for k in np.unique(fold):
        learned = np.flatnonzero(fold != k)
        learned = np.concatenate([learned, np.repeat(learned[rows.real[learned]], rows.seeds - 1)])
        classifier = HistGradientBoostingClassifier(
            **CLASSIFIER, min_samples_leaf=least_leaf * rows.seeds, early_stopping=False, random_state=seed
        )
        with threadpool_limits(1):
            classifier.fit(_known_somewhere(values[learned]), rows.real[learned])
        yield Fold(classifier, np.flatnonzero(fold == k))


def _known_somewhere(values: Array) -> Array:
    """Columns that are known in no row are 0 everywhere, which the classifier can bin, shape (n, k)."""
    return np.where(np.isnan(values).all(axis=0), 0.0, values)


def _scores(rows: Rows, folds: Sequence[Fold], values: Array | None = None) -> Array:
    """How real each row looks to the classifier that has not seen its film, shape (n,)."""
    from threadpoolctl import threadpool_limits

    values = rows.table.values if values is None else values
    scores = np.empty(len(values))
    with threadpool_limits(1):
        for fold in folds:
            scores[fold.rows] = fold.classifier.decision_function(values[fold.rows])
    return scores


def _auc_by_film(rows: Rows, scores: Array) -> Array:
    """The AUC in each film, over the rows whose score is known; NaN without a pair, shape (films,)."""
    found = np.full(rows.films, np.nan)
    for film in range(rows.films):
        chosen = (rows.film == film) & np.isfinite(scores)
        real, ranks = rows.real[chosen], rankdata(scores[chosen])
        ours, theirs = int(real.sum()), int((~real).sum())
        if ours and theirs:
            found[film] = (ranks[real].sum() - ours * (ours + 1) / 2) / (ours * theirs)
    return found


def _mean_auc(rows: Rows, by_film: Array) -> float:
    """The mean over films, each as heavy as it has rows; 0.5 where no film has a pair."""
    known = np.isfinite(by_film)
    return float(np.average(by_film[known], weights=rows.film_weight[known])) if known.any() else 0.5


def _interval(rows: Rows, by_film: Array, seed: int) -> tuple[float, float, float]:
    """The mean AUC and its interval: a bootstrap over films, wider as Student's is for few, and by `SHARED`."""
    known = np.flatnonzero(np.isfinite(by_film))
    drawn = known[np.random.default_rng(seed).integers(0, len(known), (RESAMPLED, len(known)))]
    weight = rows.film_weight[drawn]
    means = (by_film[drawn] * weight).sum(axis=1) / weight.sum(axis=1)
    auc, count = _mean_auc(rows, by_film), len(known)
    wider = SHARED * t.ppf((1 + LEVEL) / 2, count - 1) / norm.ppf((1 + LEVEL) / 2) * np.sqrt(count / (count - 1))
    low, high = np.clip(auc + wider * (np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) - auc), 0, 1)
    return auc, float(low), float(high)


def _told_by(rows: Rows, folds: Sequence[Fold], auc: float, least_leaf: int, seed: int) -> dict[str, Any]:
    """By what rows are told apart.

    `groups`: of misses, box errors, ... the AUC of a classifier that sees these alone beside the scene (`alone`), and
    by how much the AUC of the whole one falls where they are permuted among the rows of a film (`importance`).
    `features`: of each one the `importance`; the AUC of its bare value (`alone`: above 0.5 the real detector has more
    of it); the largest distance between the two cumulative distributions (`distance`); and the quantiles of both.
    """
    rng = np.random.default_rng(seed)
    groups = np.array(rows.table.groups)
    scene = groups == "scene"

    def fall(columns: Indices) -> float:
        """By how much the AUC falls without what some columns tell."""
        falls = []
        for _ in range(PERMUTATIONS):
            values = rows.table.values.copy()
            for film in range(rows.films):
                own = np.flatnonzero(rows.film == film)
                values[np.ix_(own, columns)] = values[np.ix_(rng.permutation(own), columns)]
            falls.append(auc - _mean_auc(rows, _auc_by_film(rows, _scores(rows, folds, values))))
        return round(float(np.mean(falls)), 4)

    about = {}
    for group in dict.fromkeys(rows.table.groups):
        if group == "scene":
            continue
        columns = np.flatnonzero((groups == group) | scene)
        own = list(_folds(rows, least_leaf, seed, columns))
        alone = _mean_auc(rows, _auc_by_film(rows, _scores(rows, own, rows.table.values[:, columns])))
        about[group] = {"alone": round(alone, 4), "importance": fall(np.flatnonzero(groups == group))}
    features = [
        {"name": name, "group": rows.table.groups[k], "importance": fall(np.array([k])), **_alone(rows, k)}
        for k, name in enumerate(rows.table.names)
        if not scene[k]
    ]
    features.sort(key=lambda each: -each["importance"])
    return {
        "groups": dict(sorted(about.items(), key=lambda each: -each[1]["alone"])),
        "features": features,
    }


def _alone(rows: Rows, column: int) -> dict[str, Any]:
    """What one feature tells by its bare value, and how it is distributed on both sides."""
    values = rows.table.values[:, column]
    known = np.isfinite(values)
    sides = [values[known & (rows.real == real)] for real in (True, False)]
    quantiles = [np.quantile(each, SHOWN_QUANTILES).tolist() if len(each) else None for each in sides]
    return {
        "alone": round(_mean_auc(rows, _auc_by_film(rows, values)), 4),
        "distance": round(_distance(*sides), 4),
        "real": quantiles[0] and [round(each, 4) for each in quantiles[0]],
        "simulated": quantiles[1] and [round(each, 4) for each in quantiles[1]],
    }


def _distance(a: Array, b: Array) -> float:
    """The largest distance between two cumulative distributions; 0 where one is not known."""
    if not len(a) or not len(b):
        return 0.0
    at = np.concatenate([a, b])
    both = (np.searchsorted(np.sort(each), at, side="right") / len(each) for each in (a, b))
    return float(np.abs(next(both) - next(both)).max())
