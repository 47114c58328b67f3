"""The table of detections of format 1, which had centre and size of a box, and called the centre x and y."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from modsim3d.boxes import corner_form
from modsim3d.runs.files.columns import numbers
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM
from modsim3d.runs.files.tables import DETECTIONS

_CENTRE_FORM = dict(zip(CENTRE_FORM, ("x_px", "y_px", "width_px", "height_px"), strict=True))
FORMAT_1_DETECTIONS = pa.schema(
    [
        field.with_name(_CENTRE_FORM.get(field.name, field.name)).remove_metadata()
        for field in DETECTIONS
        if field.name not in BOX_SIDES
    ]
)


def from_format_1(table: pa.Table) -> pa.Table:
    """Rows of format 1 as rows of today's table; the corners are rounded as the centres were."""
    boxes_px = corner_form(np.column_stack([numbers(table, name) for name in _CENTRE_FORM.values()]))
    columns = dict(zip(table.column_names, table.columns, strict=True))
    columns |= {name: columns[former] for name, former in _CENTRE_FORM.items()}
    columns |= {side: pa.array(boxes_px[:, i], from_pandas=True) for i, side in enumerate(BOX_SIDES)}
    return pa.table([columns[name] for name in DETECTIONS.names], schema=DETECTIONS)
