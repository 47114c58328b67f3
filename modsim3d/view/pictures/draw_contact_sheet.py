"""The contact sheet of a run."""

from __future__ import annotations

from pathlib import Path

from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.films.renderer import open_drawer
from modsim3d.view.pictures.contact_sheet import contact_sheet
from modsim3d.view.pictures.frame_picture import CameraView
from modsim3d.view.pictures.highlights import Highlight

SHEET_FILE = "contact_sheet.png"


def draw_contact_sheet(run: StoredRun) -> Path:
    """Draw the contact sheet of a finished run into its folder.

    Returns:
        The PNG's path.
    """
    scene, path = run.scene, run.folder / SHEET_FILE
    title = f"{scene.name}: annotation mode {scene.annotation.mode}, {scene.annotation.source} truth, seed {scene.seed}"

    def camera_view(highlight: Highlight) -> CameraView:
        return CameraView.of(scene, run.frame(highlight.camera, highlight.step))

    with open_drawer(scene) as drawer:
        contact_sheet(run.folder, title, scene.annotation.mode, camera_view, drawer).save(path)
    return path
