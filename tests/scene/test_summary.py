"""Facts about a scene as `check scene` shows them, by hand, and doubts about what is probably not meant."""

import json
from pathlib import Path
from typing import Any

import pytest

from modsim3d import load_scene
from modsim3d.scene.reading import shipped_scenes
from modsim3d.scene.summary import camera_summaries, doubts, sampled_tracks, vessel_types
from tests.packaging.test_documents import ROOT, blocks
from tests.scenes import camera_keys, write_scene

BOAT = [10, 4, 3]
SLOWLY = [[0, 0, 0], [10, 9, 0]]
ISLAND = {"island": {"polygon_m": [[40, -20], [60, -20], [60, 20], [40, 20]], "height_m": 9}}


def facts(folder: Path, boats: dict[str, Any], steps: int = 11, **keys: Any) -> tuple[list[str], list[str], list[str]]:
    """Lines on cameras and kinds of vessels, and doubts."""
    scene = load_scene(write_scene(folder, boats, steps, **keys))
    tracks = sampled_tracks(scene)
    return [*map(str, camera_summaries(scene))], [*map(str, vessel_types(scene, tracks))], doubts(scene, tracks)


@pytest.mark.parametrize("page", ["cameras", "scene"])
def test_a_page_shows_the_lines_that_its_scenes_have(tmp_path: Path, page: str) -> None:
    found, shown = set(), set()
    for language, text, file in blocks(ROOT / "docs" / f"{page}.md"):
        if file is not None:
            (tmp_path / file).parent.mkdir(exist_ok=True)
            (tmp_path / file).write_text(text)
            if "detector:" in text:
                found |= set(map(str, camera_summaries(load_scene(tmp_path / file))))
        elif language == "text":
            shown |= {line.strip() for line in text.splitlines() if "horizon at row" in line}
    assert shown and shown <= found


MEETING = {"a": (BOAT, [[0, 0, 0], [10, 50, 0]]), "b": (BOAT, [[0, 10, 1], [10, 40, 1]])}
DOUBTS: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "ferry": ({"a": ([14, 86, 20], SLOWLY)}, {}, "vessel 'a' is 14 m long and 86 m wide: are length_m and beam_m"),
    "millimetres": ({"a": ([0.086, 0.014, 2], SLOWLY)}, {}, "vessel 'a' is 0.086 m long, and vessels are 1 to 500 m"),
    "high": ({"a": ([86, 14, 2000], SLOWLY)}, {}, "vessel 'a' is 2000 m high, and vessels are 0.1 to 200 m high"),
    "fast": ({"a": (BOAT, [[0, 0, 0], [10, 400, 0]])}, {}, "vessel 'a' does 40 m/s, and 10 m long it can hardly do"),
    "ship": ({"a": ([300, 40, 50], [[0, 0, 0], [10, 250, 0]])}, {}, "vessel 'a' does 25 m/s, and 300 m long"),
    "island": (
        {"a": (BOAT, [[0, 0, 0], [10, 100, 0]])},
        {"obstacles": ISLAND},
        "the path of vessel 'a' leads through obstacle 'island' 4 s after the first step: move one of them",
    ),
    "meeting": (MEETING, {}, "vessels 'a' and 'b' are in one place 3 s after the first step"),
    "swapped": (
        {"a": (BOAT, SLOWLY)},
        {"cameras": {"C0": camera_keys(principal_point_px=[300, 400], pose={"position_m": [0, 0, 40]})}},
        "cameras.C0: the principal point (300, 400) is in the middle of 600 × 800, not of 800 × 600: swap",
    ),
}


@pytest.mark.parametrize(("boats", "keys", "said"), DOUBTS.values(), ids=DOUBTS)
def test_what_is_probably_not_meant_is_doubted(tmp_path: Path, boats, keys, said: str) -> None:
    keys = {"cameras": {"C0": camera_keys(pose={"position_m": [0, -90, 40]})}, **keys}
    found = facts(tmp_path, boats, **keys)[2]
    assert found[0].startswith(said) and "more like it" not in found[0]
    assert found[1:] == [each for each in found if "0.014 m wide, and vessels" in each]


@pytest.mark.parametrize("scene", sorted(shipped_scenes()))
def test_shipped_scenes_raise_no_doubt(scene: str) -> None:
    loaded = load_scene(scene)
    assert doubts(loaded, sampled_tracks(loaded)) == []


def test_a_line_on_each_camera_is_what_a_drawing_has_and_what_is_allowed_raises_no_doubt(tmp_path: Path) -> None:
    """Of 60°, f = 960 / tan 30° = 1662.8 px; 3° down the horizon is f tan 3° = 87.1 px above the middle, at row 453."""
    lens = {"hfov_deg": 60, "image_size_px": [1920, 1080]}
    board = {"vessel": "own", "position_m": [3, 0, 12]}
    cameras = {
        "bow": {**lens, "mount": {**board, "yaw_deg": -10, "pitch_deg": 3}},
        "stern": {**lens, "mount": {**board, "yaw_deg": 180, "pitch_deg": -30}},
        "pier": {**lens, "pose": {"position_m": [-50, -90, 8.04], "yaw_deg": 60, "pitch_deg": 30}},
    }
    own = (BOAT, [[0, 0, 0], [10, 0, 20]])  # heading along w2
    vessels = {"own": own, "ship": ([80, 14, 20], [[0, 0, 300], [10, 5, 300]])}
    lines, types, doubtful = facts(tmp_path, vessels, cameras=cameras)
    size = "1920 × 1080, 60.0° × 36.0°"
    assert lines == [
        f"bow: {size}, 12 m up, looks 10° to starboard and 3° down, horizon at row 453",
        f"stern: {size}, 12 m up, looks astern and 30° up, horizon below the image",
        f"pier: {size}, 8 m up, looks towards heading 60° and 30° down, horizon above the image",
    ]
    assert types == ["Vessel: 2, 10 to 80 × 4 to 14 × 3 to 20 m, 0.5 to 2 m/s"] and doubtful == []
    # A bridge over a path, a quay that a path touches, boats that pass each other, and one that leaves and returns
    bridge = {"bridge": {"polygon_m": ISLAND["island"]["polygon_m"], "height_m": 3, "base_m": 4}}
    quay = {"quay": {"polygon_m": [[0, 0], [100, 0], [100, -9], [0, -9]], "height_m": 3}}
    cameras = {"C0": camera_keys(pose={"position_m": [0, -90, 40]})}
    boats = {"a": (BOAT, [[0, 0, 0], [10, 100, 0]]), "b": (BOAT, [[0, 50, 6], [10, 0, 6]])}
    assert facts(tmp_path, boats, obstacles=bridge | quay, cameras=cameras)[2] == []
    poses = {f"{t}.0": {"a": {"center_position_m": [99.0 * t, 0, 0], "heading_rad": 0.0}} for t in (0, 2)}
    poses = {"0.0": poses["0.0"], "1.0": {}, "2.0": poses["2.0"]}
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    keys = {"poses": {"file": "poses.json"}, "obstacles": ISLAND, "time_step_s": None, "cameras": cameras}
    assert facts(tmp_path, {"a": (BOAT, [])}, 3, **keys)[2] == []
