"""Pictures of a run: joins what was simulated with how it is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.annotate.analytic import image_silhouettes, visible_regions
from modsim3d.block import frames_of
from modsim3d.compare import Case
from modsim3d.detector.reference import Reference
from modsim3d.render.id_pass import IdRenderer, Ids
from modsim3d.render.plain_ids import PlainIds
from modsim3d.scene import Scene
from modsim3d.simulate import Simulation, open_renderer, truth_block
from modsim3d.view.comparison_picture import comparison_picture
from modsim3d.view.contact_sheet import contact_sheet
from modsim3d.view.frame_picture import CameraView
from modsim3d.view.highlights import Highlight
from modsim3d.view.solids import Solids
from modsim3d.view.window import Window

SHEET_FILE = "contact_sheet.png"


def id_image(scene: Scene, camera_index: int, step: int, renderer: IdRenderer) -> Ids:
    """The whole ID image of a camera at a step: vessel index + 1, zero where no vessel is."""
    solids = Solids.at(scene, scene.cameras[camera_index], step)
    return solids.ids(Window(0.0, 0.0, 1.0, solids.intrinsics.image_size_px), renderer)


def draw_case(scene: Scene, case: Case, renderer: IdRenderer) -> Image.Image:
    """A case of a comparison: the boxes of all sources, and the pixels that differ."""
    solids = Solids.at(scene, scene.cameras[case.camera], case.step)
    outlines = solids.outlines
    (row,) = np.flatnonzero((outlines.vessel == case.vessel) & outlines.boxed)
    if outlines.convex[row]:
        known = np.flatnonzero(outlines.convex)
        exact = visible_regions(outlines.take(known), solids.intrinsics).visible[known.searchsorted(row)]
        region = "exact region" if len(known) == len(outlines) else "region that only meshes may hide"
    else:  # what is before a mesh is not known exactly
        exact, region = image_silhouettes(outlines.take(np.array([row])), solids.intrinsics)[0], "whole silhouette"
    return comparison_picture(case.boxes_px, case.vessel, solids, exact, renderer, region)


def describe_case(scene: Scene, case: Case) -> str:
    """What a case shows, where and when."""
    (time,) = scene.timestamps(case.step, case.step + 1)
    return f"{scene.vessel_names[case.vessel]}, {scene.cameras[case.camera].name}, {time} s. {case.reason}"


def draw_contact_sheet(scene: Scene, folder: Path, reference: Reference | None = None) -> Path:
    """Draw a finished run's contact sheet into its folder.

    Args:
        scene: What was run.
        folder: The run directory.
        reference: What the run's detector had to know of the whole scene, from `RunResult`.

    Returns:
        The PNG's path.
    """
    simulation = Simulation(scene, reference)
    with open_renderer(scene) as renderer:

        def camera_view_of(highlight: Highlight) -> CameraView:
            step = highlight.step
            block = simulation.detect(truth_block(scene, step, step + 1, renderer), step, step + 1)
            (frame,) = (frame for frame in frames_of(block, scene) if frame.camera == highlight.camera)
            return CameraView.of(scene, frame)

        title = (
            f"{scene.name}: annotation mode {scene.annotation.mode}, {scene.annotation.source} truth, seed {scene.seed}"
        )
        sheet = contact_sheet(folder, title, scene.annotation.mode, camera_view_of, renderer or PlainIds())
        sheet.save(folder / SHEET_FILE)
    return folder / SHEET_FILE
