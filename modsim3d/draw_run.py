"""Pictures of a run: joins what was simulated with how it is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.annotate.outlines import triangles_of
from modsim3d.block import frames_of
from modsim3d.camera import Camera
from modsim3d.compare import Case
from modsim3d.detector.reference import Reference
from modsim3d.frames import Array
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.scene import Scene
from modsim3d.simulate import Simulation, open_renderer, truth_block
from modsim3d.view.comparison_picture import comparison_picture
from modsim3d.view.contact_sheet import contact_sheet
from modsim3d.view.moments import Moment

SHEET_FILE = "contact_sheet.png"


def id_image(scene: Scene, camera_index: int, step: int, renderer: IdRenderer) -> Ids:
    """The whole ID image of a camera at a step: vessel index + 1, zero where no vessel is."""
    camera = scene.cameras[camera_index]
    outlines = scene.sight(camera, np.array([step])).outlines(camera.intrinsics, scene.vessels)
    triangles = triangles_of(outlines, camera.intrinsics)
    ids = outlines.vessel[triangles.row] + 1
    return renderer.draw(
        triangles.corners_px, triangles.inverse_depth, ids, Region(0, 0, *camera.intrinsics.image_size_px)
    )


def _sea_half_plane(scene: Scene, camera: Camera, step: int) -> Array:
    """The side of the horizon on which the sea lies at a step, shape (3,)."""
    camera_poses = scene.sight(camera, np.array([step])).camera_poses
    return camera.intrinsics.sea_half_plane(camera_poses.camera_R_world[0])


def draw_case(scene: Scene, case: Case, renderer: IdRenderer) -> Image.Image:
    """A case of a comparison: the boxes of all sources over the ID image."""
    camera = scene.cameras[case.camera]
    half_plane = _sea_half_plane(scene, camera, case.step)
    return comparison_picture(case.boxes_px, half_plane, id_image(scene, case.camera, case.step, renderer))


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
    names = [camera.name for camera in scene.cameras]
    with open_renderer(scene) as renderer:

        def look(moment: Moment):  # type: ignore[no-untyped-def]
            index, step = names.index(moment.camera), moment.step
            camera = scene.cameras[index]
            block = simulation.detect(truth_block(scene, step, step + 1, renderer), step, step + 1)
            frame = list(frames_of(block, scene))[index]
            half_plane = _sea_half_plane(scene, camera, step)
            ids = id_image(scene, index, step, renderer) if renderer else None
            return frame, ids, half_plane, camera.intrinsics.image_size_px

        title = (
            f"{scene.name}: annotation mode {scene.annotation.mode}, {scene.annotation.source} truth, seed {scene.seed}"
        )
        contact_sheet(folder, title, scene.vessel_names, look).save(folder / SHEET_FILE)
    return folder / SHEET_FILE
