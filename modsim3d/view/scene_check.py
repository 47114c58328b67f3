"""Check of a scene before it runs: what it means, what is probably not meant, and a map of it."""

from dataclasses import dataclass
from pathlib import Path

from modsim3d.core.document import Document, Result, Table, Text, Where
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, out_file
from modsim3d.core.text import counted
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.camera_sequences import blind_at_first
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.scene.summary import (
    CameraSummary,
    VesselType,
    camera_summaries,
    doubts,
    sampled_tracks,
    scene_warnings,
    vessel_types,
)
from modsim3d.view.films.plan import WIDTH_PX
from modsim3d.view.map_marks import BirdsEye
from modsim3d.view.map_picture import check_map, save_map


@dataclass(frozen=True, repr=False)
class SceneCheck(Result):
    """Meaning of a scene, from `check_scene`: cameras at the first step, kinds of vessels, a map if one was drawn, and
    sentences on what is probably not meant."""

    cameras: list[CameraSummary]
    vessel_types: list[VesselType]
    warnings: list[str]
    map: Path | None

    def _document(self) -> Document:
        verdict = counted(len(self.warnings), "warning") if self.warnings else "no problems found"
        parts = ("vessels", self.vessel_types), ("camera", self.cameras), ("warning", self.warnings)
        rows = [(name, str(entry)) for name, part in parts for entry in part]
        return Document("", [Text(verdict, "lead", Where.EVERYWHERE)], [Table("", (), rows, where=Where.EVERYWHERE)])


def check_scene(scene: Scene | StrPath, out: StrPath | None = None, *, overwrite: bool = False) -> SceneCheck:
    """Check a scene: how each camera looks, which vessels there are, and what is probably not meant.

        print(modsim3d.check_scene("strait", "strait.png"))

    Args:
        scene: A scene, its file, or the name of a shipped scene.
        out: File to draw a map of the scene at its first step in, as PNG, SVG or PDF; none is drawn if None.
        overwrite: Replace a map that is there.

    Raises:
        ModsimError: The scene is wrong, or the map cannot be drawn.
        TypeError: A path is neither text nor a path.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    tracks = sampled_tracks(scene)
    warnings = [*scene_warnings(scene), *blind_at_first(scene), *doubts(scene, tracks)]
    path = None if out is None else out_file(out, Path(f"{scene.name}.png"))
    if path is not None:
        if scene.live:
            reason = "poses come in live, so nobody knows yet where vessels are: draw a run with view map"
            raise ModsimError(f"--map: {reason}")
        check_map(path)
        with claimed([path], overwrite=overwrite, inputs=scene.copy.read):
            save_map(BirdsEye(scene, scene.steps, tuple(range(len(scene.cameras)))), 0, path, WIDTH_PX)
    return SceneCheck(camera_summaries(scene), vessel_types(scene, tracks), warnings, path)
