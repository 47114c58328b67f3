"""Runs many detectors and seeds over one truth in memory, for campaigns and tests of the detector."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.detector.chain import Detector, take_census
from modsim3d.detector.model import DetectorModel
from modsim3d.runs.pipeline import DetectorInput, block_ranges, block_steps, detector_inputs, open_renderer, truth_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth, concatenate
from modsim3d.verify.evidence import CameraEvidence, Evidence


@dataclass(frozen=True, eq=False)
class ManyDetections:
    """The truth of a whole run, as the inputs of each camera's detector."""

    scene: Scene
    inputs: tuple[DetectorInput, ...]

    @classmethod
    def of_scene(cls, scene: Scene) -> ManyDetections:
        """Make the truth of a scene."""
        with open_renderer(scene) as renderer:
            ranges = block_ranges(scene.steps, block_steps(scene))
            return cls.of_truth(scene, concatenate([truth_block(scene, *steps, renderer) for steps in ranges]))

    @classmethod
    def of_truth(cls, scene: Scene, truth: Truth) -> ManyDetections:
        """Take the truth of a whole run, such as that of a stored run."""
        return cls(scene, tuple(detector_inputs(scene, truth, 0, scene.steps)))

    def detect(self, model: DetectorModel, seed: int) -> Evidence:
        """What a run with this detector and seed would show."""
        census = take_census(model, ((part.frames, part.targets) for part in self.inputs))
        detector = Detector(model, seed, census, self.scene.times_s)
        return Evidence.of(
            [
                CameraEvidence(part.frames, part.targets, detector.detect(part.frames, part.targets))
                for part in self.inputs
            ]
        )
