"""Judges the requirements of a campaign on its rows."""

from __future__ import annotations

import pyarrow as pa

from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.verdicts.verdict import Verdict


def judged(plan: Plan, table: pa.Table) -> tuple[Verdict, ...]:
    """A verdict for each requirement, tracker and condition that it is about.

    Args:
        plan: The plan.
        table: The rows so far: whole traffic seeds from the first on, see `results_table`.
    """
    return ()
