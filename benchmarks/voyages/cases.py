"""The simulated voyages: which scene, what is wrong with its AIS, and what is learned."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import yaml

from benchmarks.processes import ROOT
from benchmarks.voyages.reported import AisErrors
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import SCENE, write_scene
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

HERE = Path(__file__).resolve().parent
STRAIT_DETECTOR, TRAFFIC = HERE / "strait_detector.yaml", HERE / "strait_traffic.yaml"
DETECTORS = {
    "strait_minute": STRAIT_DETECTOR,
    "strait_traffic": STRAIT_DETECTOR,
    "lanes": HERE / "detector.yaml",
    "sample": HERE / "one_label.yaml",
}
"""Files of the detectors that are learned, by scene."""
SAMPLE = ROOT / "tests" / "data" / "ais" / "receiver.nmea"
MESHES = ("own", "ferry", "container_ship", "sailboat", "yacht", "motorboat", "trawler", "kayak")
SHOEBOXES = {f"vessels.{name}.mesh": None for name in MESHES}
"""Of the strait: a camera that is wrong by metres may stand in own ship's hull, and shoeboxes take less time."""
REGISTRATION_SETTINGS = {
    **SHOEBOXES,
    "annotation.source": "analytic",
    "waves.apply_to": "ownship",
    "detector.states.clear.box_error.mean": [0, 0, 0, 0],
    "detector.states.haze.box_error.mean": [0, 0, 0, 0],
}
"""Of the strait. Mean box errors are zero, as the rule has it."""
DETECTOR_SETTINGS = {
    "annotation.source": "analytic",
    "waves.apply_to": "ownship",
    "detector": str(STRAIT_DETECTOR),
}
"""Of the strait where a detector is learned, with `TRAFFIC` besides in the longer voyage."""
FIRST_SEED = 100
"""Seeds below it were looked at while learning was built, so that it may suit them better than others."""
CLEAN = AisErrors()
AIS = AisErrors(position_m=3.0, position_s=300.0, delay_s=0.5, absent=0.2)
"""Positions as good as those of satellite navigation with corrections, delays, and vessels without a transponder."""

ALL = replace(AIS, absent=0.0)
TOLD_M = 3.0
"""What `--position-noise` says of them. Late reports are errors too, but of a kind that registration finds."""
PRIORS = (("offsets_m", 5.0), ("noise_m", 3.0))
"""What `modsim3d learn` expects of a scene from AIS, and the errors of positions."""


@dataclass(frozen=True)
class Case:
    """A voyage that is simulated with many seeds.

    Attributes:
        name: What it is called on the page and by `--case`.
        title: Its heading on the page.
        said: What is special about it.
        scene: `strait`, `strait_minute`, `strait_traffic`, `lanes` or `sample`.
        camera: The camera.
        errors: What is wrong with the positions that the user has.
        learns: Whether a detector is learned; else the camera and the clock are registered alone.
        registered: Whether the camera is registered before it is learned.
        guessed: Whether sizes and headings are off as well, as learning takes them to be; only of `sample`.
        priors: What registration is told besides: see `register`.
    """

    name: str
    title: str
    said: str
    scene: str
    camera: str
    errors: AisErrors = CLEAN
    learns: bool = False
    registered: bool = True
    guessed: bool = False
    priors: tuple[tuple[str, float], ...] = ()

    @property
    def detector(self) -> Path:
        """The file of the detector that is learned."""
        return DETECTORS[self.scene]

    def true_scene(self) -> Scene:
        """The scene as it really is, but for the camera and the clock."""
        return _scene(self.scene)


SAMPLE_SAID = (
    "The scene that `modsim3d ais` makes of `tests/data/ais/receiver.nmea`, with errors added. The simulated vessels "
    "differ from it by as much as [learning expects](../voyage.md#how-well-the-truth-is-known): guessed dimensions and "
    "all air drafts by 30 % (standard deviation), sent dimensions by rounding, headings by 1° or, taken from the "
    "course, by 6°, for 300 s. Every air draft is a guess, so the error in height is an upper bound, and that in y "
    "nearly always."
)
CASES = (
    Case("bow", "Registration on board", "A camera on a moving vessel; the tracks are true.", "strait", "bow"),
    Case("quay", "Registration ashore", "A camera ashore; the tracks are true.", "strait", "quay"),
    Case("bow_ais", "Registration on board, by AIS", "Tracks as AIS gives them.", "strait", "bow", AIS,
         priors=PRIORS),
    Case("quay_ais", "Registration ashore, by AIS", "Tracks as AIS gives them.", "strait", "quay", AIS,
         priors=PRIORS),
    Case("sample", "Registration in the scene of an AIS log", "The scene that `modsim3d ais` makes of "
         "`tests/data/ais/receiver.nmea`, with errors added. Dimensions that the log lacks are guesses, so the sizes "
         "of boxes do not take part. The simulated vessels are just as large as guessed.", "sample", "shore", AIS,
         priors=(*PRIORS, ("use_sizes", False))),
    Case("detector", "Detector, true tracks", "Camera and clock are registered, then the detector is learned.",
         "lanes", "shore", CLEAN, learns=True),
    Case("detector_all", "Detector, by AIS of all vessels", "Tracks as AIS gives them, of vessels that all have a "
         "transponder.", "lanes", "shore", ALL, learns=True),
    Case("detector_ais", "Detector, by AIS", "The same, and a fifth of the vessels has no transponder.",
         "lanes", "shore", AIS, learns=True),
    Case("unregistered", "Detector, by AIS, without registration", "The same voyages with `--fixed all`: the camera "
         "and the clock are taken as the scene has them.", "lanes", "shore", AIS, learns=True, registered=False),
    Case("strait_true", "Detector in the strait, true tracks", "Camera and clock of a moving vessel are registered, "
         "then the detector is learned.", "strait_minute", "bow", CLEAN, learns=True),
    Case("strait_ais", "Detector in the strait, by AIS", "A fifth of the vessels has no transponder. The shipped "
         "minute is too near for AIS: its kayak comes to 33 m, where an error of 3 m is 120 px, more than the 50 px "
         "within which boxes match. So this is a longer voyage in the same strait, and the nearest vessels pass at "
         "180 m.", "strait_traffic", "bow", AIS, learns=True),
    Case("sample_all", "Detector in the scene of an AIS log, with all vessels", SAMPLE_SAID, "sample", "shore", ALL,
         learns=True, guessed=True),
    Case("sample_ais", "Detector in the scene of an AIS log", "The same, and a fifth of the vessels has no "
         "transponder.", "sample", "shore", AIS, learns=True, guessed=True),
)  # fmt: skip
BY_NAME = {case.name: case for case in CASES}


@cache
def _scene(name: str) -> Scene:
    if name == "strait":
        return load_scene("strait", settings=REGISTRATION_SETTINGS)
    if name == "strait_traffic":
        longer = yaml.safe_load(TRAFFIC.read_text(encoding="utf-8"))
        return load_scene("strait", settings=DETECTOR_SETTINGS | longer)
    if name == "strait_minute":
        return load_scene("strait", settings=DETECTOR_SETTINGS | SHOEBOXES)
    return _of_sample() if name == "sample" else load_scene(HERE / "lanes.yaml")


def scene_of_sample(folder: Path) -> Scene:
    """The scene that `modsim3d ais` makes of the log, written into a folder."""
    write_scene(read_traffic([SAMPLE], Options()), folder, DETECTORS["sample"])
    return load_scene(folder / SCENE, settings={"annotation.source": "analytic"})


def _of_sample() -> Scene:
    """The same, and the folder is gone: nothing knows that it is from AIS."""
    with tempfile.TemporaryDirectory() as folder:
        return scene_of_sample(Path(folder))
