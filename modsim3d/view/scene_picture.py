"""What a camera sees, without boxes."""

from __future__ import annotations

from PIL import Image

from modsim3d.camera import Camera
from modsim3d.render.plain_ids import IdDrawer
from modsim3d.scene import Scene
from modsim3d.view.canvas import Canvas
from modsim3d.view.plain import background, draw_horizon, fill_solids
from modsim3d.view.solids import Solids
from modsim3d.view.window import Window


def scene_picture(scene: Scene, camera: Camera, step: int, window: Window, drawer: IdDrawer) -> Image.Image:
    """What a camera sees at a step, in the plain style: sea, sky, and vessels as solids in their colours.

    Args:
        scene: The scene.
        camera: One of its cameras.
        step: The step.
        window: What of the camera's image to show, and how large.
        drawer: Says which solid is in front.
    """
    solids = Solids.at(scene, camera, step)
    image_size_px = camera.intrinsics.image_size_px
    picture = background(window, solids.sea_half_plane, image_size_px)
    draw_horizon(Canvas(picture), window, solids.sea_half_plane, image_size_px)
    fill_solids(picture, window, solids, drawer)
    return picture
