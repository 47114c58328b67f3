"""Many seeds and detectors over one truth, in memory: what campaigns and tests of the detector need."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.annotate.record import Truth, concatenate
from modsim3d.detector.chain import Detector, reference_of
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.reference import Reference
from modsim3d.learn.evidence import CameraEvidence, Evidence
from modsim3d.scene import Scene
from modsim3d.simulate import DetectorInput, block_ranges, block_steps, detector_inputs, open_renderer, truth_block


@dataclass(frozen=True, eq=False)
class ManyDetections:
    """What the cameras of a scene give their detectors over a whole run.

    Attributes:
        scene: The scene.
        inputs: One for each camera.
    """

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
        """From the truth of a whole run, such as a stored one's."""
        return cls(scene, tuple(detector_inputs(scene, truth, 0, scene.steps)))

    def reference(self, model: DetectorModel) -> Reference | None:
        """What a detector must know of the truth before it can begin, if anything."""
        if not model.needs_reference:
            return None
        return sum((reference_of(model, part.frames, part.targets) for part in self.inputs), Reference())

    def detect(self, model: DetectorModel, seed: int) -> Evidence:
        """What a run with this detector and seed would show."""
        detector = Detector(model, seed, self.scene.times_s, self.reference(model))
        return Evidence.of(
            [
                CameraEvidence(part.frames, part.targets, detector.detect(part.frames, part.targets))
                for part in self.inputs
            ]
        )
