"""The places that films are made of: scene files in `scenes/`, each with a camera ashore and one on board."""

from __future__ import annotations

from pathlib import Path

from modsim3d.io.strict_text import load_yaml
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.view.sea_and_sky import RenderStyle

SCENES = Path(__file__).parent / "scenes"
PLACES = ("harbour", "strait", "basin")
VISIBILITIES_M = {"clear": None, "800 m": 800.0, "300 m": 300.0}
"""Visibility by weather; weathers are the states of `scenes/detector.yaml`."""
WEATHERS = tuple(VISIBILITIES_M)
VIEWPOINTS = ("shore", "own")
"""The cameras of each scene file."""


def style_of(weather: str) -> RenderStyle:
    """Light and shade in a weather without a caption that says which: a detector would read it."""
    return RenderStyle(shaded=True, visibility_m=VISIBILITIES_M[weather])


def place_scene(place: str, viewpoint: str, weather: str, seed: int, steps: int | None = None) -> Scene:
    """The scene of a place with one camera, in one performance state from its first step to its last.

    Args:
        place: One of `PLACES`.
        viewpoint: One of `VIEWPOINTS`.
        weather: One of `WEATHERS`.
        seed: What the traffic and the waves are drawn from.
        steps: Number of steps; as the file says if None.
    """
    path = SCENES / f"{place}.yaml"
    cameras = {viewpoint: load_yaml(path, "scene")["cameras"][viewpoint]}
    return load_scene(path, seed=seed, steps=steps, state=weather, settings={"cameras": cameras})
