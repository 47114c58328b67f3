"""Truth from corner projection alone, without a renderer."""

from __future__ import annotations

import numpy as np

from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.record import Occlusion


def analytic_occlusion(outlines: Outlines) -> Occlusion:
    """Full boxes and silhouette areas; what is visible is left open (NaN).

    Args:
        outlines: The vessels in front of the camera.
    """
    unknown = np.full(len(outlines), np.nan)
    return Occlusion(
        full_boxes_px=outlines.boxes_px,
        visible_boxes_px=np.full((len(outlines), 4), np.nan),
        silhouette_px=outlines.areas_px,
        visible_px=unknown,
        occluders=((),) * len(outlines),
    )
