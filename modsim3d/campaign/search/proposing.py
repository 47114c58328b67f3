"""Proposes the next batch of points, by the tree-structured Parzen estimator of Optuna.

A batch depends on the campaign's seed, its own number and what came of the batches before it, and on nothing else: so
a search that goes on after an interruption proposes what it would have proposed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from modsim3d.campaign.file.keys import SearchKeys
from modsim3d.campaign.search.space import Point, distributions, parameters_of, point_of
from modsim3d.campaign.work.digests import digest

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial


@dataclass(frozen=True)
class Tried:
    """A point and what came of it.

    Attributes:
        point: The point.
        value: The score; None if the scene refuses the point, or there is nothing to be scored.
        crashed: Whether the run crashed.
    """

    point: Point
    value: float | None
    crashed: bool = False


def proposed(search: SearchKeys, seed: int, batch: int, tried: Sequence[Tried]) -> list[Point]:
    """The points of a batch.

    The points of one batch keep away from each other: each counts as bad until its score is known (`constant_liar`).
    The estimator avoids points without a score. Crashed runs do not steer it, or the rest of the budget would be spent
    on one crash.

    Args:
        search: The search.
        seed: Seed of the campaign.
        batch: Number of the batch, from 0.
        tried: All points of the batches before it.
    """
    import optuna

    space = distributions(search)
    own_seed = int(digest("search", seed, batch)[:8], 16)
    with _quiet():
        study = optuna.create_study(
            direction="minimize" if search.minimise is not None else "maximize",
            sampler=optuna.samplers.TPESampler(seed=own_seed, multivariate=True, constant_liar=True),
        )
    study.add_trials([_trial(each, search) for each in tried])
    count = min(search.batch, search.budget - batch * search.batch)
    return [point_of(study.ask(space).params, search) for _ in range(count)]


def _trial(tried: Tried, search: SearchKeys) -> FrozenTrial:
    from optuna.trial import TrialState, create_trial

    scored = TrialState.PRUNED if tried.value is None else TrialState.COMPLETE
    state = TrialState.FAIL if tried.crashed else scored
    return create_trial(
        state=state,
        value=tried.value if state is TrialState.COMPLETE else None,
        params=parameters_of(tried.point, search),
        distributions=distributions(search),
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Without Optuna's line about a new study."""
    from optuna import logging

    before = logging.get_verbosity()
    logging.set_verbosity(logging.WARNING)
    try:
        yield
    finally:
        logging.set_verbosity(before)
