"""Pictures of vessels in which sources of truth differ."""

from __future__ import annotations

import numpy as np
from PIL import Image

from modsim3d.render.id_pass import IdRenderer
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import image_silhouettes, visible_regions
from modsim3d.verify.compare_findings import VesselDifference
from modsim3d.view.pictures.comparison_picture import comparison_picture
from modsim3d.view.pictures.solids import Solids


def draw_case(scene: Scene, case: VesselDifference, renderer: IdRenderer) -> Image.Image:
    """A case of a comparison: the boxes of all sources, and the pixels that differ."""
    solids = Solids.at(scene, scene.cameras[case.camera], case.step)
    outlines = solids.outlines
    (row,) = np.flatnonzero((outlines.occluder == case.vessel) & outlines.boxed)
    if outlines.convex[row]:
        known = np.flatnonzero(outlines.convex)
        exact = visible_regions(outlines.take(known), solids.intrinsics).visible[known.searchsorted(row)]
        region = "exact region" if len(known) == len(outlines) else "region that only meshes may hide"
    else:  # what is before a mesh is not known exactly
        exact, region = image_silhouettes(outlines.take(np.array([row])), solids.intrinsics)[0], "whole silhouette"
    return comparison_picture(case.boxes_px, case.vessel, solids, exact, renderer, region)


def describe_case(scene: Scene, case: VesselDifference) -> str:
    """What a case shows, where and when."""
    (time,) = scene.timestamps(case.step, case.step + 1)
    return f"{scene.vessel_names[case.vessel]}, {scene.cameras[case.camera].name}, {time} s. {case.reason}"
