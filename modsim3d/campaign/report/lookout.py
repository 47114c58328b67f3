"""Share of approaches that are known, against the distance, by size of vessel, condition and tracker."""

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise, product

import numpy as np
import pyarrow as pa

from modsim3d.campaign.plan import Case, Plan, key_columns
from modsim3d.campaign.report.words import condition_cells, varying
from modsim3d.campaign.verdicts.known_share import ApproachCounts, counted_approaches
from modsim3d.campaign.verdicts.seed_values import SeedRows
from modsim3d.core.document import Beside, Block, Figure, Heading, Row, Table, Text
from modsim3d.view.pages import charts

DISTANCES_M = (100.0, 200.0, 400.0, 600.0, 900.0, 1200.0, 1600.0, 2000.0, 3000.0)
SIZE_EDGES_M = (0.0, 8.0, 15.0, 50.0, np.inf)
MIN_APPROACHES = 5  # a share of fewer is not drawn
MAX_CURVES = 8  # of a chart; the table has all


def lookout_sections(plan: Plan, table: pa.Table) -> Iterator[Block]:
    """The table and the charts of a campaign with a lookout requirement."""
    asked = {each.known_at_m for each in plan.keys.require if each.known_at_m is not None}
    distances = sorted({*DISTANCES_M, *asked})
    rows, keys, drawn = SeedRows(plan, table), varying(plan), []
    cells: list[Row] = []
    cases = list(product(range(len(plan.conditions)), range(len(plan.keys.trackers))))
    for low, high in pairwise(SIZE_EDGES_M):
        size, curves = f"{low:g} to {high:g} m" if high < np.inf else f"{low:g} m and more", {}
        for condition, tracker in cases:
            found, crashed = rows.approaches(Case(tracker, condition))
            sized = [[each for each in seed if low <= each["length_m"] < high] for seed in found]
            counts = [counted_approaches(sized, crashed, distance) for distance in distances]
            label, values = plan.keys.trackers[tracker].label, condition_cells(plan, condition, keys)
            if any(each.came.sum() for each in counts):
                cells.append((size, label, *values, *(f"{c.known.sum():.0f} of {c.came.sum():.0f}" for c in counts)))
                curves[", ".join([label, *values])] = dict(zip(distances, counts, strict=True))
        drawn += [Figure(partial(_chart, size, curves), "")] if curves else []
    yield Heading("From where on vessels are known")
    yield Text(
        "Approaches that one track followed before the vessel came to a distance, and kept until the closest approach, "
        "of those that were in view beyond it and came so near; vessels that appeared nearer, or never came so near, "
        "are not among them. The charts have means over traffic seeds, where there are at least "
        f"{MIN_APPROACHES} approaches.",
        "soft",
    )
    yield Table("", ("length", "tracker", *key_columns(keys), *(f"{each:g} m" for each in distances)), cells)
    yield Beside(drawn)


def _chart(size: str, curves: Mapping[str, Mapping[float, ApproachCounts]]) -> str:
    axes, content = charts.Axes((0, 1.05 * DISTANCES_M[-1]), (0, 1.14)), ""
    for place, counts in enumerate(list(curves.values())[:MAX_CURVES]):
        shown = [(at_m, each.share) for at_m, each in counts.items() if each.came.sum() >= MIN_APPROACHES]
        x, y = np.array(shown, dtype=np.float64).reshape(-1, 2).T
        content += charts.line(axes, x, y, charts.colour_of(place))
    content += charts.key(list(curves)[:MAX_CURVES], axes.height - 38)
    return axes.drawing(content, f"Vessels of {size}", "distance, m", "share known")
